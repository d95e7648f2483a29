"""Noise models of residuals, and the matrices that whiten them.

Residuals of a thermocouple are not white: the junction sits somewhere in the
part (offset), answers late (lag), and what it reads drifts with place and
load, as does what the model leaves out (drift).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from bstm_daemon.analysis.statistics.gls import SINGULAR, column_size
from bstm_daemon.analysis.statistics.series import Column, Matrix

DRIFT_S: Final = 300.0
"""Correlation time of drift and of what the model leaves out."""

DRIFTS_S: Final = (30.0, 100.0, 300.0)
"""Correlation times of drift that are tried; a longer one is an offset."""

DRIFT_TO_WHITE: Final = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Ratios of drift variance to white variance that are tried."""

_LEAST_K2: Final = 1e-8


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Standard deviations of one node's residuals: [K], a share, [s].

    With covariance::

        C = white^2 I + d d' exp(-|dt| / tau) + offset^2 11' + lag^2 T'T''
            + quick^2 diag(s),     d = hypot(drift, share * rise)

    offset, lag and drift are integrated out and need no values of their own.
    The form of a model is off by more the further a node is above the air:
    ``share`` of the rise. The last term is what a lump can not follow: in a
    hard stop the face of the disc, where the junction sits, runs ahead of
    the mean by seconds. ``s`` is the square of the slope or, where that is
    more, the mean square of the slopes before and after a point: at the peak
    of a stop their mean is 0, and a model that is a second off there is some
    kelvin off.
    """

    white_k: float
    drift_k: float
    share: float
    offset_k: float
    lag_s: float = 2.0
    quick_s: float = 2.1

    def scaled(self, slow: float, fast: float) -> SensorNoise:
        """Return it with drift, and white noise and haste, times factors."""
        return replace(
            self,
            white_k=self.white_k * fast,
            quick_s=self.quick_s * fast,
            drift_k=self.drift_k * slow,
            share=self.share * slow,
        )

    def covariance(
        self, time_s: Column, slope_k_s: Column, rise_k: Column | None = None
    ) -> Matrix:
        """Return C for points at *time_s*, (n, n).

        *slope_k_s* (n,) is that of the temperature, *rise_k* (n,) its rise
        above the air; without it ``share`` does not count.
        """
        rise = np.zeros(len(time_s)) if rise_k is None else rise_k
        delta_s = np.abs(np.subtract.outer(time_s, time_s))
        drift = np.hypot(self.drift_k, self.share * rise)
        found = np.outer(drift, drift) * np.exp(-delta_s / DRIFT_S)
        found += self.offset_k**2
        found += self.lag_s**2 * np.outer(slope_k_s, slope_k_s)
        steep = np.maximum(slope_k_s**2, _mean_square_slope(time_s, rise))
        found[np.diag_indices_from(found)] += (
            self.white_k**2 + self.quick_s**2 * steep
        )
        return found

    def whitener(
        self, time_s: Column, slope_k_s: Column, rise_k: Column | None = None
    ) -> Matrix:
        """Return W with W C W' = 1 for points at *time_s*, (n, n)."""
        covariance = self.covariance(time_s, slope_k_s, rise_k)
        lower = np.linalg.cholesky(covariance)
        return np.asarray(np.linalg.solve(lower, np.eye(len(time_s))))


def _mean_square_slope(time_s: Column, value: Column) -> Column:
    """Return the mean square of the slopes before and after each point."""
    if len(time_s) < 2:
        return np.zeros_like(value)
    square = (np.diff(value) / np.diff(time_s)) ** 2
    before = np.concatenate((square[:1], square))
    after = np.concatenate((square, square[-1:]))
    return np.asarray(0.5 * (before + after))


@dataclass(frozen=True, slots=True)
class DriftNoise:
    """White noise plus a drift that forgets, in evenly spaced series.

    ``ratio`` is the drift's variance over the white one, ``drift_s`` its
    correlation time. ``lower`` are the Cholesky factors of the covariance
    over the white variance, by length of a series.
    """

    lengths: tuple[int, ...]
    ratio: float
    drift_s: float
    lower: dict[int, Matrix]

    @classmethod
    def of(
        cls,
        lengths: Sequence[int],
        step_s: float,
        ratio: float,
        drift_s: float,
    ) -> DriftNoise:
        """Return the noise of series of *lengths* points *step_s* apart."""
        lower = {}
        for length in set(lengths):
            steps = np.arange(length)
            delta_s = np.abs(np.subtract.outer(steps, steps)) * step_s
            covariance = np.eye(length) + ratio * np.exp(-delta_s / drift_s)
            lower[length] = np.asarray(np.linalg.cholesky(covariance))
        return cls(tuple(lengths), ratio, drift_s, lower)

    @property
    def log_determinant(self) -> float:
        """Logarithm of the determinant of the whole covariance."""
        logs = {n: np.log(np.diag(low)).sum() for n, low in self.lower.items()}
        return 2.0 * float(sum(logs[length] for length in self.lengths))

    def whiten(self, value: Matrix) -> Matrix:
        """Return *value* (n, ...), all series one after the other, white."""
        flat = value.reshape(len(value), -1)
        parts = np.split(flat, np.cumsum(self.lengths)[:-1])
        for length, lower in self.lower.items():
            # side by side: the factorisation is what takes the time
            own = [i for i, one in enumerate(self.lengths) if one == length]
            white = np.linalg.solve(lower, np.hstack([parts[i] for i in own]))
            for i, part in zip(own, np.split(white, len(own), 1), strict=True):
                parts[i] = part
        return np.concatenate(parts).reshape(value.shape)

    def covariance_of(self, operator: Matrix) -> Matrix:
        """Return the covariance of *operator* (p, n) times the noise."""
        parts = np.split(operator, np.cumsum(self.lengths)[:-1], axis=1)
        wide = np.hstack(
            [
                part @ self.lower[length]
                for length, part in zip(self.lengths, parts, strict=True)
            ]
        )
        return np.asarray(wide @ wide.T)


def likeliest_drift(
    lengths: Sequence[int], step_s: float, residual: Column, design: Matrix
) -> tuple[DriftNoise, float]:
    """Return the noise under which *residual* is likeliest, and its variance.

    The restricted likelihood (Patterson and Thompson 1971), on a grid, of
    what a fit of *design* (n, p) leaves, (n,). The fit itself may be plain
    least squares, which comes nearest to the measurement where the model has
    not quite its form; this weighs its errors only.
    """
    noises = [
        DriftNoise.of(lengths, step_s, ratio, drift_s)
        for drift_s in DRIFTS_S
        for ratio in DRIFT_TO_WHITE
    ]
    found = [_restricted(noise, residual, design) for noise in noises]
    best = max(range(len(noises)), key=lambda i: found[i][0])
    return noises[best], found[best][1]


def _restricted(
    noise: DriftNoise, residual: Column, design: Matrix
) -> tuple[float, float]:
    """Return the restricted log likelihood and the white variance."""
    design = design / column_size(design)
    both = noise.whiten(np.column_stack((design, residual)))
    x, y = both[:, :-1], both[:, -1]
    normal = x.T @ x
    step = np.linalg.pinv(normal, rcond=SINGULAR, hermitian=True) @ (x.T @ y)
    free = max(len(y) - x.shape[1], 1)
    variance = max(float(((y - x @ step) ** 2).sum()) / free, _LEAST_K2)
    _, log_normal = np.linalg.slogdet(normal)
    likelihood = -0.5 * (
        free * np.log(variance) + noise.log_determinant + log_normal
    )
    return float(likelihood), variance
