"""Resistances of the car from coast-downs, thesis Eq 4.2 to 4.6, Fig 4.4.

Least squares of

    m dv/dt = T / R - (1/2 rho CdA v^2 + C_fric v + m g f_r) - m g sin(grade)

over windows of a few seconds: the change of speed over a window is exact, no
derivative is taken. An accelerometer reads ``dv/dt + g sin(grade) + bias``
and gives the shape of the grade. Its bias, or without it each run's grade, is
one constant with f_r; runs in both directions of one road settle it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan, sqrt
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from bstm_daemon.analysis.identify.coastdown_fit import (
    directions_of,
    fit_windows,
    middle_of,
)
from bstm_daemon.analysis.identify.coastdown_run import Run, run_of
from bstm_daemon.analysis.identify.coasting import Stretch, coasting
from bstm_daemon.errors import LogError
from bstm_daemon.units import AIR_DENSITY_KG_M3, GRAVITY_MS2

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from bstm_daemon.analysis.identify.coastdown_fit import Fit
    from bstm_daemon.analysis.identify.driving import Driving
    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.config.sections import VehicleConfig

NAMES: Final = ("drag_area_m2", "friction_ns_m", "rolling_resistance")
"""Keys of ``[vehicle]``, in the order of the fit's columns."""

FAINT: Final = 0.5
"""A value with a larger relative standard error is not identified."""

TIED: Final = 0.995
"""Two values with a larger correlation can not be told apart; from 100 down
to 15 km/h it is 0.98, from 60 to 40 above 0.999."""

LEAST_WINDOWS: Final = 12
"""Fewer leave the residual, and with it every error, to chance."""

MOST: Final = {
    "drag_area_m2": 20.0,
    "friction_ns_m": 200.0,
    "rolling_resistance": 0.1,
}
"""A lorry with a trailer, a bad gearbox, loose sand."""

Road = Literal["both ways", "one way", "level"]


@dataclass(frozen=True, slots=True)
class Value:
    """A value of ``[vehicle]`` with what it was and how sure it is.

    ``standard_error`` is nan where the value was held. ``caveat`` says why it
    is not identified, and is empty where it is.
    """

    name: str
    value: float
    standard_error: float
    configured: float
    caveat: str = ""

    @property
    def identified(self) -> bool:
        """Whether the runs settle it."""
        return not self.caveat


@dataclass(frozen=True, slots=True)
class CoastDown:
    """The result: values, how they hang together, every run.

    ``correlation`` (3, 3) is that of drag, C_fric and the constant term, nan
    where held. ``bias_ms2`` is the accelerometer's, None without one.
    """

    values: tuple[Value, ...]
    correlation: Column
    residual_ms2: float
    windows: int
    road: Road
    bias_ms2: float | None
    runs: tuple[Run, ...]
    searched: tuple[str, ...]
    remarks: tuple[str, ...]

    def value(self, name: str) -> Value:
        """Return the value of the key *name*."""
        return next(one for one in self.values if one.name == name)


def identify_coast_down(
    drivings: Sequence[Driving],
    vehicle: VehicleConfig,
    *,
    held: Collection[str] = (),
    one_way: bool = False,
    even_grade: bool = False,
) -> CoastDown:
    """Find the coast-downs of *drivings* and fit the resistances to them.

    Args:
        drivings: the logs.
        vehicle: the configured values: mass and wheels are taken from it.
        held: keys of :data:`NAMES` that keep their configured value.
        one_way: the runs do not return on their road, so that nothing tells
            f_r from grade and bias.
        even_grade: the grade is one constant for each run; the
            accelerometer and its noise are left out.

    Raises:
        LogError: no log has a coast-down; says what was searched.
    """
    stretches: list[Stretch] = []
    searched = []
    for driving in drivings:
        found, words = coasting(driving)
        stretches += found
        searched.append(f"{driving.name}: {words}")
    if not stretches:
        lines = {d.line_known for d in drivings} - {""}
        hint = (
            ""
            if lines
            else "; nothing tells whether the engine pulls: map gear, "
            "clutch_open or powertrain_torque, or declare [heat] "
            "assume_powertrain_torque_nm"
        )
        msg = "no coast-down found. " + "; ".join(searched) + hint
        raise LogError(msg)
    with_sensor = not even_grade and all(d.has_accelerometer for d in drivings)
    fit = fit_windows(stretches, vehicle, held, with_sensor=with_sensor)
    return _result(
        stretches,
        fit,
        vehicle,
        held,
        tuple(searched),
        one_way=one_way,
    )


