"""The fit of two readings, and the lag between them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.analysis.quality.channels import (
    at_times,
    common_times,
    difference_quotient,
    window_mean,
)
from bstm_daemon.analysis.quality.comparison import find_lag, fit_channels
from bstm_daemon.analysis.quality.recording import Series

TIME_S = np.arange(0.0, 120.0, 0.05)
DRIVE = 15.0 + 10.0 * np.sin(TIME_S / 9.0) + 3.0 * np.sin(TIME_S / 1.7)


@settings(max_examples=30, deadline=None)
@given(
    st.floats(0.2, 5.0),
    st.sampled_from([1.0, -1.0]),
    st.floats(-10.0, 10.0),
    st.integers(-20, 20),
)
def test_what_was_put_in_comes_out(
    size: float, sign: float, offset: float, steps: int
) -> None:
    late = np.interp(TIME_S - 0.05 * steps, TIME_S, DRIVE)
    scale = size * sign

    fit = fit_channels(DRIVE, scale * late + offset, 0.5)

    assert fit is not None
    assert fit.scale == pytest.approx(scale, rel=0.02)
    assert fit.offset == pytest.approx(offset, abs=0.5 * size)
    assert fit.lag_s == pytest.approx(0.05 * steps, abs=0.03)


def test_noise_is_between_the_bounds() -> None:
    """Noise of the reference alone does not make the scale wrong."""
    rng = np.random.default_rng(3)
    noisy = DRIVE + rng.normal(0.0, 3.0, len(DRIVE))

    fit = fit_channels(noisy, DRIVE, 0.5)

    assert fit is not None
    assert fit.scale == pytest.approx(0.92, abs=0.02)
    assert not fit.beyond(1.02)


def test_outliers_do_not_move_the_line() -> None:
    broken = 2.0 * DRIVE
    broken[::7] = 0.0

    fit = fit_channels(DRIVE, broken, 0.5)

    assert fit is not None
    assert fit.scale == pytest.approx(2.0, rel=0.02)
    assert fit.outliers == pytest.approx(1 / 7, abs=0.02)


@pytest.mark.parametrize("spin", [0.08, 0.3])
def test_spin_in_launches_is_no_scale(spin: float) -> None:
    """The line leans on it, half of the samples do not show it."""
    launch = np.arange(0.0, 30.0, 0.2)
    cruise = np.repeat([4.0, 6.0, 7.0, 5.0], 80)
    true = np.tile(np.concatenate((launch, cruise)), 4)
    spinning = np.tile(
        np.concatenate((np.full(len(launch), spin), np.zeros(len(cruise)))), 4
    )

    fit = fit_channels(true * (1.0 + spinning), true, 0.5)

    assert fit is not None
    assert fit.scale < 1 / 1.06
    assert fit.ratio == pytest.approx(1.0)
    assert fit.leans
    assert not fit.beyond(1.06)
    assert not fit.offset_beyond(0.6)


@pytest.mark.parametrize(("scale", "offset"), [(1.1, 0.0), (1.0, 2.0)])
def test_a_wrong_scale_or_offset_is_in_line_and_medians(
    scale: float, offset: float
) -> None:
    fit = fit_channels(DRIVE, scale * DRIVE + offset, 0.5)

    assert fit is not None
    assert fit.beyond(1.06) == (scale != 1.0)
    assert fit.scale == pytest.approx(scale)
    assert fit.difference > 0.6
    assert fit.offset_beyond(0.6) == (offset != 0.0)


def test_nothing_to_fit() -> None:
    constant = np.full(len(DRIVE), 3.0)
    absent = np.full(len(DRIVE), np.nan)

    assert fit_channels(DRIVE, constant, 0.5) is None
    assert fit_channels(DRIVE, absent, 0.5) is None
    assert find_lag(DRIVE, constant) is None


def test_long_log_keeps_its_lag() -> None:
    """Of hours, the busiest minutes tell the lag."""
    quiet = np.full(60_000, 15.0)
    drive = np.concatenate((quiet, DRIVE, quiet))
    late = np.roll(drive, 10)

    assert find_lag(drive, late) == pytest.approx(0.5, abs=0.03)


def test_values_do_not_reach_over_gaps() -> None:
    series = Series(np.array([0.0, 0.4, 2.0, 2.4]), np.array([0, 4, 20, 24.0]))

    value = at_times(series, np.array([-1.0, 0.2, 1.0, 2.2, 3.0]), 0.5)

    assert value[[1, 3]] == pytest.approx([2.0, 22.0])
    assert np.isnan(value[[0, 2, 4]]).all()


def test_grid_leaves_out_stray_stamps() -> None:
    """A stamp years away costs a few points, not memory."""
    stray = Series(np.array([0.0, 1.0, 1e9]), np.zeros(3))

    times = common_times([stray])

    assert len(times) < 400
    assert (np.diff(times) > 0.0).all()


def test_window_mean_is_the_counterpart_of_the_quotient() -> None:
    rate = np.cos(TIME_S)
    integral = np.concatenate(
        ([0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * 0.05))
    )

    known = slice(5, -5)
    assert window_mean(rate)[known] == pytest.approx(
        difference_quotient(integral)[known]
    )
