"""Rows in stretches, and the time since the first of them."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.replay.results import Collector, ElapsedTime, Results
from bstm_daemon.replay.results.rows import STRETCH_ROWS


@pytest.mark.parametrize("rows", [0, 1, STRETCH_ROWS, 2 * STRETCH_ROWS + 1])
def test_stretches_joined_are_the_whole(rows: int) -> None:
    results = Results({"time_s": np.arange(float(rows))}, ("FL",), ())
    collector = Collector()

    for stretch in results.stretches():
        assert len(stretch) <= STRETCH_ROWS
        collector.write(stretch)

    joined = collector.results()
    assert joined.corners == ("FL",)
    assert joined.columns["time_s"].tolist() == list(range(rows))


@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_elapsed_time_goes_on_over_stretches(rows: int) -> None:
    """To the bit, also over the edge of a stretch."""
    time_s = 1.7e9 + np.cumsum(np.random.default_rng(2).random(1000))
    whole, parts = ElapsedTime(), ElapsedTime()

    elapsed_s = whole.extend(time_s)
    pieces = [
        parts.extend(time_s[first : first + rows])
        for first in range(0, 1000, rows)
    ]

    assert elapsed_s[0] == 0.0
    assert np.array_equal(np.concatenate(pieces), elapsed_s)
    assert parts.total_s == elapsed_s[-1] == whole.total_s


def test_a_clock_set_back_does_not_count() -> None:
    time = ElapsedTime()

    assert time.extend(np.array([10.0, 11.0, 12.0])).tolist() == [0, 1, 2]
    assert time.extend(np.array([])).tolist() == []
    assert time.extend(np.array([2.0, 3.0])).tolist() == [2, 3]
