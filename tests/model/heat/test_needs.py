"""Logs without an input that its reader needs."""

import pytest

from bstm_daemon.errors import LogError
from bstm_daemon.model.heat.needs import check_inputs
from bstm_daemon.roles import ROLE_INDEX

WHEELS = {ROLE_INDEX[f"wheel_speed_{name}"] for name in ("fl", "fr")}
PRESSURE = {ROLE_INDEX["primary_pressure"]}
OVER_GROUND = {ROLE_INDEX["gnss_speed"]}


def test_an_input_is_missing_where_all_its_roles_are() -> None:
    names = ("speed", "pressure")

    with pytest.raises(LogError) as caught:
        check_inputs("a.log", PRESSURE, WHEELS | PRESSURE, names, "the heat")

    assert str(caught.value) == (
        "a.log: no speed in this log (roles wheel_speed_fl, wheel_speed_fr), "
        "which the heat needs"
    )


@pytest.mark.parametrize(
    ("mapped", "seen"),
    [
        (WHEELS | PRESSURE, PRESSURE | {min(WHEELS)}),
        # what nothing is mapped to is not waited for, nor what only checks
        (PRESSURE, PRESSURE),
        (PRESSURE | OVER_GROUND, PRESSURE),
    ],
)
def test_one_role_of_an_input_is_enough(
    mapped: set[int], seen: set[int]
) -> None:
    check_inputs("a.log", seen, mapped, ("speed", "pressure"), "the heat")
