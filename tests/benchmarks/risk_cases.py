"""Descents of the independent reality: cars, roads, drivers, wear.

The cars are those of the fleet, each matched as a car is. A descent draws
what comes after: its load, the road and the driver, the pads' wear and, on
*another day*, what has changed since the match (``SINCE``). The brakes are
marched by the simulated reality, which shares no physics code with the
estimator; the daemon gets speed, pressure and outside air with errors of
sensors. Where a disc gets near 700 degC the driver brakes with the engine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from risk_fleet import GROUPS, JUDGED, FleetCar, scaled

from bstm_daemon.roles import CORNERS as ALL_CORNERS
from bstm_daemon.simulation.parameters import CornerParameters, preset_effects
from bstm_daemon.simulation.reality import LaneInputs, LaneResult, march_lanes
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

DRIVE_S: Final = 1920
"""Longest drive before the stop."""

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

SHIFTS_K: Final = HOTTEST_DISC_K - 20.0
"""Temperature of the disc at which its driver shifts down."""

ENGINE_N: Final = (500.0, 900.0, 1300.0)
"""Drag of the engine at the wheels in lower and lower gears. The last one is
the second gear: 55 N m of drag, 8 to 1, 0.34 m of wheel."""

DRIVE_KEPT_S: Final = 5
"""Interval at which temperatures before the stop are looked at."""

AMBIENT_SENSOR_K: Final = 1.0
PRESSURE_OFFSET_PA: Final = 0.05e5
PRESSURE_QUANTUM_PA: Final = 0.1e5
SPEED_QUANTUM_MS: Final = 0.03


class Drive(NamedTuple):
    """A drive, a value a second, the last one before the stop.

    ``need_n`` is the force that holds the car's speed, ``drag_n`` the
    engine's part of it, ``pulses`` the brake's on and off.
    """

    speed_ms: Column
    need_n: Column
    drag_n: Column
    pulses: Column

    @property
    def force_n(self) -> Column:
        """Force that is left to the brakes."""
        return np.maximum(self.need_n - self.drag_n, 0.0) * self.pulses

    def shifted(self, from_s: float, drag_n: float) -> Drive:
        """Return the drive with a lower gear from *from_s* on."""
        late = np.arange(len(self.drag_n)) >= from_s
        return self._replace(
            drag_n=np.maximum(self.drag_n, np.where(late, drag_n, 0.0))
        )


@dataclass(frozen=True, slots=True)
class Case:
    """A car on a drive; ``error_pa`` is that of its pressure sensor."""

    one: FleetCar
    ambient_k: float
    drive: Drive
    sensed_ambient_k: float
    error_pa: Column

    def sensed_speed_ms(self) -> Column:
        """Return what the speed's sensor makes of the drive."""
        return np.round(self.drive.speed_ms / SPEED_QUANTUM_MS) * (
            SPEED_QUANTUM_MS
        )

    def sensed_pressure_pa(self, pressure_pa: Column) -> Column:
        """Return what the pressure's sensor makes of *pressure_pa*."""
        steps = np.round((pressure_pa + self.error_pa) / PRESSURE_QUANTUM_PA)
        told = np.maximum(steps * PRESSURE_QUANTUM_PA, 0.0)
        return np.where(pressure_pa > 0, told, 0.0)


@dataclass(frozen=True, slots=True)
class Truth:
    """What a drive really came to; ``time_s`` counts from the stop.

    ``fluid_k`` [m, corner] are the judged corners from the stop on,
    ``hottest_k`` and ``disc_k`` the hottest fluid of all and the hottest disc
    before the stop, ``shifts_s`` the second in which it passed
    :data:`SHIFTS_K`, inf: none. ``pressure_pa`` is what the driver pressed,
    a value a second.
    """

    time_s: Column
    fluid_k: Column
    hottest_k: float
    disc_k: float
    shifts_s: float
    pressure_pa: Column

    @property
    def stop_k(self) -> Column:
        """The fluid at the stop."""
        return self.fluid_k[0]


def draw_case(
    rng: np.random.Generator, cars: Sequence[FleetCar], *, another_day: bool
) -> Case:
    """Return a descent of one of *cars* with a driver of its own."""
    mass_kg = rng.uniform(2000.0, 2800.0)
    car = draw_car(rng, cars, mass_kg, another_day=another_day)
    speed_ms, slope = _course(rng)
    accel = np.gradient(speed_ms)
    drag_n = rng.uniform(0.0, 350.0)
    need_n = -car.car.resistance(speed_ms, slope)
    need_n -= car.car.effective_mass_kg * accel
    pulses = _pulses(rng, len(speed_ms))
    ambient_k = KELVIN_OFFSET + rng.uniform(5.0, 38.0)
    drag = np.full(len(speed_ms), drag_n)
    return sensed(rng, car, ambient_k, Drive(speed_ms, need_n, drag, pulses))


