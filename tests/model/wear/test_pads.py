"""What switches and people say of one corner's linings."""

from __future__ import annotations

import json
from datetime import date
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.estimate import WearSource
from bstm_daemon.model.wear.pads import Change, PadWear

if TYPE_CHECKING:
    from collections.abc import Callable

EXPECTED = 3e-13 / 13e-3
MJ_A_MM = 40e6
"""The dose of a millimetre in most tests; expected are 43 MJ."""


@pytest.fixture
def make(
    make_car: Callable[..., Any], make_corner: Callable[..., Any]
) -> Callable[..., PadWear]:
    """Return the maker of a corner's wear with keys of its pad."""

    def maker(**pad: Any) -> PadWear:
        table = {"area_m2": 6.5e-3, "thickness_m": 0.011} | pad
        car = make_car(make_corner(pad=table))
        return PadWear(car, car.corner[0])

    return maker


def test_without_a_switch_the_expected_rate_wears_the_configured_lining(
    make: Callable[..., PadWear],
) -> None:
    law = make(thickness_m=0.008).law

    assert law.source is WearSource.CONFIGURED
    assert law.thickness_at_m(0.0) == 0.008
    assert law.thickness_at_m(1e-3 / EXPECTED) == pytest.approx(0.007)
    assert law.std_at_m(0.0) == pytest.approx(5e-4)
    assert law.std_at_m(4e-3 / EXPECTED) > 2e-3


def test_a_life_with_all_three_switches(make: Callable[..., PadWear]) -> None:
    """Section 4.6 from new pads to the second indicator and beyond."""
    pad = make(thickness_m=0.006, new_thickness_m=0.011)

    pad.happened("pads_new", 5e6, 1e3, seen=True)
    assert pad.law.source is WearSource.NEW_PADS
    assert pad.change is Change.FITTED
    assert pad.law.thickness_at_m(5e6) == 0.011
    pad.off("pad_worn_1mm", 5e6)
    assert pad.law.thickness_at_m(200e6) == pytest.approx(0.010)

    pad.happened("pad_worn_1mm", 5e6 + MJ_A_MM, 2e6, seen=True)
    assert pad.law.source is WearSource.FIRST_INDICATOR
    assert pad.law.rate_m_j == pytest.approx(1e-3 / MJ_A_MM)
    assert pad.law.thickness_at_m(5e6 + 3 * MJ_A_MM) == pytest.approx(0.008)
    pad.off("pad_2mm_left", 5e6 + MJ_A_MM)
    assert pad.law.thickness_at_m(1e9) == pytest.approx(0.002)

    # eight millimetres at 50 MJ each
    pad.happened("pad_2mm_left", 5e6 + MJ_A_MM + 400e6, 2e7, seen=True)
    assert pad.law.source is WearSource.SECOND_INDICATOR
    assert pad.law.rate_m_j == pytest.approx(1e-3 / 50e6)
    at_j = pad.law.dose_j
    assert pad.law.thickness_at_m(at_j) == pytest.approx(0.002)
    assert pad.law.thickness_at_m(at_j + 50e6) == pytest.approx(0.001)
    assert pad.law.thickness_at_m(at_j + 500e6) == 0.0


@pytest.mark.parametrize("late", ["pad_worn_1mm", "pad_2mm_left"])
def test_a_loose_contact_gives_no_lining_back(
    make: Callable[..., PadWear], late: str
) -> None:
    """On again, or the first indicator after the second: nothing new."""
    pad = make()
    pad.happened("pads_new", 0.0, 0.0, seen=True)
    pad.happened("pad_worn_1mm", MJ_A_MM, 0.0, seen=True)
    if late == "pad_2mm_left":
        pad.happened(late, 9 * MJ_A_MM, 0.0, seen=True)
    law, thickness_m = pad.law, pad.law.thickness_at_m(9.5 * MJ_A_MM)

    pad.happened("pad_worn_1mm", 9.5 * MJ_A_MM, 0.0, seen=True)

    assert pad.law == law
    assert pad.law.thickness_at_m(9.5 * MJ_A_MM) == thickness_m


