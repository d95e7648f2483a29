"""From a probability or a temperature to a level, with hysteresis."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

PROBABILITIES: Final = (0.01, 0.1, 0.5)
"""Probability of vapour at which elevated, high and critical begin."""

RELEASE: Final = 0.5
"""A level is left below this share of the probability it begins at."""

HOLD_US: Final = 60_000_000
"""A level falls by one after so long below: a red light is no level."""

COOLED_K: Final = 20.0
"""A level of temperature is left so far below where it begins."""


class Level(IntEnum):
    """How close the fluid is to boiling, or a part to its limit."""

    NORMAL = 0
    ELEVATED = 1
    HIGH = 2
    CRITICAL = 3
    UNKNOWN = 15


@dataclass(slots=True)
class LevelMemory:
    """A level and since when its release has been met [us], None: it is not.

    It rises at once and falls one level at a time, each after
    :data:`HOLD_US`.
    """

    level: Level = Level.NORMAL
    below_since_us: int | None = None

    def by_probability(self, probability: float, time_us: int) -> Level:
        """Take the *probability* at *time_us* and return the level."""
        reached = Level(sum(probability >= limit for limit in PROBABILITIES))
        # nan is not below: what is not known lowers no level
        stays = not probability < RELEASE * PROBABILITIES[self.level - 1]
        return self._move(reached, time_us, stays=stays)

    def by_temperatures(
        self,
        kelvins: Sequence[float],
        limits_k: Sequence[Sequence[float]],
        time_us: int,
    ) -> Level:
        """Take temperatures [K], each with the three limits it may pass.

        The worst one counts, to rise and to stay.
        """
        reached = max(
            sum(kelvin >= limit for limit in limits)
            for kelvin, limits in zip(kelvins, limits_k, strict=True)
        )
        stays = any(
            not kelvin < limits[self.level - 1] - COOLED_K
            for kelvin, limits in zip(kelvins, limits_k, strict=True)
        )
        return self._move(Level(reached), time_us, stays=stays)

    def _move(self, reached: Level, time_us: int, *, stays: bool) -> Level:
        if reached >= self.level:
            self.level, self.below_since_us = reached, None
        elif stays:
            self.below_since_us = None
        elif self.below_since_us is None or self.below_since_us > time_us:
            self.below_since_us = time_us
        elif time_us - self.below_since_us >= HOLD_US:
            self.level = Level(self.level - 1)
            self.below_since_us = time_us
        return self.level


def published_level(
    level: Level, *, usable: bool, history_known: bool
) -> Level:
    """Return *level* as it may be told.

    Of an estimate that is not *usable* none; with an unknown history never
    normal, because an assumed cold start only underestimates.
    """
    if not usable or (level is Level.NORMAL and not history_known):
        return Level.UNKNOWN
    return level
