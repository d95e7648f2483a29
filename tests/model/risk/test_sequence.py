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


def test_draws_of_one_axis_are_multiples_of_the_golden_ratio() -> None:
    """From the middle on, by 0.618..., and their normal deviates."""
    assert [point for (point,) in unit_draws(3, 1)] == pytest.approx(
        [0.11803398875, 0.7360679775, 0.35410196625]
    )
    below = -1.184872  # the deviate of 0.118034
    assert [point for (point,) in normal_draws(3, 1)] == pytest.approx(
        [below, -below, 0.0], abs=1e-6
    )


def test_draws_of_two_axes_go_by_the_plastic_number() -> None:
    """x^3 = x + 1 gives 1.3247; the axes advance by 1/x and 1/x^2."""
    first, second = unit_draws(2, 2)

    assert first == pytest.approx((0.25487766625, 0.06984029099))
    assert second == pytest.approx((0.00975533249, 0.63968058199))
