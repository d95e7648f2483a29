"""One series of evenly spaced values: runs, means, white noise."""

from math import comb, sqrt

import numpy as np
import numpy.typing as npt

Column = npt.NDArray[np.float64]
Matrix = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Indices = npt.NDArray[np.intp]


def runs(mask: Mask) -> list[tuple[int, int]]:
    """Return first and last index, both included, of each run of True."""
    edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0))
    return [
        (int(first), int(last) - 1)
        for first, last in zip(edges[::2], edges[1::2], strict=True)
    ]


def block_means(values: Column, width: int) -> Column:
    """Return the means of whole blocks of *width* values, (n // width,).

    A block with a NaN is NaN; values after the last whole block are left out.
    """
    count = len(values) // width
    return np.asarray(values[: count * width].reshape(count, width).mean(1))


def running_mean(values: Column, half: int) -> tuple[Column, Column]:
    """Return the mean over *half* values to either side, and their number.

    Windows end where the series does; NaN is left out and does not count.
    Where nothing counts the mean is NaN. Both (n,).
    """
    known = np.isfinite(values)
    sums = np.cumsum(np.concatenate(([0.0], np.where(known, values, 0.0))))
    counts = np.cumsum(np.concatenate(([0], known)))
    place = np.arange(len(values))
    first = np.maximum(place - half, 0)
    last = np.minimum(place + half + 1, len(values))
    count = counts[last] - counts[first]
    mean = np.divide(
        sums[last] - sums[first],
        count,
        out=np.full(len(values), np.nan),
        where=count > 0,
    )
    return mean, count


def white_std(differences: Column, order: int) -> float:
    """Return the standard deviation of the white noise in a series.

    From its *differences* of *order*, (n,): the median of their size is
    little moved by steps and slopes of what is measured.
    """
    size = float(np.median(np.abs(differences))) / 0.6745
    return size / sqrt(comb(2 * order, order))


def rms(values: Column) -> float:
    """Return the root mean square of *values*, (n,)."""
    return float(np.sqrt(np.mean(values**2)))


def white_noise(values: Column) -> float:
    """Return the standard deviation of the white noise of *values*, (n,).

    From their second differences; 0 for fewer than three.
    """
    return white_std(np.diff(values, 2), 2) if len(values) > 2 else 0.0
