"""Mixed driving: how often the daemon warns where nothing boils."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from risk_cases import (
    CORNERS,
    PRESSURE_QUANTUM_PA,
    Case,
    base_config,
    configured,
)
from risk_fluids import draw_fluid
from risk_judge import START_US, TIMEOUT_US, samples

from bstm_daemon.estimator import Estimator
from bstm_daemon.forecast.monitor import RiskMonitor
from bstm_daemon.risk.levels import PROBABILITIES
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.simulation.vehicle import NOMINAL
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

TRIP_S: Final = 3600
MEMBERS: Final = 8
FLUIDS: Final = 20
"""Fluids that each trip is judged with."""


def mixed(kilometres: float, seed: int) -> tuple[float, int, int, float]:
    """Return km driven, warnings with water unknown and given, hottest peak.

    A warning is a trip and fluid whose probability reaches *high* at a
    forecast; the count is a mean over the fluids. The peak [K] is the
    highest forecast.
    """
    rng = np.random.default_rng(seed)
    base = base_config()
    small = base.forecast.model_copy(update={"members": MEMBERS})
    base = base.model_copy(update={"forecast": small})
    driven = 0.0
    warned = [0, 0]
    hottest = 0.0
    while driven < kilometres:
        case = _trip(rng, base)
        driven += float(case.speed_ms.sum()) / 1000.0
        peaks = _worst_peaks(case)
        hottest = max(hottest, float(peaks.max()))
        for _ in range(FLUIDS):
            fluid = draw_fluid(rng)
            for number, known in enumerate((fluid.unknown, fluid.given)):
                mean = np.mean([known.probability(k) for k in peaks])
                warned[number] += bool(mean >= PROBABILITIES[1])
    return driven, warned[0], warned[1], hottest


def _worst_peaks(case: Case) -> Column:
    """Return the members' peaks of the hottest forecast of a trip."""
    roles = ("vehicle_speed", "primary_pressure", "ambient_temperature")
    estimator = Estimator(
        case.config,
        {ROLE_INDEX[role]: TIMEOUT_US for role in roles},
        history_known=True,
        initial_k=case.ambient_k,
    )
    monitor = RiskMonitor(case.config, estimator)
    worst = np.zeros(MEMBERS)
    times, numbers, values = samples(case, roles)
    for end in np.arange(START_US, times[-1] + 10_000_000, 10_000_000):
        part = slice(*np.searchsorted(times, (end - 10_000_000, end)))
        for block in estimator.advance(
            times[part], numbers[part], values[part]
        ):
            monitor.add(block)
        peaks = monitor.peaks_k()
        if all(peaks.values()):
            found = np.array([peaks[name] for name in CORNERS]).max(axis=0)
            if found.mean() > worst.mean():
                worst = found
    return worst


def _trip(rng: np.random.Generator, base: object) -> Case:
    """Return an hour of town, country and motorway over hills."""
    speed = _speeds(rng)
    seconds = np.arange(TRIP_S)
    hills = np.interp(
        seconds,
        np.arange(0, TRIP_S + 121, 120),
        rng.normal(0.0, 0.025, TRIP_S // 120 + 2),
    )
    car = replace(NOMINAL, mass_kg=rng.uniform(1700.0, 2700.0))
    accel = np.gradient(speed)
    need = -car.resistance(speed, np.arctan(hills))
    need -= car.effective_mass_kg * accel
    drag = rng.uniform(50.0, 400.0)
    force = np.where(speed > 0.0, np.maximum(need - drag, 0.0), 0.0)
    pressure = force / car.gains.sum()
    ambient_k = KELVIN_OFFSET + rng.uniform(-5.0, 36.0)
    known = dict.fromkeys(
        (
            *("ring_mass_kg", "pad_thickness_m", "shim_resistance_m2k_w"),
            *("caliper", "caliper_air", "disc_air"),
        ),
        1.0,
    )
    return Case(
        car,
        configured(base, known, car.mass_kg),  # type: ignore[arg-type]
        ambient_k,
        speed,
        pressure,
        force * speed,
        ambient_k,
        np.round(pressure / PRESSURE_QUANTUM_PA) * PRESSURE_QUANTUM_PA,
        speed,
    )


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
