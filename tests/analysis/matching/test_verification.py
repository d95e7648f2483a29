"""Errors, peaks, verdicts and coverage of known curves."""

from __future__ import annotations

from dataclasses import replace
from math import isnan
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.matching.baseline import baselines
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.refine import NodeAccuracy
from bstm_daemon.analysis.matching.thermocouples import Thermocouple
from bstm_daemon.analysis.matching.verification import (
    LONG_S,
    NodeErrors,
    Verdict,
    compared,
    coverage,
    decisive,
    errors_of,
    held_against,
    judged,
    peak_of,
)
from bstm_daemon.channels import CHANNELS

from ...made_drives import lumped  # noqa: TID252

if TYPE_CHECKING:
    from bstm_daemon.analysis.matching.tunables import Target

HAT = {"k": 0.1, "a": 2e-3, "b": 2.5e-4, "c": 4e-4, "g": 4e-3, "h": 8e-3}
TIME_S = np.arange(1.0, 9001.0)
AIR_C = np.full(len(TIME_S), 10.0)
HILL_C = 10.0 + 120.0 * np.exp(-(((TIME_S - 3000.0) / 1500.0) ** 2))
LATER_C = 10.0 + 125.0 * np.exp(-(((TIME_S - 3200.0) / 1500.0) ** 2))


def of(
    node: str,
    estimated: np.ndarray,
    measured: np.ndarray = HILL_C,
    accuracy: NodeAccuracy | None = None,
) -> NodeErrors:
    """Compare two curves as one node of a drive."""
    masks = {"soak": TIME_S > 2500.0, "driving": TIME_S <= 2500.0}
    return compared(
        ("drive", "FL", node, 9000.0),
        (TIME_S, measured, estimated, AIR_C),
        masks,
        accuracy,
    )


def test_a_peak_has_height_and_time() -> None:
    peak = peak_of(TIME_S, HILL_C, LATER_C, AIR_C)

    assert peak.apart_k == pytest.approx(5.0, abs=0.01)
    assert peak.apart_s == pytest.approx(200.0, abs=2.0)


def test_a_peak_at_the_end_of_the_record_has_no_time() -> None:
    rising = np.linspace(10.0, 200.0, len(TIME_S))

    assert isnan(peak_of(TIME_S, rising, rising, AIR_C).apart_s)


def test_errors_by_phase() -> None:
    shifted = HILL_C + np.where(TIME_S > 2500.0, 4.0, 1.0)

    found = of("fluid", shifted)

    assert found.phase_rms_k == pytest.approx({"soak": 4.0, "driving": 1.0})
    assert found.largest_k == pytest.approx(4.0)
    assert found.last_k == pytest.approx(4.0)


def test_the_thesis_asks_for_30_k_and_5_min() -> None:
    within = decisive(judged([of("fluid", LATER_C)]), "thesis")
    beyond = decisive(judged([of("fluid", HILL_C + 31.0)]), "thesis")

    assert [one.passed for one in within] == [True, True]
    assert [one.passed for one in beyond] == [False, True]


def test_narrower_limits_judge_more() -> None:
    late = decisive(judged([of("fluid", LATER_C)]), "goal")
    missed = {one.what for one in late if not one.passed}

    assert "fluid, peak time [s]" in missed
    assert any("last 20 min" in one.what for one in late)


@pytest.mark.parametrize(("duration_s", "judges"), [(LONG_S, 1), (10.0, 0)])
def test_the_end_of_a_long_drive_is_judged(
    duration_s: float, judges: int
) -> None:
    one = replace(of("fluid", LATER_C), duration_s=duration_s)

    found = decisive(judged([one]), "goal")

    assert sum("last 20 min" in each.what for each in found) == judges


def test_the_disc_is_judged_below_650_degc() -> None:
    """Above, one lump is no disc; the error there counts for nothing."""
    hot = np.where(TIME_S < 100.0, 700.0, 400.0)

    found = of("disc", hot + np.where(TIME_S < 100.0, 90.0, 3.0), hot)

    assert found.rms_k == pytest.approx(3.0)


def test_ninety_percent_are_covered_where_the_errors_are_as_said() -> None:
    rng = np.random.default_rng(5)
    accuracy = NodeAccuracy(2.0, 0.0)

    errors = [
        of("fluid", HILL_C + rng.normal(0.0, 2.0), accuracy=accuracy)
        for _ in range(300)
    ]
    inside, counted = coverage(errors)

    assert counted == 300 * 7
    assert 0.85 < inside / counted < 0.95


@pytest.mark.parametrize(("rise_k", "warm"), [(20.05, True), (19.95, False)])
def test_a_rise_of_less_than_20_k_is_no_peak(
    rise_k: float, *, warm: bool
) -> None:
    """A plateau of 1000 s: its middle, if it is one."""
    on = (TIME_S > 3000.0) & (TIME_S <= 4000.0)
    plateau = 10.0 + np.where(on, rise_k, 0.0)

    found = peak_of(TIME_S, plateau, plateau, AIR_C)

    assert isnan(found.measured_s) is not warm
    if warm:
        assert found.measured_s == pytest.approx(3500.5, abs=1.0)
        assert found.apart_s == 0.0
    assert found.measured_c == 10.0 + rise_k


