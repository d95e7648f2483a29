"""The noise model: its covariance, and what it learns of residuals."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.matching.noise import FIRST, Noise, learned

TIME_S = np.arange(0.0, 2000.0, 10.0)


def residuals(
    noise: Noise, seed: int, slope: np.ndarray | None = None
) -> np.ndarray:
    """Draw residuals with the covariance that the noise claims."""
    slope = np.zeros(len(TIME_S)) if slope is None else slope
    whitener = noise.whitener(TIME_S, slope)
    rng = np.random.default_rng(seed)
    return np.linalg.solve(whitener, rng.standard_normal(len(TIME_S)))


def test_whitened_residuals_are_white() -> None:
    noise = Noise(1.0, 4.0, 2.0)
    slope = np.sin(TIME_S / 200.0)
    whitener = noise.whitener(TIME_S, slope)
    apart = np.abs(np.subtract.outer(TIME_S, TIME_S))
    covariance = (
        np.eye(len(TIME_S)) * 1.0
        + 16.0 * np.exp(-apart / 300.0)
        + 4.0
        + noise.lag_s**2 * np.outer(slope, slope)
        + np.diag((noise.quick_s * slope) ** 2)
    )

    white = whitener @ covariance @ whitener.T

    assert white == pytest.approx(np.eye(len(TIME_S)), abs=1e-8)


def test_an_offset_costs_no_more_than_one_number() -> None:
    """It is marginalised: a constant error is one degree of freedom."""
    noise = Noise(1.0, 0.1, 50.0)
    whitener = noise.whitener(TIME_S, np.zeros(len(TIME_S)))
    constant = whitener @ np.full(len(TIME_S), 10.0)
    growing = whitener @ np.linspace(-10.0, 10.0, len(TIME_S))

    assert float(constant @ constant) < 1.0
    assert float(growing @ growing) > 100.0


def test_white_noise_and_drift_are_learned_apart() -> None:
    drawn = [residuals(Noise(1.0, 2.0, 0.01), seed) for seed in range(12)]

    found = learned(FIRST["fluid"], drawn, [TIME_S] * 12)

    assert found.white_k == pytest.approx(1.0, rel=0.25)
    assert found.drift_k == pytest.approx(2.0, rel=0.25)


def test_a_node_that_the_model_misses_is_still_believed() -> None:
    """Else it would be missed the more from round to round."""
    wrong = [np.full(len(TIME_S), 80.0)]

    found = learned(FIRST["disc"], wrong, [TIME_S])

    assert found.drift_k <= 1.5 * FIRST["disc"].drift_k
