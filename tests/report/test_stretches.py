"""When something held, and when the vehicle comes to rest for a while."""

import numpy as np
import pytest

from bstm_daemon.report.stretches import (
    StopFinder,
    Stretches,
    StretchFinder,
)


@pytest.mark.parametrize("rows", [1, 7, 1000])
def test_pieces_do_not_matter(rows: int) -> None:
    """One over the edge of two pieces is one."""
    rng = np.random.default_rng(4)
    holds = np.repeat(rng.integers(0, 2, 40), rng.integers(1, 40, 40)) > 0
    elapsed_s = 0.1 * np.arange(len(holds))
    whole, parts = StretchFinder(1.0), StretchFinder(1.0)

    whole.add(elapsed_s, holds)
    for first in range(0, len(holds), rows):
        stretch = slice(first, first + rows)
        parts.add(elapsed_s[stretch], holds[stretch])

    assert whole.stretches() is not None
    assert parts.stretches() == whole.stretches()


def test_a_stretch_up_to_the_end_counts_and_may_go_on() -> None:
    """Asking does not end it."""
    finder = StretchFinder()
    for first in range(3):
        rows = 10 * first + np.arange(10)
        finder.add(1.0 * rows, np.full(10, fill_value=True))
        last_s = float(rows[-1])
        assert finder.stretches() == Stretches(last_s, last_s, 0.0, 0.0)


def test_stretches_know_their_first_begin() -> None:
    """Of all that are long enough; a single row has the time before it."""
    holds = np.array([0, 1, 1, 0, 0, 1, 1, 1, 0, 1, 0], dtype=bool)
    every, long = StretchFinder(), StretchFinder(2.5)
    for finder in (every, long):
        finder.add(1.0 * np.arange(len(holds)), holds)

    assert every.stretches() == Stretches(6.0, 3.0, 4.0, 0.0)
    assert long.stretches() == Stretches(3.0, 3.0, 4.0, 4.0)
    assert StretchFinder().stretches() is None


def _speeds() -> np.ndarray:
    speed_ms = np.full(200, 10.0)
    speed_ms[:20] = 0.0
    speed_ms[50:55] = 0.0
    speed_ms[80:120] = 0.0
    speed_ms[90] = 0.8
    speed_ms[100] = np.nan
    speed_ms[170:] = 0.4
    return speed_ms


@pytest.mark.parametrize("rows", [1, 13, 200])
def test_stops_are_where_a_moving_vehicle_comes_to_rest(rows: int) -> None:
    """Not the standstill at the start, not a crossing, not a creep."""
    elapsed_s, speed_ms = np.arange(200.0), _speeds()
    finder = StopFinder()

    for first in range(0, 200, rows):
        stretch = slice(first, first + rows)
        finder.add(elapsed_s[stretch], speed_ms[stretch])

    assert finder.stops_s() == (80.0, 170.0)


def test_a_stop_is_one_when_it_has_lasted() -> None:
    elapsed_s, speed_ms = np.arange(200.0), _speeds()
    finder = StopFinder()

    finder.add(elapsed_s[:90], speed_ms[:90])
    assert finder.stops_s() == ()
    finder.add(elapsed_s[90:91], speed_ms[90:91])
    assert finder.stops_s() == (80.0,)
    finder.add(elapsed_s[91:], speed_ms[91:])
    assert finder.stops_s() == (80.0, 170.0)
