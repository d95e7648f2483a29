"""When the vehicle comes to rest for a while."""

import numpy as np
import pytest

from bstm_daemon.report.stops import StopFinder


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