def draw_car(
    rng: np.random.Generator,
    cars: Sequence[FleetCar],
    mass_kg: float,
    *,
    another_day: bool,
) -> FleetCar:
    """Return one of *cars* with worn pads, configured to match."""
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
    return FleetCar(car, one.preset, config)


def sensed(
    rng: np.random.Generator, one: FleetCar, ambient_k: float, drive: Drive
) -> Case:
    """Return the case of a car on its way, with the errors of its sensors."""
    seconds = len(drive.speed_ms)
    dither = rng.uniform(-0.5, 0.5, seconds) * PRESSURE_QUANTUM_PA
    return Case(
        one,
        ambient_k,
        drive,
        ambient_k + AMBIENT_SENSOR_K * rng.standard_normal(),
        PRESSURE_OFFSET_PA * rng.standard_normal() + dither,
    )


def driven(
    cases: Sequence[Case], horizon_s: float = HORIZON_S
) -> list[tuple[Case, Truth]]:
    """Drive *cases* and let them park; return them as they were driven.

    A driver whose disc gets too hot takes the highest gear that keeps it
    below :data:`HOTTEST_DISC_K`, from when it passed :data:`SHIFTS_K` on; the
    lowest one where none does.

    Raises ArithmeticError where the march went astray.
    """
    found = _marched(cases, horizon_s)
    for drag_n in ENGINE_N:
        hot = [
            number
            for number, (_, truth) in enumerate(found)
            if truth.disc_k > HOTTEST_DISC_K
        ]
        again = [
            replace(case, drive=case.drive.shifted(truth.shifts_s, drag_n))
            for case, truth in (found[number] for number in hot)
        ]
        for number, one in zip(hot, _marched(again, horizon_s), strict=True):
            found[number] = one
    return found


def _marched(
    cases: Sequence[Case], horizon_s: float
) -> list[tuple[Case, Truth]]:
    """March *cases* side by side; shorter drives stand first."""
    if not cases:
        return []
    drive_s = max(len(case.drive.speed_ms) for case in cases)
    steps = drive_s + round(horizon_s / SOAK_STEP_S)
    step_s = np.ones(steps)
    step_s[drive_s:] = SOAK_STEP_S
    keep = np.ones(steps, bool)
    keep[:drive_s] = np.arange(1 - drive_s, 1) % DRIVE_KEPT_S == 0
    lanes = len(JUDGED) * len(cases)
    places = [ALL_CORNERS.index(name) for name in JUDGED]
    columns = {
        name: np.zeros((steps, lanes))
        for name in ("speed", "power", "pressure")
    }
    ambient = np.empty((steps, lanes))
    corners: list[CornerParameters] = []
    for i, case in enumerate(cases):
        at = slice(len(JUDGED) * i, len(JUDGED) * (i + 1))
        speed_ms, force_n = case.drive.speed_ms, case.drive.force_n
        rows = slice(drive_s - len(speed_ms), drive_s)
        gains = case.one.car.gains
        pressure_pa = force_n / gains.sum()
        columns["speed"][rows, at] = speed_ms[:, None]
        columns["power"][rows, at] = (pressure_pa * speed_ms)[:, None] * gains[
            places
        ]
        columns["pressure"][rows, at] = pressure_pa[:, None]
        ambient[:, at] = case.ambient_k
        corners += [case.one.car.corners[place] for place in places]
    result = march_lanes(
        corners,
        [preset_effects(case.one.preset) for case in cases for _ in JUDGED],
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
    # what the driver pressed: more where friction has faded
    pressed_pa = columns["pressure"] / result.friction
    return [
        (case, _truth(result, drive_s, i, pressed_pa, case))
        for i, case in enumerate(cases)
    ]


def _truth(
    result: LaneResult,
    drive_s: int,
    number: int,
    pressed_pa: Column,
    case: Case,
) -> Truth:
    """Return what is kept of *case*, the march's *number*."""
    lanes = slice(len(JUDGED) * number, len(JUDGED) * (number + 1))
    time_s = result.time_s - drive_s
    stop = int(np.searchsorted(time_s, 0.0))
    fluid_k = result.nodes["fluid"][:, lanes]
    disc_k = result.nodes["disc_mean"][: stop + 1, lanes].max(axis=1)
    hot = disc_k > SHIFTS_K
    seconds = len(case.drive.speed_ms)
    return Truth(
        time_s[stop:],
        fluid_k[stop:].copy(),
        float(fluid_k.max()),
        float(disc_k.max()),
        float(time_s[hot.argmax()]) + seconds if hot.any() else inf,
        pressed_pa[drive_s - seconds : drive_s, lanes.start].copy(),
    )


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
