"""The stretches of a drive in which an estimate is not valid."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

SPANS_DRAWN: Final = 300
"""More stretches than this are merged to what a screen can show."""


def validity_spans(
    elapsed_s: npt.NDArray[np.float64], validity: npt.NDArray[np.float64]
) -> list[tuple[int, float, float]]:
    """Return code, start and end [s] of each stretch that is not valid.

    A stretch ends where the next one begins. Where there are more than a
    screen can show, neighbours are merged and keep the worse code.

    Args:
        elapsed_s: shape (n,), rising.
        validity: shape (n,), 0 valid, 1 degraded, 2 invalid; NaN is valid.
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
