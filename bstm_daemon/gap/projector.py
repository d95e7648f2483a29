"""Generalised least squares: what residuals say once tunables are free."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.matching.drives import Column

FREE: Final = 1.5
"""Standard deviation of strengths that are fitted beside others."""


class Projector:
    """The inverse covariance of residuals with the tunables integrated out.

    ``A = 1 - J (J'J + P^-1)^-1 J'``.
    """

    def __init__(self, jacobian: Column, prior: Column) -> None:
        """Take the whitened *jacobian* (n, p) and *prior* sd (p,)."""
        self.jacobian = jacobian
        self.prior = prior
        precision = jacobian.T @ jacobian + np.diag(prior**-2.0)
        self._solve = np.linalg.inv(precision)

    def __call__(self, residual: Column) -> Column:
        """Return ``A residual`` for (n,) or (n, k)."""
        part = self.jacobian.T @ residual
        return np.asarray(residual - self.jacobian @ (self._solve @ part))

    def beside(self, columns: Sequence[Column]) -> Projector:
        """Return one with effects, *columns* (n,) each, integrated out."""
        return Projector(
            np.column_stack((self.jacobian, *columns)),
            np.concatenate((self.prior, np.full(len(columns), FREE))),
        )

    def tunables(self, residual: Column) -> Column:
        """Return the change of the tunables that fits *residual* best."""
        return np.asarray(-self._solve @ (self.jacobian.T @ residual))
