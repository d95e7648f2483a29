"""Decimation of a growing series for a plot, with every peak kept.

A bucket of neighbouring rows is replaced by its lowest and its highest one
(the core of M4, Jugel et al. 2014, PVLDB 7(10)): on a screen with fewer
columns than buckets the line looks the same, and no extreme is lost. Buckets
double when they get too many. The extremes of a wider bucket are among those
of its parts, so what was left out before is never missed.
"""

from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.analysis.statistics.series import Column

Rows = npt.NDArray[np.intp]


SPARE: Final = 2
"""Points held while the series grows, in multiples of those at the end."""

SPANS_DRAWN: Final = 300
"""More stretches than this are merged to what a screen can show."""

BUCKETS: Final = 65_536
"""Most buckets held: single rows for 1.8 h at ten a second, then pairs of
rows, then fours."""


class ThinCurve:
    """Points of a growing series that draw the same line.

    These are the first and the last row, and the lowest and the highest of
    each bucket; a bucket with NaN keeps one, so that a line breaks where it
    did. Buckets are cut by row number, not by what is added at a time.
    """

    def __init__(self, limit: int) -> None:
        """Hold enough for *limit* points, 8 or more, at the end."""
        self._limit = limit
        self._count = 0
        self._bucket_rows = 1
        # row number, x and y, shape (3, n) each
        self._parts: list[Column] = []
        self._last: Column = np.empty((3, 0))

    def add(self, x: Column, y: Column) -> None:
        """Add points, each of shape (n,); *y* is NaN where there is none."""
        if not len(x):
            return
        rows = np.arange(self._count, self._count + len(x), dtype=np.float64)
        self._count += len(x)
        points = np.stack([rows, x, y])
        self._last = points[:, -1:].copy()
        self._keep(points)
        while sum(part.shape[1] for part in self._parts) > (
            SPARE * self._limit
        ):
            self._bucket_rows *= 2
            points, self._parts = np.hstack(self._parts), []
            self._keep(points)

    def points(self) -> tuple[Column, Column]:
        """Return x and y of at most as many points as were asked for."""
        points = np.hstack([self._last[:, :0], *self._parts])
        if self._count and points[0, -1] != self._count - 1:
            points = np.hstack([points, self._last])
        rows, x, y = points
        if len(rows) > self._limit:
            # beside the lowest and the highest one for a gap
            a_bucket = 3 if np.isnan(y).any() else 2
            buckets = (self._limit - 2) // a_bucket
            edges = np.linspace(0, self._count, buckets + 1).astype(np.intp)
            starts = np.unique(np.searchsorted(rows, edges[:-1]))
            kept = _kept(y, starts[starts < len(rows)])
            kept = np.union1d(kept, [0, len(rows) - 1])
            x, y = x[kept], y[kept]
        return x, y

    def _keep(self, points: Column) -> None:
        if self._bucket_rows > 1:
            bucket = points[0] // self._bucket_rows
            kept = _kept(
                points[2], np.flatnonzero(np.diff(bucket, prepend=-1))
            )
            if points[0, 0] == 0:
                kept = np.union1d(kept, [0])
            points = points[:, kept]
        self._parts.append(points)


def _kept(values: Column, starts: Rows) -> Rows:
    """Return the first lowest, highest and NaN of each bucket, rising."""
    edges = np.append(starts, len(values))
    return np.unique(
        np.concatenate(
            [
                _first_where(values == _spread(np.fmin, values, edges), edges),
                _first_where(values == _spread(np.fmax, values, edges), edges),
                _first_where(np.isnan(values), edges),
            ]
        )
    )


def _spread(extreme: np.ufunc, values: Column, edges: Rows) -> Column:
    """Return each row's bucket extreme; ``fmin`` and ``fmax`` pass by NaN."""
    of_bucket = extreme.reduceat(values, edges[:-1])
    spread: Column = np.repeat(of_bucket, np.diff(edges))
    return spread


def _first_where(wanted: npt.NDArray[np.bool_], edges: Rows) -> Rows:
    """Return the first wanted row of each bucket that has one."""
    found = np.append(np.flatnonzero(wanted), len(wanted))
    candidates = found[np.searchsorted(found, edges[:-1])]
    return candidates[candidates < edges[1:]]


class Buckets:
    """A growing column as a bounded number of buckets of rows.

    Columns of the same length have the same buckets.
    """

    def __init__(self, of_bucket: np.ufunc) -> None:
        """Replace the rows of a bucket by *of_bucket*, such as maximum."""
        self.values = np.empty(0)
        self._of_bucket = of_bucket
        self._bucket_rows = 1
        self._count = 0

    def add(self, values: Column) -> None:
        """Add rows, shape (n,)."""
        if not len(values):
            return
        rows = np.arange(self._count, self._count + len(values))
        self._count += len(values)
        bucket = rows // self._bucket_rows
        starts = np.flatnonzero(np.diff(bucket, prepend=-1))
        found = self._of_bucket.reduceat(values, starts)
        if bucket[0] < len(self.values):
            self.values[-1] = self._of_bucket(self.values[-1], found[0])
            found = found[1:]
        self.values = np.append(self.values, found)
        while len(self.values) > BUCKETS:
            self._bucket_rows *= 2
            pairs = np.arange(0, len(self.values), 2)
            self.values = self._of_bucket.reduceat(self.values, pairs)


def validity_spans(
    elapsed_s: Column, validity: Column
) -> list[tuple[int, float, float]]:
    """Return code, start and end [s] of each stretch that is not valid.

    A stretch ends where the next one begins. Where there are more than a
    screen can show, neighbours are merged and keep the worse code.

    Args:
        elapsed_s: shape (n,), rising.
        validity: shape (n,), 0 valid, 1 degraded, 2 invalid; NaN is valid.
            Or of an input: 1 parked, 2 suspect, 3 missing.
    """
    if not len(validity):
        return []
    codes = np.nan_to_num(validity, nan=0.0).astype(np.int64)
    starts_s = elapsed_s
    if np.count_nonzero(np.diff(codes)) > SPANS_DRAWN:
        edges = np.linspace(0, len(codes), SPANS_DRAWN, endpoint=False)
        rows = edges.astype(np.intp)
        codes, starts_s = np.maximum.reduceat(codes, rows), elapsed_s[rows]
    changes = np.flatnonzero(np.diff(codes)) + 1
    ends_s = np.append(starts_s, elapsed_s[-1])
    return [
        (int(codes[begin]), float(starts_s[begin]), float(ends_s[end]))
        for begin, end in pairwise([0, *changes.tolist(), len(codes)])
        if codes[begin] > 0
    ]
