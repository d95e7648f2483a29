"""Seconds in, columns and bars out."""

from __future__ import annotations

from math import inf, isnan, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.watch.history import (
    ASCII_BARS,
    BARS,
    HISTORY_S,
    History,
    sparkline,
)

SECOND_US = 1_000_000


def filled(values: dict[int, float]) -> History:
    """Return a history with *values* by second."""
    history = History()
    for second, value in values.items():
        history.add(second * SECOND_US, value)
    return history


def test_the_last_column_ends_now() -> None:
    history = filled({0: 1.0, 299: 2.0})

    columns = history.columns(299 * SECOND_US, 5)

    assert columns[0] == 1.0
    assert columns[4] == 2.0
    assert all(isnan(value) for value in columns[1:4])


def test_a_column_is_the_largest_of_its_span() -> None:
    history = filled({second: float(second % 60) for second in range(300)})

    assert history.columns(299 * SECOND_US, 5) == [59.0] * 5


def test_a_second_keeps_its_largest() -> None:
    history = History()
    for value in (3.0, 9.0, 5.0):
        history.add(10, value)

    assert history.columns(10, 1) == [9.0]


def test_old_values_leave() -> None:
    history = filled({0: 900.0, 10: 5.0})

    assert history.columns(300 * SECOND_US, 1) == [5.0]
    assert isnan(history.columns(310 * SECOND_US, 1)[0])


def test_time_that_ran_back_begins_anew() -> None:
    history = filled({100: 900.0, 50: 5.0})

    assert history.columns(101 * SECOND_US, 1) == [5.0]


@pytest.mark.parametrize("value", [nan, inf])
def test_what_is_no_number_leaves_a_gap(value: float) -> None:
    history = filled({0: 7.0, 1: value, 2: 8.0})
    columns = history.columns(2 * SECOND_US, HISTORY_S)

    assert columns[-3] == 7.0
    assert isnan(columns[-2])


@given(
    values=st.dictionaries(
        st.integers(0, 1000), st.floats(-60, 2000), min_size=1
    ),
    count=st.integers(1, 400),
)
def test_no_peak_gets_lost(values: dict[int, float], count: int) -> None:
    ordered = dict(sorted(values.items()))
    now = max(ordered)
    recent = [v for t, v in ordered.items() if now - t < HISTORY_S]

    columns = filled(ordered).columns(now * SECOND_US, count)

    assert len(columns) == count
    assert max(v for v in columns if not isnan(v)) == max(recent)


def test_bars() -> None:
    assert sparkline([0.0, 50.0, nan, 100.0]) == "▁▅ █"
    assert sparkline([0.0, 50.0, nan, 100.0], ASCII_BARS) == "_= #".replace(
        "=", ASCII_BARS[4]
    )


def test_noise_is_not_blown_up() -> None:
    assert sparkline([20.0, 20.5, 21.0]) == "▁▁▁"


def test_nothing_is_blank() -> None:
    assert sparkline([nan] * 3) == "   "


@given(st.lists(st.floats(-400, 2000) | st.sampled_from([nan, inf, -inf])))
def test_any_values_have_a_bar_each(values: list[float]) -> None:
    line = sparkline(values)

    assert len(line) == len(values)
    assert set(line) <= {*BARS, " "}
