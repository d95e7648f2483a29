"""The present duty of a corner: what the last minutes were like."""

from __future__ import annotations

from math import exp
from typing import TYPE_CHECKING, Final

from bstm_daemon.estimator.blocks import friction_energies
from bstm_daemon.forecast.march import Conditions

if TYPE_CHECKING:
    from bstm_daemon.estimator.blocks import Instant
    from bstm_daemon.model.thermal.program import Program

MEMORY_S: Final = 120.0
"""What is longer ago counts less than 1/e: a few bends of a descent."""

_CHANNELS: Final = ("speed_ms", "pressure_pa", "brake_on")


class Duty:
    """Fading means of speed, pressure, braking and brake power."""

    def __init__(self, program: Program) -> None:
        """Watch the corner of *program*."""
        self._sources = friction_energies(program)
        self._last: tuple[int, float] | None = None
        self._means = [0.0] * 4
        self._weight = 0.0

    def restart(self) -> None:
        """Forget everything: there is no telling what was meanwhile."""
        self._last, self._means, self._weight = None, [0.0] * 4, 0.0

    def add(self, instant: Instant, corner: str) -> None:
        """Take a publication of the *corner* that this is the duty of."""
        output, time_us = instant.output(corner), instant.time_us
        energy_j = sum(output[i] for i in self._sources)
        last, self._last = self._last, (time_us, energy_j)
        if last is None:
            return
        elapsed_s = (time_us - last[0]) * 1e-6
        if elapsed_s <= 0.0:
            return
        power_w = max(energy_j - last[1], 0.0) / elapsed_s
        news = (
            *(instant.channel(corner, channel) for channel in _CHANNELS),
            power_w,
        )
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
