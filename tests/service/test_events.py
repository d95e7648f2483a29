"""Event names, their fields, and repeats held back."""

from __future__ import annotations

import itertools
import json
import os
import re
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest
import structlog
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import CapturingLogger

from bstm_daemon.cli import main as command_line
from bstm_daemon.service import events
from bstm_daemon.service.events import (
    Event,
    ServiceLog,
)

if TYPE_CHECKING:
    from collections.abc import Iterator


BUS_UP = Event("bus_up", "info", ("bus", "channel"))
BUS_DOWN = Event("bus_down", "warning", ("bus", "channel"))
REFUSED = Event("frame_refused", "warning", ("bus", "can_id", "reason"))
STOPPING = Event("service_stopping", "info", ("reason",))


@pytest.fixture
def restored() -> Iterator[None]:
    """Leave structlog as it was."""
    yield
    structlog.reset_defaults()


def refuse(log: ServiceLog, now_s: float, can_id: int = 0x100) -> None:
    """Say that a frame was refused at *now_s*."""
    log.repeat(
        REFUSED,
        can_id,
        round(now_s * 1e6),
        bus="chassis",
        can_id=can_id,
        reason="wrong_length",
    )


EVENTS = [one for one in vars(events).values() if isinstance(one, Event)]


def test_every_fact_has_one_name() -> None:
    names = [event.name for event in EVENTS]

    assert len(set(names)) == len(names)
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)+", name) for name in names)


def test_an_event_is_logged_at_its_level_with_its_fields() -> None:
    logger = CapturingLogger()

    ServiceLog(logger).emit(BUS_UP, bus="chassis", channel="can0")

    (call,) = logger.calls
    assert call.method_name == "info"
    assert call.args == ("bus_up",)
    assert call.kwargs == {"bus": "chassis", "channel": "can0"}


@pytest.mark.parametrize(
    "fields", [{}, {"bus": "a"}, {"bus": "a", "channel": "b", "id": 1}]
)
def test_other_fields_are_a_mistake(fields: dict[str, object]) -> None:
    logger = CapturingLogger()

    with pytest.raises(TypeError, match="bus_up has the fields bus, channel"):
        ServiceLog(logger).emit(BUS_UP, **fields)

    assert logger.calls == []


def test_repeats_are_held_back_and_counted() -> None:
    logger = CapturingLogger()
    log = ServiceLog(logger, interval_s=10.0)

    for tenth in range(250):
        refuse(log, tenth * 0.1)

    assert [call.kwargs.get("suppressed") for call in logger.calls] == [
        None,
        99,
        99,
    ]


def test_another_key_passes() -> None:
    logger = CapturingLogger()
    log = ServiceLog(logger, interval_s=10.0)

    for can_id in (0x100, 0x101, 0x100, 0x101):
        refuse(log, 1.0, can_id)

    assert [call.kwargs["can_id"] for call in logger.calls] == [0x100, 0x101]


def up_and_down(log: ServiceLog, now_s: float) -> None:
    for event in (BUS_UP, BUS_DOWN):
        log.repeat(
            event, "can0", round(now_s * 1e6), bus="chassis", channel="can0"
        )


def test_two_events_with_one_key_do_not_hide_each_other() -> None:
    logger = CapturingLogger()
    log = ServiceLog(logger, interval_s=1.0)

    up_and_down(log, 0.0)
    up_and_down(log, 0.5)

    assert [call.args for call in logger.calls] == [("bus_up",), ("bus_down",)]


def test_a_time_that_went_back_does_not_silence() -> None:
    logger = CapturingLogger()
    log = ServiceLog(logger, interval_s=10.0)

    for now_s in (1000.0, 1001.0, 3.0):
        refuse(log, now_s)

    held = [call.kwargs.get("suppressed") for call in logger.calls]
    assert held == [None, 1]


@given(
    steps_s=st.lists(st.floats(0, 30), max_size=60),
    interval_s=st.floats(0.1, 20),
)
def test_nothing_is_lost_from_the_count(
    steps_s: list[float], interval_s: float
) -> None:
    logger = CapturingLogger()
    log = ServiceLog(logger, interval_s)
    now_s = 0.0
    logged_s = []
    reported = held = 0
    for step_s in steps_s:
        now_s += step_s
        refuse(log, now_s)
        if len(logger.calls) == len(logged_s):
            held += 1
            continue
        logged_s.append(now_s)
        assert logger.calls[-1].kwargs.get("suppressed", 0) == held
        reported, held = reported + held, 0

    assert reported + held + len(logged_s) == len(steps_s)
    assert all(
        later - earlier >= interval_s - 2e-6  # times are whole us
        for earlier, later in itertools.pairwise(logged_s)
    )


@pytest.mark.usefixtures("restored")
def test_off_a_terminal_a_line_is_json(
    capsys: pytest.CaptureFixture[str],
) -> None:
    command_line._set_up_log(1)

    ServiceLog().emit(STOPPING, reason="SIGTERM")

    line = json.loads(capsys.readouterr().err)
    assert line["event"] == "service_stopping"
    assert line["level"] == "info"
    assert line["reason"] == "SIGTERM"
    assert line["timestamp"].endswith("Z")


def test_a_log_that_nobody_takes_any_more_disturbs_nothing(
    restored: None,
) -> None:
    """The reader of standard error is gone, or its disk is full."""
    read_end, write_end = os.pipe()
    with os.fdopen(write_end, "w", buffering=1) as file:
        structlog.configure(
            processors=[structlog.processors.JSONRenderer()],
            logger_factory=lambda *_: structlog.WriteLogger(file),
        )
        log = ServiceLog()
        log.emit(STOPPING, reason="first")
        os.close(read_end)
        for _ in range(1000):
            log.emit(STOPPING, reason="second")
        with suppress(BrokenPipeError):
            file.close()
