"""Distribution of the water content of the brake fluid.

Brake fluid takes up water through hoses and reservoir. Age alone says
little: Keen (TRRL LR 903, 1979) found more than half of 1000 cars at 3 % or
above and no firm relation with age; in a survey of 1720 cars a fifth held 5 %
or more. Both fit a lognormal of median 3 % and spread 0.55, which stands for
a fluid of unknown age. With a known change the median follows the uptake
that is usually quoted, 1.5 % after a year, 2.5 % after two and 3.5 % after
four, with a spread of 0.45. These are assumptions, not measurements of this
car; a measured value replaces them.
"""

from collections.abc import Mapping
from itertools import pairwise
from math import exp, hypot, log
from typing import Final, NamedTuple

UPTAKE: Final = (
    (0.0, 0.2),
    (1.0, 1.5),
    (2.0, 2.5),
    (4.0, 3.5),
    (8.0, 4.5),
    (16.0, 5.5),
)
"""Age [years] and median of the water [% by mass] in a temperate climate."""

CLIMATES: Final[Mapping[str, float]] = {
    "dry": 0.7,
    "temperate": 1.0,
    "humid": 1.4,
}
"""Factor on the uptake; the air's humidity drives it."""

AGE_SPREAD: Final = 0.45
UNKNOWN_AGE: Final = (3.0, 0.55)
"""Median [%] and spread of the logarithm where nothing is known."""

LEAST_PERCENT: Final = 0.05
"""Lower bound: no fluid in a car is drier."""


class Water(NamedTuple):
    """A lognormal distribution: its median [%] and the spread of ln(w)."""

    median_percent: float
    spread: float

    def at(self, deviate: float) -> float:
        """Return the water [%] at a standard normal *deviate*."""
        return self.median_percent * exp(self.spread * deviate)


def water_of_age(age_years: float | None, climate: str) -> Water:
    """Return the water of a fluid that was changed *age_years* ago.

    Args:
        age_years: time since the change; None where it is not known.
        climate: a name of :data:`CLIMATES`.
    """
    factor = CLIMATES[climate]
    if age_years is None:
        median, spread = UNKNOWN_AGE
        return Water(median * factor, spread)
    return Water(max(_uptake(age_years) * factor, LEAST_PERCENT), AGE_SPREAD)


def water_measured(
    percent: float, accuracy: float, climate: str, since_years: float = 0.0
) -> Water:
    """Return the water of a fluid that was measured *since_years* ago.

    Args:
        percent: what was measured [% by mass].
        accuracy: standard deviation of the measurement over its value.
        climate: a name of :data:`CLIMATES`.
        since_years: what the fluid took up since is as uncertain as any.
    """
    measured = max(percent, LEAST_PERCENT)
    age = _age_of(measured / CLIMATES[climate])
    grown = _uptake(age + since_years) - _uptake(age)
    gain = grown * CLIMATES[climate]
    total = measured + gain
    spread = hypot(accuracy * measured / total, AGE_SPREAD * gain / total)
    return Water(total, spread)


def _uptake(age_years: float) -> float:
    if age_years <= UPTAKE[0][0]:
        return UPTAKE[0][1]
    for (t0, w0), (t1, w1) in pairwise(UPTAKE):
        if age_years <= t1:
            return w0 + (w1 - w0) * (age_years - t0) / (t1 - t0)
    (t0, w0), (t1, w1) = UPTAKE[-2:]
    # the last stretch goes on ever slower
    return w1 + (w1 - w0) * log(age_years / t1) / log(t1 / t0)


def _age_of(percent: float) -> float:
    """Return the age [years] at which the median holds *percent*."""
    if percent <= UPTAKE[0][1]:
        return 0.0
    for (t0, w0), (t1, w1) in pairwise(UPTAKE):
        if percent <= w1:
            return t0 + (t1 - t0) * (percent - w0) / (w1 - w0)
    return UPTAKE[-1][0]
