"""Estimates held against measured temperatures: errors, peaks, verdicts."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from math import isnan, nan
from typing import Final

import numpy as np

from bstm_daemon.analysis.matching import phases
from bstm_daemon.analysis.matching.baseline import (
    MARGIN_K,
    baselines,
    bearable_k,
)
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.refine import NodeAccuracy
from bstm_daemon.analysis.statistics.series import (
    Column,
    Mask,
    rms,
    running_mean,
    white_noise,
)
from bstm_daemon.config.sections import Config
from bstm_daemon.model.thermal.properties import DISC_LIMIT_C
from bstm_daemon.units import KELVIN_OFFSET

NODES: Final = ("disc", "pad_front", "pad_back", "fluid")
"""Nodes that are judged, in the order of tables."""

ROW_S: Final = 1.0
"""Time between two rows of the comparison."""

SMOOTH_S: Final = {"pad_back": 30.0, "fluid": 30.0}
"""Measured slow nodes are means over so long: what a thermocouple's white
noise adds to the largest error is not the model's."""

PEAK_S: Final = 120.0
TOP_SHARE: Final = 0.05
"""A fluid peak is flat, and what a thermocouple drifts would move its highest
point by minutes. So its time is the middle of the time that the curve, a mean
over ``PEAK_S``, spends within this share of its rise below the top."""

LAST_S: Final = 20.0 * 60.0
"""The drift is the mean error over the drive's last part."""

LONG_S: Final = 2.0 * 3600.0
"""Drives from which on the drift is judged."""

WARM_K: Final = 20.0
"""A peak lower above the air is none."""

FIXED_S: Final = tuple(60.0 * minute for minute in (10, 20, 30, 45, 60, 90))
"""Times at which coverage is counted, besides the peak."""

BASELINE: Final = "baseline"
OWN_FACTOR: Final = 3.0
"""A baseline fitted to the drive it is held against has an advantage: on other
drives it errs 1.1 to 8 times as much, 1.6 times in the median."""

