"""Friction scale, push-out and axle shares of the brakes, from motion.

Least squares of ``F = s sum K (p - p0)`` over samples of many stops, K the
configured geometry of Eq 4.1: s is what the configured friction has to be
multiplied by, p0 the pressure of the signal at which braking begins. Where
friction leans on speed or pressure, the exponents of either are added (Rhee
1974, SAE 740415: F = K p^a v^b, here to first order), else its curvature would
look like a push-out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.identify.brake_samples import brake_samples
from bstm_daemon.analysis.identify.friction_fit import (
    fit_axles,
    model,
    settled,
    table_of,
    weights,
)
from bstm_daemon.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.analysis.identify.brake_samples import BrakeStop
    from bstm_daemon.analysis.identify.driving import Driving
    from bstm_daemon.analysis.identify.friction_fit import Table
    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.config.sections import Config

LEAST_SAMPLES: Final = 12
PRESSURE_SPREAD_PA: Final = 3e5
"""From the 10th to the 90th percentile of the pressures: tells push-out from
friction. A few samples of the press itself are no spread."""

RELATIVE_ERROR: Final = 0.1
PUSHOUT_ERROR_PA: Final = 0.5e5
"""A value with a larger standard error, of scale or push-out, is not given."""

LOWEST_PUSHOUT_PA: Final = -1e5
"""No sensor's zero is lower: then something else brakes the car."""

SCATTER: Final = 0.2
"""Residual over mean force from which pressure is not what brakes."""

LAGS_S: Final = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3)
"""Time constants of the hydraulics that are tried."""

LAG_GAIN: Final = 0.8
"""A lag is one if it brings the weighted residual below this share."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A value, its standard error, and why it is none (empty: it is one)."""

    value: float
    standard_error: float
    caveat: str = ""

    @property
    def identified(self) -> bool:
        """Whether the stops settle it."""
        return not self.caveat


@dataclass(frozen=True, slots=True)
class Brakes:
    """What the stops show about the brakes.

    ``scale`` is the factor on the configured friction coefficients (of
    ``front_scale`` and ``rear_scale`` on those of an axle), at ``speed_ms``
    and ``pressure_pa``; ``lean_speed`` and ``lean_pressure`` are the exponents
    that friction has there, None where none shows. ``pushout_pa`` is in
    the signal's own zero, which reads ``rest_pa`` with the brake released.
    ``front_share`` is the front axle's share of the brake force at equal
    pressure.
    """

    scale: Finding
    pushout_pa: Finding
    rest_pa: float
    front_share: Finding
    front_scale: Finding
    rear_scale: Finding
    lean_speed: Finding | None
    lean_pressure: Finding | None
    speed_ms: float
    pressure_pa: float
    lag_s: Finding
    residual_n: float
    samples: int
    stops: tuple[BrakeStop, ...]
    searched: tuple[str, ...]
    remarks: tuple[str, ...]

    def ratio(self, stop: BrakeStop) -> Column:
        """Return friction over its configured value at the samples, (n,)."""
        pushing = stop.pressure_pa - self.pushout_pa.value
        return np.asarray(stop.force_n / (stop.gain * pushing))


def identify_brakes(drivings: Sequence[Driving], config: Config) -> Brakes:
    """Find the stops in *drivings* and fit the brakes of *config* to them.

    Raises:
        LogError: no pressure is in the logs, or they hold too few samples;
            says what was searched.
    """
    trials = [(lag_s, *_stops(drivings, config, lag_s)) for lag_s in LAGS_S]
    lag_s, stops, searched, rests = trials[0]
    count = sum(len(stop.since_s) for stop in stops)
    if count < LEAST_SAMPLES:
        msg = (
            f"brakes not identified, {count} samples of {LEAST_SAMPLES} "
            f"needed. {'; '.join(searched)}"
        )
        raise LogError(msg)
    rms = [_weighted_rms(table_of(trial[1]), config) for trial in trials]
    best = int(np.argmin(rms))
    if rms[best] < LAG_GAIN * rms[0]:
        lag_s, stops, searched, rests = trials[best]
    return _result(drivings, config, stops, searched, rests, lag_s)


def _stops(
    drivings: Sequence[Driving], config: Config, lag_s: float
) -> tuple[list[BrakeStop], list[str], list[float]]:
    """Return the stops behind *lag_s*, what was searched, released zeros."""
    stops: list[BrakeStop] = []
    searched, rests = [], []
    for driving in drivings:
        if not driving.pressures:
            searched.append(f"{driving.name}: no brake pressure in this log")
            continue
        found = brake_samples(driving, config, lag_s)
        stops += found.stops
        rests.append(found.rest_pa)
        hint = (
            ""
            if driving.line_known
            else "; nothing tells the torque at the wheels"
        )
        searched.append(f"{driving.name}: {found.searched}{hint}")
    return stops, searched, rests


