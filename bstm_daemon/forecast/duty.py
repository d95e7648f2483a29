"""The present duty of a corner: what the last minutes were like."""

from __future__ import annotations

from math import exp
from typing import TYPE_CHECKING, Final

from bstm_daemon.forecast.march import Conditions
from bstm_daemon.heat.sample_plan import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.thermal.program import Program

MEMORY_S: Final = 120.0
"""What is longer ago counts less than 1/e: a few bends of a descent."""

_SPEED: Final = CHANNELS.index("speed_ms")
_PRESSURE: Final = CHANNELS.index("pressure_pa")
_BRAKE_ON: Final = CHANNELS.index("brake_on")


class Duty:
    """Fading means of speed, pressure, braking and brake power."""

    def __init__(self, program: Program, size: int) -> None:
        """Watch the corner of *program*; *size* is a member's output row."""
        first = size - len(program.network.sources)
        self._sources = [
            first + i
            for i, source in enumerate(program.network.sources)
            if any(factor.a == "brake_power_w" for factor in source.factors)
        ]
        self._last: tuple[int, float] | None = None
        self._means = [0.0] * 4
        self._weight = 0.0

    def restart(self) -> None:
        """Forget everything: there is no telling what was meanwhile."""
        self._last, self._means, self._weight = None, [0.0] * 4, 0.0

    def add(
        self,
        time_us: int,
        row: Sequence[float],
        output: Sequence[float],
        first: int,
    ) -> None:
        """Take the row and the output of a publication.

        *output* at *first* begins the corner's row of state and running
        energies [J].
        """
        energy_j = sum(output[first + i] for i in self._sources)
        last, self._last = self._last, (time_us, energy_j)
        if last is None:
            return
        elapsed_s = (time_us - last[0]) * 1e-6
        if elapsed_s <= 0.0:
            return
        power_w = max(energy_j - last[1], 0.0) / elapsed_s
        news = (row[_SPEED], row[_PRESSURE], row[_BRAKE_ON], power_w)
        keep = exp(-elapsed_s / MEMORY_S)
        self._means = [
            keep * mean + (1.0 - keep) * value
            for mean, value in zip(self._means, news, strict=True)
        ]
        self._weight = keep * self._weight + (1.0 - keep)

    def conditions(self, ambient_k: float) -> Conditions:
        """Return the duty as conditions that last."""
        weight = self._weight or 1.0
        speed, pressure, brake_on, power = (m / weight for m in self._means)
        return Conditions(ambient_k, speed, pressure, brake_on, power)
