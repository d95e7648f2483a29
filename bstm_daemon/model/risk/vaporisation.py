"""Distribution of the boiling point, and probability of vapour from it.

The boiling point falls with the water ``w`` [% by mass] from the dry one to
near the wet one,

    T_b(w) = T_inf + (T_dry - T_inf) exp(-w / w_0)

with ``T_inf`` such that T_b(3.7 %) is the wet boiling point; Keen's vapour
lock points (250, 180, 145 degC at 0, 1, 3 %) follow the form with w_0 = 1.0
%, others are slower. Above 4 % the form is an upper bound: there it falls on
by up to 6 K a percent, but nothing boils below water. All at ambient pressure:
vapour forms when the pedal is released or the car is parked. Vapour lock
begins some kelvin below the equilibrium reflux boiling point that standards
speak of.
"""

from array import array
from bisect import bisect_right
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from math import exp, expm1, isnan, nan
from statistics import NormalDist
from typing import Final, NamedTuple

from bstm_daemon.model.risk.boiling import BOILING_POINTS
from bstm_daemon.model.risk.sequence import unit_draws
from bstm_daemon.model.risk.water import Water
from bstm_daemon.native.loader import load_kernel

WET_WATER_PERCENT: Final = 3.7
"""Water of a fluid humidified as FMVSS 116 S6.2 asks."""

SLOWEST_PERCENT: Final = 3.0
FASTEST_PERCENT: Final = 1.0
"""Range of w_0: Keen's fluids 1.0; a maker of refractometers (MISCO, 'When To
Change Your Brake Fluid') has 255, 180, 160 degC at 0, 2, 3 % for DOT 3, which
is 2.5, and 255, 210, 187 degC for DOT 4, which is slower still."""

DRY_EXCESS_K: Final = (35.0, 10.0)
"""Mean and standard deviation of a new fluid's boiling point above its grade's
dry minimum: today's DOT 4 boils at 265 degC, not 230. Never below it."""

WET_EXCESS_K: Final = 6.0
"""Standard deviation of the half-normal excess of a fluid's wet boiling point
over its grade's minimum."""

KNOWN_CAN_K: Final = 1.0
"""Standard deviation of boiling points that are given for the fluid used."""

BEYOND_PERCENT: Final = 4.0
BEYOND_K_PERCENT: Final = 6.0
"""Water [%] above which the boiling point falls further, and by how many
kelvin a percent at most: the scale of MISCO's refractometer for DOT 3 ends at
118 degC and 6 % of water, 12 K below the form with its w_0."""

WATER_K: Final = 373.15
"""Boiling point of water: no fluid with water in it boils below."""

VAPOUR_LOCK_K: Final = 6.0
"""How far below the boiling point vapour lock begins at most."""

DRAWS: Final = 512

_STANDARD: Final = NormalDist()


class Fluid(NamedTuple):
    """Known properties of a fluid except its water.

    ``dry_k`` and ``wet_k`` are the boiling points of this fluid if known,
    otherwise None: then the grade's minima apply.
    """

    grade: str
    dry_k: float | None = None
    wet_k: float | None = None


class Boiling:
    """The distribution of the temperature at which vapour forms."""

    def __init__(self, points_k: list[float]) -> None:
        """Take equally likely vapour lock points [K]."""
        self._points = sorted(points_k)
        self._low = self._points[0]
        count = len(self._points)
        size = int(self._points[-1] - self._low) + 2
        shares = [
            bisect_right(self._points, self._low + i) / count
            for i in range(size)
        ]
        # within each kelvin the share of the fluids is a line
        self._lines = array("d")
        for i, (left, right) in enumerate(pairwise(shares)):
            rise = right - left
            self._lines.extend((left - rise * (self._low + i), rise))
        self._count = size - 1
        kernel = load_kernel()
        self._compiled = None if kernel is None else kernel.mean_probability

    @property
    def lowest_k(self) -> float:
        """Temperature [K] up to which the probability is 0."""
        return self._low

    def probability(self, temperature_k: float) -> float:
        """Return the probability that vapour forms at *temperature_k*.

        NaN of NaN: an estimate that is no number is not a safe one.
        """
        return self.mean_probability((temperature_k,))

    def mean_probability(self, temperatures_k: Sequence[float]) -> float:
        """Return the mean probability over *temperatures_k*; NaN of none."""
        if self._compiled is not None:
            return self._compiled(self._lines, self._low, temperatures_k)
        if not temperatures_k or isnan(sum(temperatures_k)):
            return nan
        low, count, lines = self._low, self._count, self._lines
        found = 0.0
        for kelvin in temperatures_k:
            if kelvin > low:
                above_k = kelvin - low
                if above_k < count:
                    at = 2 * int(above_k)
                    found += lines[at] + lines[at + 1] * kelvin
                else:
                    found += 1.0
        return found / len(temperatures_k)

    def quantile(self, share: float) -> float:
        """Return the point [K] that *share* of the fluids boil below."""
        place = share * (len(self._points) - 1)
        index = min(int(place), len(self._points) - 2)
        left, right = self._points[index : index + 2]
        return left + (place - index) * (right - left)


@lru_cache(maxsize=8)
def boiling(fluid: Fluid, water: Water) -> Boiling:
    """Return the distribution of the vapour point of *fluid* with *water*."""
    return Boiling(
        [_drawn(fluid, water, point) for point in unit_draws(DRAWS, 6)]
    )


def boiling_point_k(
    dry_k: float, wet_k: float, water_percent: float, slowness: float
) -> float:
    """Return T_b(w) of one fluid [K]; *slowness* is w_0 [%]."""
    share = exp(-WET_WATER_PERCENT / slowness)
    floor_k = (wet_k - dry_k * share) / -expm1(-WET_WATER_PERCENT / slowness)
    return floor_k + (dry_k - floor_k) * exp(-water_percent / slowness)


def _drawn(fluid: Fluid, water: Water, shares: tuple[float, ...]) -> float:
    """Return one vapour lock point; *shares* are its place in each range."""
    by_water, by_dry, by_wet, by_slowness, by_beyond, by_lock = shares
    percent = water.at(_STANDARD.inv_cdf(by_water))
    minima = BOILING_POINTS[fluid.grade]
    if fluid.dry_k is None:
        mean, deviation = DRY_EXCESS_K
        excess_k = mean + deviation * _STANDARD.inv_cdf(by_dry)
        dry_k = minima.dry_k + max(excess_k, 0.0)
    else:
        dry_k = fluid.dry_k + KNOWN_CAN_K * _STANDARD.inv_cdf(by_dry)
    if fluid.wet_k is None:
        upper = _STANDARD.inv_cdf(0.5 + 0.5 * by_wet)
        wet_k = minima.wet_k + WET_EXCESS_K * upper
    else:
        wet_k = fluid.wet_k + KNOWN_CAN_K * _STANDARD.inv_cdf(by_wet)
    width = SLOWEST_PERCENT - FASTEST_PERCENT
    slowness = FASTEST_PERCENT + width * by_slowness
    point_k = boiling_point_k(dry_k, wet_k, percent, slowness)
    beyond = max(percent - BEYOND_PERCENT, 0.0)
    point_k -= BEYOND_K_PERCENT * by_beyond * beyond
    return max(point_k, WATER_K) - VAPOUR_LOCK_K * by_lock
