"""The board on a terminal, drawn by rich, left by a key.

The alternate screen, a hidden cursor and keys without Enter are set on entry
and undone on every way out: ``q``, Ctrl-C, an error, the signals that end a
process, and while it is stopped by Ctrl-Z.
"""

import os
import select
import signal
import sys
import termios
import time
import tty
from contextlib import suppress
from types import FrameType
from typing import Any, Final, Self, TextIO

from rich.console import Console, ConsoleDimensions
from rich.live import Live

from bstm_daemon.watch.board import ASCII_BARS, BARS, Board
from bstm_daemon.watch.lines import LineView
from bstm_daemon.watch.picture import picture

REDRAW_S: Final = 0.2

_SIGNALS: Final = (
    *(signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT),
    *(signal.SIGINT, signal.SIGTSTP),
)


class TerminalView(LineView):
    """Shows the board on a terminal, at most every 0.2 s."""

    def __init__(
        self,
        stream: TextIO,
        keys: TextIO | None = None,
        *,
        use_color: bool = True,
    ) -> None:
        """Draw on *stream*; read keys from *keys* or stdin if a terminal."""
        super().__init__(stream)
        self._console = Console(
            file=stream,
            force_terminal=True,
            color_system="standard" if use_color else None,
        )
        self._live = Live(
            console=self._console,
            screen=True,
            auto_refresh=False,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._encoding = stream.encoding or "ascii"
        keys = sys.stdin if keys is None else keys
        self._keys = keys.fileno() if keys.isatty() else None
        self._key_mode: list[Any] | None = None
        self._drawn_at_s = -REDRAW_S
        self._handlers: dict[int, Any] = {}
        self._is_drawing = False
        self._pending_signal: int | None = None
        self._has_left = False

    @property
    def has_left(self) -> bool:
        """Whether the user wants to leave."""
        return self._has_left

    def show(
        self, board: Board, now_us: int, source: str, *, at_once: bool = False
    ) -> None:
        """Draw the board unless it was drawn less than 0.2 s ago."""
        now_s = time.monotonic()
        if now_s - self._drawn_at_s < REDRAW_S and not at_once:
            return
        self._drawn_at_s = now_s
        self._read_keys(0.0)
        # rich keeps back what a signal handler writes while it draws
        self._is_drawing = True
        try:
            with suppress(OSError):
                # rich would ask the standard streams, whatever it draws on
                size = os.get_terminal_size(self._stream.fileno())
                if all(size):
                    self._console.size = ConsoleDimensions(*size)
            drawn = picture(
                board,
                now_us,
                self._encodable(source),
                self._console,
                BARS if self._encodable(BARS) == BARS else ASCII_BARS,
            )
            self._live.update(drawn, refresh=True)
        finally:
            self._is_drawing = False
        if self._pending_signal is not None:
            self._handle(self._pending_signal)

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
        for number in _SIGNALS:
            self._handlers[number] = signal.signal(number, self._on_signal)
        self._take()
        return self

    def __exit__(self, *error: object) -> None:
        """Give the terminal back."""
        self._give_back()
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _take(self) -> None:
        if self._keys is not None:
            self._key_mode = termios.tcgetattr(self._keys)
            tty.setcbreak(self._keys, termios.TCSADRAIN)
        self._live.start(refresh=True)

    def _give_back(self) -> None:
        # a terminal that has gone away needs nothing back
        with suppress(OSError):
            self._live.stop()
        if self._keys is not None and self._key_mode is not None:
            with suppress(termios.error):
                termios.tcsetattr(
                    self._keys, termios.TCSADRAIN, self._key_mode
                )

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del frame
        if self._is_drawing:
            self._pending_signal = number
        else:
            self._handle(number)

    def _handle(self, number: int) -> None:
        self._pending_signal = None
        if number == signal.SIGINT:
            raise KeyboardInterrupt
        if number != signal.SIGTSTP:
            sys.exit(128 + number)
        # the shell has the terminal for as long as we are stopped
        self._give_back()
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        signal.signal(number, self._on_signal)
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
            self._has_left |= not keys or b"q" in keys.lower()

    def _encodable(self, text: str) -> str:
        """Return *text* with ``?`` for what the terminal cannot show."""
        return text.encode(self._encoding, "replace").decode(self._encoding)
