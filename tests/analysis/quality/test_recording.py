"""Figures of one channel."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.analysis.quality.recording import (
    Series,
    bus_pauses,
    channel_statistics,
    constant_runs,
)

VALUES = st.lists(
    st.tuples(
        st.floats(0.001, 3.0, allow_nan=False),
        st.sampled_from([0.0, 0.5, 1.0, 7.0]),
    ),
    min_size=1,
    max_size=60,
)


def series_of(pairs: list[tuple[float, float]]) -> Series:
    steps, values = zip(*pairs, strict=True)
    return Series(np.cumsum(steps), np.array(values))


def test_figures_by_hand() -> None:
    series = Series(
        np.array([0.0, 0.1, 0.2, 1.2, 1.3]), np.array([1, 1, 2, 2, 2.5])
    )

    figures = channel_statistics(series, 2.0, 0.5)

    assert figures.samples == 5
    assert figures.rate_hz == pytest.approx(10.0)
    assert (figures.minimum, figures.maximum) == (1.0, 2.5)
    assert figures.longest_gap_s == pytest.approx(1.0)
    assert figures.gaps_over_timeout == 2
    assert figures.missing_share == pytest.approx((0.5 + 0.2) / 2.0)
    assert figures.constant_share == pytest.approx(0.4)
    assert figures.longest_run.length_s == pytest.approx(1.0)
    assert figures.longest_run.value == 2.0
    assert (figures.distinct, figures.step) == (3, 0.5)


def test_pause_of_the_bus_is_no_gap() -> None:
    time_s = np.concatenate((np.arange(0, 10, 0.1), np.arange(40, 50, 0.1)))
    series = Series(time_s, np.sin(time_s))

    alone = channel_statistics(series, 50.0, 0.5)
    with_pause = channel_statistics(series, 50.0, 0.5, [(9.9, 40.0)])

    assert alone.gaps_over_timeout == 1
    assert alone.missing_share == pytest.approx(29.6 / 50.0, abs=0.01)
    assert with_pause.gaps_over_timeout == 0
    assert with_pause.missing_share == 0.0


def test_pauses_need_most_of_the_bus() -> None:
    full = Series(np.arange(0, 50, 0.1), np.zeros(500))
    time_s = np.concatenate((np.arange(0, 10, 0.1), np.arange(40, 50, 0.1)))
    holed = Series(time_s, np.zeros(len(time_s)))

    assert bus_pauses([full, holed], 50.0) == []
    ((first_s, last_s),) = bus_pauses([full, holed, holed], 50.0)
    assert first_s == pytest.approx(9.9)
    assert last_s == pytest.approx(40.0)


@given(VALUES)
def test_runs_partition_the_samples(pairs: list[tuple[float, float]]) -> None:
    """Runs follow one another, are constant and differ from neighbours."""
    series = series_of(pairs)

    runs = constant_runs(series, 0.0)

    inside = [
        (series.time_s >= run.start_s) & (series.time_s <= run.end_s)
        for run in runs
    ]
    assert np.array_equal(np.sum(inside, axis=0), np.ones(len(series)))
    for run, here in zip(runs, inside, strict=True):
        assert set(series.value[here].tolist()) == {run.value}
    values = [run.value for run in runs]
    assert all(one != other for one, other in itertools.pairwise(values))


@given(VALUES, st.floats(0.01, 5.0), st.floats(0.0, 10.0))
def test_figures_keep_their_bounds(
    pairs: list[tuple[float, float]], timeout_s: float, rest_s: float
) -> None:
    series = series_of(pairs)
    duration_s = float(series.time_s[-1]) + rest_s

    figures = channel_statistics(series, duration_s, timeout_s)

    assert figures.minimum <= figures.median <= figures.maximum
    assert 0.0 <= figures.missing_share <= 1.0
    assert 1 / figures.samples <= figures.constant_share <= 1.0
    assert 0 <= figures.gaps_over_timeout <= figures.samples + 1
    assert 0.0 <= figures.longest_gap_s <= duration_s
    assert figures.longest_run == max(
        constant_runs(series, 0.0), key=lambda run: run.length_s
    )
    over = figures.longest_gap_s > timeout_s
    assert over == (figures.gaps_over_timeout > 0)
    assert over == (figures.missing_share > 0.0)
