"""A screen drawn with ANSI sequences that leaves the terminal as it was.

The alternate screen, a hidden cursor and keys without Enter are set on entry
and undone on every way out: ``q``, Ctrl-C, an error, the signals that end a
process, and while it is stopped by Ctrl-Z.
"""

from __future__ import annotations

import os
import select
import signal
import sys
import termios
import time
import tty
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Final, Self, TextIO

from bstm_daemon.watch.history import ASCII_BARS, BARS
from bstm_daemon.watch.picture import picture
from bstm_daemon.watch.styled import painted

if TYPE_CHECKING:
    from types import FrameType, TracebackType

    from bstm_daemon.watch.board import Board

REDRAW_S: Final = 0.2

_ENTER: Final = "\x1b[?1049h\x1b[?25l\x1b[?7l"
"""Alternate screen, no cursor, no wrapping at the right edge."""
_LEAVE: Final = "\x1b[?7h\x1b[?25h\x1b[?1049l"
_HOME: Final = "\x1b[H"
_CLEAR_LINE: Final = "\x1b[K"
_CLEAR_BELOW: Final = "\x1b[J"

_ENDING: Final = (signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
_LEAST_SIZE: Final = (80, 24)


class TerminalView:
    """Shows the board on a terminal, at most every 0.2 s."""

    def __init__(
        self,
        stream: TextIO,
        keys: TextIO | None = None,
        *,
        use_color: bool = True,
    ) -> None:
        """Draw on *stream*; read keys from *keys* or stdin if a terminal."""
        self._stream = stream
        keys = sys.stdin if keys is None else keys
        self._keys = keys.fileno() if keys.isatty() else None
        self._use_color = use_color
        self._bars = BARS if _shows(stream, BARS) else ASCII_BARS
        self._drawn_at_s = -REDRAW_S
        self._handlers: dict[int, Any] = {}
        self._mode: list[Any] | None = None
        self.has_left = False

    def show(
        self, board: Board, now_us: int, source: str, *, at_once: bool = False
    ) -> None:
        """Draw the board unless it was drawn less than 0.2 s ago."""
        now_s = time.monotonic()
        if now_s - self._drawn_at_s < REDRAW_S and not at_once:
            return
        self._drawn_at_s = now_s
        self._read_keys(0.0)
        width, height = self._size()
        lines = picture(board, now_us, source, width, height, self._bars)
        body = "\r\n".join(
            painted(line, use_color=self._use_color) + _CLEAR_LINE
            for line in lines
        )
        self._write(f"{_HOME}{body}{_CLEAR_BELOW}")

    def pause(self, seconds: float) -> None:
        """Wait for *seconds*, or until a key says to leave."""
        until_s = time.monotonic() + seconds
        while not self.has_left:
            left_s = until_s - time.monotonic()
            if left_s <= 0:
                return
            self._read_keys(left_s)

    def linger(self) -> None:
        """Keep the last picture until the user leaves."""
        while self._keys is not None and not self.has_left:
            self._read_keys(None)

    def __enter__(self) -> Self:
        """Take the terminal over."""
        for number in (*_ENDING, signal.SIGTSTP):
            handler = self._stop if number == signal.SIGTSTP else _end
            self._handlers[number] = signal.signal(number, handler)
        self._take()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Give the terminal back."""
        self._give_back()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _take(self) -> None:
        if self._keys is not None:
            self._mode = termios.tcgetattr(self._keys)
            tty.setcbreak(self._keys, termios.TCSADRAIN)
        self._write(_ENTER)

    def _give_back(self) -> None:
        # a terminal that has gone away needs nothing back
        with suppress(OSError):
            self._write(_LEAVE)
        if self._keys is not None and self._mode is not None:
            with suppress(termios.error):
                termios.tcsetattr(self._keys, termios.TCSADRAIN, self._mode)

    def _stop(self, number: int, frame: FrameType | None) -> None:
        """Give the terminal to the shell for as long as we are stopped."""
        del frame
        self._give_back()
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, self._stop)
        self._take()

    def _read_keys(self, seconds: float | None) -> None:
        if self._keys is None:
            if seconds:
                time.sleep(seconds)
            return
        ready, _, _ = select.select([self._keys], [], [], seconds)
        if ready:
            keys = os.read(self._keys, 256)
            # none at all: the terminal has gone
            self.has_left |= not keys or b"q" in keys.lower()

    def _size(self) -> tuple[int, int]:
        try:
            width, height = os.get_terminal_size(self._stream.fileno())
        except OSError:
            width, height = 0, 0
        return (width, height) if width and height else _LEAST_SIZE

    def _write(self, text: str) -> None:
        encoding = self._stream.encoding or "ascii"
        known = text.encode(encoding, "replace").decode(encoding)
        self._stream.write(known)
        self._stream.flush()


def _end(number: int, frame: FrameType | None) -> None:
    del frame
    sys.exit(128 + number)


def _shows(stream: TextIO, text: str) -> bool:
    try:
        text.encode(stream.encoding or "ascii")
    except UnicodeEncodeError:
        return False
    return True
