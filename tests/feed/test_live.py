"""The newest record and the last hour, for any number of pages."""

import json
import tracemalloc
from collections.abc import Callable
from typing import Any

import pytest

from bstm_daemon.config.sections import Config
from bstm_daemon.estimate import Estimate
from bstm_daemon.feed.live import Live
from bstm_daemon.feed.record import RecordWriter

HISTORY_S = 3600
START_S = 1_700_000_000.0


@pytest.fixture
def record(config: Config, estimate: Callable[[int], Estimate]) -> Any:
    """Return what makes a record of a time, with a disc temperature of FL."""
    made = json.loads(RecordWriter(config).line(estimate(0)))

    def at(time_s: float, disc_c: float = 100.0) -> dict[str, Any]:
        corners = made["corners"]
        front = {**corners["FL"], "disc_c": disc_c}
        return {
            **made,
            "time_s": START_S + time_s,
            "corners": {**corners, "FL": front},
        }

    return at


def event(live: Live, seen: str = "") -> tuple[str, dict[str, Any]]:
    found = live.event(seen)
    assert found is not None
    return found[0], json.loads(found[1])


def test_the_first_event_has_everything_and_the_next_what_is_new(
    record: Any,
) -> None:
    live = Live("here")
    for time_s in (0.0, 0.1, 2.0, 4.0):
        live.take(record(time_s))

    seen, first = event(live)
    assert first["source"] == "here"
    assert first["reset"]
    assert [point[0] - START_S for point in first["points"]] == [0, 2, 4]
    assert live.event(seen) is None, "nothing has come"

    live.take(record(5.0))
    live.take(record(6.0))
    _, second = event(live, seen)
    assert not second["reset"]
    # the last point was not over
    assert [point[0] - START_S for point in second["points"]] == [4, 6]
    assert second["record"]["time_s"] == START_S + 6


def test_a_point_is_the_hottest_of_its_two_seconds(record: Any) -> None:
    live = Live("")
    for time_s, disc_c in ((0.0, 100.0), (1.0, 300.0), (1.9, 200.0)):
        live.take(record(time_s, disc_c))
    _, found = event(live)
    (point,) = found["points"]
    assert point[1] == 300.0


def test_curves_leave_out_what_is_not_valid(record: Any) -> None:
    """FL is valid, FR degraded, RL invalid, RR unknown."""
    live = Live("")
    live.take(record(0.0))
    _, found = event(live)
    assert found["points"][0][1:] == [
        *(100.0, 300.0, None, None),
        *(100.0, 100.0, None, None),
    ]


def test_a_time_before_the_last_begins_a_new_hour(record: Any) -> None:
    live = Live("")
    live.take(record(100.0))
    seen, _ = event(live)
    live.take(record(50.0))
    _, found = event(live, seen)
    assert found["reset"]
    assert [point[0] - START_S for point in found["points"]] == [50]


@pytest.mark.parametrize("seen", ["nonsense", "0:x:y", "::", "9:9:9"])
def test_a_client_that_saw_something_else_gets_everything(
    record: Any, seen: str
) -> None:
    live = Live("")
    live.take(record(0.0))
    assert event(live, seen)[1]["reset"]


def test_before_the_first_record_there_is_only_the_source() -> None:
    _, found = event(Live("somewhere"))
    assert found["record"] is None
    assert found["points"] == []


@pytest.mark.slow
def test_eight_hours_take_no_more_memory_than_one(record: Any) -> None:
    live = Live("")

    def hour(number: int) -> None:
        for second in range(HISTORY_S):
            live.take(record(number * HISTORY_S + second, float(second)))

    hour(0)
    tracemalloc.start()
    hour(1)
    before, _ = tracemalloc.get_traced_memory()
    for number in range(2, 8):
        hour(number)
    after, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert after - before < 20_000
    _, found = event(live)
    assert len(found["points"]) == 1800
    assert found["points"][0][0] == START_S + 7 * HISTORY_S
