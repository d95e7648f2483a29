"""Times in words and on axes."""

import pytest

from bstm_daemon.report.timescale import (
    clock,
    duration,
    start_text,
    time_axis,
)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0:00"),
        (59.4, "0:59"),
        (59.6, "1:00"),
        (724.0, "12:04"),
        (3599.6, "1:00:00"),
        (5100.0, "1:25:00"),
        (-130.0, "-2:10"),
        (-0.2, "0:00"),
        (90_061.0, "25:01:01"),
    ],
)
def test_clock(seconds: float, text: str) -> None:
    assert clock(seconds) == text


def test_clock_of_a_column_has_one_form() -> None:
    assert clock(90, with_hours=True) == "0:01:30"
    assert clock(5400, with_hours=False) == "90:00"


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (90.0, "90 s"),
        (600.0, "10 min"),
        (1504.0, "25 min 4 s"),
        (5100.0, "1 h 25 min"),
        (7199.0, "2 h"),
        (10_800.0, "3 h"),
    ],
)
def test_duration(seconds: float, text: str) -> None:
    assert duration(seconds) == text


def test_start_is_a_date_only_where_the_log_has_one() -> None:
    assert start_text(1.7e9) == "2023-11-14 22:13:20 UTC"
    assert start_text(12.5) is None
    assert start_text(1e18) is None


def test_an_axis_names_its_unit_and_never_mixes_two_meanings() -> None:
    short, long = time_axis(90.0), time_axis(3 * 3600.0)

    assert short.title == "time [min:s]"
    assert short.coarse == "%-M:%S"
    assert long.title == "time [h:min]"
    assert long.coarse == "%-H:%M"
    assert long.fine == "%-H:%M:%S"
    assert "day" in time_axis(2 * 86_400.0).title
