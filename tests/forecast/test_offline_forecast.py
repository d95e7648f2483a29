"""The forecast of a saved state: the fluid it saved, now, and ahead."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimate import RiskLevel
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast.fluid import WATER_ROLE, FluidKnowledge
from bstm_daemon.forecast.march import HORIZON_S, parked_course
from bstm_daemon.forecast.members import Ensemble, Spread
from bstm_daemon.forecast.offline_forecast import Outlook, outlook
from bstm_daemon.model.risk.levels import level_of
from bstm_daemon.native.loader import load_kernel

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config

SAVED_US = 1_780_000_000_000_000  # 2026-05-28

pytestmark = pytest.mark.skipif(
    load_kernel() is None, reason="seconds a corner in pure Python"
)


def car(members: int = 8) -> Config:
    """Return the front left corner, in air of 10 degC, at 440 K."""
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    forecast = config.forecast.model_copy(update={"members": members})
    corners = [c for c in config.corner if c.name == "FL"]
    vehicle = config.vehicle.model_copy(update={"ambient_c": 166.85})
    return config.model_copy(
        update={"corner": corners, "forecast": forecast, "vehicle": vehicle}
    )


def saved_with(percent: float | None) -> dict[str, Any]:
    """Return a state file's document whose bus measured *percent*."""
    document: dict[str, Any] = {
        "wall_us": SAVED_US,
        "ambient_k": 283.15,
        "corners": {},
        "samples": {},
    }
    if percent is not None:
        knowledge = FluidKnowledge(car().fluid)
        knowledge.ingest(SAVED_US, WATER_ROLE, 0.01 * percent)
        document["risk"] = {"fluid": knowledge.export()}
    return document


def seen(percent: float | None, *, known: bool = True) -> Outlook:
    config = car()
    estimator = Estimator(config, {}, history_known=known)
    return outlook(config, estimator, saved_with(percent))


def test_an_outlook_has_the_fluid_that_was_saved() -> None:
    """Its water, its boiling points, and the probability by both."""
    config = car()
    estimator = Estimator(config, {}, history_known=True)
    found = outlook(config, estimator, saved_with(5.0))
    fluid = FluidKnowledge(config.fluid)
    fluid.ingest(SAVED_US, WATER_ROLE, 0.05)
    boiling = fluid.boiling(SAVED_US)
    (corner,) = found.corners

    assert (found.saved_us, found.ambient_k) == (SAVED_US, 283.15)
    assert found.water_percent == pytest.approx(5.0)
    assert found.boiling_k == {
        share: boiling.quantile(share) for share in (0.01, 0.5, 0.99)
    }
    assert found.members == 8

    # as warm as the air of the configuration, in the air that was saved
    assert corner.fluid_k == pytest.approx(440.0)
    state = list(estimator.state("FL").values())
    course = parked_course(
        Ensemble(estimator.programs["FL"], 8, Spread()),
        load_kernel(),
        state,
        283.15,
        factor=1.0,
    )
    now = [series[0] for series in course.fluid_k]
    risk = corner.risk
    assert risk.probability_now == boiling.mean_probability(now)
    assert risk.probability == boiling.mean_probability(
        course.peaks_k(HORIZON_S)
    )
    assert risk.probability >= risk.probability_now > 0.3
    assert risk.level is level_of(risk.probability)
    assert (risk.peak_k, risk.peak_in_s) == course.peak(HORIZON_S)
    assert risk.safe_in_s == course.safe_in_s(boiling, 0.01) > 600.0


def test_less_water_is_less_risk() -> None:
    """What the bus measured counts, not the fluid of unknown age."""
    risks = [seen(percent).corners[0].risk for percent in (0.5, None, 7.0)]

    probabilities = [risk.probability for risk in risks]
    assert probabilities == sorted(probabilities)
    assert probabilities[0] < 0.05
    assert probabilities[2] > probabilities[1] + 0.1 > 0.2


def test_what_nobody_matched_is_less_certain() -> None:
    """As in the live forecast."""
    config = car()
    unset = config.forecast.model_copy(update={"uncertainty": None})
    unmatched = config.model_copy(update={"forecast": unset})

    sure_k, open_k = (
        outlook(one, Estimator(one, {}, history_known=True), saved_with(5.0))
        .corners[0]
        .risk.fluid_deviation_k
        for one in (config, unmatched)
    )

    assert open_k == pytest.approx(6.0 * sure_k)
    assert sure_k > 4.0


def test_an_unknown_start_is_told_by_the_hot_bound() -> None:
    """Its temperature, and twice as uncertain."""
    known, unknown = seen(0.5), seen(0.5, known=False)

    cool, hot = known.corners[0], unknown.corners[0]
    assert (known.history_known, unknown.history_known) == (True, False)
    bound_k = Estimator(car(), {}).start.states()["FL"]["fluid"]
    assert hot.fluid_k == bound_k > cool.fluid_k + 50.0
    for corner, factor in ((cool, 1.0), (hot, 2.0)):
        share = (0.03**2 + 0.02**2) ** 0.5 * (corner.fluid_k - 283.15)
        assert corner.risk.fluid_deviation_k == pytest.approx(
            factor * (share**2 + 1.0) ** 0.5
        )
    assert cool.risk.level is RiskLevel.NORMAL
    assert hot.risk.level is RiskLevel.CRITICAL
