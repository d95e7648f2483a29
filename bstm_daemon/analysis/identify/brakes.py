"""Friction scale, push-out and axle shares of the brakes, from motion.

Least squares of ``F = s sum K (p - p0)`` over samples of many stops, K the
configured geometry of Eq 4.1: s is what the configured friction has to be
multiplied by, p0 the pressure of the signal at which braking begins. If
friction depends on speed or pressure, the exponents of either are added (Rhee
1974, SAE 740415: F = K p^a v^b, here to first order), else its curvature would
look like a push-out.

With one pressure for both axles the car's motion shows their sum only. If
their pressures differ, ``F = s_f K_f (p_f - p0) + s_r K_r (p_r - p0)`` is
linear in both scales and in one constant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import nan
from typing import Any, Final

import numpy as np

from bstm_daemon.analysis.identify.brake_samples import (
    BrakeStop,
    Samples,
    brake_samples,
)
from bstm_daemon.analysis.identify.driving import Driving
from bstm_daemon.analysis.identify.value import Value
from bstm_daemon.analysis.statistics.gls import fit_linear
from bstm_daemon.analysis.statistics.resampling import jackknife, leave_one_out
from bstm_daemon.analysis.statistics.series import Column, Indices, Mask
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError

LEAST_SAMPLES: Final = 12
PRESSURE_SPREAD_PA: Final = 3e5
"""Least difference of the 10th and 90th percentile of the pressures, below
which push-out and friction can not be separated."""

RELATIVE_ERROR: Final = 0.1
PUSHOUT_ERROR_PA: Final = 0.5e5
"""Largest standard errors of a scale (relative) and a push-out to report."""

LOWEST_PUSHOUT_PA: Final = -1e5
"""No sensor's zero is lower; a lower result means that something else brakes
the car."""

SCATTER: Final = 0.2
"""Residual over mean force above which something else than pressure brakes."""

LAGS_S: Final = (0.0, 0.05, 0.1, 0.15, 0.2, 0.3)
"""Time constants of the hydraulics that are tried."""

LAG_GAIN: Final = 0.8
"""A lag is accepted if it reduces the weighted residual below this share."""


FLOOR_N: Final = 100.0
SHARE: Final = 0.03
"""Standard deviation of a sample: noise and grade [N], friction [share]."""

SIGMAS: Final = 3.0
"""Least exponent of speed or pressure, in standard errors."""

LEAST_LEAN: Final = 0.01
"""Least change of friction by an exponent over the range of the samples."""

ROUNDS: Final = 12

PARTS: Final = 10
"""Parts of the samples for the jackknife if there are too few stops."""

AXLE_SPREAD: Final = 0.05
"""Least spread of rear over front pressure to separate the axles."""

AXLE_ERROR: Final = 0.05
"""Largest standard error of a front share that is identified."""


COLUMNS: Final = ("speed_ms", "force_n", "front_pa", "rear_pa")
AXLE_VALUES: Final = ("front", "rear", "total", "share", "pushout")


@dataclass(frozen=True, slots=True)
class Brakes:
    """Brake parameters identified from the stops.

    ``scale`` is the factor on the configured friction coefficients (of
    ``front_scale`` and ``rear_scale`` on those of an axle), at the means of
    ``samples``; ``lean_speed`` and ``lean_pressure`` are the exponents
    of friction there, None if not significant. ``pushout_pa`` is in
    the signal's own zero, which reads ``rest_pa`` with the brake released.
    ``front_share`` is the front axle's share of the brake force at equal
    pressure.
    """

    scale: Value
    pushout_pa: Value
    rest_pa: float
    front_share: Value
    front_scale: Value
    rear_scale: Value
    lean_speed: Value | None
    lean_pressure: Value | None
    lag_s: Value
    residual_n: float
    samples: Table
    stops: tuple[BrakeStop, ...]
    searched: tuple[str, ...]
    remarks: tuple[str, ...]

    def ratio(self, samples: Samples) -> Column:
        """Return friction over its configured value at *samples*, (n,)."""
        pushing = samples.pressure_pa - self.pushout_pa.value
        return np.asarray(samples.force_n / (samples.gain * pushing))


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
        found, rest_pa, words = brake_samples(driving, config, lag_s)
        stops += found
        rests.append(rest_pa)
        hint = (
            ""
            if driving.line_known
            else "; the torque at the wheels is unknown"
        )
        searched.append(f"{driving.name}: {words}{hint}")
    return stops, searched, rests


def _weighted_rms(table: Table, config: Config) -> float:
    pushout_pa = _held_pushout(table, config)
    fit, *_ = settled(table, pushout_pa)
    rest = (table.force_n - model(table, fit)) * table.weights()
    return float(np.sqrt(np.mean(rest**2)))


def _spread_pa(table: Table) -> float:
    low, high = np.percentile(table.pressure_pa, (10.0, 90.0)).tolist()
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
    parameters, leans, errors, residual = settled(table, held_pa)
    scale, pushout, *exponents = (
        Value(value=value, standard_error=error)
        for value, error in zip(
            parameters.tolist(), errors.tolist(), strict=True
        )
    )
    lean = [
        one if on else None for one, on in zip(exponents, leans, strict=True)
    ]
    if held_pa is not None:
        caveat = (
            f"the pressures spread by {_spread_pa(table) / 1e5:.1f} bar only "
            f"({PRESSURE_SPREAD_PA / 1e5:g} needed): the configured "
            f"{held_pa / 1e5:g} bar is used"
        )
        pushout = replace(pushout, standard_error=nan, caveat=caveat)
    axles, axle_residual = fit_axles(table, config, held_pa)
    if axles["share"].identified:
        # one scale for two axles would bend push-out and exponents
        scale, residual, lean = axles["total"], axle_residual, [None, None]
        if held_pa is None:
            pushout = axles["pushout"]
    caveat = _caveat(scale, pushout, residual / abs(table.force_n.mean()))
    if not caveat and pushout.standard_error > PUSHOUT_ERROR_PA:
        error_bar = pushout.standard_error / 1e5
        pushout = replace(
            pushout, caveat=f"standard error of {error_bar:.1f} bar"
        )
    scale, pushout, share, front, rear = (
        replace(one, caveat=one.caveat or caveat)
        for one in (
            *(scale, pushout),
            *(axles[name] for name in ("share", "front", "rear")),
        )
    )
    no_lag = "" if lag_s else "no lag brings force and pressure nearer"
    return Brakes(
        scale=scale,
        pushout_pa=pushout,
        rest_pa=float(np.median(rests)),
        front_share=share,
        front_scale=front,
        rear_scale=rear,
        lean_speed=lean[0],
        lean_pressure=lean[1],
        lag_s=Value(value=lag_s, standard_error=nan, caveat=no_lag),
        residual_n=residual,
        samples=table,
        stops=tuple(stops),
        searched=tuple(searched),
        remarks=_remarks(drivings, stops),
    )


def _caveat(scale: Value, pushout: Value, scatter: float) -> str:
    """Return why nothing is identified; empty if something is.

    *scatter* is the residual over the mean force.
    """
    if scatter > SCATTER:
        return f"the samples scatter by {100 * scatter:.0f} % of their mean"
    if not scale.value > 0.0:
        return "more pressure brakes the car less"
    if scale.standard_error > RELATIVE_ERROR * scale.value:
        share = scale.standard_error / scale.value
        return f"standard error of {100 * share:.0f} %"
    if pushout.identified and pushout.value < LOWEST_PUSHOUT_PA:
        return (
            f"braking would begin at {pushout.value / 1e5:.1f} bar: something "
            "else brakes the car, such as an engine whose torque is unknown"
        )
    return ""


def _remarks(
    drivings: Sequence[Driving], stops: Sequence[BrakeStop]
) -> tuple[str, ...]:
    remarks = [f"{d.name}: {text}" for d in drivings for text in d.remarks]
    borrowed = sum(not stop.own_zero for stop in stops)
    if borrowed:
        remarks.append(
            f"{borrowed} stops have no released brake around them; they use "
            "the zero of the others"
        )
    if not all(d.has_accelerometer for d in drivings):
        remarks.append(
            "no accelerometer: the grade is assumed as around each stop"
        )
    remarks += [
        f"{d.name}: the body pitches by {d.pitch:.3f} m/s2 a m/s2, subtracted "
        "from the accelerometer"
        for d in drivings
        if d.pitch > 0.0
    ]
    remarks.append(
        "the mass is an input: the friction scale is proportional to it. "
        "Tyre slip (1 to 2 % of the energy) counts as braking"
    )
    return tuple(remarks)


@dataclass(frozen=True, slots=True, kw_only=True)
class Table(Samples):
    """Samples of all stops one after the other; ``stop`` (n,) is whose."""

    stop: Indices
    speed_mean_ms: float
    pressure_mean_pa: float

    def chosen(self, rows: Indices) -> Table:
        """Return the samples *rows*, with the same reference means."""
        columns: dict[str, Any] = {
            name: getattr(self, name)[rows] for name in (*COLUMNS, "stop")
        }
        return replace(self, **columns)

    def leaning(self) -> tuple[Column, Column]:
        """Return what exponents of speed and pressure act on, (n,) each."""
        return (
            np.log(self.speed_ms / self.speed_mean_ms),
            np.log(self.pressure_pa / self.pressure_mean_pa),
        )

    def weights(self) -> Column:
        """Return the weights of the samples, (n,) [1/N]."""
        return np.asarray(1.0 / np.hypot(FLOOR_N, SHARE * self.force_n))


def table_of(stops: Sequence[BrakeStop]) -> Table:
    """Return the samples of *stops*, which are of one car."""

    def joined(name: str) -> Column:
        return np.concatenate([getattr(stop, name) for stop in stops])

    columns: dict[str, Any] = {name: joined(name) for name in COLUMNS}
    return Table(
        **columns,
        front_gain=stops[0].front_gain,
        rear_gain=stops[0].rear_gain,
        stop=np.repeat(np.arange(len(stops)), [len(s.since_s) for s in stops]),
        speed_mean_ms=float(columns["speed_ms"].mean()),
        pressure_mean_pa=float(joined("pressure_pa").mean()),
    )


def settled(
    table: Table, pushout_pa: float | None
) -> tuple[Column, Mask, Column, float]:
    """Fit with the leans that stand out.

    Returns the parameters (scale, push-out, lean on speed, on pressure), which
    leans are in, the standard errors, and the residual [N].
    """
    leans = np.array([True, pushout_pa is None])
    spans = np.ptp(table.leaning(), axis=1)
    while True:
        fit = fit_table(table, pushout_pa, leans)
        errors = errors_of(table, pushout_pa, leans)
        size, error = np.abs(fit[2:]), errors[2:]
        clear = (size > SIGMAS * error) & (size * spans > LEAST_LEAN)
        weak = leans & ~clear
        if not weak.any():
            rest = table.force_n - model(table, fit)
            return fit, leans, errors, float(np.sqrt(np.mean(rest**2)))
        # the weaker one first: without it the other may be significant
        ratio = size / np.where(error > 0.0, error, 1.0)
        leans[np.where(weak, ratio, np.inf).argmin()] = False


def model(table: Table, parameters: Column) -> Column:
    """Return the brake force [N] that *parameters* give, (n,)."""
    scale, pushout, on_speed, on_pressure = parameters.tolist()
    x_speed, x_pressure = table.leaning()
    pushing = table.gain * (table.pressure_pa - pushout)
    factor = 1.0 + on_speed * x_speed + on_pressure * x_pressure
    return np.asarray(scale * pushing * factor)


def fit_table(table: Table, pushout_pa: float | None, leans: Mask) -> Column:
    """Solve for (scale, push-out, leans): linear except for their product."""
    weight = table.weights()
    pushout = 0.0 if pushout_pa is None else pushout_pa
    used = [x for x, on in zip(table.leaning(), leans, strict=True) if on]
    result = np.zeros(4)
    for _ in range(ROUNDS):
        pushing = table.gain * (table.pressure_pa - pushout)
        first = [pushing]
        if pushout_pa is None:
            first = [
                table.gain * table.pressure_pa,
                np.full(len(weight), table.gain),
            ]
        design = np.column_stack([*first, *(pushing * x for x in used)])
        found = fit_linear(design, table.force_n, weight).estimate.tolist()
        scale = found[0]
        if pushout_pa is None:
            pushout = -found[1] / scale
        result[:2] = scale, pushout
        result[2:][leans] = np.array(found[len(first) :]) / scale
    return result


def errors_of(table: Table, pushout_pa: float | None, leans: Mask) -> Column:
    """Return standard errors by leaving out one stop, or a tenth, at a time.

    Errors within a stop are correlated, so that stops and not samples count.
    """
    groups = table.stop
    if len(np.unique(groups)) < 4:
        groups = np.arange(len(groups)) * PARTS // len(groups)
    fits = leave_one_out(
        lambda rows: fit_table(table.chosen(rows), pushout_pa, leans), groups
    )
    return np.sqrt(np.diag(jackknife(fits)))


def fit_axles(
    table: Table, config: Config, pushout_pa: float | None
) -> tuple[dict[str, Value], float]:
    """Fit the axles of *config* separately; *pushout_pa* is held if given.

    Returns the values of :data:`AXLE_VALUES`, ``total`` being the scale of
    both axles at equal pressure, and the residual [N].
    """
    share, error = table.front_gain / table.gain, nan
    caveat = _why_not(table, config)
    if not caveat:
        rows = np.arange(len(table.force_n))
        parts = leave_one_out(
            lambda kept: _solve_axles(table.chosen(kept), pushout_pa),
            rows * PARTS // len(rows),
        )
        fit = _solve_axles(table, pushout_pa)
        errors = np.sqrt(np.diag(jackknife(parts)))
        front, rear, _, share, pushout = fit.tolist()
        error = float(errors[3])
        if error > AXLE_ERROR or not 0.0 < share < 1.0:
            caveat = (
                f"the pressures of the axles differ too little: {share:.2f} "
                f"with a standard error of {error:.2f}"
            )
        else:
            rest = (
                table.force_n
                - front * table.front_gain * (table.front_pa - pushout)
                - rear * table.rear_gain * (table.rear_pa - pushout)
            )
            found = {
                name: Value(value=value, standard_error=error)
                for name, value, error in zip(
                    AXLE_VALUES, fit.tolist(), errors.tolist(), strict=True
                )
            }
            return found, float(np.sqrt(np.mean(rest**2)))
    nothing = Value(value=nan, standard_error=nan, caveat=caveat)
    found = dict.fromkeys(AXLE_VALUES, nothing)
    found["share"] = replace(nothing, value=share, standard_error=error)
    return found, nan


def _solve_axles(table: Table, pushout_pa: float | None) -> Column:
    """Return front, rear and total scale, front share and push-out."""
    held = 0.0 if pushout_pa is None else pushout_pa
    columns = [
        table.front_gain * (table.front_pa - held),
        table.rear_gain * (table.rear_pa - held),
    ]
    if pushout_pa is None:
        columns.append(np.full(len(table.force_n), table.gain))
    front, rear, *rest = fit_linear(
        np.column_stack(columns), table.force_n, table.weights()
    ).estimate.tolist()
    pushed_front = front * table.front_gain
    pushed = pushed_front + rear * table.rear_gain
    if rest:
        held = -rest[0] * table.gain / pushed
    return np.array(
        [front, rear, pushed / table.gain, pushed_front / pushed, held]
    )


def _why_not(table: Table, config: Config) -> str:
    """Return why front and rear can not be separated; empty if they can."""
    if not table.front_gain or not table.rear_gain:
        return "brakes of one axle only have a pressure"
    ratio = table.rear_pa / table.front_pa
    spread = float(np.std(ratio) / abs(np.mean(ratio)))
    if spread >= AXLE_SPREAD:
        return ""
    text = (
        "the rear pressure is the same share of the front one in every "
        f"sample (spread {100 * spread:.1f} %): the car's motion shows their "
        "sum only"
    )
    if not any(role.startswith("wheel_pressure_") for role in config.signals):
        text += (
            ". Wheel pressures that differ (brake force distribution, one "
            "circuit bled) would show it; wheel slip would need the tyres' "
            "stiffness"
        )
    return text
