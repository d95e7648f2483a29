"""Linear least squares with weights, and errors under correlated noise.

The columns of a design may be of very different size (S in 1/s beside
kelvins), so every solution is found on columns of unit length.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.statistics.series import Column, Matrix

SINGULAR: Final = 1e-12
"""Singular values below this share of the largest count as 0."""

MOST_CORRELATED: Final = 0.9
"""Upper bound of the residuals' lag-one correlation."""

_NOTHING: Final = 1e-300


@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Least squares of ``values = design @ estimate + residual``.

    ``estimate`` (p,), ``residual`` (n,) unweighted, ``inverse`` (p, p) is
    that of the normal matrix and ``freedom`` the degrees of freedom.
    """

    estimate: Column
    residual: Column
    inverse: Matrix
    freedom: int

    @property
    def variance(self) -> float:
        """Residual variance per degree of freedom."""
        return float(self.residual @ self.residual) / self.freedom

    @property
    def covariance(self) -> Matrix:
        """Covariance of the estimate, neighbours erring alike, (p, p)."""
        return (
            self.variance * correlation_inflation(self.residual) * self.inverse
        )


def fit_linear(
    design: Matrix, values: Column, weights: Column | None = None
) -> LinearFit:
    """Return the least-squares fit of *design* (n, p) to *values* (n,).

    *weights* (n,) are inverse standard deviations; all 1 without.
    """
    if weights is not None:
        weighted, target = design * weights[:, None], values * weights
    else:
        weighted, target = design, values
    size = column_size(weighted)
    unit = weighted / size
    estimate = np.linalg.lstsq(unit, target, rcond=None)[0] / size
    return LinearFit(
        estimate,
        values - design @ estimate,
        np.linalg.pinv(unit.T @ unit) / np.outer(size, size),
        max(len(values) - design.shape[1], 1),
    )


def column_size(design: Matrix) -> Column:
    """Return the length of each column of *design*, never 0, (p,)."""
    return np.asarray(np.linalg.norm(design, axis=0) + _NOTHING)


def solution_operator(design: Matrix) -> Matrix:
    """Return what least squares multiplies a residual with, (p, n)."""
    size = column_size(design)
    inverse = np.linalg.pinv(design / size, rcond=SINGULAR)
    return np.asarray(inverse / size[:, None])


def correlation_inflation(residual: Column) -> float:
    """Return by how much correlated neighbours enlarge a variance.

    ``(1 + r) / (1 - r)`` of an autoregression of first order with the lag-one
    correlation r of *residual* (n,); 1 for fewer than four values.
    """
    if len(residual) < 4:
        return 1.0
    square = max(float(residual @ residual), 1e-30)
    lag = float(residual[1:] @ residual[:-1]) / square
    lag = min(max(lag, 0.0), MOST_CORRELATED)
    return (1.0 + lag) / (1.0 - lag)
