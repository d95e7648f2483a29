"""Brake power from the motion for several drag areas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.channels import CHANNELS


@dataclass(frozen=True, slots=True, eq=False)
class PowerByDrag:
    """Brake power from motion for several drag areas.

    ``area_m2`` (k,) rises, ``power_w`` is (k, steps, corners). Between two
    areas power is all but a straight line: each sample's is one, as long as
    it brakes.
    """

    area_m2: Column
    power_w: Column

    def at(self, corner: int, area_m2: Sequence[float]) -> Column:
        """Return the power of that corner, (steps, len(*area_m2*))."""
        last = len(self.area_m2) - 2
        above = np.searchsorted(self.area_m2, area_m2)
        low = np.clip(above - 1, 0, last)
        step = self.area_m2[low + 1] - self.area_m2[low]
        into = np.clip((area_m2 - self.area_m2[low]) / step, 0.0, 1.0)
        own = self.power_w[:, :, corner].T
        return np.asarray(own[:, low] * (1.0 - into) + own[:, low + 1] * into)

    @classmethod
    def of_inputs(cls, inputs: Mapping[float, Column]) -> PowerByDrag:
        """Take the inputs of one drive, read with each drag area [m2]."""
        areas = sorted(inputs)
        index = CHANNELS.index("brake_power_w")
        powers = [inputs[area][:, :, index] for area in areas]
        return cls(np.array(areas), np.array(powers))

    def part(self, steps: slice) -> PowerByDrag:
        """Return it over *steps*."""
        return replace(self, power_w=self.power_w[:, steps])
