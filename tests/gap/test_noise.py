"""The noise of a node, never white."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.gap.noise import USUAL, NodeNoise, noise_of
from bstm_daemon.shipped import shipped_file

if TYPE_CHECKING:
    from bstm_daemon.config import Config


def told_of(**known: float) -> tuple[Config, Config]:
    """Return the example car, and the same with *known* in [accuracy]."""
    config = load_vehicle(shipped_file("config/example_vehicle.toml"))[0]
    accuracy = config.accuracy.model_copy(update=known)
    return config, config.model_copy(update={"accuracy": accuracy})


def test_whitened_draws_are_white() -> None:
    noise = NodeNoise(1.0, 3.0, 0.02, 2.0)
    time_s = np.arange(0.0, 600.0, 20.0)
    slope, rise = np.sin(time_s / 90.0), 100.0 + 0.0 * time_s
    lower = np.linalg.cholesky(noise.covariance(time_s, slope, rise))
    draws = lower @ np.random.default_rng(1).standard_normal((30, 4000))

    white = noise.whitener(time_s, slope, rise) @ draws

    assert np.cov(white) == pytest.approx(np.eye(30), abs=0.12)


def test_a_running_mean_is_less_noisy() -> None:
    assert USUAL["disc"].smoothed(4).white_k == 0.5 * USUAL["disc"].white_k
    assert USUAL["disc"].smoothed(4).floor_k == USUAL["disc"].floor_k


def test_accuracy_of_the_match_is_taken() -> None:
    _, matched = told_of(disc_k=4.0, disc_share=0.03, fluid_k=25.0)

    assert noise_of(matched, "disc").floor_k == 4.0
    assert noise_of(matched, "disc").share == 0.03
    assert noise_of(matched, "fluid").floor_k == 2.0 * USUAL["fluid"].floor_k


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


def test_at_a_peak_what_is_late_is_wrong() -> None:
    """The mean slope is 0 there; a model a second late errs all the same."""
    noise = NodeNoise(0.5, 0.0, 0.0, 0.0, lag_s=0.0, quick_s=2.0)
    time_s = np.arange(0.0, 200.0, 20.0)
    rise = 100.0 + 4.0 * np.minimum(time_s, 160.0 - time_s)
    late = np.random.default_rng(3).normal(0.0, 2.0, (4000, len(time_s)))
    peak = 100.0 + 4.0 * np.minimum(time_s - late, 160.0 - time_s + late)

    told = noise.covariance(time_s, np.gradient(rise, time_s), rise)

    seen = np.mean((peak - rise) ** 2, axis=0) + 0.5**2
    assert np.diag(told) == pytest.approx(seen, rel=0.15)


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
