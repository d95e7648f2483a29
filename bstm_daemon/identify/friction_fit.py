"""The least squares behind ``bstm identify brakes``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import numpy.typing as npt

    from bstm_daemon.identify.brake_samples import BrakeStop
    from bstm_daemon.quality.recording import Column

    Rows = npt.NDArray[np.intp]

FLOOR_N: Final = 100.0
SHARE: Final = 0.03
"""What a sample may err by: noise and grade, and friction itself."""

SIGMAS: Final = 3.0
"""A lean on speed or pressure must stand out so far."""

LEAST_LEAN: Final = 0.01
"""... and change friction by so much over the range of the samples."""

ROUNDS: Final = 12


@dataclass(frozen=True, slots=True)
class Table:
    """Samples of all stops as columns, (n,) each."""

    stop: Column
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

    def chosen(self, rows: Rows) -> Table:
        """Return the samples *rows*, around the same means."""
        return Table(
            self.stop[rows],
            self.force[rows],
            self.front[rows],
            self.rear[rows],
            self.gain,
            self.front_gain,
            self.rear_gain,
            self.speed[rows],
            self.speed_mean,
            self.pressure_mean,
        )


def table_of(stops: Sequence[BrakeStop]) -> Table:
    """Return the samples of *stops* as columns."""

    def joined(column: Callable[[BrakeStop], Column]) -> Column:
        return np.concatenate([column(stop) for stop in stops])

    first = stops[0]
    speed = joined(lambda stop: stop.speed_ms)
    pressure = joined(lambda stop: stop.pressure_pa)
    front = joined(lambda stop: stop.front_pa)
    rear = joined(lambda stop: stop.rear_pa)
    return Table(
        np.concatenate(
            [np.full(len(s.since_s), float(i)) for i, s in enumerate(stops)]
        ),
        joined(lambda stop: stop.force_n),
        np.nan_to_num(front) if not first.front_gain else front,
        np.nan_to_num(rear) if not first.rear_gain else rear,
        first.gain,
        first.front_gain,
        first.rear_gain,
        speed,
        float(speed.mean()),
        float(pressure.mean()),
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
    held = pushout_pa
    pushout = 0.0 if held is None else held
    result = np.zeros(4)
    for _ in range(ROUNDS):
        pushing = table.gain * (table.pressure - pushout)
        if held is None:
            first = [
                table.gain * table.pressure,
                np.full(len(weight), table.gain),
            ]
        else:
            first = [pushing]
        lean = [
            pushing * x
            for x, used in zip((x_speed, x_pressure), leans, strict=True)
            if used
        ]
        matrix = np.column_stack([*first, *lean]) * weight[:, None]
        norm = np.linalg.norm(matrix, axis=0)
        solved = (
            np.linalg.lstsq(matrix / norm, table.force * weight, rcond=None)[0]
            / norm
        ).tolist()
        scale = solved[0]
        if held is None:
            pushout = -solved[1] / scale
        result[:2] = scale, pushout
        rest = iter(solved[len(first) :])
        result[2] = next(rest) / scale if leans[0] else 0.0
        result[3] = next(rest) / scale if leans[1] else 0.0
    return result


def errors_of(
    table: Table, pushout_pa: float | None, leans: tuple[bool, bool]
) -> Column:
    """Return standard errors by leaving out one stop, or a tenth, at a time.

    Samples of a stop err alike, so that stops and not samples count.
    """
    groups = table.stop.astype(int)
    names = np.unique(groups)
    if len(names) < 4:
        groups = np.arange(len(groups)) * 10 // len(groups)
        names = np.unique(groups)
    fits = np.array(
        [
            fit_table(
                table.chosen(np.flatnonzero(groups != n)), pushout_pa, leans
            )
            for n in names
        ]
    )
    count = len(names)
    spread = ((fits - fits.mean(axis=0)) ** 2).sum(axis=0)
    return np.asarray(np.sqrt(spread * (count - 1) / count))
