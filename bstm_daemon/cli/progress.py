"""A progress line on a terminal, and nothing anywhere else."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Final, Self, TextIO

from bstm_daemon.terminal_text import raw_stream

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

_REDRAW_S: Final = 0.1
_BYTES_PER_LINE: Final = 44
"""A candump line of eight bytes."""

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

    def show(self, fraction: float | None) -> None:
        """Draw that *fraction* (0 to 1) is done, at most every 0.1 s.

        None, where that is not known, is drawn as 0.
        """
        if not self._is_terminal:
            return
        now_s = time.monotonic()
        if now_s - self._drawn_at_s < _REDRAW_S:
            return
        self._drawn_at_s = now_s
        self._write(f"{_ERASE_LINE}{self._label} {fraction or 0.0:4.0%}")

    def show_lines(
        self, log: Path, lines: int, share: float | None = None
    ) -> None:
        """Draw *share* of *log*, or how far *lines* are by its size."""
        with suppress(OSError):  # the reader of the log reports that
            size = max(log.stat().st_size, 1)
            by_size = min(lines * _BYTES_PER_LINE / size, 1.0)
            self.show(by_size if share is None else share)

    def __enter__(self) -> Self:
        """Return the progress line itself."""
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
