"""Stretches of a drive in which a condition holds, and its stops."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

STANDING_MS: Final = 0.5
"""At or below this a vehicle stands, as wheel-speed sensors stop there."""

MOVING_MS: Final = 1.0
"""Above this it has driven off; between the two its state does not change."""

SHORTEST_STOP_S: Final = 10.0
"""Shortest stop with a heat soak; a shorter one is a crossing."""


@dataclass(frozen=True, slots=True)
class Stretches:
    """Total and longest duration of a condition, and its first start."""

    total_s: float
    longest_s: float
    longest_from_s: float
    first_from_s: float


class StretchFinder:
    """Adds up the stretches of a growing drive in which something holds.

    Times count from the first row. A row stands for the time since the row
    before. What holds throughout is one stretch as long as the drive.
    """

    def __init__(self, shortest_s: float = 0.0) -> None:
        """Leave out stretches that are shorter than *shortest_s*."""
        self._shortest_s = shortest_s
        self._last_s = 0.0
        # the last row before a stretch that is not over yet
        self._open_from_s: float | None = None
        self._found: Stretches | None = None

    def add(self, elapsed_s: Column, holds: npt.NDArray[np.bool_]) -> None:
        """Add rows: time since the first, whether it holds; (n,) each."""
        was = self._open_from_s is not None
        edges = np.flatnonzero(np.diff(holds, prepend=was))
        before_s = np.append(self._last_s, elapsed_s)[edges].tolist()
        for edge, last_s in zip(edges.tolist(), before_s, strict=True):
            if holds[edge]:
                self._open_from_s = last_s
            elif self._open_from_s is not None:
                self._found = self._found_with(self._open_from_s, last_s)
                self._open_from_s = None
        if len(elapsed_s):
            self._last_s = float(elapsed_s[-1])

    def stretches(self) -> Stretches | None:
        """Return what was found so far, None if there is no time in it."""
        if self._open_from_s is None:
            return self._found
        return self._found_with(self._open_from_s, self._last_s)

    def _found_with(self, from_s: float, to_s: float) -> Stretches | None:
        length_s = to_s - from_s
        if length_s <= 0.0 or length_s < self._shortest_s:
            return self._found
        found = self._found or Stretches(0.0, 0.0, from_s, from_s)
        if length_s > found.longest_s:
            found = replace(found, longest_s=length_s, longest_from_s=from_s)
        return replace(found, total_s=found.total_s + length_s)


class StopFinder:
    """Finds standstills of :data:`SHORTEST_STOP_S` or more as a drive grows.

    A vehicle that stands in the first row has not stopped. A NaN speed
    changes nothing.
    """

    def __init__(self) -> None:
        """Begin before the first row."""
        self._stops_s: list[float] = []
        self._standing: bool | None = None
        self._since_s: float | None = None
        self._last_s = 0.0

    def add(self, elapsed_s: Column, speed_ms: Column) -> None:
        """Add rows: time since the first and speed, shape (n,) each."""
        if not len(elapsed_s):
            return
        before = bool(self._standing)
        standing = _held(speed_ms <= STANDING_MS, speed_ms > MOVING_MS, before)
        if self._standing is None:
            before = bool(standing[0])
        for row in np.flatnonzero(np.diff(standing, prepend=before)).tolist():
            if standing[row]:
                self._since_s = float(elapsed_s[row])
            else:
                self._stops_s = self._with_open(float(elapsed_s[row]))
                self._since_s = None
        self._standing = bool(standing[-1])
        self._last_s = float(elapsed_s[-1])

    def stops_s(self) -> tuple[float, ...]:
        """Return the start of each so far, also of one that goes on."""
        return tuple(self._with_open(self._last_s))

    def _with_open(self, until_s: float) -> list[float]:
        since_s = self._since_s
        if since_s is None or until_s - since_s < SHORTEST_STOP_S:
            return self._stops_s
        return [*self._stops_s, since_s]


def _held(
    begins: npt.NDArray[np.bool_],
    ends: npt.NDArray[np.bool_],
    before: bool,  # noqa: FBT001
) -> npt.NDArray[np.bool_]:
    """Latch: true from a row of *begins* until a row of *ends*."""
    row = np.arange(len(begins))
    decided = np.maximum.accumulate(np.where(begins | ends, row, -1))
    latched: npt.NDArray[np.bool_] = np.where(
        decided >= 0, begins[decided], before
    )
    return latched
