"""Resistances of the car from coast-downs, thesis Eq 4.2 to 4.6, Fig 4.4.

Least squares of

    m dv/dt = T / R - (1/2 rho CdA v^2 + C_fric v + m g f_r) - m g sin(grade)

over windows of a few seconds: the change of speed over a window is exact, no
derivative is taken. An accelerometer reads ``dv/dt + g sin(grade) + bias``
and gives the shape of the grade. Its bias, or without it each run's grade, is
one constant with f_r; runs in both directions of one road separate them.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from math import nan, sqrt
from typing import Final, Literal

import numpy as np

from bstm_daemon.analysis.identify import coasting
from bstm_daemon.analysis.identify.driving import Driving
from bstm_daemon.analysis.identify.value import Value
from bstm_daemon.analysis.quality.channels import window_mean
from bstm_daemon.analysis.quality.limits import GRID_S
from bstm_daemon.analysis.statistics.gls import fit_linear
from bstm_daemon.analysis.statistics.series import Column, Matrix
from bstm_daemon.config.sections import Config, VehicleConfig
from bstm_daemon.errors import LogError
from bstm_daemon.units import AIR_DENSITY_KG_M3, GRAVITY_MS2

NAMES: Final = ("drag_area_m2", "friction_ns_m", "rolling_resistance")
"""Keys of ``[vehicle]``, in the order of the fit's columns."""

FAINT: Final = 0.5
"""A value with a larger relative standard error is not identified."""

TIED: Final = 0.995
"""Two values with a larger correlation can not be separated; from 100 down
to 15 km/h it is 0.98, from 60 to 40 above 0.999."""

LEAST_WINDOWS: Final = 12
"""With fewer the residual, and with it every standard error, is unreliable."""

MOST: Final = {
    "drag_area_m2": 20.0,
    "friction_ns_m": 200.0,
    "rolling_resistance": 0.1,
}
"""Upper bounds: a lorry with a trailer, a bad gearbox, loose sand."""

WINDOW_S: Final = 4.0
"""Long enough for a change of speed well above a quantum of 0.06 m/s."""

LEVEL_MS2: Final = 0.01
"""Directions whose grades differ by less (0.1 %) are of one level road."""

Road = Literal["both ways", "one way", "level"]


@dataclass(frozen=True, slots=True)
class CoastDown:
    """The result: values by key of ``[vehicle]``, every run.

    ``correlation`` (3, 3) is that of drag, C_fric and the constant term, nan
    where held. ``bias_ms2`` is the accelerometer's, None without one.
    """

    values: dict[str, Value]
    correlation: Column
    residual_ms2: float
    windows: int
    road: Road
    bias_ms2: float | None
    runs: tuple[coasting.Run, ...]
    searched: tuple[str, ...]
    remarks: tuple[str, ...]


def identify_coast_down(
    drivings: Sequence[Driving],
    config: Config,
    *,
    held: Collection[str] = (),
    one_way: bool = False,
    even_grade: bool = False,
) -> CoastDown:
    """Find the coast-downs of *drivings* and fit the resistances to them.

    Args:
        drivings: the logs.
        config: the car; its mass and wheels are taken as they are.
        held: keys of :data:`NAMES` that keep their configured value.
        one_way: the runs do not return on their road, so that f_r can not be
            separated from grade and bias.
        even_grade: the grade is one constant for each run; the
            accelerometer and its noise are left out.

    Raises:
        LogError: no log has a coast-down; says what was searched.
    """
    stretches: list[coasting.Stretch] = []
    searched = []
    for driving in drivings:
        found, words = coasting.coasting(driving)
        stretches += found
        searched.append(f"{driving.name}: {words}")
    if not stretches:
        msg = "no coast-down found. " + "; ".join(searched)
        if not any(d.line_known for d in drivings):
            msg += (
                "; no signal shows whether the engine drives the car: map "
                "gear, "
                "clutch_open or powertrain_torque, or declare [heat] "
                "assume_powertrain_torque_nm"
            )
        raise LogError(msg)
    with_sensor = not even_grade and all(d.has_accelerometer for d in drivings)
    vehicle = config.vehicle
    fit = fit_windows(stretches, vehicle, held, with_sensor=with_sensor)
    return _result(
        stretches, fit, vehicle, held, tuple(searched), one_way=one_way
    )


