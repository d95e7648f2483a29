"""The thesis's matching in stages (chapter 5), each part isolated.

In every stage the neighbours of the fitted node follow their measured
temperatures; outside the stage's phase the node itself does, so that each
stretch begins at what was measured. A stage needs its thermocouples: without
one of them it is left out and said so, the others stay.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from bstm_daemon.analysis.matching import phases
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.march import initial_temperatures
from bstm_daemon.analysis.matching.problem import (
    Problem,
    Run,
    Series,
    series_of,
)
from bstm_daemon.analysis.matching.tunables import (
    S_SPEEDS_MS,
    TUNABLES,
    Target,
    usable,
)
from bstm_daemon.analysis.statistics.levenberg_marquardt import minimise
from bstm_daemon.analysis.statistics.series import Mask, runs
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.units import KELVIN_OFFSET

Phase = Literal["soak", "drive", "cooling", "normal braking", "hot braking"]

SMOOTH_S: Final = 120.0
"""The fluid's peak is that of a mean over so long."""
HALF: Final = round(0.5 * SMOOTH_S / GRID_S)


@dataclass(frozen=True, slots=True)
class Stage:
    """One stage: what is fitted to which node, in which phase."""

    title: str
    section: str
    phase: Phase
    node: str
    keys: tuple[str, ...]

    @property
    def forced(self) -> tuple[str, ...]:
        """The neighbours that follow their measurement."""
        return NEIGHBOURS[self.node]


NEIGHBOURS: Final[dict[str, tuple[str, ...]]] = {
    "disc": (),
    "pad_front": ("disc", "pad_back"),
    "pad_back": ("pad_front", "fluid"),
    "fluid": ("pad_back",),
}

PEAK: Final = "5.1.3 stage 1"

STAGES: Final = (
    Stage("disc cooling", "4.4", "cooling", "disc", tuple(S_SPEEDS_MS)),
    Stage(
        *("disc in the soak", "5.1.1", "soak", "disc"),
        ("cooling.standstill_convection_fraction",),
    ),
    Stage(
        *("pad front in the soak", "5.1.2 stage 1", "soak", "pad_front"),
        ("thermal.disc_emissivity", "thermal.pad_emissivity"),
    ),
    Stage(
        *("pad back in the soak", "5.1.2 stage 2", "soak", "pad_back"),
        ("thermal.pad_backplate_thermal_resistance_m2k_w",),
    ),
    Stage(
        *("static convection at the fluid's peak", PEAK, "soak", "fluid"),
        ("thermal.fluid_static_convection_w_k",),
    ),
    Stage(
        *("capacity of fluid and caliper", "5.1.3 stage 2", "soak", "fluid"),
        ("thermal.fluid_caliper_thermal_capacity_j_k",),
    ),
    Stage(
        *("heat partition", "5.2.1 stage 1", "normal braking", "pad_front"),
        ("thermal.heat_partition_correction_factor",),
    ),
    Stage(
        *("disc mass", "5.2.1 stage 2", "normal braking", "disc"),
        ("thermal.disc_mass_correction_factor",),
    ),
    Stage(
        *("dynamic loss of the pad", "5.2.1 stage 3", "drive", "pad_back"),
        ("thermal.pad_dynamic_convection_ws_m3k",),
    ),
    Stage(
        *("dynamic loss of the fluid", "5.2.1 stage 4", "drive", "fluid"),
        ("thermal.fluid_dynamic_convection_ws_mk",),
    ),
    Stage(
        *("pads at high temperature", "5.2.2", "hot braking", "pad_front"),
        ("thermal.hot_pad_factor",),
    ),
)
"""The stages in the thesis's order; the S-function comes first."""

STAGE_PRIOR: Final = 10.0
"""A stage follows the measurement, as the thesis does; what was believed
before counts in the joint refinement."""


@dataclass(frozen=True, slots=True)
class StageResult:
    """What a stage gave.

    ``values`` by key with ``before``; empty with ``why`` where it was left
    out. ``rms_k`` is over the phase, before and after.
    """

    stage: Stage
    values: dict[str, float]
    before: dict[str, float]
    rms_k: tuple[float, float] = (np.nan, np.nan)
    why: str = ""


def run_stages(
    target: Target,
    drives: Sequence[Drive],
    only: Sequence[str] | None = None,
    progress: Callable[[float], None] | None = None,
    *,
    without: Collection[str] = (),
) -> tuple[dict[str, float], list[StageResult]]:
    """Match *target* stage by stage; *only* limits the keys.

    Stages of a key that is *without* are left: it is found already.

    Returns:
        The values by key, and what each stage did.
    """
    results = []
    values: dict[str, float] = {}
    for number, stage in enumerate(STAGES):
        if only is not None and not set(stage.keys) <= set(only):
            continue
        if set(stage.keys) & set(without):
            continue
        result = _run(stage, target, drives)
        results.append(result)
        target = target.changed(result.values)
        values |= result.values
        if progress is not None:
            progress((number + 1) / len(STAGES))
    return values, results


