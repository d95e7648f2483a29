"""What the saving goes by: rates, clocks and failures, with values."""

from __future__ import annotations

from datetime import UTC, datetime
from math import isnan
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.service import events
from bstm_daemon.service.clock import SteadyAxis
from bstm_daemon.service.persistence import Persistence

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

SECOND = 1_000_000
NEW_YEAR_US = round(datetime(2025, 1, 1, tzinfo=UTC).timestamp() * 1e6)
UP_US = 100 * SECOND


class Lines:
    """Keeps what is logged, with the time of what repeats."""

    def __init__(self) -> None:
        self.said: list[tuple[Any, ...]] = []

    def emit(self, event: object, **fields: Any) -> None:
        self.said.append((event, fields))

    def repeat(
        self, event: object, key: str, now_s: float, **fields: Any
    ) -> None:
        self.said.append((event, key, now_s, fields))


class Box:
    """The persistence alone, under a wall clock that is off by 70 us."""

    def __init__(self, file: Path, wall_us: int = NEW_YEAR_US) -> None:
        self.nodes_k = [300.0, 400.0]
        axis = SteadyAxis(
            lambda: wall_us * 1000, lambda: UP_US * 1000, lambda: 70
        )
        self.lines, self.axis = Lines(), axis
        log: Any = self.lines
        self.persistence = Persistence(file, axis, log)
        self.trust = False

    def engine(self) -> Any:
        state = SimpleNamespace(trust_wall_clock=self.trust)
        return SimpleNamespace(
            config=SimpleNamespace(state=state),
            temperatures_k=lambda: list(self.nodes_k),
        )


@pytest.fixture
def box(tmp_path: Path) -> Iterator[Box]:
    made = Box(tmp_path / "car.state")
    yield made
    made.persistence._writer.close()
    made.persistence._lock.close()


def test_a_node_that_changes_by_a_kelvin_a_minute_is_moving(box: Box) -> None:
    """The first time nobody knows; cooling counts as heating does."""
    engine = box.engine()
    found = []
    for second, kelvin in ((0, 400.0), (60, 400.9), (120, 399.8),
                           (150, 400.25), (180, 400.8)):  # fmt: skip
        box.nodes_k[1] = kelvin
        found.append(box.persistence._is_moving(engine, second * SECOND))
    box.nodes_k.append(300.0)
    found.append(box.persistence._is_moving(engine, 240 * SECOND))

    assert found == [True, False, True, False, True, True]


@pytest.mark.parametrize(
    ("before_us", "trust", "error_us"),
    [(0, False, 10_070), (1, False, None), (0, True, 0), (1, True, None)],
)
def test_a_wall_clock_before_2025_is_not_set(
    tmp_path: Path, before_us: int, error_us: int | None, *, trust: bool
) -> None:
    """Nor does it help to trust it; two readings may be 10 ms apart."""
    one = Box(tmp_path / "car.state", NEW_YEAR_US - before_us)
    one.trust = trust
    now_us = one.axis.read()

    moment = one.persistence._moment(one.engine(), now_us)

    assert moment.wall_us == NEW_YEAR_US - before_us
    assert moment.boot_us == UP_US
    assert moment.wall_error_us == error_us
    one.persistence._writer.close()
    one.persistence._lock.close()


def test_when_the_state_is_saved(
    box: Box, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every 10 s while a node changes; at rest after another 300 s."""
    engine = box.engine()
    engine.config.state.interval_s = 10.0
    engine.config.state.idle_interval_s = 300.0
    engine.export_state = lambda: {"time_us": None}
    saved: list[float] = []
    monkeypatch.setattr(
        box.persistence._writer,
        "submit",
        lambda _, now_us: saved.append(now_us / SECOND),
    )

    for second in range(700):
        box.nodes_k[1] += 0.5 if second < 100 else 0.0
        box.persistence.poll(engine, second * SECOND)

    assert saved == [*range(0, 101, 10), 400]


def test_each_further_failure_is_logged_once(
    box: Box, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At the time since the computer started, with the last reason."""
    outcome = SimpleNamespace(failures=0, last_error=None)
    writer = SimpleNamespace(
        outcome=lambda: outcome, close=box.persistence._writer.close
    )
    monkeypatch.setattr(box.persistence, "_writer", writer)
    said = []
    for failures, reason in ((0, None), (1, None), (1, "x"), (3, "full")):
        outcome.failures, outcome.last_error = failures, reason
        box.persistence._report_failures()
        said.append(len(box.lines.said))

    assert said == [0, 1, 1, 2]
    file = str(box.persistence._file)
    assert box.lines.said == [
        (
            events.STATE_SAVE_FAILED,
            "save",
            100_000_000,
            {"file": file, "error": ""},
        ),
        (
            *(events.STATE_SAVE_FAILED, "save", 100_000_000),
            {"file": file, "error": "full"},
        ),
    ]


def test_the_age_of_the_last_save(
    box: Box, monkeypatch: pytest.MonkeyPatch
) -> None:
    outcome = SimpleNamespace(saves=4, failures=2, saved_us=None)
    writer = SimpleNamespace(
        outcome=lambda: outcome, close=box.persistence._writer.close
    )
    monkeypatch.setattr(box.persistence, "_writer", writer)

    never = box.persistence.status(90 * SECOND)
    outcome.saved_us = 60 * SECOND
    then = box.persistence.status(150 * SECOND)

    assert isnan(never.age_s)
    assert (then.saves, then.failures, then.age_s) == (4, 2, 90.0)


def running(*corners: str, driven: int = 0) -> Any:
    """Return an engine as far as a reload concerns it."""
    return SimpleNamespace(
        estimator=SimpleNamespace(
            plan=SimpleNamespace(corners=corners),
            input_history=object(),
            unseen=SimpleNamespace(driven=driven),
        )
    )


@pytest.mark.parametrize(
    ("corners", "same"),
    [(("FL", "RR"), True), (("FL",), False), (("RL", "RR"), False)],
)
def test_a_reload_keeps_the_history_of_the_same_corners(
    box: Box, corners: tuple[str, ...], *, same: bool
) -> None:
    """And counts the holes of both; another car corrects nothing."""
    old, fresh = running("FL", "RR", driven=3), running(*corners, driven=2)
    own = fresh.estimator.input_history
    start = box.persistence._start = object()  # type: ignore[assignment]

    box.persistence.reloaded(old, fresh)

    history = old.estimator.input_history if same else own
    assert fresh.estimator.input_history is history
    assert fresh.estimator.unseen.driven == (5 if same else 2)
    assert box.persistence._start is (start if same else None)
