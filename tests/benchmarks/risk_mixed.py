"""Mixed driving: how often the daemon warns where nothing boils.

No trip is left out: a march of the reality that goes astray is an error.
Drivers brake with the engine near 700 degC, as on the descents.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from risk_cases import HORIZON_S, Case, Drive, Truth, draw_car, driven, sensed
from risk_fleet import JUDGED, FleetCar
from risk_fluids import draw_fluid
from risk_judge import START_US, estimating, samples
from side_by_side import Table

from bstm_daemon.model.risk.levels import PROBABILITIES
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy.typing as npt
    from risk_fluids import DrawnFluid

    Column = npt.NDArray[np.float64]

TRIP_S: Final = 3600
PARKED_S: Final = int(HORIZON_S)
"""A car stands so long after its trip."""

MASS_KG: Final = (1700.0, 2800.0)
"""From the driver alone to the gross mass."""

PASSES: Final = 0.1
"""Share of the trips that lead over a pass."""

LOW_GEAR: Final = 0.75
"""Share of the drivers who take a pass in a gear chosen to the grade."""

LOW_GEAR_N: Final = (300.0, 900.0)
HIGH_GEAR_N: Final = (50.0, 300.0)
"""Drag of the engine at the wheels."""

FLUIDS: Final = 20
"""Fluids that each trip is judged with."""

HIGH: Final = PROBABILITIES[1]


@dataclass(frozen=True, slots=True)
class Judged:
    """Fluids of a trip, out of :data:`FLUIDS`.

    ``warned`` of *high* though the fluid did not boil, ``nor_parked`` where
    it would not have if the car had parked at that moment either; ``oracle``
    what one who knows the true temperature there says where it did not boil;
    ``found`` boiled and warned of.
    """

    warned: int
    nor_parked: int
    oracle: int
    found: int


@dataclass(frozen=True, slots=True)
class Trip:
    """What a trip came to; temperatures the hottest ones of it [K].

    ``forecast_k`` is the mean of the members' peaks in the hottest forecast,
    ``parked_k`` the true peak if the car had parked then.
    """

    km: float
    mountain: bool
    forecast_k: float
    parked_k: float
    fluid_k: float
    disc_k: float
    boiled: int
    unknown: Judged
    given: Judged


def mixed(
    kilometres: float,
    seed: tuple[int, ...],
    cars: Sequence[FleetCar],
    passes: float = PASSES,
) -> list[Trip]:
    """Drive *kilometres* or a little more with *cars*.

    *passes* is the share of the trips that lead over one.
    """
    rng = np.random.default_rng(seed)
    trips: list[Trip] = []
    while sum(trip.km for trip in trips) < kilometres:
        mountain = bool(rng.random() < passes)
        trips.append(_driven(rng, _trip(rng, cars, mountain), mountain))
    return trips


def rate(trips: Sequence[Trip], counts: Iterable[int]) -> float:
    """Return *counts* of fluids as cases in 10 000 km with one fluid."""
    return sum(counts) / FLUIDS / _km(trips) * 1e4


def mixed_tables(title: str, trips: Sequence[Trip]) -> list[Table]:
    """Return the warnings of *trips*, and the trips themselves."""
    unknown = [trip.unknown for trip in trips]
    given = [trip.given for trip in trips]
    mountain = [trip for trip in trips if trip.mountain]
    boiled = f"{rate(trips, (trip.boiled for trip in trips)):.2f}"
    driven_rows = [
        ("km driven, trips left out", f"{_km(trips):.0f}, none"),
        ("trips, over a pass", f"{len(trips)}, {len(mountain)}"),
        ("boiled in 10 000 km", boiled),
        *(
            (f"{name}, degC", _span([getattr(t, key) for t in trips]))
            for name, key in (
                ("hottest forecast peak: median, 95 %, most", "forecast_k"),
                ("true peak had it parked then", "parked_k"),
                ("hottest fluid", "fluid_k"),
                ("hottest disc", "disc_k"),
            )
        ),
    ]
    rows = [
        (
            name,
            *(
                f"{rate(trips, (getattr(j, key) for j in of)):.2f}"
                for of in (unknown, given)
            ),
        )
        for name, key in (
            ("false warnings in 10 000 km", "warned"),
            ("- nor would it have boiled, had it parked then", "nor_parked"),
            ("the oracle's", "oracle"),
            ("boiled and warned of", "found"),
        )
    ]
    return [
        Table(title, ("", "water unknown", "water given"), tuple(rows)),
        Table(f"{title}: the trips", ("", ""), tuple(driven_rows)),
    ]


def _km(trips: Sequence[Trip]) -> float:
    return sum(trip.km for trip in trips)


def _span(kelvin: list[float]) -> str:
    celsius = np.array(kelvin) - KELVIN_OFFSET
    return ", ".join(f"{q:.0f}" for q in np.quantile(celsius, (0.5, 0.95, 1)))


def _driven(rng: np.random.Generator, case: Case, mountain: bool) -> Trip:  # noqa: FBT001
    ((case, truth),) = driven([case], 0.0)
    peaks, at_s = _worst_peaks(case, truth)
    ((_, parked),) = driven([_parked(case, at_s)], 0.0)
    fluids = [draw_fluid(rng) for _ in range(FLUIDS)]
    # at that forecast the oracle knows both courses
    known_k = max(parked.hottest_k, truth.hottest_k)
    return Trip(
        float(case.drive.speed_ms.sum()) / 1000.0,
        mountain,
        float(peaks.mean()),
        parked.hottest_k,
        truth.hottest_k,
        truth.disc_k,
        sum(truth.hottest_k >= fluid.boiling_k for fluid in fluids),
        *(
            _judged(fluids, peaks, truth.hottest_k, known_k, given=given)
            for given in (False, True)
        ),
    )


def _judged(
    fluids: list[DrawnFluid],
    peaks: Column,
    fluid_k: float,
    known_k: float,
    *,
    given: bool,
) -> Judged:
    warned = nor_parked = oracle = found = 0
    for fluid in fluids:
        known = fluid.given if given else fluid.unknown
        says = np.mean([known.probability(k) for k in peaks]) >= HIGH
        if fluid_k >= fluid.boiling_k:
            found += bool(says)
            continue
        warned += bool(says)
        nor_parked += bool(says) and known_k < fluid.boiling_k
        oracle += known.probability(known_k) >= HIGH
    return Judged(warned, nor_parked, oracle, found)


def _worst_peaks(case: Case, truth: Truth) -> tuple[Column, int]:
    """Return the members' peaks of the hottest forecast, and when [s]."""
    estimator, monitor = estimating(case)
    worst, at_s = np.zeros(1), 0
    times, numbers, values = samples(case, truth)
    ends = np.arange(times[0], times[-1] + 10_000_000, 10_000_000)
    cuts = np.searchsorted(times, ends).tolist()
    for part in map(slice, cuts[:-1], cuts[1:]):
        risk = None
        for block in estimator.advance(
            times[part], numbers[part], values[part]
        ):
            risk = monitor.add(block)[-1]
        peaks = monitor.peaks_k()
        if risk is None or risk.forecast_us is None:
            continue
        found = np.array([peaks[name] for name in JUDGED]).max(axis=0)
        if found.mean() > worst.mean():
            worst = found
            at_s = (risk.forecast_us - START_US) // 1_000_000
    return worst, at_s


