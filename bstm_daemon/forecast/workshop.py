"""The forecast of a saved state, all at once: what a workshop asks for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.forecast.fluid import FluidKnowledge
from bstm_daemon.forecast.march import (
    HORIZON_S,
    PARKED_STEPS,
    Conditions,
    Job,
)
from bstm_daemon.forecast.members import DEGRADED_FACTOR, Ensemble, Spread
from bstm_daemon.forecast.monitor import PYTHON_MEMBERS
from bstm_daemon.forecast.resuming import saved_ambient_k
from bstm_daemon.heat.sample_plan import CHANNELS
from bstm_daemon.native import load_kernel
from bstm_daemon.risk.levels import PROBABILITIES, Level, published_level

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config import Config
    from bstm_daemon.estimator import Estimator

SHARES: Final = (0.01, 0.5, 0.99)
"""Quantiles of the boiling point that are told."""


@dataclass(frozen=True, slots=True)
class CornerOutlook:
    """A corner if the car stays parked from the save on; K and s.

    ``probability`` is that of vapour within the horizon, ``safe_in_s`` the
    time until it stays unlikely, infinite where that is out of sight.
    """

    corner: str
    fluid_k: float
    deviation_k: float
    probability_now: float
    probability: float
    level: Level
    peak_k: float
    peak_in_s: float
    safe_in_s: float


@dataclass(frozen=True, slots=True)
class Outlook:
    """What follows from a saved state.

    ``saved_us`` is its wall time [us since 1970], None where it has none;
    ``boiling_k`` are the quantiles :data:`SHARES`. The levels are those that
    the probabilities give, without memory.
    """

    saved_us: int | None
    history_known: bool
    ambient_k: float
    water_percent: float
    boiling_k: tuple[float, ...]
    members: int
    corners: tuple[CornerOutlook, ...]


def outlook(
    config: Config, estimator: Estimator, document: Mapping[str, Any]
) -> Outlook:
    """Return what the brakes of *estimator* will do, parked.

    *document* is the state file's that they were restored from.
    """
    known = estimator.history_known
    fluid = FluidKnowledge(config.fluid)
    risk = document.get("risk")
    heard = risk.get("fluid") if isinstance(risk, dict) else None
    if isinstance(heard, dict):
        fluid.resume(heard)
    saved_us = document.get("wall_us")
    saved_us = saved_us if isinstance(saved_us, int) else None
    boiling = fluid.boiling(saved_us or 0)
    air_k = saved_ambient_k(document, estimator)
    kernel = load_kernel()
    members = config.forecast.members if kernel else PYTHON_MEMBERS
    spread = Spread().scaled(config.forecast.uncertainty)
    factor = 1.0 if known else DEGRADED_FACTOR
    corners = []
    for name in (c.name for c in config.disc_corners()):
        ensemble = Ensemble(estimator.programs[name], members, spread)
        state = estimator.state(name)
        job = Job(
            ensemble,
            kernel,
            list(state.values()),
            Conditions(air_k),
            PARKED_STEPS,
            channels=CHANNELS,
            factor=factor,
        )
        job.advance(len(PARKED_STEPS))
        course = job.course()
        peaks = course.peaks_k(HORIZON_S)
        probability = sum(map(boiling.probability, peaks)) / members
        peak_k, peak_in_s = course.peak(HORIZON_S)
        reached = Level(sum(probability >= p for p in PROBABILITIES))
        corners.append(
            CornerOutlook(
                name,
                state["fluid"],
                ensemble.fluid_deviation_k(state["fluid"], air_k, factor),
                course.probability(0, boiling),
                probability,
                published_level(reached, usable=True, history_known=known),
                peak_k,
                peak_in_s,
                course.safe_in_s(boiling, PROBABILITIES[0]),
            )
        )
    return Outlook(
        saved_us,
        known,
        air_k,
        fluid.water.median_percent,
        tuple(boiling.quantile(share) for share in SHARES),
        members,
        tuple(corners),
    )
