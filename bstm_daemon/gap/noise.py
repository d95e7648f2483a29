"""How model and thermocouples err together when nothing is missing.

Never white: a junction has an offset and a lag, its reading drifts, and the
form of the model itself is off by what ``[accuracy]`` says, which grows with
the rise above the air. With covariance

    C = white^2 I + d d' exp(-|dt|/tau) + offset^2 11' + lag^2 T'T''
        + quick^2 diag(T'-^2 + T'+^2) / 2,     d = hypot(floor, share * rise)

offset and lag are marginalised and need no values of their own. T'- and T'+
are the slopes before and after a point: at the peak of a stop their mean is 0,
and a model that is a second off there is some kelvin off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.matching.noise import DRIFT_S

if TYPE_CHECKING:
    from bstm_daemon.config import Config
    from bstm_daemon.matching.drives import Column


@dataclass(frozen=True, slots=True)
class NodeNoise:
    """Standard deviations of one node: [K], share of the rise, [s]."""

    white_k: float
    floor_k: float
    share: float
    offset_k: float
    lag_s: float = 2.0
    quick_s: float = 2.1

    def smoothed(self, samples: int) -> NodeNoise:
        """Return the noise of a running mean over *samples*."""
        return replace(
            self,
            white_k=self.white_k / samples**0.5,
            quick_s=self.quick_s / samples**0.5,
        )

    def covariance(
        self, time_s: Column, slope_k_s: Column, rise_k: Column
    ) -> Column:
        """Return C for points at *time_s*, (n, n)."""
        apart = np.abs(np.subtract.outer(time_s, time_s))
        drift = np.hypot(self.floor_k, self.share * rise_k)
        found = np.outer(drift, drift) * np.exp(-apart / DRIFT_S)
        found += self.offset_k**2
        found += self.lag_s**2 * np.outer(slope_k_s, slope_k_s)
        steep2 = np.maximum(slope_k_s**2, _steep2(time_s, rise_k))
        found[np.diag_indices_from(found)] += (
            self.white_k**2 + self.quick_s**2 * steep2
        )
        return found

    def whitener(
        self, time_s: Column, slope_k_s: Column, rise_k: Column
    ) -> Column:
        """Return W with W C W' = 1 for points at *time_s*, (n, n)."""
        covariance = self.covariance(time_s, slope_k_s, rise_k)
        lower = np.linalg.cholesky(covariance)
        return np.asarray(np.linalg.solve(lower, np.eye(len(time_s))))


def _steep2(time_s: Column, rise_k: Column) -> Column:
    """Return the mean square of the slopes before and after each point."""
    if len(time_s) < 2:
        return np.zeros_like(rise_k)
    square = (np.diff(rise_k) / np.diff(time_s)) ** 2
    before = np.concatenate((square[:1], square))
    after = np.concatenate((square, square[-1:]))
    return np.asarray(0.5 * (before + after))


USUAL: Final[dict[str, NodeNoise]] = {
    # a lumped disc has no surface: in stops it errs by seconds of its slope
    "disc": NodeNoise(1.5, 3.6, 0.024, 2.0, quick_s=3.4),
    "pad_front": NodeNoise(0.7, 2.4, 0.024, 3.0, quick_s=1.5),
    "pad_back": NodeNoise(0.7, 1.2, 0.016, 1.5, quick_s=1.5),
    "fluid": NodeNoise(1.0, 1.0, 0.01, 0.7),
}
"""Of a model matched to this car, by node, where ``[accuracy]`` is empty."""

OTHER: Final = NodeNoise(1.0, 4.0, 0.03, 3.0)
"""Of any other node."""


LEAST_K: Final = 0.5
LARGEST: Final = 2.0
"""Times the usual: ``[accuracy]`` of few drives is mostly what the tunables
do not know yet, and here they are fitted."""


def noise_of(config: Config, node: str) -> NodeNoise:
    """Return the noise of *node*: what ``[accuracy]`` knows, else usual.

    Offset and drift of the junctions add to what the model is off by.
    """
    known = config.accuracy
    found = USUAL.get(node, OTHER)
    floor = getattr(known, f"{node}_k", None)
    if floor is not None:
        share = float(getattr(known, f"{node}_share"))
        found = replace(
            found,
            floor_k=min(max(float(floor), LEAST_K), LARGEST * found.floor_k),
            share=min(share, LARGEST * found.share),
        )
    return replace(
        found,
        offset_k=hypot(found.offset_k, known.thermocouple_offset_k),
        floor_k=hypot(found.floor_k, known.drift_beyond_usual_k()),
    )
