"""Low-discrepancy draws: the same few numbers on every machine.

An ensemble of 64 members drawn at random would carry a sampling error of its
own and differ from seed to seed. The additive recurrence of the generalised
golden ratio (Roberts 2018) fills the unit cube evenly from the first point
on and needs neither table nor generator.
"""

from statistics import NormalDist
from typing import Final

_STANDARD: Final = NormalDist()
_ROOT_ITERATIONS: Final = 60


def unit_draws(count: int, dimensions: int) -> list[tuple[float, ...]]:
    """Return *count* points of the open unit cube, evenly spread."""
    root = 1.5
    for _ in range(_ROOT_ITERATIONS):
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = [root ** -(axis + 1) for axis in range(dimensions)]
    return [
        tuple((0.5 + step * (i + 1)) % 1.0 for step in steps)
        for i in range(count)
    ]


def normal_draws(count: int, dimensions: int) -> list[tuple[float, ...]]:
    """Return *count* points of the standard normal distribution.

    They come in pairs of opposite sign, so that every axis has the mean 0
    exactly; with an odd *count* the last one is the origin.
    """
    half = [
        tuple(_STANDARD.inv_cdf(share) for share in point)
        for point in unit_draws(count // 2, dimensions)
    ]
    pairs = [p for point in half for p in (point, tuple(-x for x in point))]
    return pairs + [(0.0,) * dimensions] * (count % 2)
