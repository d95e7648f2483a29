"""Brake fluids as published: the truth of the risk benchmark.

Boiling points of fluids as sold, curves over water, and surveys of the water
in cars, each row with its source. Nothing here is taken from
``bstm_daemon.model.risk``, whose assumptions are what the benchmark judges.

The surveys are of cars in temperate climates; no measurement by climate was
found, so every car here is configured as temperate. All boiling points are
equilibrium reflux boiling points but Keen's, which are vapour lock points: no
published difference between the two was found either.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from side_by_side import Table

from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

WATER_C: Final = 100.0
WET_PERCENT: Final = 3.7
"""Water [% by mass] of a humidified fluid: 49 CFR 571.116, S6.2."""

GRADES: Final = {"DOT3": 0.15, "DOT4": 0.65, "DOT5.1": 0.1, "CLASS6": 0.1}
"""Share of each grade; DOT 4 is the usual one (DEKRA 2000)."""

FMVSS: Final = "49 CFR 571.116, S5.1.1 and S5.1.2: the least that is allowed"
JERCO: Final = "Jerco, maker of testers, jercoproducts.com/fluid-testing"
LISTED: Final = "list of makers' figures, bullittarchive.com/5001.htm"
MISCO: Final = "MISCO, maker of testers, misco.com/when-to-change-your-brake"


class Can(NamedTuple):
    """Two boiling points [degC] of a fluid and the water [%] they are at."""

    grade: str
    dry_c: float
    wet_c: float
    source: str
    dry_percent: float = 0.0
    wet_percent: float = WET_PERCENT


CANS: Final = (
    Can("DOT3", 205.0, 140.0, FMVSS),
    Can("DOT3", 287.8, 143.3, "Ford Heavy Duty, aussiefrogs.com t/7868"),
    Can("DOT3", 274.0, 156.0, "AMSOIL Series 500, synthetic-solutions.com"),
    Can("DOT3", 257.2, 137.8, JERCO, wet_percent=5.0),
    Can("DOT3", 260.0, 140.0, "TUEV Sued, dpa 2017", 0.05, 3.0),
    Can("DOT4", 230.0, 155.0, FMVSS),
    Can("DOT4", 232.2, 155.0, f"Castrol LMA, {LISTED}"),
    Can("DOT4", 267.2, 167.2, f"Valvoline SynPower, {LISTED}"),
    Can("DOT4", 280.0, 200.0, f"ATE TYP 200, {LISTED}"),
    Can("DOT4", 290.0, 198.0, "Shell Donax UB, typical, lubricanthub.com"),
    Can("DOT4", 270.0, 170.0, "most widely sold, dixcel.co.jp literature"),
    Can("DOT4", 268.3, 165.6, JERCO, wet_percent=5.0),
    Can("DOT4", 232.2, 148.9, "typical, remaninc.com", wet_percent=3.0),
    Can("DOT4", 233.0, 140.0, "measured, KTU elaba:59919942", 0.28, 4.0),
    Can("DOT5.1", 260.0, 180.0, FMVSS),
    Can("DOT5.1", 270.0, 190.0, "as sold, brakeperformance.com"),
    Can("CLASS6", 250.0, 165.0, "ISO 4925, class 6: the least allowed"),
)


class Curve(NamedTuple):
    """Boiling points [degC] over water [%]; ``of`` are the grades it is of."""

    of: tuple[str, ...]
    points: tuple[tuple[float, float], ...]
    source: str


_BORATE: Final = ("DOT4", "DOT5.1", "CLASS6")
CURVES: Final = (
    Curve(
        ("DOT3", *_BORATE),
        ((0.0, 250.0), (1.0, 180.0), (3.0, 145.0), (8.0, 105.0)),
        "Keen, TRRL LR 903 (1979), to 3 %; at 8 % Shell's graph for DOT 3, "
        "'almost 100', epicbleedsolutions.com",
    ),
    Curve(
        ("DOT3",),
        ((0.0, 249.0), (1.0, 187.2), (2.0, 160.0), (3.0, 145.0), (5.0, 137.8)),
        "trade press on a typical DOT 3, forums.anandtech.com t/2177342, to "
        f"3 %; at 5 % {JERCO}",
    ),
    Curve(
        ("DOT3",),
        ((0.0, 251.7), (2.0, 180.0), (3.0, 160.0), (6.0, 117.8)),
        f"{MISCO}-fluid, DOT3; ends of the scale of its refractometer",
    ),
    Curve(
        _BORATE,
        ((0.0, 255.0), (2.0, 210.0), (3.0, 187.0), (5.0, 165.6)),
        f"{MISCO}-fluid, DOT4, to 3 %; at 5 % {JERCO}",
    ),
)


class Survey(NamedTuple):
    """Share of cars (second) with at most so much water [%] (first)."""

    points: tuple[tuple[float, float], ...]
    source: str


_MOST: Final = (8.0, 1.0)
_NEW: Final = (0.2, 0.0)
"""Most in a new can: Shell Donax UB, lubricanthub.com. 7 to 8 % is 'not
unusual after several years', forums.anandtech.com t/2177342."""