def _result(
    stretches: Sequence[Stretch],
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
    middle, middle_error = middle_of(fit.apparent_ms2, directions)
    weight = vehicle.mass_kg * GRAVITY_MS2
    if fit.with_sensor:
        # the one constant is m (g f_r - bias)
        constant = float(fit.constant_n[0]) + vehicle.mass_kg * middle
    else:
        constant = float(np.mean(fit.constant_n)) + vehicle.mass_kg * middle
    rolling_error = sqrt(
        float(fit.errors[2]) ** 2 + (vehicle.mass_kg * middle_error) ** 2
    )
    road: Road = "both ways" if any(directions) else "level"
    if one_way:
        road = "one way"
    half_rho = 0.5 * AIR_DENSITY_KG_M3
    rolling = constant / weight
    rolling_caveat = ""
    if one_way:
        rolling_caveat = "the runs do not return: it is one with the grade"
    if "rolling_resistance" in held:
        rolling = vehicle.rolling_resistance
        rolling_error = nan
        middle = rolling * GRAVITY_MS2 - float(fit.constant_n.mean()) / (
            vehicle.mass_kg
        )
        rolling_caveat = "held"
    found = {
        "drag_area_m2": (fit.quadratic / half_rho, fit.errors[0] / half_rho),
        "friction_ns_m": (fit.linear, fit.errors[1]),
        "rolling_resistance": (rolling, rolling_error / weight),
    }
    values = []
    for row, (name, (value, error)) in enumerate(found.items()):
        caveat = rolling_caveat if row == 2 else ""
        if name in held:
            caveat, error = "held", nan  # noqa: PLW2901
        elif not caveat:
            caveat = _caveat(row, value, float(error), fit)
        values.append(
            Value(name, value, float(error), getattr(vehicle, name), caveat)
        )
    car = replace(
        stretches[0].driving.vehicle,
        quadratic=fit.quadratic,
        linear=fit.linear,
        constant=weight * rolling,
    )
    grades = (fit.apparent_ms2 - middle) / GRAVITY_MS2
    return CoastDown(
        tuple(values),
        fit.correlation,
        fit.residual_n / vehicle.mass_kg,
        fit.windows,
        road,
        middle if fit.with_sensor else None,
        tuple(
            run_of(
                stretch,
                way,
                float(grade),
                car,
                bias_ms2=middle if fit.with_sensor else None,
            )
            for stretch, way, grade in zip(
                stretches, directions, grades, strict=True
            )
        ),
        searched,
        _remarks(stretches, road, directions, with_sensor=fit.with_sensor),
    )


def _caveat(row: int, value: float, error: float, fit: Fit) -> str:
    """Say why a value is not identified; empty if it is."""
    if fit.windows < LEAST_WINDOWS:
        return f"{fit.windows} windows only, {LEAST_WINDOWS} needed"
    tied = [
        NAMES[other]
        for other in range(3)
        if other != row and abs(fit.correlation[row, other]) > TIED
    ]
    if tied:
        return f"can not be told from {' and '.join(tied)}: more speeds needed"
    if not 0.0 <= value <= MOST[NAMES[row]]:
        return f"{value:.3g} can not be: something else slows the car"
    if error > FAINT * value:
        return f"standard error of {100 * error / (value or 1e-30):.0f} %"
    return ""


def _remarks(
    stretches: Sequence[Stretch],
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
            f"taken as one road driven both ways, {there} runs up and "
            f"{directions.count(-1)} down: its grade cancels. Runs that do "
            "not return on their road: --one-way"
        )
    elif road == "level":
        remarks.append(
            "the road is taken as level: 0.1 % of grade, the same in every "
            "run, is 0.001 of f_r"
        )
    else:
        remarks.append("f_r is not told from grade and accelerometer bias")
    if not with_sensor:
        remarks.append(
            "the accelerometer is not used: the grade is one constant for "
            "each run"
        )
    pitches = [d for d in drivings if with_sensor and d.pitch > 0.0]
    remarks += [
        f"{d.name}: the body pitches by {d.pitch:.3f} m/s2 a m/s2 (standard "
        f"error {d.pitch_error:.3f}), taken off the accelerometer"
        for d in pitches
    ]
    remarks.append(
        "the mass is given: drag and C_fric are in proportion to it, f_r is "
        "not"
    )
    return tuple(remarks)
