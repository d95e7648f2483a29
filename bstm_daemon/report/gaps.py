"""Stretches of a drive in which an input was missing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.heat.sample_plan import FLAGS

if TYPE_CHECKING:
    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

INPUTS: Final = {
    "ff": ("speed", "pressure"),
    "fb": ("speed",),
    "measured": ("speed", "pressure"),
}
"""Inputs without which a heat mode goes on only by assumption."""

SHORTEST_GAP_S: Final = 1.0
"""Shorter ones are a late frame."""


@dataclass(frozen=True, slots=True)
class Gap:
    """One input: how long it was missing in all, and the longest stretch."""

    name: str
    total_s: float
    longest_s: float
    longest_from_s: float


class GapFinder:
    """Finds the stretches of a growing drive without one input.

    Times count from the first row. An input that is missing throughout is
    one gap as long as the drive.
    """

    def __init__(self, name: str) -> None:
        """Look for the input *name*."""
        self._name = name
        self._bit = FLAGS[f"{name}_missing"]
        self._last_s = 0.0
        # the last row before a gap that is not over yet
        self._open_from_s: float | None = None
        # total, longest and begin of the longest [s]
        self._found = 0.0, 0.0, 0.0

    def add(self, elapsed_s: Column, flags: Column) -> None:
        """Add rows: time since the first and ``flags``, shape (n,) each."""
        missing = (flags.astype(np.int64) & self._bit) != 0
        was = self._open_from_s is not None
        edges = np.flatnonzero(np.diff(missing, prepend=was))
        before_s = np.append(self._last_s, elapsed_s)[edges].tolist()
        for edge, last_s in zip(edges.tolist(), before_s, strict=True):
            if missing[edge]:
                self._open_from_s = last_s
            elif self._open_from_s is not None:
                self._found = self._found_with(self._open_from_s, last_s)
                self._open_from_s = None
        if len(elapsed_s):
            self._last_s = float(elapsed_s[-1])

    def gap(self) -> Gap | None:
        """Return what was missing so far, None if nothing for long."""
        found = self._found
        if self._open_from_s is not None:
            found = self._found_with(self._open_from_s, self._last_s)
        return Gap(self._name, *found) if found[0] else None

    def _found_with(
        self, from_s: float, to_s: float
    ) -> tuple[float, float, float]:
        total_s, longest_s, longest_from_s = self._found
        length_s = to_s - from_s
        if length_s < SHORTEST_GAP_S:
            return self._found
        if length_s > longest_s:
            longest_s, longest_from_s = length_s, from_s
        return total_s + length_s, longest_s, longest_from_s