SURVEYS: Final = (
    Survey(
        (_NEW, (3.0, 0.5), (5.0, 0.8), _MOST),
        "Keen 1979: over half of 1000 cars 3 % or more; NHTSA: 20 % of 1720 "
        "vehicles 5 % or more",
    ),
    Survey(
        (_NEW, (1.5, 0.5), (4.0, 0.75), _MOST),
        "random US cars of 8 years on average: mean 2.6 %, a quarter above "
        "4 % (SAE, in misco.com and aussiefrogs.com); the median follows",
    ),
)

EVERY: Final = 1000
"""Fluids that the median of a grade is taken of."""

RATE_PERCENT: Final = (1.0, 2.0)
"""Uptake a year: Ryan (Leica), 'Determining Brake Fluid Quality by
Refractometer'; SAE: 2 % in the average car of one year. It ends at what the
surveys found: Keen saw no firm relation of water with age."""


MEASURED: Final = (
    (150.0, 0.07, "DEKRA 2003, 759 cars"),
    (155.0, 0.15, "DEKRA 2000, 500 cars"),
    (180.0, 0.33, "DEKRA 2003"),
    (181.0, 0.29, "Comma 2016, United Kingdom"),
    (200.0, 0.52, "Comma 2016"),
    (200.0, 0.65, "DEKRA 2000"),
)
"""Share of cars whose fluid boils below a temperature [degC]: autokiste.de,
a.htm?id=0290 and id=1939; aftermarketonline.net, aid 2975. It was taken from
the reservoir, where it boils at up to 100 K more than at the wheel (DEKRA).
They are no part of the truth and tell how far it may be off."""


@dataclass(frozen=True, slots=True)
class Published:
    """A fluid in a car: as sold, the form of its curve, and its water [%]."""

    can: Can
    curve: Curve
    water_percent: float

    @property
    def boiling_k(self) -> float:
        """Temperature at which it boils."""
        return self.at(self.water_percent)

    def at(self, percent: float) -> float:
        """Return where it would boil [K] with so much water.

        It has the form of the curve and passes through both points of the
        can, and never boils below water.
        """
        shape = _shape(self.curve.points)
        can = self.can
        dry, wet = shape(can.dry_percent), shape(can.wet_percent)
        share = (shape(percent) - wet) / (dry - wet)
        celsius = can.wet_c + (can.dry_c - can.wet_c) * share
        return KELVIN_OFFSET + max(celsius, WATER_C)

    def of_form(self, curve: Curve) -> Published:
        """Return the fluid between its own dry and wet point by *curve*."""
        own = Can(
            self.can.grade,
            self.at(0.0) - KELVIN_OFFSET,
            self.at(WET_PERCENT) - KELVIN_OFFSET,
            self.can.source,
        )
        return Published(own, curve, self.water_percent)


def drawn(
    rng: np.random.Generator, grade: str, age_years: float | None
) -> Published:
    """Return a fluid of *grade*, *age_years* in the car or at any age."""
    cans = [can for can in CANS if can.grade == grade]
    curves = [curve for curve in CURVES if grade in curve.of]
    can = cans[int(rng.integers(len(cans)))]
    curve = curves[int(rng.integers(len(curves)))]
    percent = _surveyed(rng)
    rate = float(rng.uniform(*RATE_PERCENT))
    if age_years is not None:
        percent = min(percent, _NEW[0] + rate * age_years)
    return Published(can, curve, percent)


@cache
def every_k(grade: str) -> npt.NDArray[np.float64]:
    """Return where many fluids of *grade* boil [K], of any age."""
    rng = np.random.default_rng(EVERY)
    return np.array([drawn(rng, grade, None).boiling_k for _ in range(EVERY)])


@cache
def median_k(grade: str) -> float:
    """Return the boiling point [K] of half of the fluids of *grade*."""
    return float(np.median(every_k(grade)))


def measured_table() -> Table:
    """Return the drawn DOT 4 fluids against boiling points in cars."""
    celsius = every_k("DOT4") - KELVIN_OFFSET
    return Table(
        "DOT 4 fluids of any age that boil below",
        ("degC", "drawn", "measured in reservoirs", "by"),
        tuple(
            (
                f"{limit:.0f}",
                f"{(celsius < limit).mean():.0%}",
                f"{share:.0%}",
                by,
            )
            for limit, share, by in MEASURED
        ),
    )


def _surveyed(rng: np.random.Generator) -> float:
    """Return the water [%] of a car of one of the surveys."""
    survey = SURVEYS[int(rng.integers(len(SURVEYS)))]
    percents, shares = zip(*survey.points, strict=True)
    return float(np.interp(rng.random(), shares, percents))


@cache
def _shape(points: tuple[tuple[float, float], ...]) -> Callable[..., float]:
    """Return the monotone curve through *points*, straight beyond them."""
    percents, celsius = np.array(points).T
    inside = PchipInterpolator(percents, celsius)
    slope = (celsius[-1] - celsius[-2]) / (percents[-1] - percents[-2])

    def at(percent: float) -> float:
        within = min(percent, percents[-1])
        return float(inside(within) + slope * (percent - within))

    return at
