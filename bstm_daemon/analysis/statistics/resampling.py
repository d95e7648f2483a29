"""Errors without a noise model: leave groups out, or draw them anew.

Neighbouring samples err alike, so the groups (stops, windows, blocks of time)
have to be long enough to be independent.
"""

from collections.abc import Callable

import numpy as np

from bstm_daemon.analysis.statistics.series import Column, Indices, Matrix


def leave_one_out(
    estimate: Callable[[Indices], Column], groups: Indices
) -> Matrix:
    """Return *estimate* of the rows without each group in turn, (g, p).

    *groups* (n,) is the group of each row.
    """
    return np.array(
        [
            estimate(np.flatnonzero(groups != one))
            for one in np.unique(groups).tolist()
        ]
    )


def jackknife(estimates: Matrix) -> Matrix:
    """Return the covariance (p, p) from estimates without one group each.

    Tukey's jackknife: ``(g - 1) / g`` times the sum of squares about the
    mean of *estimates*, (g, p).
    """
    count = len(estimates)
    deviations = estimates - estimates.mean(axis=0)
    return np.asarray((count - 1) / count * deviations.T @ deviations)


def bootstrap(
    blocks: Matrix,
    statistic: Callable[[Column], float],
    *,
    draws: int,
    seed: int,
    coverage: float = 0.9,
) -> tuple[float, float]:
    """Return the interval of a statistic of sums over blocks.

    Args:
        blocks: contribution of each independent block, (b, k).
        statistic: of the sums over the blocks, (k,).
        draws: how often as many blocks are drawn, with replacement.
        seed: of the draws.
        coverage: probability that the interval is to hold.
    """
    rng = np.random.default_rng(seed)
    count = len(blocks)
    found = [
        statistic(blocks[rng.integers(0, count, count)].sum(axis=0))
        for _ in range(draws)
    ]
    tail = 0.5 * (1.0 - coverage)
    lower, upper = np.quantile(found, (tail, 1.0 - tail))
    return float(lower), float(upper)
