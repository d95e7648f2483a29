"""Noise of recordings is found where it is larger than usual."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.gap.calibration import calibrated, scaled
from bstm_daemon.gap.layout import Layout, Series
from bstm_daemon.gap.noise import USUAL, NodeNoise
from bstm_daemon.gap.signatures import Sensed

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


def seen(noise: NodeNoise, hidden: float = 0.0) -> tuple[Layout, Sensed]:
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
    return layout, sensed


@pytest.mark.parametrize(("slow", "fast"), [(2.8, 1.0), (1.0, 2.8)])
def test_larger_noise_is_found(slow: float, fast: float) -> None:
    usual = USUAL["fluid"]

    found = calibrated(*seen(scaled(usual, slow, fast)))["fluid"]

    assert found.floor_k / usual.floor_k == pytest.approx(slow, rel=0.5)
    assert found.white_k / usual.white_k == pytest.approx(fast, rel=0.5)


def test_it_never_falls_below_the_usual() -> None:
    usual = USUAL["fluid"]

    found = calibrated(*seen(scaled(usual, 0.3, 0.3)))

    assert found["fluid"] == usual
    assert found["disc"] == USUAL["disc"]


def test_what_an_effect_explains_is_no_noise() -> None:
    usual = USUAL["fluid"]

    found = calibrated(*seen(usual, hidden=2.0))["fluid"]

    assert found == replace(usual)
