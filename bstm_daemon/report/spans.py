"""The stretches of a drive in which something is not as it should be."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

SPANS_DRAWN: Final = 300
"""More stretches than this are merged to what a screen can show."""

BUCKETS: Final = 65_536
"""Rows that are told apart: ten a second for 1.8 h, then each two together,
then each four."""


class Buckets:
    """A growing column as a bounded number of buckets of rows.

    What takes as many rows has the same buckets.
    """

    def __init__(self, of_bucket: np.ufunc) -> None:
        """Replace the rows of a bucket by *of_bucket*, maximum say."""
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
            Or of an input: 1 suspect, 2 missing.
    """
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
