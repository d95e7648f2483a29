"""Errors of least squares whose residual is white noise plus a slow drift.

What a thermocouple and the model miss drifts over minutes: hundreds of
seconds of one cool-down are a few independent numbers. Sizes of noise and
drift, and the time in which the drift forgets, are those of the highest
restricted likelihood (Patterson and Thompson 1971) on a grid. The values
stay those of plain least squares, which come nearest to the measurement
where the model has not quite its form; only their errors are weighed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from bstm_daemon.quality.recording import Column

    Matrix = npt.NDArray[np.float64]

DRIFTS_S: Final = (30.0, 100.0, 300.0)
"""Times in which the drift forgets; a longer one is an offset."""

DRIFT_TO_NOISE: Final = (0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Variance of the drift over that of the noise."""

_NOTHING: Final = 1e-300
_SINGULAR: Final = 1e-12
_LEAST_K2: Final = 1e-8


@dataclass(frozen=True, slots=True)
class Noise:
    """Covariance of series of ``lengths``, over that of the white noise.

    ``ratio`` is the drift's variance over the noise's. ``factors`` are the
    Cholesky factors and their inverses, for each length.
    """

    lengths: tuple[int, ...]
    ratio: float
    drift_s: float
    factors: dict[int, tuple[Matrix, Matrix]]
    log_determinant: float

    def white(self, value: Matrix) -> Matrix:
        """Return *value*, rows of all series one after the other, white."""
        parts, at = [], 0
        for length in self.lengths:
            parts.append(self.factors[length][1] @ value[at : at + length])
            at += length
        return np.concatenate(parts)

    def spread(self, weights: Matrix) -> Matrix:
        """Return the covariance of *weights* (p, n) times the noise."""
        parts, at = [], 0
        for length in self.lengths:
            parts.append(
                weights[:, at : at + length] @ self.factors[length][0]
            )
            at += length
        wide = np.hstack(parts)
        return np.asarray(wide @ wide.T)


def noise_of(
    lengths: Sequence[int], step_s: float, ratio: float, drift_s: float
) -> Noise:
    """Return the noise of series of *lengths* points *step_s* apart."""
    factors: dict[int, tuple[Matrix, Matrix]] = {}
    logs: dict[int, float] = {}
    for length in set(lengths):
        apart = np.abs(np.subtract.outer(*(np.arange(length),) * 2)) * step_s
        covariance = np.eye(length) + ratio * np.exp(-apart / drift_s)
        factor = np.asarray(np.linalg.cholesky(covariance), np.float64)
        inverse = np.asarray(np.linalg.inv(factor), np.float64)
        factors[length] = factor, inverse
        logs[length] = 2.0 * float(np.log(np.diag(factor)).sum())
    return Noise(
        tuple(lengths),
        ratio,
        drift_s,
        factors,
        sum(logs[length] for length in lengths),
    )


def weights_of(design: Matrix) -> Matrix:
    """Return what least squares multiplies a residual with, (p, n)."""
    scale = _scale(design)
    inverse = np.linalg.pinv(design / scale, rcond=_SINGULAR)
    return np.asarray(inverse / scale[:, None])


def _scale(design: Matrix) -> Column:
    """Return the size of each column: S stands beside kelvins."""
    return np.asarray(np.sqrt((design * design).sum(0)) + _NOTHING)


def likeliest(
    lengths: Sequence[int], step_s: float, left: Column, design: Matrix
) -> tuple[Noise, float]:
    """Return the noise under which *left* is likeliest, and its variance.

    *left* (n,) is what *design* (n, p) leaves over.
    """
    noises = [
        noise_of(lengths, step_s, ratio, drift_s)
        for drift_s in DRIFTS_S
        for ratio in DRIFT_TO_NOISE
    ]
    found = [_restricted(noise, left, design) for noise in noises]
    best = max(range(len(noises)), key=lambda i: found[i][0])
    return noises[best], found[best][1]


def _restricted(
    noise: Noise, left: Column, design: Matrix
) -> tuple[float, float]:
    """Return the restricted log likelihood and the noise's variance."""
    x, y = noise.white(design / _scale(design)), noise.white(left)
    normal = x.T @ x
    step = np.linalg.pinv(normal, rcond=_SINGULAR, hermitian=True) @ (x.T @ y)
    free = max(len(y) - x.shape[1], 1)
    variance = max(float(((y - x @ step) ** 2).sum()) / free, _LEAST_K2)
    _, log_normal = np.linalg.slogdet(normal)
    likelihood = -0.5 * (
        free * np.log(variance) + noise.log_determinant + log_normal
    )
    return float(likelihood), variance
