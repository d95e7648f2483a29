"""Noise models: whitened residuals are white, and what residuals show."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.analysis.statistics.gls import solution_operator
from bstm_daemon.analysis.statistics.whitening import (
    SensorNoise,
    likeliest_drift,
)

TIME_S = np.arange(0.0, 2000.0, 10.0)


def test_whitened_residuals_are_white() -> None:
    noise = SensorNoise(1.0, 4.0, 0.0, 2.0)
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
    noise = SensorNoise(1.0, 0.1, 0.0, 50.0)
    whitener = noise.whitener(TIME_S, np.zeros(len(TIME_S)))
    constant = whitener @ np.full(len(TIME_S), 10.0)
    growing = whitener @ np.linspace(-10.0, 10.0, len(TIME_S))

    assert float(constant @ constant) < 1.0
    assert float(growing @ growing) > 100.0


def test_draws_of_a_share_of_the_rise_are_whitened() -> None:
    noise = SensorNoise(1.0, 3.0, 0.02, 2.0)
    time_s = np.arange(0.0, 600.0, 20.0)
    slope, rise = np.sin(time_s / 90.0), 100.0 + 0.0 * time_s
    lower = np.linalg.cholesky(noise.covariance(time_s, slope, rise))
    draws = lower @ np.random.default_rng(1).standard_normal((30, 4000))

    white = noise.whitener(time_s, slope, rise) @ draws

    assert np.cov(white) == pytest.approx(np.eye(30), abs=0.12)


def test_at_a_peak_what_is_late_is_wrong() -> None:
    """The mean slope is 0 there; a model a second late errs all the same."""
    noise = SensorNoise(0.5, 0.0, 0.0, 0.0, lag_s=0.0, quick_s=2.0)
    time_s = np.arange(0.0, 200.0, 20.0)
    rise = 100.0 + 4.0 * np.minimum(time_s, 160.0 - time_s)
    late = np.random.default_rng(3).normal(0.0, 2.0, (4000, len(time_s)))
    peak = 100.0 + 4.0 * np.minimum(time_s - late, 160.0 - time_s + late)

    told = noise.covariance(time_s, np.gradient(rise, time_s), rise)

    seen = np.mean((peak - rise) ** 2, axis=0) + 0.5**2
    assert np.diag(told) == pytest.approx(seen, rel=0.15)


def test_noise_with_a_drift_is_recognised() -> None:
    """Noise of 1, drift of 3 over 100 s: the grid's own point."""
    rng = np.random.default_rng(1)
    lengths = [150] * 6
    parts = []
    for length in lengths:
        drift = [rng.normal(0, 3.0)]
        for _ in range(length - 1):
            keep = np.exp(-5.0 / 100.0)
            drift.append(
                drift[-1] * keep + rng.normal(0, 3.0 * np.sqrt(1 - keep**2))
            )
        parts.append(np.array(drift) + rng.normal(0, 1.0, length))
    left = np.concatenate(parts)
    design = np.ones((len(left), 1))

    noise, variance = likeliest_drift(lengths, 5.0, left, design)

    assert noise.drift_s == 100.0
    assert noise.ratio == pytest.approx(10.0)
    assert variance == pytest.approx(1.0, rel=0.25)
    # the mean of 900 points is worth some 50 of them
    operator = solution_operator(design)
    error = float(np.sqrt(variance * noise.covariance_of(operator)[0, 0]))
    assert error > 8.0 * np.std(left) / np.sqrt(len(left)) / 2.0
