"""How much data speak for linear terms, nuisance parameters integrated out.

Residuals ``r = J x + C a + noise`` are whitened; the nuisance parameters x
and the strengths a have normal priors, so that both integrate in closed form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.statistics.series import Column, Matrix

FREE: Final = 1.5
"""Standard deviation of strengths that are fitted beside others."""


class Projector:
    """The inverse covariance of residuals, nuisance parameters integrated out.

    ``A = 1 - J (J'J + P^-1)^-1 J'``.
    """

    def __init__(self, jacobian: Matrix, prior: Column) -> None:
        """Take the whitened *jacobian* (n, p) and *prior* sd (p,)."""
        self.jacobian = jacobian
        self.prior = prior
        precision = jacobian.T @ jacobian + np.diag(prior**-2.0)
        self._covariance = np.linalg.inv(precision)

    def __call__(self, residual: Matrix) -> Matrix:
        """Return ``A residual`` for (n,) or (n, k)."""
        part = self.jacobian.T @ residual
        return np.asarray(residual - self.jacobian @ (self._covariance @ part))

    def beside(self, columns: Sequence[Column]) -> Projector:
        """Return one with *columns*, (n,) each, integrated out too."""
        return Projector(
            np.column_stack((self.jacobian, *columns)),
            np.concatenate((self.prior, np.full(len(columns), FREE))),
        )

    def nuisance(self, residual: Column) -> Column:
        """Return the nuisance parameters that fit *residual* best, (p,)."""
        return np.asarray(-self._covariance @ (self.jacobian.T @ residual))


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """Linear terms fitted to residuals.

    ``strengths`` (k,) take the terms out of the residual and ``covariance``
    (k, k) is theirs; ``gain`` is the fall of half the sum of squares, priors
    included, ``log_evidence`` the log Bayes factor against none of them.
    """

    strengths: Column
    covariance: Matrix
    gain: float
    log_evidence: float


def fit_terms(
    project: Projector, residual: Column, columns: Matrix, prior: float
) -> Terms:
    """Fit *columns* (n, k) to *residual* (n,), strengths N(0, prior^2)."""
    projected = project(columns)
    count = columns.shape[1]
    normal = columns.T @ projected + np.eye(count) / prior**2
    score = projected.T @ residual
    gain = 0.5 * float(score @ np.linalg.solve(normal, score))
    cost = 0.5 * float(np.linalg.slogdet(normal)[1]) + count * np.log(prior)
    covariance = np.asarray(np.linalg.inv(normal), np.float64)
    return Terms(-covariance @ score, covariance, gain, gain - float(cost))


def mean_evidence(logs: Column | Sequence[float]) -> float:
    """Return the log Bayes factor of alternatives (k,) as likely each."""
    logs = np.asarray(logs, float)
    top = float(np.max(logs, initial=-np.inf))
    if not np.isfinite(top):
        return -np.inf
    return top + float(np.log(np.mean(np.exp(logs - top))))
