"""The least squares behind a coast-down, and what its runs have in common.

The force over a window of some seconds is what only the resistances explain:
the change of speed over it is exact, no derivative is taken.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.quality.grid import window_mean
from bstm_daemon.quality.limits import GRID_S
from bstm_daemon.units import AIR_DENSITY_KG_M3

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from bstm_daemon.config import VehicleConfig
    from bstm_daemon.identify.coasting import Stretch
    from bstm_daemon.quality.recording import Column

WINDOW_S: Final = 4.0
"""The change of speed over it stands out of a quantum of 0.06 m/s."""

APART_MS2: Final = 0.01
"""Directions whose grades are nearer (0.1 %) are one and the same level
road."""


@dataclass(frozen=True, slots=True)
class _Windows:
    """Means over the windows of all stretches, (k,) each."""

    stretch: Column
    force_n: Column
    square: Column
    linear: Column


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


def _windows(stretches: Sequence[Stretch], *, with_sensor: bool) -> _Windows:
    """Average over windows; the force is what only the resistances explain.

    With the accelerometer climbing is in its reading, without it stays in.
    """
    steps = round(WINDOW_S / GRID_S)
    columns: list[tuple[float, float, float, float]] = []
    for number, stretch in enumerate(stretches):
        driving, car = stretch.driving, stretch.driving.vehicle
        # over half a second a quantum averages out
        smooth = window_mean(driving.speed_ms)
        for first in range(stretch.first, stretch.last - steps + 1, steps):
            part = slice(first, first + steps + 1)
            v = driving.speed_ms[part]
            ends = smooth[[first, first + steps]]
            rate = float(ends[1] - ends[0]) / WINDOW_S
            drive = mean(driving.torque_nm[part]) / car.wheel_radius_m
            drive += mean(driving.push_n[part])
            if with_sensor:
                felt = mean(driving.felt_ms2[part])
                force = (
                    drive - car.mass_kg * felt - car.rotating_mass_kg * (rate)
                )
            else:
                force = drive - car.effective_mass_kg * rate
            columns.append((number, force, mean(v * v), mean(v)))
    table = np.array(columns, np.float64)
    return _Windows(table[:, 0], table[:, 1], table[:, 2], table[:, 3])


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
    windows = _windows(stretches, with_sensor=with_sensor)
    known = {
        "drag_area_m2": 0.5 * AIR_DENSITY_KG_M3 * vehicle.drag_area_m2,
        "friction_ns_m": vehicle.friction_ns_m,
    }
    shapes = {"drag_area_m2": windows.square, "friction_ns_m": windows.linear}
    force = windows.force_n.copy()
    free = []
    for name, shape in shapes.items():
        if name in held:
            force -= known[name] * shape
        else:
            free.append(name)
    count = 1 if with_sensor else len(stretches)
    constants = np.zeros((len(force), count))
    place = np.zeros(len(force), int) if with_sensor else windows.stretch
    constants[np.arange(len(force)), place.astype(int)] = 1.0
    matrix = np.column_stack([*(shapes[name] for name in free), constants])
    scale = np.linalg.norm(matrix, axis=0)
    solution = np.linalg.lstsq(matrix / scale, force, rcond=None)[0] / scale
    rest = force - matrix @ solution
    freedom = max(len(force) - matrix.shape[1], 1)
    variance = float(rest @ rest) / freedom * _inflation(rest)
    inverse = np.linalg.pinv((matrix / scale).T @ (matrix / scale))
    covariance = variance * inverse / np.outer(scale, scale)
    values = dict(zip(free, solution, strict=False))
    # of the constants the mean: what f_r follows from
    mix = np.zeros((3, matrix.shape[1]))
    for row, name in enumerate(shapes):
        if name in free:
            mix[row, free.index(name)] = 1.0
    mix[2, len(free) :] = 1.0 / count
    joint = mix @ covariance @ mix.T
    errors = np.sqrt(np.clip(np.diag(joint), 0.0, None))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = joint / np.outer(errors, errors)
    constant = solution[len(free) :]
    mass_kg = vehicle.mass_kg
    if with_sensor:
        apparent = np.array([_apparent_ms2(one) for one in stretches])
        constant = np.repeat(constant, len(stretches))
    else:
        apparent = (constant - constant.mean()) / mass_kg
    return Fit(
        float(values.get("drag_area_m2", known["drag_area_m2"])),
        float(values.get("friction_ns_m", known["friction_ns_m"])),
        constant,
        errors,
        correlation,
        sqrt(float(rest @ rest) / freedom),
        len(force),
        apparent,
        with_sensor,
    )


def _inflation(rest: Column) -> float:
    """Return by how much neighbours that err alike enlarge a variance."""
    if len(rest) < 4:
        return 1.0
    lag = float(rest[1:] @ rest[:-1]) / max(float(rest @ rest), 1e-30)
    lag = min(max(lag, 0.0), 0.9)
    return (1.0 + lag) / (1.0 - lag)


def _apparent_ms2(stretch: Stretch) -> float:
    """Return the mean of grade times g plus bias over the way."""
    driving, part = stretch.driving, stretch.points
    speed = driving.speed_ms[part]
    apart = driving.felt_ms2[part] - driving.rate_ms2[part]
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
