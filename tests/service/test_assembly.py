"""A configuration that is built beside the running service."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from bstm_daemon.errors import ConfigError, FileAccessError
from bstm_daemon.service.assembly import (
    BUILD_LIMIT_US,
    MonitorBuild,
    refusing,
)


def joined() -> None:
    """Wait for the thread that builds."""
    for thread in threading.enumerate():
        if thread.name == "build":
            thread.join(10.0)


def test_what_was_built_is_given_once_it_is_there() -> None:
    go_on = threading.Event()
    monitor: Any = object()

    def build() -> Any:
        assert go_on.wait(10.0)
        return monitor

    under_way = MonitorBuild(build, 5)
    assert under_way.outcome(5 + BUILD_LIMIT_US - 1) is None
    go_on.set()
    joined()
    assert under_way.outcome(5 + 2 * BUILD_LIMIT_US) is monitor


def test_what_takes_too_long_is_refused() -> None:
    go_on = threading.Event()
    forever: Any = go_on.wait
    under_way = MonitorBuild(forever, 5)

    with pytest.raises(ConfigError, match="longer than 60 s"):
        under_way.outcome(5 + BUILD_LIMIT_US)

    go_on.set()
    joined()


@pytest.mark.parametrize("error", [RecursionError("deep"), MemoryError()])
def test_what_ends_the_building_is_raised(error: Exception) -> None:
    def build() -> Any:
        raise error

    under_way = MonitorBuild(build, 0)
    joined()

    with pytest.raises(type(error)) as caught:
        under_way.outcome(0)
    assert caught.value is error


@pytest.mark.filterwarnings(
    "ignore::pytest.PytestUnhandledThreadExceptionWarning"
)
def test_a_thread_that_ends_without_a_word_is_no_monitor() -> None:
    def build() -> Any:
        raise SystemExit

    under_way = MonitorBuild(build, 0)
    joined()

    with pytest.raises(ConfigError, match="ended"):
        under_way.outcome(0)


def test_errors_for_the_user_pass_and_others_become_one_line() -> None:
    path = Path("car.toml")
    known = FileAccessError("car.toml: no such file")

    with pytest.raises(FileAccessError) as passed, refusing(path):
        raise known
    with pytest.raises(ConfigError) as made, refusing(path):
        raise ValueError("too\nmany digits")  # noqa: TRY003, EM101

    assert passed.value is known
    assert made.value.problems == [
        "car.toml: cannot be used: ValueError too many digits"
    ]
    with pytest.raises(KeyboardInterrupt), refusing(path):
        raise KeyboardInterrupt
