"""Mixed driving: how often the daemon warns where nothing boils."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from risk_cases import HOTTEST_DISC_K, Case, draw_car, march_drive, sensed
from risk_fleet import JUDGED, FleetCar
from risk_fluids import draw_fluid
from risk_judge import estimating, samples

from bstm_daemon.risk.levels import PROBABILITIES
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

TRIP_S: Final = 3600
PASSES: Final = 0.1
"""Share of the trips that lead over a pass."""

MEMBERS: Final = 8
FLUIDS: Final = 20
"""Fluids that each trip is judged with."""


@dataclass(frozen=True, slots=True)
class Driven:
    """What mixed driving came to.

    ``warned`` and ``warned_given`` count trips and fluids whose probability
    reached *high* at a forecast though the fluid did not boil, ``boiled``
    those that did boil; over :data:`FLUIDS` a trip. Peaks in K: ``forecast_k``
    the hottest forecast, ``fluid_k`` the hottest fluid.
    """

    km: float
    warned: int
    warned_given: int
    boiled: int
    forecast_k: float
    fluid_k: float

    def __add__(self, other: Driven) -> Driven:
        """Return both together."""
        return Driven(
            self.km + other.km,
            self.warned + other.warned,
            self.warned_given + other.warned_given,
            self.boiled + other.boiled,
            max(self.forecast_k, other.forecast_k),
            max(self.fluid_k, other.fluid_k),
        )

    def rate(self, warned: int) -> float:
        """Return *warned* for every 10 000 km with one fluid."""
        return warned / FLUIDS / self.km * 1e4


NOTHING: Final = Driven(0.0, 0, 0, 0, 0.0, 0.0)


def mixed(
    kilometres: float, seed: tuple[int, ...], cars: Sequence[FleetCar]
) -> Driven:
    """Drive *kilometres* or a little more with *cars*."""
    rng = np.random.default_rng(seed)
    driven = NOTHING
    while driven.km < kilometres:
        driven += _judged(rng, _trip(rng, cars))
    return driven


def _judged(rng: np.random.Generator, case: Case) -> Driven:
    fluid_k, disc_k = march_drive(case)
    # as for the descents; NaN, too, is not below
    if not disc_k <= HOTTEST_DISC_K:
        return NOTHING
    peaks = _worst_peaks(case)
    warned = [0, 0]
    boiled = 0
    for _ in range(FLUIDS):
        fluid = draw_fluid(rng)
        if fluid_k >= fluid.boiling_k:
            boiled += 1
            continue
        for number, known in enumerate((fluid.unknown, fluid.given)):
            mean = np.mean([known.probability(k) for k in peaks])
            warned[number] += bool(mean >= PROBABILITIES[1])
    km = float(case.speed_ms.sum()) / 1000.0
    return Driven(km, *warned, boiled, float(peaks.max()), fluid_k)


def _worst_peaks(case: Case) -> Column:
    """Return the members' peaks of the hottest forecast of a trip."""
    small = case.config.forecast.model_copy(update={"members": MEMBERS})
    config = case.config.model_copy(update={"forecast": small})
    estimator, monitor = estimating(case, config)
    worst = np.zeros(MEMBERS)
    times, numbers, values = samples(case)
    ends = np.arange(times[0], times[-1] + 10_000_000, 10_000_000)
    for part in map(slice, *_places(times, ends)):
        for block in estimator.advance(
            times[part], numbers[part], values[part]
        ):
            monitor.add(block)
        peaks = monitor.peaks_k()
        if all(peaks.values()):
            found = np.array([peaks[name] for name in JUDGED]).max(axis=0)
            if found.mean() > worst.mean():
                worst = found
    return worst


def _places(
    times: npt.NDArray[np.int64], ends: npt.NDArray[np.int64]
) -> tuple[list[int], list[int]]:
    cuts = np.searchsorted(times, ends)
    return cuts[:-1].tolist(), cuts[1:].tolist()


def _trip(rng: np.random.Generator, cars: Sequence[FleetCar]) -> Case:
    """Return an hour of town, country and motorway over hills, or a pass."""
    mass_kg = rng.uniform(1700.0, 2700.0)
    car, config = draw_car(rng, cars, mass_kg, another_day=True)
    seconds = np.arange(TRIP_S)
    if rng.random() < PASSES:
        speed, hills, drag = _pass_road(rng)
    else:
        speed = _speeds(rng)
        hills = np.interp(
            seconds,
            np.arange(0, TRIP_S + 121, 120),
            rng.normal(0.0, 0.025, TRIP_S // 120 + 2),
        )
        drag = rng.uniform(50.0, 400.0)
    need = -car.resistance(speed, np.arctan(hills))
    need -= car.effective_mass_kg * np.gradient(speed)
    force = np.where(speed > 0.0, np.maximum(need - drag, 0.0), 0.0)
    ambient_k = KELVIN_OFFSET + rng.uniform(-5.0, 36.0)
    return sensed(rng, car, config, ambient_k, speed, force)


def _pass_road(rng: np.random.Generator) -> tuple[Column, Column, float]:
    """Return speed, grade and drag over a pass, driven in a lower gear."""
    up, down, valley = (
        int(rng.uniform(*span))
        for span in ((600.0, 1200.0), (600.0, 1300.0), (120.0, 400.0))
    )
    knots = np.arange(0, TRIP_S + 61, 30)
    pace = rng.uniform(11.0, 16.0)
    bends = np.where(
        rng.random(len(knots)) < 0.35, rng.uniform(0.4, 0.75, len(knots)), 1.0
    )
    speed = np.interp(np.arange(TRIP_S), knots, pace * bends)
    grade = rng.uniform(0.05, 0.09) * rng.uniform(0.6, 1.4, len(knots))
    hills = np.interp(np.arange(TRIP_S), knots, grade)
    summit = valley + up
    hills[:valley] = 0.0
    hills[summit : summit + down] *= -1.0
    hills[summit + down :] = 0.0
    speed[summit + down + valley :] = 0.0
    return _smooth(speed), hills, rng.uniform(200.0, 900.0)


def _smooth(speed: Column) -> Column:
    """Return *speed* as a car can do it."""
    found = speed.copy()
    found[0] = 0.0
    for i in range(1, len(found)):
        change = speed[i] - found[i - 1]
        found[i] = found[i - 1] + min(max(change, -2.0), 1.5)
    return found


def _speeds(rng: np.random.Generator) -> Column:
    """Return the speed [m/s] a second."""
    targets: list[float] = []
    while len(targets) < TRIP_S:
        kind = rng.choice(3, p=(0.35, 0.4, 0.25))
        length = int(rng.uniform(20.0, (90.0, 180.0, 400.0)[kind]))
        pace = (13.0, 24.0, 35.0)[kind] * rng.uniform(0.6, 1.1)
        targets += [pace] * length
        if kind == 0 or rng.random() < 0.15:
            targets += [0.0] * int(rng.uniform(5.0, 40.0))
    speed = np.zeros(TRIP_S)
    up, down = rng.uniform(1.0, 2.2), rng.uniform(1.0, 3.5)
    for i in range(1, TRIP_S):
        change = targets[i] - speed[i - 1]
        speed[i] = speed[i - 1] + min(max(change, -down), up)
    return speed