def _parked(case: Case, at_s: int) -> Case:
    """Return *case* as if the car had parked after *at_s*."""
    rest = np.zeros(PARKED_S)
    drive = Drive(*(np.append(column[:at_s], rest) for column in case.drive))
    # no one reads its sensors
    return replace(case, drive=drive)


def _trip(
    rng: np.random.Generator,
    cars: Sequence[FleetCar],
    mountain: bool,  # noqa: FBT001
) -> Case:
    """Return an hour of town, country and motorway over hills, or a pass."""
    mass_kg = rng.uniform(*MASS_KG)
    one = draw_car(rng, cars, mass_kg, another_day=True)
    speed, hills, drag_n = _pass_road(rng) if mountain else _hour(rng)
    need = -one.car.resistance(speed, np.arctan(hills))
    need -= one.car.effective_mass_kg * np.gradient(speed)
    drag = np.full(len(speed), drag_n)
    rest = np.zeros(PARKED_S)
    drive = Drive(
        *(
            np.append(column, rest)
            for column in (speed, need, drag, (speed > 0.0).astype(float))
        )
    )
    return sensed(rng, one, KELVIN_OFFSET + rng.uniform(-5.0, 36.0), drive)


def _hour(rng: np.random.Generator) -> tuple[Column, Column, float]:
    """Return speed, grade and drag over hills."""
    hills = np.interp(
        np.arange(TRIP_S),
        np.arange(0, TRIP_S + 121, 120),
        rng.normal(0.0, 0.025, TRIP_S // 120 + 2),
    )
    return _speeds(rng), hills, rng.uniform(50.0, 400.0)


def _pass_road(rng: np.random.Generator) -> tuple[Column, Column, float]:
    """Return speed, grade and drag up a pass, down and to where it parks."""
    valley, up, down, flat = (
        int(rng.uniform(*span))
        for span in (
            *((120.0, 400.0), (400.0, 1000.0)),
            *((600.0, 1800.0), (0.0, 400.0)),
        )
    )
    seconds = np.arange(valley + up + down + flat)
    knots = np.arange(0, len(seconds) + 61, 30)
    pace = rng.uniform(9.0, 16.0)
    bends = np.where(
        rng.random(len(knots)) < 0.35, rng.uniform(0.4, 0.75, len(knots)), 1.0
    )
    speed = np.interp(seconds, knots, pace * bends)
    grade = rng.uniform(0.05, 0.1) * rng.uniform(0.6, 1.4, len(knots))
    hills = np.interp(seconds, knots, grade)
    summit = valley + up
    hills[:valley] = 0.0
    hills[summit : summit + down] *= -1.0
    hills[summit + down :] = 0.0
    low = rng.random() < LOW_GEAR
    drag = rng.uniform(*(LOW_GEAR_N if low else HIGH_GEAR_N))
    return _driveable(speed, 1.5, 2.0), hills, drag


def _driveable(speed: Column, up: float, down: float) -> Column:
    """Return *speed* as a car can do it, from rest to rest."""
    found = speed.copy()
    found[0] = 0.0
    for i in range(1, len(found)):
        change = speed[i] - found[i - 1]
        found[i] = found[i - 1] + min(max(change, -down), up)
    # the last metres: down to the stop
    left = down * np.arange(len(found) - 1, -1, -1)
    return np.minimum(found, left)


def _speeds(rng: np.random.Generator) -> Column:
    """Return the speed [m/s] a second of an hour, from rest to rest."""
    targets: list[float] = []
    while len(targets) < TRIP_S:
        kind = rng.choice(3, p=(0.35, 0.4, 0.25))
        length = int(rng.uniform(20.0, (90.0, 180.0, 400.0)[kind]))
        pace = (13.0, 24.0, 35.0)[kind] * rng.uniform(0.6, 1.1)
        targets += [pace] * length
        if kind == 0 or rng.random() < 0.15:
            targets += [0.0] * int(rng.uniform(5.0, 40.0))
    up, down = rng.uniform(1.0, 2.2), rng.uniform(1.0, 3.5)
    return _driveable(np.array(targets[:TRIP_S]), up, down)
