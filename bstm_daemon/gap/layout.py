"""How residuals are laid out and how they err: all that naming needs to know.

Apart from the model, so that residuals which were kept can be judged anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt

    from bstm_daemon.gap.noise import NodeNoise
    from bstm_daemon.matching.drives import Column


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One node over one drive, (n,) each; ``couples`` are (corner, name)."""

    drive: int
    node: str
    couples: tuple[tuple[str, str], ...]
    steps: npt.NDArray[np.intp]
    time_s: Column
    measured_k: Column
    slope_k_s: Column
    rise_k: Column


class Layout:
    """Series one after the other, their noise, and the tunables' priors.

    ``prior`` (p,) are standard deviations of logarithms, ``edges`` where the
    series begin and end, ``drive_names`` of the recordings.
    """

    def __init__(
        self,
        series: Sequence[Series],
        noise: Mapping[str, NodeNoise],
        prior: Column,
        drive_names: Sequence[str],
    ) -> None:
        """Take the series and what is known of them."""
        self.series = tuple(series)
        self.prior = prior
        self.drive_names = tuple(drive_names)
        self.set_noise(noise)
        sizes = [len(one.time_s) for one in self.series]
        self.edges = np.concatenate(([0], np.cumsum(sizes)))

    def set_noise(self, noise: Mapping[str, NodeNoise]) -> None:
        """Let residuals err by *noise*, by node."""
        self.noise = dict(noise)
        self._whiteners = [
            self.noise[one.node].whitener(
                one.time_s, one.slope_k_s, one.rise_k
            )
            for one in self.series
        ]

    def slices(self, drive: int) -> list[slice]:
        """Return where the points of *drive* are."""
        return [
            slice(self.edges[i], self.edges[i + 1])
            for i, one in enumerate(self.series)
            if one.drive == drive
        ]

    def whiten(self, apart_k: Column) -> Column:
        """Return *apart_k* (n, k) or (n,) with unit covariance."""
        parts = [
            whitener @ apart_k[self.edges[i] : self.edges[i + 1]]
            for i, whitener in enumerate(self._whiteners)
        ]
        return np.concatenate(parts)
