"""Brake fluids of the benchmark, what is known of them, and scores.

What a fluid is comes from published figures (``risk_published``); what is
known of it is told to the daemon, which makes its own distribution of that.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from risk_published import CURVES, GRADES, WET_PERCENT, Published, drawn

from bstm_daemon.model.risk.vaporisation import Boiling, Fluid, boiling
from bstm_daemon.model.risk.water import water_measured, water_of_age

if TYPE_CHECKING:
    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

CLIMATE: Final = "temperate"
"""That of the surveys."""

AGE_KNOWN: Final = 0.6
"""Share of the cars whose last change of fluid is known."""

WATER_GIVEN: Final = 0.05
"""Relative deviation of a water content that is given."""

MISSED: Final = 0.01


@dataclass(frozen=True, slots=True)
class DrawnFluid:
    """A fluid and what the daemon makes of what is known of it.

    ``unknown`` is the daemon's distribution by grade and age, ``given`` that
    with water measured and the can's boiling points known.
    """

    true: Published
    unknown: Boiling
    given: Boiling

    @property
    def boiling_k(self) -> float:
        """Temperature at which it boils."""
        return self.true.boiling_k


def draw_fluid(rng: np.random.Generator) -> DrawnFluid:
    """Return a fluid of a random car."""
    grade = str(rng.choice(list(GRADES), p=list(GRADES.values())))
    # to a quarter of a year: distributions are cached by what is known
    age = round(rng.uniform(0.0, 6.0) * 4.0) / 4.0
    known = age if rng.random() < AGE_KNOWN else None
    true = drawn(rng, grade, known)
    told = true.water_percent * (1.0 + WATER_GIVEN * rng.standard_normal())
    can = Fluid(grade, true.at(0.0), true.at(WET_PERCENT))
    return DrawnFluid(
        true,
        boiling(Fluid(grade), water_of_age(known, CLIMATE)),
        boiling(can, water_measured(told, WATER_GIVEN, CLIMATE)),
    )


def left_open_k(fluid: DrawnFluid) -> dict[str, float]:
    """Return what leaves the boiling point open though the water is given.

    Standard deviations [K], one a cause.
    """
    true = fluid.true
    drier, wetter = (
        true.at(true.water_percent * (1.0 + error))
        for error in (-WATER_GIVEN, WATER_GIVEN)
    )
    forms = [
        true.of_form(curve).boiling_k
        for curve in CURVES
        if true.can.grade in curve.of
    ]
    return {
        "water, 5 %": 0.5 * (drier - wetter),
        "which published curve it follows": float(np.std(forms)),
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
