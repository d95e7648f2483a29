"""The noise of a node: from [accuracy], and larger where recordings say so."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.gap.noise import (
    USUAL,
    Layout,
    calibrated,
    noise_of,
)
from bstm_daemon.analysis.gap.signatures import Sensed
from bstm_daemon.analysis.matching.problem import Series
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.estimates import MatchedConfig
from bstm_daemon.files import shipped_file

if TYPE_CHECKING:
    from bstm_daemon.analysis.statistics.whitening import SensorNoise
    from bstm_daemon.config.sections import Config

POINTS = 300
TIME_S = 10.0 * np.arange(POINTS)
RISE_K = 60.0 * np.sin(TIME_S / 500.0) ** 2
SERIES = tuple(
    Series(
        drive,
        "fluid",
        (("FL", "fluid"),),
        np.arange(POINTS),
        TIME_S,
        290.0 + RISE_K,
        np.gradient(RISE_K, TIME_S),
        RISE_K,
    )
    for drive in range(3)
)


def told_of(**known: float) -> tuple[Config, Config]:
    """Return the example car, and the same with *known* in [accuracy]."""
    config = load_vehicle(shipped_file("config/example_vehicle.toml"))[0]
    accuracy = config.accuracy.model_copy(update=known)
    return config, config.model_copy(update={"accuracy": accuracy})


def test_a_running_mean_of_four_is_less_noisy() -> None:
    assert (
        USUAL["disc"].scaled(1.0, 0.5).white_k == 0.5 * USUAL["disc"].white_k
    )
    assert USUAL["disc"].scaled(1.0, 0.5).drift_k == USUAL["disc"].drift_k


def test_accuracy_of_the_match_is_taken() -> None:
    _, matched = told_of(disc_k=4.0, disc_share=0.03, fluid_k=25.0)

    assert noise_of(matched, "disc").drift_k == 4.0
    assert noise_of(matched, "disc").share == 0.03
    assert noise_of(matched, "fluid").drift_k == 2.0 * USUAL["fluid"].drift_k


def test_drift_is_what_the_match_left_and_at_least_the_usual(
    config: Config,
) -> None:
    """What a fit leaves on its own drives says little of others."""
    form = MatchedConfig(
        corners=["FL"],
        names=[],
        values=[],
        factor=[],
        form_k={"disc": 30.0, "fluid": 0.1},
        form_share={"disc": 0.001, "fluid": 0.03},
    )

    disc, fluid = (noise_of(config, one, form) for one in ("disc", "fluid"))

    assert (disc.drift_k, disc.share) == (30.0, USUAL["disc"].share)
    assert (fluid.drift_k, fluid.share) == (USUAL["fluid"].drift_k, 0.03)
    other = noise_of(config, "pad_back", form)
    assert other == noise_of(config, "pad_back")


def test_offsets_of_the_junctions_add_to_the_models() -> None:
    """Of readings that have them, the covariance is right."""
    config, sheet = told_of(thermocouple_offset_k=3.0)
    usual, told = noise_of(config, "fluid"), noise_of(sheet, "fluid")
    time_s = np.arange(0.0, 300.0, 20.0)
    still = np.zeros_like(time_s)
    chance = np.random.default_rng(2)
    lower = np.linalg.cholesky(usual.covariance(time_s, still, still))
    draws = lower @ chance.standard_normal((len(time_s), 4000))
    draws += 3.0 * chance.standard_normal(4000)

    white = told.whitener(time_s, still, still) @ draws

    assert np.cov(white) == pytest.approx(np.eye(len(time_s)), abs=0.12)


def test_drift_of_the_junctions_beyond_the_usual_adds_to_the_models() -> None:
    """Of readings that have it, the covariance is right."""
    config, sheet = told_of(thermocouple_drift_k=3.0)
    usual, told = noise_of(config, "fluid"), noise_of(sheet, "fluid")
    time_s = np.arange(0.0, 600.0, 20.0)
    still = np.zeros_like(time_s)
    chance = np.random.default_rng(5)
    apart_s = np.abs(np.subtract.outer(time_s, time_s))
    drift = (3.0**2 - 1.0**2) * np.exp(-apart_s / 300.0)
    lower = np.linalg.cholesky(usual.covariance(time_s, still, still) + drift)
    draws = lower @ chance.standard_normal((len(time_s), 4000))

    white = told.whitener(time_s, still, still) @ draws

    assert np.cov(white) == pytest.approx(np.eye(len(time_s)), abs=0.12)


def test_a_drift_that_is_usual_changes_nothing() -> None:
    config, sheet = told_of(thermocouple_drift_k=1.0)

    assert noise_of(sheet, "disc") == noise_of(config, "disc")


def seen(
    noise: SensorNoise, hidden: float = 0.0
) -> tuple[Layout, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    parts = []
    for one in SERIES:
        covariance = noise.covariance(one.time_s, one.slope_k_s, one.rise_k)
        lower = np.linalg.cholesky(covariance)
        parts.append(lower @ rng.normal(0.0, 1.0, POINTS))
    effect = np.tile(0.2 * RISE_K, len(SERIES))
    base_k = np.concatenate(parts) - hidden * effect
    sensed = Sensed(
        base_k,
        np.zeros((len(base_k), 1)),
        {"effect": np.array((effect, 0.0 * effect))},
        (),
        (),
    )
    layout = Layout(SERIES, USUAL, np.ones(1), ("a", "b", "c"))
    return layout, sensed.base_k, sensed.columns_k()


@pytest.mark.parametrize(("slow", "fast"), [(2.8, 1.0), (1.0, 2.8)])
def test_larger_noise_is_found(slow: float, fast: float) -> None:
    usual = USUAL["fluid"]

    found = calibrated(*seen(usual.scaled(slow, fast)))["fluid"]

    assert found.drift_k / usual.drift_k == pytest.approx(slow, rel=0.5)
    assert found.white_k / usual.white_k == pytest.approx(fast, rel=0.5)


def test_it_never_falls_below_the_usual() -> None:
    usual = USUAL["fluid"]

    found = calibrated(*seen(usual.scaled(0.3, 0.3)))

    assert found["fluid"] == usual
    assert found["disc"] == USUAL["disc"]


def test_what_an_effect_explains_is_no_noise() -> None:
    usual = USUAL["fluid"]

    found = calibrated(*seen(usual, hidden=2.0))["fluid"]

    assert found == usual