def _weighted_rms(table: Table, config: Config) -> float:
    pushout_pa = _held_pushout(table, config)
    fit, *_ = settled(table, pushout_pa)
    rest = (table.force - model(table, fit)) * weights(table)
    return float(np.sqrt(np.mean(rest**2)))


def _spread_pa(table: Table) -> float:
    low, high = np.percentile(table.pressure, (10.0, 90.0)).tolist()
    return float(high - low)


def _held_pushout(table: Table, config: Config) -> float | None:
    """Return the configured push-out where the pressures show none."""
    if _spread_pa(table) >= PRESSURE_SPREAD_PA:
        return None
    return max(corner.pushout_pressure_pa for corner in config.corner)


def _result(
    drivings: Sequence[Driving],
    config: Config,
    stops: Sequence[BrakeStop],
    searched: Sequence[str],
    rests: Sequence[float],
    lag_s: float,
) -> Brakes:
    table = table_of(stops)
    held_pa = _held_pushout(table, config)
    free = held_pa is None
    parameters, leans, errors, residual = settled(table, held_pa)
    caveat = (
        ""
        if free
        else (
            f"the pressures spread by {_spread_pa(table) / 1e5:.1f} "
            f"bar only ({PRESSURE_SPREAD_PA / 1e5:g} needed): the configured "
            f"{parameters[1] / 1e5:g} bar is taken"
        )
    )
    pushout = Finding(
        float(parameters[1]), float(errors[1]) if free else nan, caveat
    )
    axles = fit_axles(table, config, held_pa)
    share = Finding(*axles.share, axles.caveat)
    front = Finding(*axles.front, axles.caveat)
    rear = Finding(*axles.rear, axles.caveat)
    lean: list[Finding | None] = [
        Finding(float(parameters[2 + i]), float(errors[2 + i]))
        if leans[i]
        else None
        for i in range(2)
    ]
    scale = Finding(float(parameters[0]), float(errors[0]))
    if not axles.caveat:
        # one scale for two axles would bend push-out and exponents
        scale, residual = Finding(*axles.total), axles.residual_n
        lean = [None, None]
        if free:
            pushout = Finding(*axles.pushout_pa)
    scatter = residual / abs(float(table.force.mean()))
    if scatter > SCATTER:
        caveat = f"the samples scatter by {100 * scatter:.0f} % of their mean"
    elif not scale.value > 0.0:
        caveat = "more pressure brakes the car less"
    elif scale.standard_error > RELATIVE_ERROR * scale.value:
        caveat = (
            "standard error of "
            f"{100 * scale.standard_error / scale.value:.0f} %"
        )
    elif pushout.identified and pushout.value < LOWEST_PUSHOUT_PA:
        caveat = (
            f"braking would begin at {pushout.value / 1e5:.1f} bar: something "
            "else brakes the car, such as an engine whose torque is unknown"
        )
    else:
        caveat = ""
    if caveat:
        scale = replace(scale, caveat=caveat)
        pushout = replace(pushout, caveat=pushout.caveat or caveat)
        share = replace(share, caveat=share.caveat or caveat)
        front = replace(front, caveat=front.caveat or caveat)
        rear = replace(rear, caveat=rear.caveat or caveat)
    elif pushout.identified and pushout.standard_error > PUSHOUT_ERROR_PA:
        pushout = replace(
            pushout,
            caveat=f"standard error of {pushout.standard_error / 1e5:.1f} bar",
        )
    return Brakes(
        scale,
        pushout,
        float(np.median(rests)),
        share,
        front,
        rear,
        lean[0],
        lean[1],
        table.speed_mean,
        table.pressure_mean,
        Finding(
            lag_s,
            nan,
            "" if lag_s else "no lag brings force and pressure nearer",
        ),
        residual,
        len(table.force),
        tuple(stops),
        tuple(searched),
        _remarks(drivings, stops),
    )


def _remarks(
    drivings: Sequence[Driving], stops: Sequence[BrakeStop]
) -> tuple[str, ...]:
    remarks = [f"{d.name}: {text}" for d in drivings for text in d.remarks]
    borrowed = sum(not stop.own_zero for stop in stops)
    if borrowed:
        remarks.append(
            f"{borrowed} stops have no released brake around them; their "
            "zero is that of the others"
        )
    if not all(d.has_accelerometer for d in drivings):
        remarks.append(
            "no accelerometer: the grade is taken as that around each stop"
        )
    remarks += [
        f"{d.name}: the body pitches by {d.pitch:.3f} m/s2 a m/s2, taken off "
        "the accelerometer"
        for d in drivings
        if d.pitch > 0.0
    ]
    remarks.append(
        "the mass is given: the friction scale is in proportion to it. "
        "Tyre slip (1 to 2 % of the energy) is counted as brake"
    )
    return tuple(remarks)
