"""Descents of the independent reality: cars, roads, drivers, wear.

The cars are those of the fleet, each matched as a car is. A descent draws
what comes after: its load, the road and the driver, the pads' wear and, on
*another day*, what has changed since the match (``SINCE``). The brakes are
marched by the simulated reality, which shares no physics code with the
estimator; the daemon gets speed, pressure and outside air with errors of
sensors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from risk_fleet import GROUPS, JUDGED, FleetCar, scaled

from bstm_daemon.roles import CORNERS as ALL_CORNERS
from bstm_daemon.simulation.march import LaneInputs
from bstm_daemon.simulation.parameters import preset_effects
from bstm_daemon.simulation.reality import march_lanes
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation.march import LaneResult
    from bstm_daemon.simulation.parameters import CornerParameters
    from bstm_daemon.simulation.vehicle import CarParameters

    Column = npt.NDArray[np.float64]

DRIVE_S: Final = 1920
"""Time before the stop that is marched; shorter drives stand first."""

SOAK_STEP_S: Final = 2.0
HORIZON_S: Final = 1800.0

LINING_LEFT: Final = (0.55, 1.0)
"""Lining over that of new pads, which the match was made with."""

LINING_KNOWN_M: Final = 2.5e-4
"""Deviation of the thickness that the configuration has."""

SINCE: Final = {
    "friction": 0.02,
    "caliper_air": 0.03,
    "disc_air": 0.03,
}
"""Relative deviation by which another day differs from that of the match:
friction of the lining, air at caliper and disc. The daemon does not know."""

HOTTEST_DISC_K: Final = 973.15
"""Beyond 700 degC a driver has had no brake for long."""

AMBIENT_SENSOR_K: Final = 1.0
PRESSURE_OFFSET_PA: Final = 0.05e5
PRESSURE_QUANTUM_PA: Final = 0.1e5
SPEED_QUANTUM_MS: Final = 0.03


@dataclass(frozen=True, slots=True)
class Case:
    """One descent; arrays a value a second, the last one before the stop."""

    car: CarParameters
    config: Config
    ambient_k: float
    speed_ms: Column
    pressure_pa: Column
    power_w: Column
    sensed_ambient_k: float
    sensed_pressure_pa: Column
    sensed_speed_ms: Column


@dataclass(frozen=True, slots=True)
class Truth:
    """The fluid of the judged corners after the stop, [m, corner], every 2 s.

    ``stop_k`` is that at the stop, ``time_s`` counts from it; ``disc_k`` is
    the hottest disc at the stop.
    """

    time_s: Column
    fluid_k: Column
    stop_k: Column
    disc_k: float


def draw_case(
    rng: np.random.Generator, cars: Sequence[FleetCar], *, another_day: bool
) -> Case:
    """Return a descent of one of *cars* with a driver of its own."""
    mass_kg = rng.uniform(2000.0, 2800.0)
    car, config = draw_car(rng, cars, mass_kg, another_day=another_day)
    speed_ms, slope = _course(rng)
    accel = np.gradient(speed_ms)
    drag = rng.uniform(0.0, 350.0)
    need = -car.resistance(speed_ms, slope) - car.effective_mass_kg * accel
    force = np.maximum(need - drag, 0.0) * _pulses(rng, len(speed_ms))
    ambient_k = KELVIN_OFFSET + rng.uniform(5.0, 38.0)
    return sensed(rng, car, config, ambient_k, speed_ms, force)


def draw_car(
    rng: np.random.Generator,
    cars: Sequence[FleetCar],
    mass_kg: float,
    *,
    another_day: bool,
) -> tuple[CarParameters, Config]:
    """Return one of *cars* with worn pads, and its configuration."""
    one = cars[int(rng.integers(len(cars)))]
    left = rng.uniform(*LINING_LEFT)
    since = {
        name: float(np.exp(another_day * deviation * rng.standard_normal()))
        for name, deviation in SINCE.items()
    }
    factors = {"pad_thickness_m": left}
    for name, factor in since.items():
        for key in GROUPS.get(name, ("friction_coefficient",)):
            factors[key] = factor
    car = replace(
        one.car,
        mass_kg=mass_kg,
        front=scaled(one.car.front, factors),
        rear=scaled(one.car.rear, factors),
    )
    error_m = LINING_KNOWN_M * rng.standard_normal()
    corners = []
    for corner in one.config.corner:
        if corner.name not in JUDGED:
            continue
        assert corner.pad is not None
        told_m = corner.pad.thickness_m * left + error_m
        pad = corner.pad.model_copy(update={"thickness_m": told_m})
        corners.append(corner.model_copy(update={"pad": pad}))
    vehicle = one.config.vehicle.model_copy(update={"mass_kg": mass_kg})
    config = one.config.model_copy(
        update={"corner": corners, "vehicle": vehicle}
    )
    return car, config


def sensed(
    rng: np.random.Generator,
    car: CarParameters,
    config: Config,
    ambient_k: float,
    speed_ms: Column,
    force_n: Column,
) -> Case:
    """Return the case of a car that brakes with *force_n*, as it is sensed."""
    # what the pedal asks for: the gains are those of today's friction
    pressure = force_n / car.gains.sum()
    offset = PRESSURE_OFFSET_PA * rng.standard_normal()
    noisy = pressure + np.where(pressure > 0, offset, 0.0)
    noisy += rng.uniform(-0.5, 0.5, len(noisy)) * PRESSURE_QUANTUM_PA
    told = np.round(noisy / PRESSURE_QUANTUM_PA) * PRESSURE_QUANTUM_PA
    return Case(
        car,
        config,
        ambient_k,
        speed_ms,
        pressure,
        force_n * speed_ms,
        ambient_k + AMBIENT_SENSOR_K * rng.standard_normal(),
        np.where(pressure > 0, np.maximum(told, 0.0), 0.0),
        np.round(speed_ms / SPEED_QUANTUM_MS) * SPEED_QUANTUM_MS,
    )


def march_truth(cases: list[Case], preset: str = "plain") -> list[Truth]:
    """Return what the fluid of each case really does after its stop."""
    steps = DRIVE_S + round(HORIZON_S / SOAK_STEP_S)
    step_s = np.ones(steps)
    step_s[DRIVE_S:] = SOAK_STEP_S
    keep = np.zeros(steps, bool)
    keep[DRIVE_S - 1 :] = True
    result = _marched(cases, preset, step_s, keep, DRIVE_S)
    time_s = result.time_s - DRIVE_S
    fluid = result.nodes["fluid"].reshape(len(time_s), len(cases), -1)
    disc = result.nodes["disc_mean"][0].reshape(len(cases), -1).max(axis=1)
    return [
        Truth(time_s, fluid[:, i].copy(), fluid[0, i].copy(), float(disc[i]))
        for i in range(len(cases))
    ]


def march_drive(case: Case, preset: str = "plain") -> tuple[float, float]:
    """Return the hottest fluid and the hottest disc [K] of a drive.

    Raises ArithmeticError where the march went astray.
    """
    steps = len(case.speed_ms)
    step_s, keep = np.ones(steps), np.ones(steps, bool)
    result = _marched([case], preset, step_s, keep, steps)
    fluid, disc = result.nodes["fluid"], result.nodes["disc_mean"]
    return float(fluid.max()), float(disc.max())


def _marched(
    cases: list[Case],
    preset: str,
    step_s: Column,
    keep: npt.NDArray[np.bool_],
    drive_s: int,
) -> LaneResult:
    """March *cases* side by side; their drives end after *drive_s* steps."""
    steps, lanes = len(step_s), len(JUDGED) * len(cases)
    places = [ALL_CORNERS.index(name) for name in JUDGED]
    columns = {
        name: np.zeros((steps, lanes))
        for name in ("speed", "power", "pressure")
    }
    ambient = np.empty((steps, lanes))
    corners: list[CornerParameters] = []
    for i, case in enumerate(cases):
        at = slice(len(JUDGED) * i, len(JUDGED) * (i + 1))
        first = drive_s - len(case.speed_ms)
        gains = case.car.gains
        share = gains[places] / gains.sum()
        columns["speed"][first:drive_s, at] = case.speed_ms[:, None]
        columns["power"][first:drive_s, at] = case.power_w[:, None] * share
        columns["pressure"][first:drive_s, at] = case.pressure_pa[:, None]
        ambient[:, at] = case.ambient_k
        corners += [case.car.corners[place] for place in places]
    result = march_lanes(
        corners,
        [preset_effects(preset)] * lanes,
        LaneInputs(
            step_s=step_s,
            keep=keep,
            speed_ms=columns["speed"],
            power_w=columns["power"],
            pressure_pa=columns["pressure"],
            contact=(columns["pressure"] > 0).astype(float),
            ambient_k=ambient,
            wetness=np.zeros((steps, lanes)),
            pumping_pa_s=np.zeros((steps, lanes)),
            corners_per_car=len(JUDGED),
        ),
        start_k=ambient[0].copy(),
    )
    if not np.isfinite(result.nodes["disc_mean"]).all():
        msg = "the reality's march went astray"
        raise ArithmeticError(msg)
    return result


def _course(rng: np.random.Generator) -> tuple[Column, Column]:
    """Return speed [m/s] and slope [rad] a second; it ends at the stop."""
    length = int(rng.uniform(1200.0, DRIVE_S))
    pace = rng.uniform(9.0, 14.0)
    knots = np.arange(0.0, length + 60.0, 30.0)
    bends = np.where(
        rng.random(len(knots)) < 0.35, rng.uniform(0.4, 0.75, len(knots)), 1.0
    )
    speed = np.interp(
        np.arange(length), knots, pace * bends * rng.uniform(0.85, 1.15)
    )
    grade = rng.uniform(0.08, 0.115)
    slope = -np.interp(
        np.arange(length),
        knots,
        np.arctan(grade * rng.uniform(0.6, 1.4, len(knots))),
    )
    if rng.random() < 0.2:
        at = int(rng.uniform(0.3, 0.8) * length)
        for rest in range(int(rng.uniform(20.0, 120.0))):
            speed[min(at + rest, length - 1)] = 0.0
            slope[min(at + rest, length - 1)] = 0.0
    if rng.random() < 0.3:
        flat = int(rng.uniform(30.0, 240.0))
        slope[-flat:] = 0.0
    # the last seconds: brakes to the stop, then 1 s at rest
    last = speed[-6]
    speed[-6:] = last * np.array([0.8, 0.6, 0.4, 0.2, 0.1, 0.0])
    return speed, slope


def _pulses(rng: np.random.Generator, length: int) -> Column:
    """Return a driver's brake on and off, of mean 1."""
    share, period = rng.uniform(0.5, 1.0), rng.uniform(8.0, 30.0)
    phase = (np.arange(length) / period + rng.random()) % 1.0
    return np.where(phase < share, 1.0 / share, 0.0)
