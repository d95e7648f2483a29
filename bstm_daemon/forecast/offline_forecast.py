"""Forecast of a saved state in one call, for a workshop."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from bstm_daemon.estimate import CornerRisk
from bstm_daemon.estimator.memory import SavedState, checked
from bstm_daemon.forecast.course_risk import PYTHON_MEMBERS
from bstm_daemon.forecast.fluid import FluidKnowledge
from bstm_daemon.forecast.march import HORIZON_S, parked_course
from bstm_daemon.forecast.members import DEGRADED_FACTOR, Ensemble, Spread
from bstm_daemon.forecast.monitor import SavedRisk
from bstm_daemon.model.risk.levels import PROBABILITIES, level_of
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimator.estimator import Estimator

SHARES: Final = (0.01, 0.5, 0.99)
"""Quantiles of the boiling point that are reported."""


class CornerOutlook(NamedTuple):
    """Forecast of a corner if the car stays parked from the save on.

    Of the hot bound where the start is unknown. ``risk`` has no duty and no
    level of fade.
    """

    corner: str
    fluid_k: float
    risk: CornerRisk


@dataclass(frozen=True, slots=True)
class Outlook:
    """Forecast of all corners from a saved state.

    ``saved_us`` is its wall time [us since 1970], None where it has none;
    ``boiling_k`` are quantiles, by their share. The levels are those that
    the probabilities give, without memory.
    """

    saved_us: int | None
    history_known: bool
    ambient_k: float
    water_percent: float
    boiling_k: dict[float, float]
    members: int
    corners: tuple[CornerOutlook, ...]


def outlook(
    config: Config, estimator: Estimator, document: Mapping[str, Any]
) -> Outlook:
    """Return the forecast of the parked brakes of *estimator*.

    *document* is the state file's that they were restored from.
    """
    known = estimator.history_known
    fluid = FluidKnowledge(config.fluid)
    reported = SavedRisk.of(document).fluid
    if reported is not None:
        fluid.resume(reported)
    saved = checked(SavedState, document)
    boiling = fluid.boiling(saved.wall_us or 0)
    air_k = saved.ambient_k
    if air_k is None:
        air_k = config.vehicle.ambient_c + KELVIN_OFFSET
    kernel = estimator.kernel
    members = config.forecast.members if kernel else PYTHON_MEMBERS
    factor = 1.0 if known else DEGRADED_FACTOR
    bounds = estimator.start.states()
    corners = []
    for name in (c.name for c in config.disc_corners()):
        spread = Spread().scaled(config.uncertainty_of(name))
        ensemble = Ensemble(estimator.programs[name], members, spread)
        state = bounds.get(name) or estimator.state(name)
        course = parked_course(
            ensemble, kernel, list(state.values()), air_k, factor
        )
        probability = boiling.mean_probability(course.peaks_k(HORIZON_S))
        peak_k, peak_in_s = course.peak(HORIZON_S)
        risk = CornerRisk(
            probability=probability,
            probability_now=course.probability(0, boiling),
            level=level_of(probability),
            fluid_deviation_k=ensemble.fluid_deviation_k(
                state["fluid"], air_k, factor
            ),
            peak_k=peak_k,
            peak_in_s=peak_in_s,
            safe_in_s=course.safe_in_s(boiling, PROBABILITIES[0]),
        )
        corners.append(CornerOutlook(name, state["fluid"], risk))
    return Outlook(
        saved.wall_us,
        known,
        air_k,
        fluid.water.median_percent,
        {share: boiling.quantile(share) for share in SHARES},
        members,
        tuple(corners),
    )
