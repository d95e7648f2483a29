"""Runs, means and white noise of one series."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.analysis.statistics.series import (
    block_means,
    running_mean,
    runs,
    white_std,
)


def test_runs_reach_both_ends() -> None:
    mask = np.array([1, 1, 0, 1, 0, 0, 1], bool)

    assert runs(mask) == [(0, 1), (3, 3), (6, 6)]
    assert runs(np.zeros(3, bool)) == []


def test_block_means_leave_out_the_rest() -> None:
    found = block_means(np.array([1.0, 3.0, np.nan, 1.0, 9.0]), 2)

    assert found == pytest.approx([2.0, np.nan], nan_ok=True)


def test_running_mean_leaves_out_what_is_not_there() -> None:
    mean, count = running_mean(np.array([1.0, np.nan, 4.0, 6.0]), 1)

    assert mean == pytest.approx([1.0, 2.5, 5.0, 5.0])
    assert count.tolist() == [1, 2, 2, 2]


@pytest.mark.parametrize("order", [1, 2])
def test_white_noise_beside_a_slope(order: int) -> None:
    rng = np.random.default_rng(4)
    series = 0.02 * np.arange(5000.0) + rng.normal(0.0, 0.7, 5000)

    found = white_std(np.diff(series, order), order)

    assert found == pytest.approx(0.7, rel=0.05)