def test_the_next_set_begins_with_what_the_last_one_taught(
    make: Callable[..., PadWear],
) -> None:
    pad = make()
    pad.happened("pads_new", 0.0, 0.0, seen=True)
    pad.happened("pad_worn_1mm", MJ_A_MM, 1e6, seen=True)

    pad.happened("pads_new", 10 * MJ_A_MM, 1e7, seen=True)

    assert pad.law.source is WearSource.NEW_PADS
    assert pad.law.rate_m_j == pytest.approx(1e-3 / MJ_A_MM)
    assert pad.law.rate_spread == pytest.approx(0.15)
    assert pad.first_dose_j is None


def test_second_indicator_alone_uses_the_whole_life(
    make: Callable[..., PadWear],
) -> None:
    pad = make()
    pad.happened("pads_new", 0.0, 0.0, seen=True)

    pad.happened("pad_2mm_left", 9 * MJ_A_MM, 1e6, seen=True)

    assert pad.law.rate_m_j == pytest.approx(1e-3 / MJ_A_MM)


def test_a_switch_of_unknown_begin_bounds_and_teaches_nothing(
    make: Callable[..., PadWear],
) -> None:
    """On from the first moment: worn, but nobody knows since when."""
    pad = make()

    pad.happened("pad_worn_1mm", 1e6, 0.0, seen=False)

    assert pad.law.source is WearSource.CONFIGURED
    assert pad.law.rate_m_j == pytest.approx(EXPECTED)
    assert pad.law.thickness_at_m(1e6) == pytest.approx(0.010)
    assert pad.law.highest_m == pytest.approx(0.010)


def test_pads_of_unknown_age_correct_but_teach_nothing(
    make: Callable[..., PadWear],
) -> None:
    pad = make(thickness_m=0.009, new_thickness_m=0.011)

    pad.happened("pad_worn_1mm", 1e6, 0.0, seen=True)

    assert pad.law.source is WearSource.CONFIGURED
    assert pad.law.thickness_at_m(1e6) == pytest.approx(0.010)
    assert pad.law.rate_m_j == pytest.approx(EXPECTED)
    pad.happened("pad_2mm_left", 2e6, 0.0, seen=True)
    # from a first indicator of unknown age on eight millimetres are known
    assert pad.law.thickness_at_m(2e6) == pytest.approx(0.002)


def test_the_second_indicator_alone_of_unknown_pads(
    make: Callable[..., PadWear],
) -> None:
    pad = make(thickness_m=0.009, new_thickness_m=0.011)

    pad.happened("pad_2mm_left", 9 * MJ_A_MM, 0.0, seen=True)

    assert pad.law.thickness_at_m(9 * MJ_A_MM) == pytest.approx(0.002)
    assert pad.law.rate_m_j == pytest.approx(EXPECTED)


@pytest.mark.parametrize(
    ("thickness_m", "new_dose_j"),
    [(0.01089, None), (0.01091, 0.0), (0.011, 0.0)],
)
def test_a_configured_lining_is_new_within_a_tenth(
    make: Callable[..., PadWear], thickness_m: float, new_dose_j: float | None
) -> None:
    pad = make(thickness_m=thickness_m, new_thickness_m=0.011)

    assert pad.new_dose_j == new_dose_j


def test_an_indicator_on_from_the_start_takes_back_that_it_was_off(
    make: Callable[..., PadWear],
) -> None:
    pad = make()
    pad.off("pad_2mm_left", 0.0)

    pad.happened("pad_2mm_left", 1e6, 0.0, seen=False)

    assert pad.law.lowest_m == 0.0
    assert pad.law.thickness_at_m(1e6) == pytest.approx(0.002)


def test_a_corner_without_pads(make_car: Callable[..., Any]) -> None:
    car = make_car()
    bare = car.corner[0].model_copy(update={"pad": None})

    with pytest.raises(ValueError, match="corner FL: no pads"):
        PadWear(car, bare)


@pytest.mark.parametrize("dose_j", [0.0, 1e5, 1e12])
def test_a_switch_that_can_not_be_of_these_pads_teaches_nothing(
    make: Callable[..., PadWear], dose_j: float
) -> None:
    pad = make()
    pad.happened("pads_new", 0.0, 0.0, seen=True)

    pad.happened("pad_worn_1mm", dose_j, 0.0, seen=True)

    assert pad.law.rate_m_j == pytest.approx(EXPECTED)
    assert pad.learned_rate_m_j is None


