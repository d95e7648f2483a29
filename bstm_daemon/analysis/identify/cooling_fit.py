"""One regression over all cool-downs (Eq 4.12), with errors that hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.identify.cool_downs import BIN, STEP_S, CoolDown
from bstm_daemon.analysis.identify.disc_loss import DiscLoss, Lanes
from bstm_daemon.analysis.statistics.gls import solution_operator
from bstm_daemon.analysis.statistics.whitening import likeliest_drift

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.analysis.statistics.series import Column, Matrix
    from bstm_daemon.analysis.statistics.whitening import DriftNoise

OFFSET_K: Final = 3.0
"""Spread of a thermocouple against the ambient sensor: type K class 2 is
+-2.5 K, ambient sensors +-2 K. It is not fitted, what the model misses would
go there, but its part is in the errors."""

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
    apart = [one.measured_k - one.model_k for one in series]
    return float(np.sqrt(np.mean(np.concatenate(apart) ** 2)))


class _Regression:
    """Parameters: S of each group, the start of each cool-down."""

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
        self.lanes = Lanes(
            downs,
            losses,
            [speeds_ms[g] for g in groups],
            rate_form=rate_form,
            beside=beside,
        )
        names = list(dict.fromkeys((d.log, d.role) for d in downs))
        self.couple = np.array([names.index((d.log, d.role)) for d in downs])
        self.couples = len(names)
        self.count = len(speeds_ms)
        self.measured = [down.bins(down.disc_k) for down in downs]
        self.lengths = self.lanes.lengths
        self.values = np.concatenate(
            (
                [self._guess(group) for group in range(self.count)],
                [float(one[0]) for one in self.measured],
            )
        )

    def _guess(self, group: int) -> float:
        """Return S from both ends of the group's cool-downs (Eq 4.12)."""
        found = []
        for down, number in zip(self.downs, self.groups, strict=True):
            if number == group:
                above = down.disc_k - down.ambient_k
                fall = float(np.log(above[:BIN].mean() / above[-BIN:].mean()))
                found.append(fall / float(down.time_s[-1]))
        return max(float(np.mean(found)), _LEAST_S)

    def model(self) -> tuple[list[Column], Matrix, Matrix]:
        """Return the model in bins, its derivatives (n, p), those by offset.

        The last, (n, couples), is by what a thermocouple reads too much.
        """
        s, start = self.values[self.groups], self.values[self.count :]
        none = np.zeros(len(self.downs))
        h_s, h_k = np.maximum(1e-3 * s, 1e-8), 0.5
        out = self.lanes.march(
            np.concatenate((start, start, start, start + h_k)),
            np.concatenate((s, s + h_s, s, s)),
            np.concatenate((none, none, none + h_k, none)),
            BIN * STEP_S,
        ).reshape(-1, 4, len(self.downs))
        model = []
        rows = sum(self.lengths)
        design = np.zeros((rows, len(self.values)))
        by_offset = np.zeros((rows, self.couples))
        at = 0
        for i, length in enumerate(self.lengths):
            base, by_s, by_off, by_start = out[:length, :, i].T
            part = slice(at, at + length)
            design[part, self.groups[i]] = (by_s - base) / h_s[i]
            design[part, self.count + i] = (by_start - base) / h_k
            by_offset[part, self.couple[i]] = (by_off - base) / h_k
            model.append(base)
            at += length
        return model, design, by_offset

    def left(self, model: Sequence[Column]) -> Column:
        """Return measurement less *model*, all series one after the other."""
        return np.concatenate(self.measured) - np.concatenate(model)


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
        task.values[: task.count] = np.maximum(
            task.values[: task.count], _LEAST_S
        )
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
            Series(
                down,
                groups[i],
                down.bins(down.time_s),
                task.measured[i],
                model[i],
            )
            for i, down in enumerate(downs)
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
    pairs = list(
        dict.fromkeys(
            (int(group), down.corner)
            for group, down in zip(task.groups, task.downs, strict=True)
        )
    )
    split = np.zeros((len(left), len(pairs)))
    at = 0
    for i, length in enumerate(task.lengths):
        rows, group = slice(at, at + length), int(task.groups[i])
        column = pairs.index((group, task.downs[i].corner))
        split[rows, column] = design[rows, group]
        at += length
    weights = solution_operator(np.hstack((split, design[:, task.count :])))
    step = weights @ left
    errors = np.sqrt(np.diag(variance * noise.covariance_of(weights)))
    result: list[dict[str, tuple[float, float]]] = [
        {} for _ in range(task.count)
    ]
    for i, (group, corner) in enumerate(pairs):
        result[group][corner] = (
            float(task.values[group] + step[i]),
            float(errors[i]),
        )
    return tuple(result)


def _scattered(
    covariance: Matrix, by_corner: Sequence[dict[str, tuple[float, float]]]
) -> Matrix:
    """Return *covariance*, wider where corners part by more than it says.

    A value for both sides is then uncertain by their half difference.
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
