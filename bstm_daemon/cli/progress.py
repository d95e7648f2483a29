"""A progress line on a terminal, and nothing anywhere else."""

import sys
import time
from collections.abc import Callable
from types import TracebackType
from typing import Final, Self, TextIO

from bstm_daemon.watch.terminal_text import raw_stream

_REDRAW_S: Final = 0.1
_ERASE_LINE: Final = "\r\x1b[K"


class Progress:
    """A line on stderr such as ``replay 42 %``, erased at the end.

    Use it as a context manager around the work::

        with Progress("replay") as progress:
            for done, chunk in chunks:
                progress.show(done / total)
    """

    def __init__(self, label: str, stream: TextIO | None = None) -> None:
        """Prepare a line that starts with *label* on *stream* or stderr."""
        self._label = label
        self._stream = raw_stream(sys.stderr if stream is None else stream)
        self._is_terminal = self._stream.isatty()
        self._drawn_at_s = -_REDRAW_S

    def show(self, fraction: float, detail: str = "") -> None:
        """Draw that *fraction* (0 to 1) is done, at most every 0.1 s.

        *detail* stands behind it.
        """
        if not self._is_terminal:
            return
        now_s = time.monotonic()
        if now_s - self._drawn_at_s < _REDRAW_S:
            return
        self._drawn_at_s = now_s
        self._write(
            f"{_ERASE_LINE}{self._label} {fraction:4.0%} {detail}".rstrip()
        )

    def part(self, begin: float, end: float) -> Callable[[float], None]:
        """Return :meth:`show` for a part of the work, *begin* to *end*."""
        return lambda fraction: self.show(begin + (end - begin) * fraction)

    def __enter__(self) -> Self:
        """Draw the line and return it."""
        if self._is_terminal:
            self._write(f"{_ERASE_LINE}{self._label}   0%")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Erase the line."""
        if self._is_terminal:
            self._write(_ERASE_LINE)

    def _write(self, text: str) -> None:
        self._stream.write(text)
        self._stream.flush()