def test_new_pads_from_the_start_on_are_no_event(
    make: Callable[..., PadWear],
) -> None:
    """A switch stuck on must not renew the linings at every start."""
    pad = make(thickness_m=0.005, new_thickness_m=0.011)

    pad.happened("pads_new", 1e6, 0.0, seen=False)

    assert pad.law.thickness_at_m(1e6) < 0.005


def test_state_comes_back_whole(make: Callable[..., PadWear]) -> None:
    pad = make()
    pad.happened("pads_new", 3e6, 5.0, seen=True)
    pad.off("pad_worn_1mm", 4e6)
    pad.happened("pad_worn_1mm", MJ_A_MM, 1e6, seen=True)
    saved = json.loads(json.dumps(pad.export(), allow_nan=False))

    fresh = make()
    fresh.restore(saved, 50e6)

    assert fresh.law == pad.law
    assert fresh.export() == pad.export()
    assert saved["entry"] == [0.011, None, 0.0]


@pytest.mark.parametrize(
    "pad_table",
    [{"thickness_m": 0.0065}, {"measured": date(2026, 5, 1)}],
)
def test_a_changed_entry_is_a_measurement_of_now(
    make: Callable[..., PadWear], pad_table: dict[str, Any]
) -> None:
    pad = make(new_thickness_m=0.011)
    saved = pad.export()
    fresh = make(new_thickness_m=0.011, **pad_table)

    fresh.restore(saved, 100e6)

    entered_m = pad_table.get("thickness_m", 0.011)
    assert fresh.law.thickness_at_m(100e6) == entered_m
    assert fresh.law.std_at_m(100e6) == pytest.approx(5e-4)
    assert fresh.change is Change.CORRECTED
    assert fresh.first_dose_j is None


def test_a_disc_that_is_entered_anew(make: Callable[..., PadWear]) -> None:
    """Its loss counts from now; what was worn before is in the entry."""
    pad = make(thickness_m=0.009, new_thickness_m=0.011)
    pad.new_dose_j = 0.0

    pad.configure([0.009, None, 3e-4], 1e9)

    assert pad.law.disc_loss_at_m(1e9) == 0.0
    assert pad.new_dose_j is None
    pad.configure([0.008, None, 0.0], 2e9)
    assert pad.law.disc_loss_at_m(2e9) == pytest.approx(1e9 * 1e-13 / 42.5e-3)


def test_the_same_entry_is_not_news(make: Callable[..., PadWear]) -> None:
    saved = make().export()
    fresh = make()

    fresh.restore(saved, 100e6)

    assert fresh.law.thickness_at_m(100e6) == pytest.approx(
        0.011 - EXPECTED * 100e6
    )


@pytest.mark.parametrize(
    "change",
    [
        {"law": {}},
        {"law": None},
        {"learned_rate_m_j": "fast"},
        {"begin_dose_j": None},
    ],
)
def test_what_is_no_state_is_refused(
    make: Callable[..., PadWear], change: dict[str, Any]
) -> None:
    saved = make().export() | change

    with pytest.raises((KeyError, TypeError, ValueError)):
        make().restore(saved, 0.0)


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("source", WearSource.NOT_AVAILABLE, "rests on nothing"),
        ("dose_j", float("inf"), "dose_j = inf: not a number"),
    ],
)
def test_a_law_that_no_lining_has_is_refused(
    make: Callable[..., PadWear], name: str, value: float, reason: str
) -> None:
    saved = make().export()
    saved["law"][name] = value

    with pytest.raises(ValueError, match=reason):
        make().restore(saved, 0.0)


@pytest.mark.parametrize("name", ["highest_m", "lowest_m", "thickness_m"])
@pytest.mark.parametrize("value", [{}, "thick", float("nan"), [0.01]])
def test_a_law_of_anything_but_numbers_is_refused(
    make: Callable[..., PadWear], name: str, value: object
) -> None:
    saved = make().export()
    saved["law"][name] = value

    with pytest.raises((TypeError, ValueError)):
        make().restore(saved, 0.0)
