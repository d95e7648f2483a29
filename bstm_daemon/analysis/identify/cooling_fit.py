"""One regression over all cool-downs (Eq 4.12), with robust errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.identify.cool_downs import BIN, STEP_S, CoolDown
from bstm_daemon.analysis.identify.disc_loss import DiscLoss, HeatCapacities
from bstm_daemon.analysis.statistics.gls import solution_operator
from bstm_daemon.analysis.statistics.series import Column, Matrix
from bstm_daemon.analysis.statistics.whitening import (
    DriftNoise,
    likeliest_drift,
)
from bstm_daemon.model.thermal.properties import REFERENCE_K

OFFSET_K: Final = 3.0
"""Spread of a thermocouple against the ambient sensor: type K class 2 is
+-2.5 K, ambient sensors +-2 K. It is not fitted, as it would absorb
model errors, but it counts in the standard errors."""

ROUNDS: Final = 6
_LEAST_S: Final = 1e-7


@dataclass(frozen=True, slots=True)
class Series:
    """A cool-down beside the model: bins (n,), ``time_s`` since its start."""

    down: CoolDown
    group: int
    time_s: Column
    measured_k: Column
    model_k: Column


@dataclass(frozen=True, slots=True)
class CoolingFit:
    """S at each group's speed [1/s] and their covariance.

    ``by_corner`` is S and its error of each corner alone. ``noise_k`` and
    ``drift_k`` are the spreads of a bin, ``drift_s`` the drift's time.
    """

    s_per_s: Column
    covariance: Matrix
    by_corner: tuple[dict[str, tuple[float, float]], ...]
    noise_k: float
    drift_k: float
    drift_s: float
    series: tuple[Series, ...]

    def standard_error(self, group: int) -> float:
        """Return the standard error of S of *group*."""
        return float(np.sqrt(self.covariance[group, group]))

    @property
    def residual_k(self) -> float:
        """Root mean square of measurement less model."""
        return rms_k(self.series)


def rms_k(series: Sequence[Series]) -> float:
    """Return the root mean square of measurement less model."""
    residuals_k = [one.measured_k - one.model_k for one in series]
    return float(np.sqrt(np.mean(np.concatenate(residuals_k) ** 2)))


class _Regression:
    """Cool-downs marched side by side (Eq 4.12), and their least squares.

    ``values`` are S of each group and the start of each cool-down.
    """

    def __init__(
        self,
        downs: Sequence[CoolDown],
        losses: Sequence[DiscLoss],
        groups: Sequence[int],
        speeds_ms: Sequence[float],
        *,
        rate_form: bool,
        beside: bool,
    ) -> None:
        self.downs, self.groups = downs, np.array(groups)
        names = list(dict.fromkeys((d.log, d.role) for d in downs))
        self.couple = np.array([names.index((d.log, d.role)) for d in downs])
        self.couples = len(names)
        self.count = len(speeds_ms)
        self.measured = [down.bins(down.disc_k) for down in downs]
        self.lengths = [len(one) for one in self.measured]
        # of each row of the regression: its cool-down, its bin in that
        self.down = np.repeat(np.arange(len(downs)), self.lengths)
        self.bin = np.concatenate([np.arange(n) for n in self.lengths])
        self.values = np.concatenate(
            (
                [self._guess(group) for group in range(self.count)],
                [float(one[0]) for one in self.measured],
            )
        )
        of_downs = [
            (down, loss, speeds_ms[group])
            for down, loss, group in zip(downs, losses, groups, strict=True)
        ]

        def side_by_side(
            bins: Callable[[CoolDown, DiscLoss, float], Column],
            fill: float = 0.0,
        ) -> Matrix:
            """Return *bins* of each cool-down as a column, *fill* below."""
            matrix = np.full((max(self.lengths), len(downs)), fill)
            matrix[self.bin, self.down] = np.concatenate(
                [bins(*one) for one in of_downs]
            )
            return matrix

        self._ambient_k = side_by_side(
            lambda down, *_: down.bins(down.ambient_k), REFERENCE_K
        )
        self._strength = side_by_side(
            lambda down, loss, mean_ms: loss.shape(
                down.bins(down.speed_ms), mean_ms
            )
        )
        # without separate radiation S holds all of the loss
        self._radiation = beside * side_by_side(
            lambda down, loss, _: (
                loss.radiation_w_k4 * loss.radiating(down.bins(down.speed_ms))
            )
        )
        self._pads = beside * side_by_side(
            lambda down, loss, _: (
                loss.pads_w_k4 * np.isfinite(down.bins(down.pad_k))
            )
        )
        self._pad_k4 = side_by_side(
            lambda down, *_: np.nan_to_num(down.bins(down.pad_k)) ** 4
        )
        self._capacities = HeatCapacities(losses, [rate_form for _ in losses])

    def _guess(self, group: int) -> float:
        """Return S from both ends of the group's cool-downs (Eq 4.12)."""
        found = []
        for down, number in zip(self.downs, self.groups, strict=True):
            if number == group:
                above = down.disc_k - down.ambient_k
                fall = float(np.log(above[:BIN].mean() / above[-BIN:].mean()))
                found.append(fall / float(down.time_s[-1]))
        return max(float(np.mean(found)), _LEAST_S)

    def model(self) -> tuple[Column, Matrix, Matrix]:
        """Return the model in bins (n,), its derivatives (n, p) and (n, c).

        The last are with respect to the offset of each of c thermocouples.
        """
        s, start = self.values[self.groups], self.values[self.count :]
        none = np.zeros(len(self.downs))
        h_s, h_k = np.maximum(1e-3 * s, 1e-8), 0.5
        out = self._march(
            np.concatenate((start, start, start, start + h_k)),
            np.concatenate((s, s + h_s, s, s)),
            np.concatenate((none, none, none + h_k, none)),
        ).reshape(-1, 4, len(self.downs))
        base, by_s, by_off, by_start = out[self.bin, :, self.down].T
        rows = np.arange(len(base))
        design = np.zeros((len(base), len(self.values)))
        design[rows, self.groups[self.down]] = (by_s - base) / h_s[self.down]
        design[rows, self.count + self.down] = (by_start - base) / h_k
        by_offset = np.zeros((len(base), self.couples))
        by_offset[rows, self.couple[self.down]] = (by_off - base) / h_k
        return base, design, by_offset

    def left(self, model: Column) -> Column:
        """Return measurement less *model*, all series one after the other."""
        return np.concatenate(self.measured) - model

    def _march(
        self, start_k: Column, s_per_s: Column, off_k: Column
    ) -> Column:
        """Return the bins [K] of every lane, (longest, lanes).

        From *start_k* with *s_per_s*; *off_k* is what the thermocouple reads
        above ambient once the disc has cooled. All (m * lanes,), the
        cool-downs repeated m times.
        """
        step_s = BIN * STEP_S
        repeats = len(start_k) // len(self.lengths)
        lanes = np.tile(np.arange(len(self.lengths)), repeats)
        ambient_k = self._ambient_k[:, lanes] + off_k
        strength = self._strength[:, lanes] * s_per_s
        radiation, pads = self._radiation[:, lanes], self._pads[:, lanes]
        outer = radiation * ambient_k**4 + pads * self._pad_k4[:, lanes]
        both = radiation + pads

        def slope(now: Column, step: int) -> Column:
            per_capacity = self._capacities.inverse(lanes, now)
            rate = strength[step] * self._capacities.factor(
                lanes, per_capacity
            )
            beside = (both[step] * now**4 - outer[step]) * per_capacity
            return np.asarray(-rate * (now - ambient_k[step]) - beside)

        out = np.empty((max(self.lengths), len(lanes)))
        now = np.array(start_k, float)
        for step in range(len(out)):
            out[step] = now
            first = step_s * slope(now, step)
            second = step_s * slope(now + first, step)
            now = now + 0.5 * (first + second)
        return out


