"""Brake power as it follows a value of the heat, not of the brake."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from bstm_daemon.analysis.statistics.series import Column


@dataclass(frozen=True, slots=True, eq=False)
class PowerBy:
    """Brake power of one corner for several values of the tunable ``key``.

    ``value`` (k,) rises, ``power_w`` is (k, steps). Between two values power
    is all but a straight line, and beyond the last it goes on as one: each
    sample's is, as long as it brakes.
    """

    key: str
    value: Column
    power_w: Column

    def at(self, value: Sequence[float]) -> Column:
        """Return the power at each *value*, (steps, n)."""
        last = len(self.value) - 2
        low = np.clip(np.searchsorted(self.value, value) - 1, 0, last)
        step = self.value[low + 1] - self.value[low]
        into = (value - self.value[low]) / step
        own = self.power_w.T
        power_w = own[:, low] * (1.0 - into) + own[:, low + 1] * into
        return np.asarray(np.maximum(power_w, 0.0))

    def part(self, steps: slice) -> PowerBy:
        """Return it over *steps*."""
        return replace(self, power_w=self.power_w[:, steps])
