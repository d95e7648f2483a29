"""What a match writes, key by key."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.identify.writing import Change
from bstm_daemon.analysis.matching.changes import changes_of, learned
from bstm_daemon.analysis.matching.coarse import CAPACITY, FILTER
from bstm_daemon.analysis.matching.refine import NodeAccuracy
from bstm_daemon.analysis.matching.tunables import (
    CONDUCTANCE,
    CONTACT,
    DRAG,
    MASS,
    MIDDLE,
    SLOW,
)

from ...made_matches import match_of  # noqa: TID252  (tests are no package)

if TYPE_CHECKING:
    from bstm_daemon.analysis.matching.tunables import Target
    from bstm_daemon.config.sections import Config

FADE = "thermal.hot_pad_factor"
"""What no corner of the example has a value of its own for."""


def of(changes: list[Change], key: str) -> list[Change]:
    return [one for one in changes if one.key == key]


@pytest.fixture
def both(target: Target) -> Target:
    return replace(target, corners=("FL", "FR"))


def test_a_value_goes_where_its_readers_have_it(both: Target) -> None:
    """The rear corners have a mass of their own, and no factor."""
    values = {MASS: 1.1, FADE: 0.8, DRAG: 0.7}

    found = changes_of([match_of(both, values)], both.config, "by drives")

    assert found == [
        Change(
            "thermal", MASS.partition(".")[2], 1.1, "", "by drives, sd 0.11"
        ),
        Change("corner", FADE, 0.8, "FL", "by drives, sd 0.04"),
        Change("corner", FADE, 0.8, "FR", "by drives, sd 0.04"),
        Change("vehicle", "drag_area_m2", 0.7, "", "by drives, sd 0.023"),
    ]


def test_what_all_corners_read_goes_to_its_section(target: Target) -> None:
    every = tuple(one.name for one in target.config.disc_corners())
    all_of = replace(target, corners=every)

    found = changes_of(
        [match_of(all_of, {FADE: 0.8})], target.config, "by drives"
    )

    assert found == [
        Change("thermal", "hot_pad_factor", 0.8, "", "by drives, sd 0.08")
    ]


def test_the_table_says_its_worst_factor_in_percent(both: Target) -> None:
    match = match_of(both, {MASS: 1.0, SLOW: 2.0, MIDDLE: 0.5})

    found = changes_of([match], both.config, "by drives")

    cooling = match.after.config.cooling_of(match.after.corner)
    # the factors' own are 5 % and 3.3 %
    assert of(found, "s_per_s") == [
        Change(
            *("cooling", "s_per_s", tuple(cooling.s_per_s)),
            note="by drives, sd 5 %",
        )
    ]
    assert match.deviation("cooling.s_per_s") == pytest.approx(0.05)


def test_what_was_chosen_has_no_deviation(both: Target) -> None:
    heat = both.config.heat.model_copy(update={"derivative_filter_s": 0.02})
    after = replace(
        both, config=both.config.model_copy(update={"heat": heat})
    ).with_disc(heat_capacity_exponent=0.0)
    match = match_of(both, {MASS: 1.1}, after=after)

    found = changes_of([match], both.config, "by drives")

    assert of(found, "derivative_filter_s") == [
        Change("heat", "derivative_filter_s", 0.02, "", "by drives")
    ]
    exponents = of(found, CAPACITY)
    assert [(one.corner, one.value, one.note) for one in exponents] == [
        ("FL", 0.0, "by drives"),
        ("FR", 0.0, "by drives"),
    ]
    assert np.isnan(match.deviation(FILTER))
    assert match.deviation(MASS) == pytest.approx(0.11)


@pytest.mark.parametrize("matched", [("FL", "FR"), None])
def test_an_effect_is_of_the_corners_or_of_all(
    config: Config, matched: tuple[str, ...] | None, target: Target
) -> None:
    every = tuple(one.name for one in config.disc_corners())
    one = replace(target, corners=matched or every)
    # the entry itself is of what the match added
    match = match_of(one, {CONDUCTANCE: 1400.0}, after=one)

    found = changes_of([match], config, "by drives")

    assert [(one.corner, one.effect, one.key) for one in found] == [
        (corner, CONTACT, "conductance_w_m2k")
        for corner in matched or ("all",)
    ]
    assert {(one.section, one.value) for one in found} == {("effect", 1400.0)}


def test_a_corner_that_is_alike_gets_the_values(target: Target) -> None:
    """But is none of those that the match is of."""
    one = replace(target, corners=("FL",), alike=("FR",))
    match = replace(match_of(one, {FADE: 0.8}), drives=[Any])

    found = of(changes_of([match], one.config, "by drives"), FADE)

    assert [(change.corner, change.value) for change in found] == [
        ("FL", 0.8),
        ("FR", 0.8),
    ]
    table = learned(match)
    assert (table.corners, table.alike) == (["FL"], ["FR"])


def test_accuracy_is_that_of_the_worst_corner(target: Target) -> None:
    def of_corner(corner: str, floor_k: float, left_out: str) -> Any:
        nodes = {"disc": NodeAccuracy(floor_k, 0.01 * floor_k)}
        if corner == "FL":
            nodes["pad_back"] = NodeAccuracy(3.0, 0.02)
        return match_of(target.of(corner), {}, left_out=left_out, nodes=nodes)

    found = changes_of(
        [of_corner("FL", 4.0, "a drive"), of_corner("FR", 5.0, "")],
        target.config,
        "by drives",
    )

    small = "by drives, residual on the drive itself: too small"
    assert found == [
        Change("accuracy", "disc_k", 5.0, note=small),
        Change("accuracy", "disc_share", 0.05, note=small),
        Change(
            "accuracy", "pad_back_k", 3.0,
            note="by drives, residual on what was left out",
        ),
        Change(
            "accuracy", "pad_back_share", 0.02,
            note="by drives, residual on what was left out",
        ),
    ]  # fmt: skip


def test_what_is_the_cars_own_is_said_once(target: Target) -> None:
    matches = [
        match_of(target.of(corner), {DRAG: 0.7}) for corner in ("FL", "FR")
    ]

    found = changes_of(matches, target.config, "by drives")

    assert len(found) == 1
