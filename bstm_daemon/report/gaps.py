"""Stretches of a drive in which something held; those without an input."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.heat.sample_plan import FLAGS

if TYPE_CHECKING:
    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

SHORTEST_GAP_S: Final = 1.0
"""Shorter ones are a late frame."""


@dataclass(frozen=True, slots=True)
class Gap:
    """One input: how long it was missing in all, and the longest stretch."""

    name: str
    total_s: float
    longest_s: float
    longest_from_s: float


@dataclass(frozen=True, slots=True)
class Stretches:
    """How long something held in all, at the longest, and from when."""

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
        found = self._found
        length_s = to_s - from_s
        if length_s <= 0.0 or length_s < self._shortest_s:
            return found
        if found is None:
            return Stretches(length_s, length_s, from_s, from_s)
        longest_s, longest_from_s = found.longest_s, found.longest_from_s
        if length_s > longest_s:
            longest_s, longest_from_s = length_s, from_s
        return Stretches(
            found.total_s + length_s,
            longest_s,
            longest_from_s,
            found.first_from_s,
        )


class GapFinder:
    """Finds the stretches of a growing drive without one input."""

    def __init__(self, name: str) -> None:
        """Look for the input *name*."""
        self._name = name
        self._bit = FLAGS[f"{name}_missing"]
        self._finder = StretchFinder(SHORTEST_GAP_S)

    def add(self, elapsed_s: Column, flags: Column) -> None:
        """Add rows: time since the first and ``flags``, shape (n,) each."""
        self._finder.add(elapsed_s, (flags.astype(np.int64) & self._bit) != 0)

    def gap(self) -> Gap | None:
        """Return what was missing so far, None if nothing for long."""
        found = self._finder.stretches()
        if found is None:
            return None
        return Gap(
            self._name, found.total_s, found.longest_s, found.longest_from_s
        )
