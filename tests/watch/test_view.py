"""A screen or lines, by what stdout is."""

from __future__ import annotations

import io
import os
import sys

import pytest

from bstm_daemon.errors import MissingExtraError
from bstm_daemon.watch.lines import LineView
from bstm_daemon.watch.view import open_view


def test_what_is_no_terminal_gets_lines() -> None:
    assert isinstance(open_view(io.StringIO()), LineView)


def test_a_terminal_that_cannot_move_its_cursor_gets_lines(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    master, slave = os.openpty()
    monkeypatch.setenv("TERM", "dumb")

    with os.fdopen(slave, "w") as stream:
        assert type(open_view(stream)) is LineView
    os.close(master)


def test_a_screen_needs_rich(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = os.openpty()
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setitem(sys.modules, "rich", None)

    with (
        os.fdopen(slave, "w") as stream,
        pytest.raises(MissingExtraError, match=r"bstm-daemon\[terminal\]"),
    ):
        open_view(stream)
    os.close(master)