NINETY: Final = 1.6449
"""Standard deviations to each side that hold 90 % of a normal error."""


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest temperature: measured and estimated [degC], when [s].

    ``apart_s``, estimated minus measured time, is nan where a curve does not
    rise to it and fall from it within the record.
    """

    measured_c: float
    estimated_c: float
    measured_s: float
    apart_s: float

    @property
    def apart_k(self) -> float:
        """Estimated less measured height."""
        return self.estimated_c - self.measured_c


@dataclass(frozen=True, slots=True, eq=False)
class NodeErrors:
    """One node of one corner over one drive.

    ``time_s``, ``measured_c``, ``estimated_c``, ``error_k`` and ``rise_k``,
    the estimate above the air, (n,), a row a second; ``phase_rms_k`` and
    ``phase_max_k`` by phase, ``last_k`` the mean error of the last 20
    minutes, ``covered`` whether the 90 % interval holds the measurement at
    the peak and at fixed times.
    """

    drive: str
    corner: str
    node: str
    duration_s: float
    time_s: Column
    measured_c: Column
    estimated_c: Column
    error_k: Column
    rise_k: Column
    rms_k: float
    largest_k: float
    phase_rms_k: Mapping[str, float]
    phase_max_k: Mapping[str, float]
    peak: Peak
    last_k: float
    covered: tuple[bool, ...]


@dataclass(frozen=True, slots=True)
class Limits:
    """A set of requirements; nan where there is none."""

    name: str
    fluid_max_k: float
    peak_s: float
    fluid_rms_k: float = nan
    disc_rms_k: float = nan
    pad_back_rms_k: float = nan
    last_k: float = nan


LIMITS: Final = {
    one.name: one
    for one in (
        Limits("thesis", 30.0, 300.0),
        Limits("floor", 10.0, 120.0, 4.0, 15.0, 8.0, 3.0),
        Limits("goal", 6.0, 60.0, 2.5, 12.0, 5.0, 2.0),
    )
}
"""Section 1.3 of the thesis, then what this project asks for at least, then
what it aims at."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """One requirement on one node of one drive."""

    limits: str
    drive: str
    corner: str
    what: str
    value: float
    limit: float

    @property
    def passed(self) -> bool:
        """Whether it is met."""
        return abs(self.value) <= self.limit


def errors_of(drive: Drive, config: Config) -> list[NodeErrors]:
    """Compare the estimates of *drive* with what was measured."""
    found = []
    for corner in drive.measured:
        for node in NODES:
            one = _errors(drive, corner, node, accuracy_of(config, node))
            if one is not None:
                found.append(one)
    return found


def accuracy_of(config: Config, node: str) -> NodeAccuracy | None:
    """Return ``[accuracy]`` of *node*, None where it is not there."""
    floor = getattr(config.accuracy, f"{node}_k", None)
    if floor is None:
        return None
    return NodeAccuracy(floor, getattr(config.accuracy, f"{node}_share"))


def _errors(
    drive: Drive, corner: str, node: str, accuracy: NodeAccuracy | None
) -> NodeErrors | None:
    couple = drive.measured[corner].get(node)
    columns = {} if drive.estimates is None else drive.estimates.columns
    if couple is None or f"{corner}.{node}_c" not in columns:
        return None
    time_s = np.arange(ROW_S, drive.duration_s, ROW_S)
    measured = couple.at(time_s) - KELVIN_OFFSET
    measured = _mean(measured, SMOOTH_S.get(node, ROW_S))
    estimated = np.interp(
        time_s, columns["time_s"], columns[f"{corner}.{node}_c"]
    )
    known = np.isfinite(measured)
    if not known.any():
        return None
    every = max(round(ROW_S / GRID_S), 1)
    air = drive.channel(corner, "ambient_k")[every - 1 :: every]
    air_c = np.resize(air, len(time_s)) - KELVIN_OFFSET
    return compared(
        (drive.name, corner, node, drive.duration_s),
        (time_s[known], measured[known], estimated[known], air_c[known]),
        {
            name: mask[every - 1 :: every][: len(time_s)][known]
            for name, mask in phases_of(drive, corner).items()
        },
        accuracy,
        white_noise(couple.temperature_k),
    )


def phases_of(drive: Drive, corner: str) -> dict[str, Mask]:
    """Return the masks of braking, driving and soak, (steps,) each."""
    soak = phases.soak(drive, corner)
    braking = phases.braking(drive, corner)
    return {"braking": braking, "driving": ~braking & ~soak, "soak": soak}


def compared(
    head: tuple[str, str, str, float],
    columns: tuple[Column, Column, Column, Column],
    masks: Mapping[str, Mask],
    accuracy: NodeAccuracy | None,
    white_k: float = 0.0,
) -> NodeErrors:
    """Compare an estimate with what was measured, or with the truth.

    Args:
        head: drive, corner, node, and the drive's length [s].
        columns: time [s], measured, estimated and air [degC], (n,) each, a
            row a second.
        masks: phases by name, (n,).
        accuracy: what the 90 % interval is drawn from, if it is known.
        white_k: white noise of what was measured.
    """
    time_s, measured, estimated, air_c = columns
    error = estimated - measured
    judged = np.abs(error)
    if head[2] == "disc":
        judged = judged[measured < DISC_LIMIT_C]
    peak = peak_of(time_s, measured, estimated, air_c)
    covered: tuple[bool, ...] = ()
    if accuracy is not None:
        at_s = [s for s in FIXED_S if time_s[0] <= s <= time_s[-1]]
        rows = [int(np.searchsorted(time_s, s)) for s in at_s]
        rows.append(int(np.argmax(measured)))
        deviation = np.hypot(
            accuracy.deviation_k(estimated - air_c),
            0.0 if head[2] in SMOOTH_S else white_k,
        )
        covered = tuple(
            bool(abs(error[row]) <= NINETY * deviation[row]) for row in rows
        )
    last = time_s > time_s[-1] - LAST_S
    by_phase = {
        name: error[mask] for name, mask in masks.items() if mask.any()
    }
    return NodeErrors(
        *head,
        time_s,
        measured,
        estimated,
        error,
        estimated - air_c,
        rms(judged) if len(judged) else nan,
        float(judged.max()) if len(judged) else nan,
        {name: rms(one) for name, one in by_phase.items()},
        {name: float(np.abs(one).max()) for name, one in by_phase.items()},
        peak,
        float(np.mean(error[last])),
        covered,
    )


def peak_of(
    time_s: Column, measured_c: Column, estimated_c: Column, air_c: Column
) -> Peak:
    """Return the peaks of both series, (n,) each, smoothed alike."""
    tops = [_top_s(time_s, one, air_c) for one in (measured_c, estimated_c)]
    return Peak(
        float(np.max(measured_c)),
        float(np.max(estimated_c)),
        tops[0],
        tops[1] - tops[0],
    )


def _top_s(time_s: Column, series_c: Column, air_c: Column) -> float:
    """Return when *series_c* is at its top, nan where it has none."""
    smooth = _mean(series_c, PEAK_S)
    at = int(np.nanargmax(smooth))
    rise = float(smooth[at] - air_c[at])
    below = ~(smooth >= smooth[at] - TOP_SHARE * rise)
    before, after = np.flatnonzero(below[:at]), np.flatnonzero(below[at:])
    if rise < WARM_K or not len(before) or not len(after):
        return nan
    first, last = int(before[-1]) + 1, at + int(after[0]) - 1
    return 0.5 * float(time_s[first] + time_s[last])


def judged(errors: Sequence[NodeErrors]) -> list[Verdict]:
    """Return every requirement of all :data:`LIMITS` on *errors*."""
    found = []
    for limits, one in product(LIMITS.values(), errors):
        last_k = one.last_k if one.duration_s >= LONG_S else nan
        asked = {
            "fluid": (
                ("largest error [K]", one.largest_k, limits.fluid_max_k),
                ("RMS [K]", one.rms_k, limits.fluid_rms_k),
                ("peak time [s]", one.peak.apart_s, limits.peak_s),
                ("last 20 min [K]", last_k, limits.last_k),
            ),
            "disc": (("RMS [K]", one.rms_k, limits.disc_rms_k),),
            "pad_back": (("RMS [K]", one.rms_k, limits.pad_back_rms_k),),
        }
        node = one.node.replace("_", " ")
        found += [
            Verdict(
                *(limits.name, one.drive, one.corner, f"{node}, {what}"),
                *(value, limit),
            )
            for what, value, limit in asked.get(one.node, ())
            if not (isnan(value) or isnan(limit))
        ]
    return found


def held_against(
    verified: Sequence[tuple[Drive, Sequence[NodeErrors]]],
    matched_on: Sequence[Drive] = (),
) -> list[Verdict]:
    """Return whether the model's disc errs less than the baselines.

    Those fitted to other drives, and one node fitted to the drive itself; a
    disc and hat can follow any single drive. At any temperature.

    Args:
        verified: drives, and the model's errors on them.
        matched_on: the other drives; else the others of *verified*.
    """
    fixed = baselines(matched_on)
    found = []
    for drive, errors in verified:
        others = [one for one, _ in verified if one is not drive]
        fits, own = fixed or baselines(others), baselines([drive])
        for one in errors:
            if one.node != "disc":
                continue
            rivals = [
                (f"{fit.title} fitted to others", fit.rms_on([drive]))
                for fit in fits.get(one.corner, ())
            ]
            for fit in own.get(one.corner, ())[:1]:
                name = f"{OWN_FACTOR:g} x {fit.title} fitted to it"
                rivals.append((name, OWN_FACTOR * fit.rms_k))
            found += [
                Verdict(
                    *(BASELINE, drive.name, one.corner),
                    f"disc, RMS [K], {name} + {MARGIN_K:g} K",
                    rms(one.error_k),
                    bearable_k(limit_k),
                )
                for name, limit_k in rivals
                if not isnan(limit_k)
            ]
    return found


def decisive(verdicts: Sequence[Verdict], required: str) -> list[Verdict]:
    """Return those of the *required* limits, and of the baseline."""
    return [one for one in verdicts if one.limits in {required, BASELINE}]


def coverage(errors: Sequence[NodeErrors]) -> tuple[int, int]:
    """Return how many of how many counted measurements were covered."""
    counts = [flag for one in errors for flag in one.covered]
    return sum(counts), len(counts)


def _mean(series: Column, width_s: float) -> Column:
    """Return the running mean over *width_s*, NaN where *series* is, (n,)."""
    mean, _ = running_mean(series, round(0.5 * width_s / ROW_S))
    return np.where(np.isfinite(series), mean, np.nan)
