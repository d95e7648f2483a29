"""The minimiser on problems whose minimum is known."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.analysis.statistics.levenberg_marquardt import minimise


def valley(points: np.ndarray) -> np.ndarray:
    """Rosenbrock's valley: minimum 0 at (1, 1)."""
    x, y = points[:, 0], points[:, 1]
    return np.column_stack((1.0 - x, 5.0 * (y - x * x)))


def test_it_finds_the_end_of_a_bent_valley() -> None:
    wide = np.full(2, 9.0)

    found = minimise(valley, np.array([0.4, 0.6]), -wide, wide)

    assert found.x == pytest.approx([1.0, 1.0], abs=0.02)
    assert not found.at_bound.any()


def test_a_bound_that_the_cost_pushes_against_is_named() -> None:
    upper = np.array([0.5, 9.0])

    found = minimise(valley, np.array([0.2, 0.6]), -np.full(2, 9.0), upper)

    assert found.x == pytest.approx([0.5, 0.25], abs=0.01)
    assert found.at_bound.tolist() == [True, False]


def test_it_never_ends_worse_than_it_began() -> None:
    def rough(points: np.ndarray) -> np.ndarray:
        return 10.0 + np.sin(40.0 * points)

    wide = np.full(1, 2.0)
    for start in np.linspace(-1.5, 1.5, 13):
        before = 0.5 * float(np.sum(rough(np.array([[start]])) ** 2))
        found = minimise(rough, np.array([start]), -wide, wide)
        assert found.cost <= before


def test_a_point_that_is_no_number_is_not_taken() -> None:
    def broken(points: np.ndarray) -> np.ndarray:
        x = points[:, 0]
        return np.column_stack((np.where(x > 1.0, np.nan, x - 3.0),))

    found = minimise(
        broken, np.array([0.0]), np.full(1, -9.0), np.full(1, 9.0)
    )

    assert np.isfinite(found.cost)