def _result(
    stretches: Sequence[coasting.Stretch],
    fit: Fit,
    vehicle: VehicleConfig,
    held: Collection[str],
    searched: tuple[str, ...],
    *,
    one_way: bool,
) -> CoastDown:
    directions = [0] * len(stretches)
    if not one_way:
        directions = directions_of(fit.apparent_ms2)
    road: Road = "both ways" if any(directions) else "level"
    caveats = dict.fromkeys(NAMES, "")
    if one_way:
        road = "one way"
        caveats[NAMES[2]] = (
            "the runs do not return: inseparable from the grade"
        )
    middle, middle_error = middle_of(fit.apparent_ms2, directions)
    mass_kg, weight = vehicle.mass_kg, vehicle.mass_kg * GRAVITY_MS2
    # with an accelerometer the one constant is m (g f_r - bias)
    constant = float(
        fit.constant_n[0] if fit.with_sensor else np.mean(fit.constant_n)
    )
    rolling = (constant + mass_kg * middle) / weight
    rolling_error = sqrt(fit.errors[2] ** 2 + (mass_kg * middle_error) ** 2)
    if NAMES[2] in held:
        rolling = vehicle.rolling_resistance
        middle = rolling * GRAVITY_MS2 - float(fit.constant_n.mean()) / mass_kg
    half_rho = 0.5 * AIR_DENSITY_KG_M3
    found = (
        (fit.quadratic / half_rho, fit.errors[0] / half_rho),
        (fit.linear, fit.errors[1]),
        (rolling, rolling_error / weight),
    )
    values = {}
    for row, (name, (value, error)) in enumerate(
        zip(NAMES, found, strict=True)
    ):
        values[name] = Value(
            value=value,
            standard_error=nan if name in held else float(error),
            configured=getattr(vehicle, name),
            caveat="held"
            if name in held
            else caveats[name] or _caveat(row, value, float(error), fit),
        )
    car = replace(
        stretches[0].driving.vehicle,
        quadratic=fit.quadratic,
        linear=fit.linear,
        constant=weight * rolling,
    )
    grades = (fit.apparent_ms2 - middle) / GRAVITY_MS2
    bias_ms2 = middle if fit.with_sensor else None
    return CoastDown(
        values,
        fit.correlation,
        fit.residual_n / mass_kg,
        fit.windows,
        road,
        bias_ms2,
        tuple(
            coasting.run_of(stretch, way, grade, car, bias_ms2=bias_ms2)
            for stretch, way, grade in zip(
                stretches, directions, grades.tolist(), strict=True
            )
        ),
        searched,
        _remarks(stretches, road, directions, with_sensor=fit.with_sensor),
    )


def _caveat(row: int, value: float, error: float, fit: Fit) -> str:
    """Return why a value is not identified; empty if it is."""
    if fit.windows < LEAST_WINDOWS:
        return f"{fit.windows} windows only, {LEAST_WINDOWS} needed"
    tied = [
        NAMES[other]
        for other in range(3)
        if other != row and abs(fit.correlation[row, other]) > TIED
    ]
    if tied:
        return f"inseparable from {' and '.join(tied)}: more speeds needed"
    if not 0.0 <= value <= MOST[NAMES[row]]:
        return f"{value:.3g} is impossible: something else slows the car"
    if error > FAINT * value:
        return f"standard error of {100 * error / (value or 1e-30):.0f} %"
    return ""


def _remarks(
    stretches: Sequence[coasting.Stretch],
    road: Road,
    directions: list[int],
    *,
    with_sensor: bool,
) -> tuple[str, ...]:
    drivings = list({id(s.driving): s.driving for s in stretches}.values())
    remarks = [f"{d.name}: {text}" for d in drivings for text in d.remarks]
    if road == "both ways":
        there = directions.count(1)
        remarks.append(
            f"assumed to be one road driven both ways, {there} runs up and "
            f"{directions.count(-1)} down: its grade cancels. Runs that do "
            "not return on their road: --one-way"
        )
    elif road == "level":
        remarks.append(
            "the road is assumed level: 0.1 % of grade, the same in every "
            "run, is 0.001 of f_r"
        )
    else:
        remarks.append("f_r includes grade and accelerometer bias")
    if not with_sensor:
        remarks.append(
            "the accelerometer is not used: the grade is one constant for "
            "each run"
        )
    pitches = [d for d in drivings if with_sensor and d.pitch > 0.0]
    remarks += [
        f"{d.name}: the body pitches by {d.pitch:.3f} m/s2 a m/s2 (standard "
        f"error {d.pitch_error:.3f}), subtracted from the accelerometer"
        for d in pitches
    ]
    remarks.append(
        "the mass is an input: drag and C_fric are proportional to it, f_r is "
        "not"
    )
    return tuple(remarks)


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


def _windows(
    stretches: Sequence[coasting.Stretch], *, with_sensor: bool
) -> Matrix:
    """Return run, force [N] and the means of v^2 and v of each window, (4, k).

    The force is that of the resistances. With the accelerometer climbing is
    subtracted, without it is included.
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
    stretches: Sequence[coasting.Stretch],
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
    known = [
        0.5 * AIR_DENSITY_KG_M3 * vehicle.drag_area_m2,
        vehicle.friction_ns_m,
    ]
    shapes = (square, linear)
    free = [row for row in (0, 1) if NAMES[row] not in held]
    for row in {0, 1}.difference(free):
        force = force - known[row] * shapes[row]
    constants = np.ones((len(force), 1))
    if not with_sensor:
        constants = 1.0 * np.equal.outer(run, np.arange(len(stretches)))
    fit = fit_linear(
        np.column_stack([*(shapes[row] for row in free), constants]), force
    )
    for row, value in zip(free, fit.estimate.tolist(), strict=False):
        known[row] = value
    # f_r follows from the mean of the constants
    mix = np.zeros((3, len(fit.estimate)))
    mix[free, range(len(free))] = 1.0
    mix[2, len(free) :] = 1.0 / constants.shape[1]
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
        known[0],
        known[1],
        constant,
        errors,
        correlation,
        sqrt(fit.variance),
        len(force),
        apparent,
        with_sensor,
    )


def _apparent_ms2(stretch: coasting.Stretch) -> float:
    """Return the mean of grade times g plus bias over the way."""
    driving, part = stretch.driving, stretch.points
    speed = driving.speed_ms[part]
    slope_ms2 = driving.slope_ms2[part]
    return float((slope_ms2 * speed).sum() / speed.sum())


def directions_of(apparent_ms2: Column) -> list[int]:
    """Return +1 or -1 for each run by its side of the widest gap.

    All 0 where the runs differ by no more than a level road's.
    """
    order = np.sort(apparent_ms2)
    gaps = np.diff(order)
    if not len(gaps) or gaps.max() < LEVEL_MS2:
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
