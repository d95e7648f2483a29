"""Errors by leaving out and by drawing anew: known ones come back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.statistics.resampling import (
    bootstrap,
    jackknife,
    leave_one_out,
)

if TYPE_CHECKING:
    from bstm_daemon.analysis.statistics.series import Column


def ratio(sums: Column) -> float:
    return float(sums[0] / sums[1])


def test_jackknife_of_a_mean_is_its_standard_error() -> None:
    """The textbook identity: variance over n, exactly."""
    values = np.array([1.0, 4.0, 2.0, 7.0, 3.0])
    means = leave_one_out(
        lambda rows: values[rows].mean(keepdims=True), np.arange(5)
    )

    assert jackknife(means)[0, 0] == pytest.approx(values.var(ddof=1) / 5)


def test_groups_that_err_alike_count_once() -> None:
    """Ten samples each of five stops are five numbers."""
    stops = np.array([1.0, 4.0, 2.0, 7.0, 3.0])
    values, groups = np.repeat(stops, 10), np.repeat(np.arange(5), 10)
    means = leave_one_out(
        lambda rows: values[rows].mean(keepdims=True), groups
    )

    assert jackknife(means)[0, 0] == pytest.approx(stops.var(ddof=1) / 5)


@pytest.mark.slow
def test_the_interval_covers() -> None:
    """Nine in ten of 200 samples of 60 blocks hold the true ratio of 2."""
    rng = np.random.default_rng(2)
    held = 0
    for seed in range(200):
        noise = rng.normal(0.0, 0.5, (60, 2))
        blocks = np.array([2.0, 1.0]) + noise
        lower, upper = bootstrap(blocks, ratio, draws=200, seed=seed)
        held += lower < 2.0 < upper

    assert 0.84 <= held / 200 <= 0.95
