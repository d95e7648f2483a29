"""The regressions behind ``bstm identify brakes``: the car, and its axles.

With one pressure for both axles the car's motion shows their sum only. Where
their pressures part, ``F = s_f K_f (p_f - p0) + s_r K_r (p_r - p0)`` is
linear in both scales and in one constant.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.statistics.gls import fit_linear
from bstm_daemon.analysis.statistics.resampling import jackknife, leave_one_out

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.analysis.identify.brake_samples import BrakeStop
    from bstm_daemon.analysis.statistics.series import Column, Indices
    from bstm_daemon.config.sections import Config

FLOOR_N: Final = 100.0
SHARE: Final = 0.03
"""What a sample may err by: noise and grade, and friction itself."""

SIGMAS: Final = 3.0
"""A lean on speed or pressure must stand out so far."""

LEAST_LEAN: Final = 0.01
"""... and change friction by so much over the range of the samples."""

ROUNDS: Final = 12

PARTS: Final = 10
"""Errors come from leaving out one such part of the samples at a time, where
there are too few stops for that."""

AXLE_SPREAD: Final = 0.05
"""Spread of rear over front pressure that tells the axles apart."""

AXLE_ERROR: Final = 0.05
"""Largest standard error of a front share that is identified."""


@dataclass(frozen=True, slots=True)
class Table:
    """Samples of all stops as columns, (n,) each."""

    stop: Indices
    force: Column
    front: Column
    rear: Column
    gain: float
    front_gain: float
    rear_gain: float
    speed: Column
    speed_mean: float
    pressure_mean: float

    @property
    def pressure(self) -> Column:
        """Pressure that gives the nominal force at both axles, (n,)."""
        return np.asarray(
            (self.front_gain * self.front + self.rear_gain * self.rear)
            / self.gain
        )

    def chosen(self, rows: Indices) -> Table:
        """Return the samples *rows*, around the same means."""
        return replace(
            self,
            stop=self.stop[rows],
            force=self.force[rows],
            front=self.front[rows],
            rear=self.rear[rows],
            speed=self.speed[rows],
        )


def table_of(stops: Sequence[BrakeStop]) -> Table:
    """Return the samples of *stops* as columns."""

    def joined(column: Callable[[BrakeStop], Column]) -> Column:
        return np.concatenate([column(stop) for stop in stops])

    first = stops[0]
    speed = joined(lambda stop: stop.speed_ms)
    front = joined(lambda stop: stop.front_pa)
    rear = joined(lambda stop: stop.rear_pa)
    return Table(
        np.repeat(np.arange(len(stops)), [len(s.since_s) for s in stops]),
        joined(lambda stop: stop.force_n),
        # an axle without a gain has no pressure
        front if first.front_gain else np.nan_to_num(front),
        rear if first.rear_gain else np.nan_to_num(rear),
        first.gain,
        first.front_gain,
        first.rear_gain,
        speed,
        float(speed.mean()),
        float(joined(lambda stop: stop.pressure_pa).mean()),
    )


def settled(
    table: Table, pushout_pa: float | None
) -> tuple[Column, tuple[bool, bool], Column, float]:
    """Fit with the leans that stand out.

    Returns the parameters (scale, push-out, lean on speed, on pressure), which
    leans are in, the standard errors, and the residual [N].
    """
    leans = (True, pushout_pa is None)
    spans = tuple(float(np.ptp(x)) for x in leaning(table))
    while True:
        fit = fit_table(table, pushout_pa, leans)
        errors = errors_of(table, pushout_pa, leans)
        kept = (
            leans[0] and _stands_out(fit[2], errors[2], spans[0]),
            leans[1] and _stands_out(fit[3], errors[3], spans[1]),
        )
        if kept == leans:
            rest = table.force - model(table, fit)
            return fit, leans, errors, float(np.sqrt(np.mean(rest**2)))
        # the weaker one first: without it the other may stand out
        weak = [i for i in (0, 1) if leans[i] and not kept[i]]
        drop = min(weak, key=lambda i: abs(fit[2 + i] / (errors[2 + i] or 1)))
        leans = (leans[0] and drop != 0, leans[1] and drop != 1)


def _stands_out(lean: float, error: float, span: float) -> bool:
    return abs(lean) > SIGMAS * error and abs(lean) * span > LEAST_LEAN


def model(table: Table, parameters: Column) -> Column:
    """Return the brake force [N] that *parameters* give, (n,)."""
    scale, pushout, on_speed, on_pressure = parameters.tolist()
    x_speed, x_pressure = leaning(table)
    pushing = table.gain * (table.pressure - pushout)
    factor = 1.0 + on_speed * x_speed + on_pressure * x_pressure
    return np.asarray(scale * pushing * factor)


def leaning(table: Table) -> tuple[Column, Column]:
    """Return what the exponents of speed and pressure act on, (n,) each."""
    return (
        np.log(table.speed / table.speed_mean),
        np.log(table.pressure / table.pressure_mean),
    )


def weights(table: Table) -> Column:
    """Return the weights of the samples, (n,) [1/N]."""
    return np.asarray(1.0 / np.hypot(FLOOR_N, SHARE * table.force))


def fit_table(
    table: Table, pushout_pa: float | None, leans: tuple[bool, bool]
) -> Column:
    """Solve for (scale, push-out, leans): linear but for their product."""
    weight = weights(table)
    x_speed, x_pressure = leaning(table)
    pushout = 0.0 if pushout_pa is None else pushout_pa
    used = [
        x for x, on in zip((x_speed, x_pressure), leans, strict=True) if on
    ]
    result = np.zeros(4)
    for _ in range(ROUNDS):
        pushing = table.gain * (table.pressure - pushout)
        first = [pushing]
        if pushout_pa is None:
            first = [
                table.gain * table.pressure,
                np.full(len(weight), table.gain),
            ]
        design = np.column_stack([*first, *(pushing * x for x in used)])
        found = fit_linear(design, table.force, weight).estimate.tolist()
        scale = found[0]
        if pushout_pa is None:
            pushout = -found[1] / scale
        result[:2] = scale, pushout
        result[2:][list(leans)] = np.array(found[len(first) :]) / scale
    return result


def errors_of(
    table: Table, pushout_pa: float | None, leans: tuple[bool, bool]
) -> Column:
    """Return standard errors by leaving out one stop, or a tenth, at a time.

    Samples of a stop err alike, so that stops and not samples count.
    """
    groups = table.stop
    if len(np.unique(groups)) < 4:
        groups = np.arange(len(groups)) * PARTS // len(groups)
    fits = leave_one_out(
        lambda rows: fit_table(table.chosen(rows), pushout_pa, leans), groups
    )
    return np.sqrt(np.diag(jackknife(fits)))


@dataclass(frozen=True, slots=True)
class AxleFit:
    """Pairs of value and standard error; ``caveat`` says why they are none.

    ``total`` is the scale of both axles at equal pressure.
    """

    share: tuple[float, float]
    front: tuple[float, float] = (nan, nan)
    rear: tuple[float, float] = (nan, nan)
    total: tuple[float, float] = (nan, nan)
    pushout_pa: tuple[float, float] = (nan, nan)
    residual_n: float = nan
    caveat: str = ""


def fit_axles(
    table: Table, config: Config, pushout_pa: float | None
) -> AxleFit:
    """Fit the axles of *config* apart; *pushout_pa* is held if given."""
    caveat = _why_not(table, config)
    if caveat:
        return AxleFit((table.front_gain / table.gain, nan), caveat=caveat)
    rows = np.arange(len(table.force))
    parts = leave_one_out(
        lambda kept: _solve_axles(table.chosen(kept), pushout_pa),
        rows * PARTS // len(rows),
    )
    errors = np.sqrt(np.diag(jackknife(parts))).tolist()
    front, rear, total, share, pushout = zip(
        _solve_axles(table, pushout_pa).tolist(), errors, strict=True
    )
    if share[1] > AXLE_ERROR or not 0.0 < share[0] < 1.0:
        caveat = (
            f"the pressures of the axles differ too little: {share[0]:.2f} "
            f"with a standard error of {share[1]:.2f}"
        )
        return AxleFit(share, caveat=caveat)
    rest = (
        table.force
        - front[0] * table.front_gain * (table.front - pushout[0])
        - rear[0] * table.rear_gain * (table.rear - pushout[0])
    )
    residual = float(np.sqrt(np.mean(rest**2)))
    return AxleFit(share, front, rear, total, pushout, residual)


def _solve_axles(table: Table, pushout_pa: float | None) -> Column:
    """Return front, rear and total scale, front share and push-out."""
    held = 0.0 if pushout_pa is None else pushout_pa
    columns = [
        table.front_gain * (table.front - held),
        table.rear_gain * (table.rear - held),
    ]
    if pushout_pa is None:
        columns.append(np.full(len(table.force), table.gain))
    front, rear, *rest = fit_linear(
        np.column_stack(columns), table.force, weights(table)
    ).estimate.tolist()
    pushed_front = front * table.front_gain
    pushed = pushed_front + rear * table.rear_gain
    if rest:
        held = -rest[0] * table.gain / pushed
    return np.array(
        [front, rear, pushed / table.gain, pushed_front / pushed, held]
    )


def _why_not(table: Table, config: Config) -> str:
    """Say why front and rear can not be told apart; empty if they can."""
    if not table.front_gain or not table.rear_gain:
        return "brakes of one axle only have a pressure"
    ratio = table.rear / table.front
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
            ". Wheel pressures that part (brake force distribution, one "
            "circuit bled) would tell; wheel slip would need the tyres' "
            "stiffness"
        )
    return text