def fit_cooling(
    downs: Sequence[CoolDown],
    losses: Sequence[DiscLoss],
    groups: Sequence[int],
    speeds_ms: Sequence[float],
    *,
    rate_form: bool,
    beside: bool = True,
) -> CoolingFit:
    """Fit S of every group to *downs*.

    *groups* is the group of each, *speeds_ms* the speed of each group.
    Without *beside*, S holds radiation too.
    """
    task = _Regression(
        downs, losses, groups, speeds_ms, rate_form=rate_form, beside=beside
    )
    for _ in range(ROUNDS):
        model, design, _ = task.model()
        task.values += solution_operator(design) @ task.left(model)
        # S stays a rate of cooling while the fit is far off
        s = task.values[: task.count]
        np.maximum(s, _LEAST_S, out=s)
    model, design, by_offset = task.model()
    left = task.left(model)
    noise, variance = likeliest_drift(task.lengths, BIN * STEP_S, left, design)
    weights = solution_operator(design)[: task.count]
    # an offset of a thermocouple moves S by this much a kelvin
    moves = weights @ by_offset
    covariance = variance * noise.covariance_of(weights)
    covariance = covariance + OFFSET_K**2 * moves @ moves.T
    by_corner = _by_corner(task, left, design, noise, variance)
    return CoolingFit(
        task.values[: task.count].copy(),
        _scattered(covariance, by_corner),
        by_corner,
        float(np.sqrt(variance)),
        float(np.sqrt(variance * noise.ratio)),
        noise.drift_s,
        tuple(
            Series(down, group, down.bins(down.time_s), measured, one)
            for down, group, measured, one in zip(
                downs,
                groups,
                task.measured,
                np.split(model, np.cumsum(task.lengths)[:-1]),
                strict=True,
            )
        ),
    )


def _by_corner(
    task: _Regression,
    left: Column,
    design: Matrix,
    noise: DriftNoise,
    variance: float,
) -> tuple[dict[str, tuple[float, float]], ...]:
    """Return S of each corner alone, one step from the common one."""
    of_down = [
        (int(group), down.corner)
        for group, down in zip(task.groups, task.downs, strict=True)
    ]
    pairs = list(dict.fromkeys(of_down))
    column = np.array([pairs.index(one) for one in of_down])[task.down]
    rows = np.arange(len(left))
    split = np.zeros((len(left), len(pairs)))
    split[rows, column] = design[rows, task.groups[task.down]]
    weights = solution_operator(np.hstack((split, design[:, task.count :])))
    step = weights @ left
    errors = np.sqrt(np.diag(variance * noise.covariance_of(weights)))
    result: list[dict[str, tuple[float, float]]] = [
        {} for _ in range(task.count)
    ]
    for i, (group, corner) in enumerate(pairs):
        value = float(task.values[group] + step[i])
        result[group][corner] = value, float(errors[i])
    return tuple(result)


def _scattered(
    covariance: Matrix, by_corner: Sequence[dict[str, tuple[float, float]]]
) -> Matrix:
    """Return *covariance*, widened where corners differ significantly.

    A value for both sides is then uncertain by half their difference.
    """
    factor = np.ones(len(by_corner))
    for group, corners in enumerate(by_corner):
        if len(corners) < 2:
            continue
        values = np.array([value for value, _ in corners.values()])
        scatter = float(np.var(values, ddof=1)) / len(values)
        factor[group] = np.sqrt(
            max(1.0, scatter / float(covariance[group, group]))
        )
    return np.asarray(covariance * np.outer(factor, factor))
