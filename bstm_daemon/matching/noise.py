"""How far measured temperatures lie from the best model, and how they cohere.

Residuals of a thermocouple are not white: the junction sits somewhere in the
part (offset), answers late (lag), and what it reads drifts with place and
load, as does what the model leaves out (drift). With covariance

    C = white^2 I + drift^2 exp(-|dt|/tau) + offset^2 11' + lag^2 T'T''
        + quick^2 diag(T'^2)

offset, lag and drift are marginalised: they need no values of their own. The
last term is what a lump can not follow: in a hard stop the face of the disc,
where the junction sits, runs ahead of the mean by seconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.matching.drives import Column

DRIFT_S: Final = 300.0
"""Correlation time of drift and of what the model leaves out."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations of one node's residuals.

    ``white_k``, ``drift_k`` and ``offset_k`` in kelvin, ``lag_s`` and
    ``quick_s`` in seconds.
    """

    white_k: float
    drift_k: float
    offset_k: float
    lag_s: float = 2.0
    quick_s: float = 3.0

    def whitener(self, time_s: Column, slope_k_s: Column) -> Column:
        """Return W with W C W' = 1 for points at *time_s*, (n, n).

        Its rows are the innovations of a Kalman filter whose state is drift,
        offset and lag: n small updates, where a factorisation would let the
        linear-algebra library start threads of its own.
        """
        count = len(time_s)
        mean = np.zeros((3, count))
        spread = np.diag(
            [self.drift_k**2, self.offset_k**2, self.lag_s**2]
        ).astype(np.float64)
        white_2 = self.white_k**2 + (self.quick_s * slope_k_s) ** 2
        keep = np.exp(-np.diff(time_s, prepend=time_s[:1]) / DRIFT_S)
        found = np.zeros((count, count))
        for k in range(count):
            mean[0] *= keep[k]
            spread[0] *= keep[k]
            spread[:, 0] *= keep[k]
            spread[0, 0] += self.drift_k**2 * (1.0 - keep[k] ** 2)
            shown = spread[:, 0] + spread[:, 1] + slope_k_s[k] * spread[:, 2]
            size_2 = shown[0] + shown[1] + slope_k_s[k] * shown[2]
            size_2 += white_2[k]
            apart = -(mean[0] + mean[1] + slope_k_s[k] * mean[2])
            apart[k] += 1.0
            found[k] = apart / np.sqrt(size_2)
            mean += np.outer(shown / size_2, apart)
            spread -= np.outer(shown, shown) / size_2
        return found


FIRST: Final[dict[str, Noise]] = {
    "disc": Noise(2.0, 8.0, 2.0),
    "pad_front": Noise(2.0, 8.0, 3.0),
    "pad_back": Noise(1.0, 3.0, 1.5),
    "fluid": Noise(1.0, 1.5, 0.7),
}
"""Before residuals are known, by node; the spread of two thermocouples in one
disc reaches 20 K (thesis section 3.2)."""

OTHER: Final = Noise(1.0, 5.0, 3.0)
"""Of any other node."""

LEAST_K: Final = 0.5
"""No sensor and no model is better."""

LARGEST: Final = 1.5
"""Drift is at most so many times the first guess: else a node that the model
misses would be believed less from round to round, and missed the more."""


def learned(
    noise: Noise, residuals: Sequence[Column], time_s: Sequence[Column]
) -> Noise:
    """Return *noise* with what *residuals* of a fit show, (n,) each."""
    if not residuals:
        return noise
    total = np.concatenate(residuals)
    steps = np.concatenate(
        [
            np.diff(one)[np.diff(at) < DRIFT_S / 10.0]
            for one, at in zip(residuals, time_s, strict=True)
        ]
    )
    # a median, as the jumps at stops are drift of the model, not noise
    white = 1.0
    if len(steps):
        white = float(np.median(np.abs(steps))) / 0.6745 / np.sqrt(2.0)
    drift_2 = float(np.mean(total**2)) - white**2
    return replace(
        noise,
        white_k=max(white, LEAST_K),
        drift_k=min(max(drift_2, LEAST_K**2) ** 0.5, LARGEST * noise.drift_k),
    )
