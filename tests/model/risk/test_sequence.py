"""Draws that are the same everywhere."""

from statistics import fmean, stdev

import pytest

from bstm_daemon.model.risk.sequence import normal_draws, unit_draws


@pytest.mark.parametrize("dimensions", [1, 3, 11])
def test_points_fill_every_axis(dimensions: int) -> None:
    """Of 64 points, each eighth of an axis holds about 8."""
    points = unit_draws(64, dimensions)

    for axis in range(dimensions):
        for eighth in range(8):
            held = sum(int(p[axis] * 8) == eighth for p in points)
            assert 4 <= held <= 12


@pytest.mark.parametrize("count", [8, 64, 65])
def test_normal_draws_have_mean_0_and_deviation_1(count: int) -> None:
    points = normal_draws(count, 11)

    assert len(points) == count
    for axis in zip(*points, strict=True):
        assert fmean(axis) == pytest.approx(0.0, abs=1e-12)
        if count >= 64:
            assert stdev(axis) == pytest.approx(1.0, abs=0.2)


def test_axes_are_not_alike() -> None:
    """Two axes that went together would double one uncertainty."""
    points = normal_draws(64, 11)
    axes = list(zip(*points, strict=True))

    for i, one in enumerate(axes):
        for other in axes[:i]:
            product = fmean(a * b for a, b in zip(one, other, strict=True))
            assert abs(product) < 0.45