def disc_errors(drive: Drive, off_k: float) -> NodeErrors:
    """Return the errors of a model that is *off_k* off the disc."""
    time_s = drive.time_s[1::2]
    measured = drive.measured["FL"]["disc"].at(time_s) - 273.15
    return compared(
        (drive.name, "FL", "disc", drive.duration_s),
        (time_s, measured, measured + off_k, np.full(len(time_s), 17.0)),
        {},
        None,
    )


def rivals(
    pairs: list[tuple[Drive, list[NodeErrors]]], *on: Drive
) -> dict[tuple[str, str], Verdict]:
    """Return the verdicts by drive and baseline."""
    found = held_against(pairs, on)
    assert all(one.limits == "baseline" for one in found)
    return {
        (one.drive, one.what.removeprefix("disc, RMS [K], ")): one
        for one in found
    }


ONE = "disc of one node fitted to others + 1 K"
TWO = "disc and hat fitted to others + 1 K"
OWN = "3 x disc of one node fitted to it + 1 K"


@pytest.mark.slow
def test_a_model_is_held_against_what_other_drives_give() -> None:
    """One node misses the hat, so that 2 K of the model are better."""
    drives = [lumped(HAT, name="a"), lumped(HAT, seed=2, name="b")]

    found = rivals([(drive, [disc_errors(drive, 2.0)]) for drive in drives])

    assert list(found) == [
        (name, what) for name in "ab" for what in (ONE, TWO, OWN)
    ]
    assert [one.value for one in found.values()] == pytest.approx([2.0] * 6)
    fit, _ = baselines([drives[1]])["FL"]
    assert found["a", ONE].limit == pytest.approx(
        fit.rms_on([drives[0]]) + 1.0
    )
    assert found["a", ONE].limit > 3.0
    assert found["a", ONE].passed
    assert not found["a", TWO].passed


@pytest.mark.slow
def test_one_drive_alone_is_its_own_rival_three_times() -> None:
    """A fit to the drive itself has an advantage."""
    drive = lumped(HAT)
    fit, _ = baselines([drive])["FL"]

    for off_k, met in ((0.9, True), (1.1, False)):
        errors = disc_errors(drive, 3.0 * fit.rms_k + off_k)
        (found,) = rivals([(drive, [errors])]).values()
        assert found.what.endswith(OWN)
        assert found.limit == pytest.approx(3.0 * fit.rms_k + 1.0)
        assert found.passed is met


@pytest.mark.slow
def test_the_drives_of_the_match_are_the_others() -> None:
    drive, of_match = lumped(HAT), lumped(HAT, 900.0, seed=2)
    fit, _ = baselines([of_match])["FL"]

    found = rivals([(drive, [disc_errors(drive, 1.0)])], of_match)

    assert found["made", ONE].limit == pytest.approx(fit.rms_on([drive]) + 1.0)


def test_only_a_measured_disc_has_a_baseline() -> None:
    drive = lumped(HAT, 600.0)

    assert not held_against([(drive, [of("fluid", LATER_C)])])


def test_a_disc_is_held_against_rivals_also_behind_another_node() -> None:
    drive = lumped(HAT, 600.0)
    disc = disc_errors(drive, 1.0)

    both = held_against([(drive, [of("fluid", LATER_C), disc])])

    assert both == held_against([(drive, [disc])])
    assert both


def test_the_baseline_decides_beside_the_required_limits() -> None:
    verdicts = [
        Verdict(limits, "drive", "FL", "what", 1.0, 2.0)
        for limits in ("thesis", "floor", "baseline")
    ]

    assert [one.limits for one in decisive(verdicts, "floor")] == [
        "floor",
        "baseline",
    ]


def test_an_estimate_is_compared_with_its_own_thermocouple(
    target: Target,
) -> None:
    """Corner and node, the air of the corner, a row a second."""
    steps = round(900.0 / GRID_S)
    inputs = np.zeros((steps, 2, len(CHANNELS)))
    inputs[:, 1, CHANNELS.index("ambient_k")] = (
        283.15 + np.arange(steps) * 0.01
    )
    time_s = np.arange(0.0, 901.0)
    couple = Thermocouple(time_s, 373.15 + 0.1 * time_s)
    estimates: Any = SimpleNamespace(
        columns={"time_s": time_s, "FR.disc_c": 105.0 + 0.1 * time_s}
    )
    drive = Drive(
        *("made.log", 0.0, ("FL", "FR"), inputs, {"FR": {"disc": couple}}),
        estimates=estimates,
    )

    (found,) = errors_of(drive, target.config)

    assert (found.drive, found.corner, found.node) == (
        "made.log",
        "FR",
        "disc",
    )
    assert found.duration_s == 900.0
    assert found.time_s.tolist() == list(range(1, 900))
    assert found.error_k == pytest.approx(np.full(899, 5.0))
    # the air at the end of each second
    air_c = 10.0 + 0.01 * (2.0 * found.time_s - 1.0)
    assert found.rise_k == pytest.approx(105.0 + 0.1 * found.time_s - air_c)
    assert found.last_k == pytest.approx(5.0)

    # one that never read anything is compared with nothing
    silent = Thermocouple(time_s, np.full(len(time_s), np.nan))
    drive = replace(drive, measured={"FR": {"disc": silent}})
    assert errors_of(drive, target.config) == []
