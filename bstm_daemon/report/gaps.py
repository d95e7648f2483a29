"""Stretches of a drive in which an input was missing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.heat.sample_plan import FLAGS

if TYPE_CHECKING:
    from bstm_daemon.results import Results

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


def input_gaps(results: Results, heat_mode: str) -> tuple[Gap, ...]:
    """Return the gaps of the inputs that *heat_mode* needs.

    Times count from the start of the results. An input that is missing
    throughout is one gap as long as the drive.
    """
    flags = results.columns["flags"].astype(np.int64)
    elapsed_s = results.elapsed_s
    steps_s = np.diff(elapsed_s, prepend=0.0)
    gaps = []
    for name in INPUTS[heat_mode]:
        missing = (flags & FLAGS[f"{name}_missing"]) != 0
        edges = np.diff(missing.astype(np.int8), prepend=0, append=0)
        starts, ends = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
        lengths = [
            float(steps_s[a:b].sum())
            for a, b in zip(starts, ends, strict=True)
        ]
        long = [length for length in lengths if length >= SHORTEST_GAP_S]
        if long:
            longest = int(np.argmax(lengths))
            begin = max(int(starts[longest]) - 1, 0)
            gaps.append(
                Gap(name, sum(long), max(long), float(elapsed_s[begin]))
            )
    return tuple(gaps)
