"""Fewer points for a plot, with every peak kept.

A bucket of neighbouring rows is replaced by its lowest and its highest one
(the core of M4, Jugel et al. 2014, PVLDB 7(10)): on a screen with fewer
columns than buckets the line looks the same, and no extreme is lost.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt


def kept_rows(
    values: npt.NDArray[np.float64], limit: int
) -> npt.NDArray[np.intp]:
    """Return rows of *values* that draw the same line.

    The first and the last row, and the lowest and the highest of each
    bucket; a bucket with NaN keeps one, so that a line breaks where it did.

    Args:
        values: shape (n,), NaN where there is nothing to draw.
        limit: largest number of rows to return, 8 or more.

    Returns:
        Row numbers, rising, at most *limit*.
    """
    count = len(values)
    if count <= limit:
        return np.arange(count)
    missing = np.isnan(values)
    a_bucket = 3 if missing.any() else 2
    buckets = (limit - 2) // a_bucket
    edges = np.linspace(0, count, buckets + 1).astype(np.intp)
    starts, ends = edges[:-1], edges[1:]
    rows = [
        np.array([0, count - 1]),
        _first_where(values == _spread(np.fmin, values, edges), starts, ends),
        _first_where(values == _spread(np.fmax, values, edges), starts, ends),
        _first_where(missing, starts, ends),
    ]
    return np.unique(np.concatenate(rows))


def _spread(
    extreme: np.ufunc,
    values: npt.NDArray[np.float64],
    edges: npt.NDArray[np.intp],
) -> npt.NDArray[np.float64]:
    """Return each row's bucket extreme; ``fmin`` and ``fmax`` pass by NaN."""
    of_bucket = extreme.reduceat(values, edges[:-1])
    spread: npt.NDArray[np.float64] = np.repeat(of_bucket, np.diff(edges))
    return spread


def _first_where(
    wanted: npt.NDArray[np.bool_],
    starts: npt.NDArray[np.intp],
    ends: npt.NDArray[np.intp],
) -> npt.NDArray[np.intp]:
    """Return the first wanted row of each bucket that has one."""
    found = np.append(np.flatnonzero(wanted), len(wanted))
    candidates = found[np.searchsorted(found, starts)]
    return candidates[candidates < ends]
