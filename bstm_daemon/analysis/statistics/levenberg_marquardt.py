"""Levenberg-Marquardt with bounds, for residuals that march many at once.

A function that evaluates k points costs hardly more than one that evaluates
one, so sensitivities and trial steps are asked for together.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.statistics.series import Column, Mask

STEP: Final = 0.01
"""Step of a parameter's logarithm for finite differences."""

DAMPINGS: Final = (0.0, 1e-2, 1.0, 30.0)
"""Damping factors tried together in each iteration, times the diagonal."""

ITERATIONS: Final = 12
CONVERGED: Final = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The minimum: ``x`` (p,), ``residuals`` (n,), ``jacobian`` (n, p).

    ``at_bound`` (p,) is which parameters are held by a bound that the
    cost pushes against; ``cost`` is half the sum of squares.
    """

    x: Column
    residuals: Column
    jacobian: Column
    at_bound: Mask
    cost: float
    evaluations: int


def minimise(  # noqa: PLR0913
    function: Callable[[Column], Column],
    start: Column,
    lower: Column,
    upper: Column,
    progress: Callable[[int, float], None] | None = None,
    *,
    converged: float = CONVERGED,
    iterations: int = ITERATIONS,
    dampings: Sequence[float] = DAMPINGS,
) -> Solution:
    """Minimise the sum of squares of *function*.

    Args:
        function: takes points (k, p), returns residuals (k, n).
        start: first point, (p,), put inside the bounds.
        lower: bounds, (p,).
        upper: bounds, (p,).
        progress: called with each iteration and its cost.
        converged: relative fall of the cost, and a tenth of the longest
            step, at which it is done.
        iterations: at most.
        dampings: tried together in each iteration, times the diagonal.
    """
    x = np.clip(start, lower, upper)
    evaluations = 0
    residuals, jacobian, held = _linearised(function, x, lower, upper)
    cost = 0.5 * float(residuals @ residuals)
    for iteration in range(1, iterations + 1):
        evaluations += len(x) + 1
        trials = _trials(
            x, residuals, jacobian, held, (lower, upper), dampings
        )
        values = function(trials)
        evaluations += len(trials)
        costs = 0.5 * np.einsum("kn,kn->k", values, values)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        best = int(np.argmin(costs))
        if progress is not None:
            progress(iteration, min(cost, float(costs[best])))
        if costs[best] >= cost:
            break
        fall = (cost - float(costs[best])) / max(cost, 1e-30)
        moved = float(np.abs(trials[best] - x).max())
        x = trials[best]
        residuals, jacobian, held = _linearised(function, x, lower, upper)
        cost = 0.5 * float(residuals @ residuals)
        if fall < converged and moved < 10.0 * converged:
            break
    return Solution(x, residuals, jacobian, held, cost, evaluations)


def _linearised(
    function: Callable[[Column], Column],
    x: Column,
    lower: Column,
    upper: Column,
) -> tuple[Column, Column, Mask]:
    """Return residuals, sensitivities, and which bounds hold at *x*."""
    steps = np.where(x + STEP <= upper, STEP, -STEP)
    values = function(np.vstack((x, x + np.diag(steps))))
    residuals = values[0]
    jacobian = (values[1:] - residuals).T / steps
    # what can not be computed beside x shows nothing of the way downhill
    jacobian = np.where(np.isfinite(jacobian), jacobian, 0.0)
    downhill = -(jacobian.T @ residuals)
    held = ((x <= lower + 1e-9) & (downhill < 0.0)) | (
        (x >= upper - 1e-9) & (downhill > 0.0)
    )
    return residuals, jacobian, held


def _trials(
    x: Column,
    residuals: Column,
    jacobian: Column,
    held: Mask,
    bounds: tuple[Column, Column],
    dampings: Sequence[float],
) -> Column:
    """Return the points to try, (k, p), inside the bounds."""
    free = ~held
    part = jacobian[:, free]
    normal = np.einsum("ni,nj->ij", part, part)
    gradient = part.T @ residuals
    scale = np.maximum(np.diag(normal), 1e-12)
    points = []
    for damping in dampings:
        step = np.zeros(len(x))
        matrix = normal + np.diag(damping * scale + 1e-12 * scale)
        step[free] = -np.linalg.lstsq(matrix, gradient, rcond=None)[0]
        points.append(np.clip(x + np.clip(step, -1.0, 1.0), *bounds))
    return np.array(points)
