"""The screen on a real terminal: what it changes it puts back."""

from __future__ import annotations

import fcntl
import io
import os
import select
import signal
import struct
import termios
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.watch.terminal import TerminalView

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.watch.board import Board

    from .conftest import Terminal

    Start = Callable[..., Terminal]

MAIN = """
import sys
from bstm_daemon.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
WATCH = (MAIN, "watch", "-i", "virtual", "--channel", "terminal")

ENTER = b"\x1b[?1049h\x1b[H\x1b[?25l"
LEAVE = b"\x1b[?25h\x1b[?1049l"
HANGS_S = 20.0


@pytest.fixture
def watching(terminal: Start) -> Terminal:
    """Return a terminal on which ``bstm watch`` shows itself."""
    started = terminal(80, 24, *WATCH)
    started.until("q leaves")
    return started


def test_it_follows_the_size_is_stopped_and_left(watching: Terminal) -> None:
    """One start of the program: it takes most of the time."""
    assert watching.raw.startswith(ENTER)
    assert b"\x1b[1m" in watching.raw
    assert "bstm" in watching.lines[0]
    assert watching.lines[0].endswith("terminal")

    size = struct.pack("HHHH", 10, 60, 0, 0)
    watching.screen.resize(10, 60)
    watching.screen.reset()
    fcntl.ioctl(watching._slave, termios.TIOCSWINSZ, size)
    watching.until_raw(b"q leaves", len(watching.raw) + 1)
    watching.until("q leaves")
    assert watching.lines[-1].endswith("q leaves")
    assert len(watching.lines[-1]) == 60

    # no shell holds this job, so the kernel lets it go on at once
    watching.process.send_signal(signal.SIGTSTP)
    left = watching.until_raw(LEAVE)
    watching.until_raw(ENTER, left)
    watching.until("q leaves")

    watching.press(b"x")
    watching.press(b"q")
    assert watching.ended() == 0
    assert watching.raw.endswith(LEAVE)


@pytest.mark.slow
def test_control_c_leaves_and_nothing_is_coloured(terminal: Start) -> None:
    watching = terminal(80, 24, *WATCH, NO_COLOR="1")
    watching.until("q leaves")
    assert b"\x1b[1m" not in watching.raw

    watching.press(b"\x03")
    assert watching.ended() == 0
    assert watching.raw.endswith(LEAVE)


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        pytest.param(signal.SIGHUP, marks=pytest.mark.slow),
        pytest.param(signal.SIGQUIT, marks=pytest.mark.slow),
    ],
)
def test_a_signal_that_ends_leaves_the_terminal_as_it_was(
    watching: Terminal, number: signal.Signals
) -> None:
    watching.process.send_signal(number)

    assert watching.ended() == 128 + number
    assert watching.raw.endswith(LEAVE)


def test_an_error_leaves_the_terminal_as_it_was(terminal: Start) -> None:
    code = (
        "import sys\n"
        "from bstm_daemon.watch.terminal import TerminalView\n"
        "with TerminalView(sys.stdout):\n"
        "    raise RuntimeError('broken')\n"
    )
    started = terminal(80, 24, code)

    assert started.ended() == 1
    assert b"broken" in started.raw.partition(LEAVE)[2]


def test_a_signal_while_it_draws_waits_for_the_end_of_it(
    terminal: Start,
) -> None:
    code = (
        "import os, signal, sys\n"
        "from bstm_daemon.watch.board import Board\n"
        "from bstm_daemon.watch.terminal import TerminalView\n"
        "class Interrupted(Board):\n"
        "    @property\n"
        "    def has_frames(self):\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "        return False\n"
        "with TerminalView(sys.stdout) as view:\n"
        "    view.show(Interrupted(0x5B0), 0, 'can0')\n"
        "    view.linger()\n"
    )
    started = terminal(80, 24, code)

    assert started.ended() == 128 + signal.SIGTERM
    assert b"no frame yet" in started.raw
    assert started.raw.endswith(LEAVE)


def _until_left(master: int) -> bytes:
    """Return what was written up to the end of the view.

    The kernel hands it over in pieces, and after the writing.
    """
    written = b""
    while LEAVE not in written:
        readable, _, _ = select.select([master], [], [], HANGS_S)
        assert readable, written
        written += os.read(master, 65536)
    return written


def test_a_terminal_without_block_elements(board: Board) -> None:
    master, slave = os.openpty()
    with os.fdopen(slave, "w", encoding="ascii") as stream:
        with TerminalView(stream, io.StringIO()) as view:
            view.show(board, 0, "Prüfstand.log")
            view.linger()
        written = _until_left(master)
    os.close(master)

    assert b"Pr?fstand.log" in written


def test_it_is_not_drawn_faster_than_one_can_see(board: Board) -> None:
    master, slave = os.openpty()
    with os.fdopen(slave, "w", encoding="utf-8") as stream:
        with TerminalView(stream, io.StringIO()) as view:
            for _ in range(3):
                view.show(board, 0, "can0")
            view.show(board, 0, "can0", at_once=True)
        written = _until_left(master)
    os.close(master)

    assert written.count(b"q leaves") == 2
