"""Brake fluids of the benchmark, and scores of what is told of them.

Fluids are drawn from the distribution that the daemon assumes (its
parameters are taken, the draws are not): what the benchmark tests is what
the daemon makes of temperatures, not whether real fluids hold that water.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.model.risk.boiling import BOILING_POINTS
from bstm_daemon.model.risk.vaporisation import (
    BEYOND_K_PERCENT,
    BEYOND_PERCENT,
    DRY_EXCESS_K,
    FASTEST_PERCENT,
    SLOWEST_PERCENT,
    VAPOUR_LOCK_K,
    WET_EXCESS_K,
    Boiling,
    Fluid,
    boiling,
    boiling_point_k,
)
from bstm_daemon.model.risk.water import Water, water_measured, water_of_age

if TYPE_CHECKING:
    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

GRADES: Final = {"DOT3": 0.15, "DOT4": 0.65, "DOT5.1": 0.1, "CLASS6": 0.1}
CLIMATES: Final = ("dry", "temperate", "humid")
AGE_KNOWN: Final = 0.6
"""Share of the cars whose last change of fluid is known."""

WATER_GIVEN: Final = 0.05
"""Relative deviation of a water content that is given."""

MISSED: Final = 0.01


@dataclass(frozen=True, slots=True)
class DrawnFluid:
    """A fluid: when it boils, and what is known of that.

    ``unknown`` is the daemon's distribution by age and climate, ``given``
    that with water measured and the can's boiling points known. The others
    are the fluid's true ones.
    """

    boiling_k: float
    unknown: Boiling
    given: Boiling
    dry_k: float
    wet_k: float
    water_percent: float


def draw_fluid(rng: np.random.Generator) -> DrawnFluid:
    """Return a fluid of a random car."""
    grade = str(rng.choice(list(GRADES), p=list(GRADES.values())))
    climate = str(rng.choice(CLIMATES))
    # to a quarter of a year: distributions are cached by what is known
    age = round(rng.uniform(0.0, 6.0) * 4.0) / 4.0
    water = water_of_age(age if rng.random() < AGE_KNOWN else None, climate)
    percent = water.at(rng.standard_normal())
    minima = BOILING_POINTS[grade]
    mean, deviation = DRY_EXCESS_K
    excess_k = mean + deviation * rng.standard_normal()
    dry_k = minima.dry_k + max(excess_k, 0.0)
    wet_k = minima.wet_k + WET_EXCESS_K * abs(rng.standard_normal())
    slowness = rng.uniform(FASTEST_PERCENT, SLOWEST_PERCENT)
    point_k = boiling_point_k(dry_k, wet_k, percent, slowness)
    beyond = max(percent - BEYOND_PERCENT, 0.0)
    point_k -= BEYOND_K_PERCENT * rng.random() * beyond
    point_k -= rng.uniform(*VAPOUR_LOCK_K)
    told = percent * (1.0 + WATER_GIVEN * rng.standard_normal())
    measured = water_measured(told, WATER_GIVEN, climate)
    return DrawnFluid(
        point_k,
        boiling(Fluid(grade), Water(*water)),
        boiling(Fluid(grade, dry_k, wet_k), measured),
        dry_k,
        wet_k,
        percent,
    )


def left_open_k(fluid: DrawnFluid) -> dict[str, float]:
    """Return what leaves the boiling point open though the water is given.

    Standard deviations [K], one a cause.
    """
    dry_k, wet_k, percent = fluid.dry_k, fluid.wet_k, fluid.water_percent
    forms = [
        boiling_point_k(dry_k, wet_k, percent, slowness)
        for slowness in np.linspace(FASTEST_PERCENT, SLOWEST_PERCENT, 11)
    ]
    middle = 0.5 * (FASTEST_PERCENT + SLOWEST_PERCENT)
    drier, wetter = (
        boiling_point_k(dry_k, wet_k, percent * (1.0 + error), middle)
        for error in (-WATER_GIVEN, WATER_GIVEN)
    )
    beyond = max(percent - BEYOND_PERCENT, 0.0)
    low, high = VAPOUR_LOCK_K
    return {
        "water, 5 %": 0.5 * (drier - wetter),
        "form of the curve, w_0": float(np.std(forms)),
        "fall above 4 % of water": BEYOND_K_PERCENT * beyond / sqrt(12.0),
        "vapour lock below the boiling point": (high - low) / sqrt(12.0),
    }


def auc(scores: Column, boiled: npt.NDArray[np.bool_]) -> float:
    """Return the area under the ROC curve; ties count half."""
    order = np.argsort(scores, kind="stable")
    ranks = np.empty(len(scores))
    ranks[order] = np.arange(1, len(scores) + 1)
    for value in np.unique(scores):
        same = scores == value
        ranks[same] = ranks[same].mean()
    positives = int(boiled.sum())
    negatives = len(boiled) - positives
    total = ranks[boiled].sum() - positives * (positives + 1) / 2
    return float(total / (positives * negatives))


def false_share(scores: Column, boiled: npt.NDArray[np.bool_]) -> float:
    """Return the share of safe cases warned of where 1 % are missed."""
    hit = np.sort(scores[boiled])
    limit = hit[int(MISSED * len(hit))]
    return float((scores[~boiled] >= limit).mean())


def calibration_error(
    scores: Column, boiled: npt.NDArray[np.bool_], bins: int = 10
) -> float:
    """Return the expected calibration error over equal bins."""
    place = np.minimum((scores * bins).astype(int), bins - 1)
    error = 0.0
    for number in range(bins):
        own = place == number
        if own.any():
            gap = abs(boiled[own].mean() - scores[own].mean())
            error += own.mean() * gap
    return float(error)
