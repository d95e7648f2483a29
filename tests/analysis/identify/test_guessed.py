"""What a first configuration guesses, found from forces."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from bstm_daemon.analysis.identify.guessed import (
    identified_guesses,
    with_changes,
)
from bstm_daemon.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.identify.driving import Driving
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

    from .conftest import Logged

FRICTION = "corner.friction_coefficient"
DRAG = "vehicle.drag_area_m2"


def guess(config: Config) -> Config:
    """Return *config* with another friction and another drag."""
    corners = [
        one.model_copy(update={"friction_coefficient": 0.30})
        for one in config.corner
    ]
    vehicle = config.vehicle.model_copy(update={"drag_area_m2": 1.1})
    return config.model_copy(update={"corner": corners, "vehicle": vehicle})


@pytest.mark.slow
def test_guesses_are_found_and_measured_values_stay(
    logged: Logged,
    driving: Callable[..., Driving],
    example: tuple[Config, SignalMap],
) -> None:
    right, wrong = example[0], guess(example[0])
    drives = [driving(logged(one)) for one in ("coastdown", "idiada-ramp")]

    changes, why_not = identified_guesses(
        wrong, frozenset({FRICTION, DRAG}), lambda: drives
    )
    found = with_changes(wrong, changes)

    assert why_not == []
    assert {one.key for one in changes} == {
        "friction_coefficient",
        "drag_area_m2",
    }
    assert found.vehicle.drag_area_m2 == pytest.approx(
        right.vehicle.drag_area_m2, rel=0.05
    )
    assert [one.friction_coefficient for one in found.corner] == pytest.approx(
        [one.friction_coefficient for one in right.corner], rel=0.02
    )
    # nobody called these a guess
    assert found.vehicle.rolling_resistance == wrong.vehicle.rolling_resistance

    only_drag, _ = identified_guesses(wrong, frozenset({DRAG}), lambda: drives)
    assert {one.key for one in only_drag} == {"drag_area_m2"}


@pytest.mark.slow
def test_what_the_drives_do_not_show_is_said(
    logged: Logged,
    driving: Callable[..., Driving],
    example: tuple[Config, SignalMap],
) -> None:
    drives = [driving(logged("idiada-ramp"))]

    changes, why_not = identified_guesses(
        example[0], frozenset({FRICTION, DRAG}), lambda: drives
    )

    assert {one.key for one in changes} == {"friction_coefficient"}
    assert len(why_not) == 1
    assert why_not[0].startswith("no coast-down found")


def test_logs_are_read_only_for_guesses(
    example: tuple[Config, SignalMap],
) -> None:
    def read() -> list[Driving]:
        msg = "no speed in this log"
        raise LogError(msg)

    config = example[0]
    without = config.model_copy(
        update={
            "signals": {
                role: one
                for role, one in config.signals.items()
                if "pressure" not in role
            }
        }
    )

    assert identified_guesses(config, frozenset(), read) == ([], [])
    assert identified_guesses(without, frozenset({FRICTION}), read) == ([], [])
    assert identified_guesses(config, frozenset({DRAG}), read) == (
        [],
        ["no speed in this log"],
    )
