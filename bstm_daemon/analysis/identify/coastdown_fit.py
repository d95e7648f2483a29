"""The regression behind a coast-down, and what its runs have in common.

The force over a window of some seconds is what only the resistances explain:
the change of speed over it is exact, no derivative is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.quality.grid import window_mean
from bstm_daemon.analysis.quality.limits import GRID_S
from bstm_daemon.analysis.statistics.gls import fit_linear
from bstm_daemon.units import AIR_DENSITY_KG_M3

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from bstm_daemon.analysis.identify.coasting import Stretch
    from bstm_daemon.analysis.statistics.series import Column, Matrix
    from bstm_daemon.config.sections import VehicleConfig

WINDOW_S: Final = 4.0
"""The change of speed over it stands out of a quantum of 0.06 m/s."""

APART_MS2: Final = 0.01
"""Directions whose grades are nearer (0.1 %) are one and the same level
road."""


@dataclass(frozen=True, slots=True)
class Fit:
    """Drag [N s2/m2], C_fric [N s/m], constants of the stretches [N].

    ``apparent_ms2`` is each stretch's grade times g plus bias, (s,).
    """

    quadratic: float
    linear: float
    constant_n: Column
    errors: Column
    correlation: Column
    residual_n: float
    windows: int
    apparent_ms2: Column
    with_sensor: bool


def _windows(stretches: Sequence[Stretch], *, with_sensor: bool) -> Matrix:
    """Return run, force [N] and the means of v^2 and v of each window, (4, k).

    The force is what only the resistances explain. With the accelerometer
    climbing is in its reading, without it stays in.
    """
    steps = round(WINDOW_S / GRID_S)
    rows: list[tuple[float, float, float, float]] = []
    for number, stretch in enumerate(stretches):
        driving, car = stretch.driving, stretch.driving.vehicle
        # over half a second a quantum averages out
        smooth = window_mean(driving.speed_ms)
        for first in range(stretch.first, stretch.last - steps + 1, steps):
            part = slice(first, first + steps + 1)
            v = driving.speed_ms[part]
            rate = float(smooth[first + steps] - smooth[first]) / WINDOW_S
            force = mean(driving.traction_n[part])
            if with_sensor:
                force -= car.mass_kg * mean(driving.accel_measured_ms2[part])
                force -= car.rotating_mass_kg * rate
            else:
                force -= car.effective_mass_kg * rate
            rows.append((number, force, mean(v * v), mean(v)))
    return np.array(rows, np.float64).T


def mean(values: Column) -> float:
    """Return the mean of *values* over time by trapezoids."""
    return float(
        (values[1:-1].sum() + 0.5 * (values[0] + values[-1]))
        / (len(values) - 1)
    )


def fit_windows(
    stretches: Sequence[Stretch],
    vehicle: VehicleConfig,
    held: Collection[str],
    *,
    with_sensor: bool,
) -> Fit:
    """Fit the resistances to the windows of *stretches*.

    Args:
        stretches: the runs.
        vehicle: mass, and the configured value of what is held.
        held: keys of ``[vehicle]`` that keep their configured value.
        with_sensor: take the grade from the accelerometer; else each run has
            a constant of its own.
    """
    run, force, square, linear = _windows(stretches, with_sensor=with_sensor)
    known = {
        "drag_area_m2": 0.5 * AIR_DENSITY_KG_M3 * vehicle.drag_area_m2,
        "friction_ns_m": vehicle.friction_ns_m,
    }
    shapes = {"drag_area_m2": square, "friction_ns_m": linear}
    free = [name for name in shapes if name not in held]
    for name, shape in shapes.items():
        if name in held:
            force = force - known[name] * shape
    constants = np.ones((len(force), 1))
    if not with_sensor:
        constants = np.equal.outer(run, np.arange(len(stretches))).astype(
            float
        )
    count = constants.shape[1]
    fit = fit_linear(
        np.column_stack([*(shapes[name] for name in free), constants]), force
    )
    values = known | dict(zip(free, fit.estimate.tolist(), strict=False))
    # of the constants the mean: what f_r follows from
    mix = np.zeros((3, len(fit.estimate)))
    for row, name in enumerate(shapes):
        if name in free:
            mix[row, free.index(name)] = 1.0
    mix[2, len(free) :] = 1.0 / count
    joint = mix @ fit.covariance @ mix.T
    errors = np.sqrt(np.clip(np.diag(joint), 0.0, None))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = joint / np.outer(errors, errors)
    constant = fit.estimate[len(free) :]
    if with_sensor:
        apparent = np.array([_apparent_ms2(one) for one in stretches])
        constant = np.repeat(constant, len(stretches))
    else:
        apparent = (constant - constant.mean()) / vehicle.mass_kg
    return Fit(
        values["drag_area_m2"],
        values["friction_ns_m"],
        constant,
        errors,
        correlation,
        sqrt(fit.variance),
        len(force),
        apparent,
        with_sensor,
    )


def _apparent_ms2(stretch: Stretch) -> float:
    """Return the mean of grade times g plus bias over the way."""
    driving, part = stretch.driving, stretch.points
    speed = driving.speed_ms[part]
    apart = driving.slope_ms2[part]
    return float((apart * speed).sum() / speed.sum())


def directions_of(apparent_ms2: Column) -> list[int]:
    """Return +1 or -1 for each run by its side of the widest gap.

    All 0 where the runs differ by no more than a level road's.
    """
    order = np.sort(apparent_ms2)
    gaps = np.diff(order)
    if not len(gaps) or gaps.max() < APART_MS2:
        return [0] * len(apparent_ms2)
    split = 0.5 * (order[gaps.argmax()] + order[gaps.argmax() + 1])
    return [1 if one > split else -1 for one in apparent_ms2.tolist()]


def middle_of(
    apparent_ms2: Column, directions: list[int]
) -> tuple[float, float]:
    """Return what is grade-free in *apparent_ms2*, and its standard error."""
    groups = [
        apparent_ms2[np.array(directions) == way]
        for way in sorted(set(directions))
    ]
    middle = float(np.mean([group.mean() for group in groups]))
    freedom = sum(len(group) - 1 for group in groups)
    spread = sum(float(((g - g.mean()) ** 2).sum()) for g in groups)
    if not freedom:
        return middle, 0.0
    variance = spread / freedom
    share = sum(1.0 / len(group) for group in groups) / len(groups) ** 2
    return middle, sqrt(variance * share)
