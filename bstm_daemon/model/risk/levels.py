"""Risk levels from a probability or a temperature, with hysteresis."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Final

from bstm_daemon.estimate import RiskLevel, Validity

PROBABILITIES: Final = (0.01, 0.1, 0.5)
"""Thresholds of the probability of vapour: elevated, high, critical."""

RELEASE: Final = 0.5
"""A level is released below this share of its threshold."""

HOLD_US: Final = 60_000_000
"""Time below the release threshold before a level falls by one; longer than a
red light."""

COOLED_K: Final = 20.0
"""Hysteresis of a level by temperature."""

ELEVATED_MARGIN_K: Final = 40.0
"""The fluid estimate may be off by 30 K over a whole descent (thesis, section
1.3, reached in section 6) and vapour lock begins some K below the equilibrium
boiling point: from 40 K on, boiling is no longer excluded."""

HIGH_MARGIN_K: Final = 20.0
"""Two thermocouples in the same disc differ by up to 20 K (thesis, section
3.2): nearer than this, even a measurement would not rule boiling out."""

CRITICAL_MARGIN_K: Final = 0.0
"""The fluid has the temperature at which a wet fluid of its grade boils."""


def level_of(probability: float) -> RiskLevel:
    """Return the level that begins at or below *probability*; no memory."""
    return RiskLevel(sum(probability >= limit for limit in PROBABILITIES))


@dataclass(slots=True)
class LevelMemory:
    """A level and since when its release has been met [us], None: it is not.

    It rises at once and falls one level at a time, each after
    :data:`HOLD_US`.
    """

    level: RiskLevel = RiskLevel.NORMAL
    below_since_us: int | None = None

    def by_probability(self, probability: float, time_us: int) -> RiskLevel:
        """Take the *probability* at *time_us* and return the level."""
        return self._move(_aim(self.level, probability), time_us)

    def is_sure(self, least: float, most: float) -> bool:
        """Whether all probabilities from *least* to *most* do the same.

        Also where the level falls by one meanwhile.
        """
        level = self.level
        aim = _aim(level, least)
        if aim != _aim(level, most):
            return False
        falls = level and (aim < level or self.below_since_us is not None)
        return not falls or _aim(level - 1, least) == _aim(level - 1, most)

    def by_temperatures(
        self,
        kelvins: Sequence[float],
        limits_k: Sequence[Sequence[float]],
        time_us: int,
    ) -> RiskLevel:
        """Take temperatures [K], each with the three limits it may pass.

        The worst one counts, to rise and to stay.
        """
        aim = 0
        for kelvin, limits in zip(kelvins, limits_k, strict=True):
            aim = max(aim, _aim(self.level, kelvin, limits, 1.0, COOLED_K))
        return self._move(aim, time_us)

    def _move(self, aim: int, time_us: int) -> RiskLevel:
        if aim >= self.level:
            if aim != self.level:
                self.level = RiskLevel(aim)
            self.below_since_us = None
        elif self.below_since_us is None or self.below_since_us > time_us:
            self.below_since_us = time_us
        elif time_us - self.below_since_us >= HOLD_US:
            self.level = RiskLevel(self.level - 1)
            self.below_since_us = time_us
        return self.level


def _aim(
    level: int,
    value: float,
    limits: Sequence[float] = PROBABILITIES,
    share: float = RELEASE,
    below: float = 0.0,
) -> int:
    """Return the level that *value* moves *level* to, sooner or later.

    By one at a time down, where it is less than *share* of the limit less
    *below*; nan is not: an unknown value lowers none.
    """
    if value < limits[0] and not level:
        # nearly always
        return level
    reached = sum(value >= limit for limit in limits)
    if level and value < share * limits[level - 1] - below:
        level -= 1
    return max(reached, level)


def level_of_margin(margin_k: float) -> RiskLevel:
    """Return the level of *margin_k* [K] below the wet boiling point.

    Unknown where the margin is no finite number.
    """
    if not isfinite(margin_k):
        return RiskLevel.UNKNOWN
    limits = ELEVATED_MARGIN_K, HIGH_MARGIN_K, CRITICAL_MARGIN_K
    return RiskLevel(sum(margin_k <= limit for limit in limits))


def published_level(level: RiskLevel, validity: Validity) -> RiskLevel:
    """Return *level*, unknown where *validity* is not usable."""
    return level if validity.is_usable else RiskLevel.UNKNOWN


def sure_level(least: RiskLevel, most: RiskLevel) -> RiskLevel:
    """Return the level that is certain between two bounds, else unknown.

    Args:
        least: from the cold start, which only underestimates: raised it
            holds, normal it proves nothing of a car that was parked hot.
        most: from the hot start, which only overestimates: normal it holds.
    """
    is_sure = least is most or least is not RiskLevel.NORMAL
    return least if is_sure else RiskLevel.UNKNOWN