def _run(stage: Stage, target: Target, drives: Sequence[Drive]) -> StageResult:
    keys, remarks = usable(target, stage.keys)
    before = {key: target.value(TUNABLES[key]) for key in keys}
    if not keys:
        return StageResult(stage, {}, before, why="; ".join(remarks))
    there = {
        couple
        for drive in drives
        for corner in target.corners
        for couple in drive.measured.get(corner, {})
    }
    gone = [one for one in (stage.node, *stage.forced) if one not in there]
    if gone:
        why = f"no thermocouple for {', '.join(gone)}"
        return StageResult(stage, {}, before, why=why)
    runs, terms = _isolated(stage, target, drives)
    if not terms:
        why = f"no {stage.phase} long and warm enough in these drives"
        return StageResult(stage, {}, before, why=why)
    problem = Problem(target, drives, keys, runs, terms, {})
    problem.prior = STAGE_PRIOR * problem.prior
    if stage.section == PEAK:
        values, why = _static_convection(target, drives)
        if why:
            return StageResult(stage, {}, before, why=why)
        x = np.log([values[key] for key in keys])
        x = np.clip(x, problem.lower, problem.upper)
        values = problem.values(x)
    else:
        found = minimise(problem, problem.start, problem.lower, problem.upper)
        x, values = found.x, problem.values(found.x)
    points = np.vstack((problem.start, x))
    apart = np.concatenate(problem.residuals_k(points))
    rms = np.sqrt(np.mean(apart**2, axis=0))
    return StageResult(stage, values, before, (float(rms[0]), float(rms[1])))


def _isolated(
    stage: Stage, target: Target, drives: Sequence[Drive]
) -> tuple[list[Run], list[Series]]:
    program = compile_corner(target.config, target.corner)
    runs, terms = [], []
    for index, drive in enumerate(drives):
        for corner in target.corners:
            couples = drive.measured.get(corner, {})
            if not {stage.node, *stage.forced} <= couples.keys():
                continue
            mask = phase_mask(stage.phase, drive, corner, target)
            own_couple = ((corner, stage.node),)
            term = series_of(drive, index, stage.node, own_couple, within=mask)
            if term is None:
                continue
            series = {
                node: couples[node].at(drive.time_s) for node in stage.forced
            }
            own = couples[stage.node].at(drive.time_s)
            series[stage.node] = np.where(mask, np.nan, own)
            initial = initial_temperatures(program, drive, corner)
            runs.append(Run(index, corner, initial, series))
            terms.append(term)
    return runs, terms


def phase_mask(
    phase: Phase, drive: Drive, corner: str, target: Target
) -> Mask:
    """Return where *drive* is in *phase*, (steps,)."""
    if phase == "soak":
        return phases.soak(drive, corner)
    if phase == "cooling":
        return phases.cooling(drive, corner)
    moving = phases.moving(drive, corner)
    if phase == "drive":
        return moving
    thermal = target.config.thermal_of(target.corner)
    limit_k = thermal.hot_pad_threshold_c - 0.5 * thermal.hot_pad_width_k
    couple = drive.measured.get(corner, {}).get("pad_front")
    couple = couple or drive.measured.get(corner, {}).get("disc")
    if couple is None:
        return np.zeros(len(drive), bool)
    with np.errstate(invalid="ignore"):
        hot = couple.at(drive.time_s) > limit_k + KELVIN_OFFSET
    braking = phases.braking(drive, corner) & moving
    return braking & hot if phase == "hot braking" else braking & ~hot


def _static_convection(
    target: Target, drives: Sequence[Drive]
) -> tuple[dict[str, float], str]:
    """Eq 5.1 at each fluid peak: H (Tf - Ta) = (A/R)(Tb - Tf), the median."""
    thermal = target.config.thermal_of(target.corner)
    pad = target.corner.pad
    if pad is None:
        return {}, "no pad"
    to_fluid_w_k = (
        2.0 * pad.area_m2 / thermal.pad_backplate_thermal_resistance_m2k_w
    )
    found = []
    for drive in drives:
        for corner in target.corners:
            couples = drive.measured.get(corner, {})
            if not {"fluid", "pad_back"} <= couples.keys():
                continue
            ambient = drive.channel(corner, "ambient_k")
            for first, last in runs(phases.soak(drive, corner)):
                at = fluid_peak(drive, corner, first, last)
                if at is None:
                    continue
                around = slice(at - HALF, at + HALF + 1)
                time_s = drive.time_s[around]
                fluid = np.nanmean(couples["fluid"].at(time_s))
                back = np.nanmean(couples["pad_back"].at(time_s))
                air = ambient[at]
                found.append(to_fluid_w_k * (back - fluid) / (fluid - air))
    found = [one for one in found if np.isfinite(one) and one > 0.0]
    if not found:
        return {}, "the fluid has no peak within a soak of these drives"
    key = "thermal.fluid_static_convection_w_k"
    return {key: float(np.median(found))}, ""


def fluid_peak(drive: Drive, corner: str, first: int, last: int) -> int | None:
    """Return the step of the fluid's peak within *first* to *last*.

    None where it is not above the air by much, or lies at an end: then heat
    in and heat out were not equal there.
    """
    span = slice(first, last + 1)
    fluid = drive.measured[corner]["fluid"].at(drive.time_s[span])
    width = 2 * HALF + 1
    if len(fluid) < 3 * width or not np.isfinite(fluid).any():
        return None
    smooth = np.convolve(fluid, np.full(width, 1.0 / width), "valid")
    if not np.isfinite(smooth).any():
        return None
    at = int(np.nanargmax(smooth)) + HALF
    rise = fluid[at] - drive.channel(corner, "ambient_k")[first + at]
    inside = width < at < len(fluid) - width
    return first + at if inside and rise > phases.WARM_K else None
