"""Friction within and from stop to stop, front and rear (thesis Fig 4.7).

Within a stop the car's motion shows one friction for all brakes. An axle's
share of a stop's energy follows from its discs: mass times the integral of
c_p over the measured rise, over the disc's share of the heat.
The axle without thermocouples gets the rest of the energy balance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.identify.brake_samples import brake_samples
from bstm_daemon.analysis.identify.disc_loss import disc_part
from bstm_daemon.model.heat.feed_forward import PressureTorque
from bstm_daemon.model.thermal.brake_corner import corner_spec
from bstm_daemon.model.thermal.properties import disc_heat_capacity

if TYPE_CHECKING:
    from bstm_daemon.analysis.identify.driving import Driving
    from bstm_daemon.analysis.identify.heat_comparison import (
        HeatComparison,
        HeatStop,
    )
    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.config.sections import Config, CornerConfig

LONGEST_STOP_S: Final = 15.0
"""Longest stop; in a longer one the disc loses heat before its peak."""

SETTLING_S: Final = 4.0
"""Time for the disc's heat to spread before its peak is read."""

LEAST_RISE_K: Final = 10.0
"""Least rise, above a thermocouple's noise."""

LEAST_ENERGY_J: Final = 50e3
PARTS: Final = {"front": "F", "rear": "R"}


@dataclass(frozen=True, slots=True)
class WithinStop:
    """Friction coefficient over the time since the press, (n,) each."""

    start_s: float
    since_s: Column
    friction: Column
    initial_c: dict[str, float]


@dataclass(frozen=True, slots=True)
class AxleFriction:
    """Mean friction of an axle in a stop, by the heat in its discs."""

    axle: str
    start_s: float
    initial_c: float
    friction: float
    by_discs: bool


@dataclass(frozen=True, slots=True)
class StopFriction:
    """Friction within and between stops, and why the axles' may be missing."""

    within: tuple[WithinStop, ...]
    axles: tuple[AxleFriction, ...]
    why_no_axles: str


def stop_friction(
    driving: Driving, config: Config, heat: HeatComparison
) -> StopFriction:
    """Return the friction coefficients that *driving* shows."""
    within = []
    if driving.pressures:
        nominal = _nominal(config, "F")
        pushout = max(c.pushout_pressure_pa for c in config.corner)
        stops, *_ = brake_samples(driving, config, every_stop=True)
        for stop in stops:
            pushing = stop.gain * (stop.pressure_pa - pushout)
            within.append(
                WithinStop(
                    stop.start_s,
                    stop.since_s,
                    nominal * stop.force_n / pushing,
                    _initial_of(heat, stop.start_s),
                )
            )
    corners = [
        corner
        for corner in config.disc_corners()
        if driving.channels.alive([f"temp_{corner.name.lower()}_disc"])
    ]
    axles: list[AxleFriction] = []
    if corners and driving.pressures:
        why = (
            f"no stop of at most {LONGEST_STOP_S:g} s that warms a measured "
            f"disc by {LEAST_RISE_K:g} K"
        )
        for one in heat.stops:
            axles += _axles(one, driving, config, corners)
    else:
        what = "disc temperature" if driving.pressures else "brake pressure"
        why = (
            f"no measured {what}: the motion only shows the sum of front and "
            "rear"
        )
    return StopFriction(tuple(within), tuple(axles), "" if axles else why)


def _initial_of(heat: HeatComparison, start_s: float) -> dict[str, float]:
    """Return the discs' temperatures of the stop nearest to *start_s*."""
    nearest = min(
        heat.stops, key=lambda s: abs(s.begin_s - start_s), default=None
    )
    return {} if nearest is None else nearest.initial_c


def _nominal(config: Config, axle: str) -> float:
    of_axle = [
        corner.friction_coefficient
        for corner in config.corner
        if corner.name[0] == axle
    ]
    return float(np.mean(of_axle or [np.nan]))


def _axles(
    stop: HeatStop,
    driving: Driving,
    config: Config,
    corners: list[CornerConfig],
) -> list[AxleFriction]:
    """Return the friction of the axles in *stop*, none where it shows none."""
    if (
        stop.end_s - stop.begin_s > LONGEST_STOP_S
        or not stop.balance.brake_j > LEAST_ENERGY_J
        or "ff" not in stop.energy_j
    ):
        return []
    heats = {c.name: _disc_heat_j(c, stop, driving, config) for c in corners}
    taken: dict[str, float] = {}
    for axle, letter in PARTS.items():
        own = [c for c in config.corner if c.name[0] == letter]
        known = [heats[c.name] for c in own if c.name in heats]
        if own and known and np.isfinite(known).all():
            # both sides of an axle are alike
            taken[axle] = float(np.mean(known)) * len(own)
    measured = set(taken)
    if len(taken) == 1:
        (axle,) = taken
        other = "rear" if axle == "front" else "front"
        taken[other] = stop.balance.brake_j - taken[axle]
    found = []
    for axle, energy_j in taken.items():
        letter = PARTS[axle]
        forward_j = stop.energy_j["ff"] * _gain_share(config, letter)
        if forward_j <= 0.0:
            continue
        initial = [c for n, c in stop.initial_c.items() if n[0] == letter]
        found.append(
            AxleFriction(
                axle,
                stop.begin_s,
                float(np.mean(initial or [np.nan])),
                _nominal(config, letter) * energy_j / forward_j,
                axle in measured,
            )
        )
    return found


def _gain_share(config: Config, letter: str) -> float:
    gains = {
        c.name: PressureTorque.of_corner(c).torque_per_pressure_nm_pa
        for c in config.corner
    }
    own = sum(gain for name, gain in gains.items() if name[0] == letter)
    return own / sum(gains.values())


def _disc_heat_j(
    corner: CornerConfig, stop: HeatStop, driving: Driving, config: Config
) -> float:
    """Return the brake energy that the rise of *corner*'s disc shows [J]."""
    if corner.disc is None:  # the caller asks for disc corners only
        return float("nan")
    value = driving.value(f"temp_{corner.name.lower()}_disc")
    time_s = driving.time_s
    before = value[(time_s > stop.begin_s - 2.0) & (time_s < stop.begin_s)]
    after = value[(time_s > stop.end_s) & (time_s < stop.end_s + SETTLING_S)]
    before, after = before[np.isfinite(before)], after[np.isfinite(after)]
    if not len(before) or not len(after):
        return float("nan")
    start_k, end_k = float(np.median(before)), float(np.median(after))
    if end_k - start_k < LEAST_RISE_K:
        return float("nan")
    spec = corner_spec(config, corner)
    capacity = disc_heat_capacity(corner.disc)
    stored_j = spec.disc_mass_kg * (
        capacity.integral(end_k) - capacity.integral(start_k)
    )
    return stored_j / disc_part(spec)
