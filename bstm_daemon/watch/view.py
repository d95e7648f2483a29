"""The choice between a screen and lines of text."""

import os
from typing import Final, TextIO

from bstm_daemon.errors import require_packages
from bstm_daemon.watch.lines import LineView

_NO_SCREEN: Final = ("dumb", "unknown")
"""Values of ``TERM`` for terminals that cannot move the cursor."""


def open_view(stream: TextIO) -> LineView:
    """Return a screen where *stream* is a terminal, lines elsewhere.

    ``NO_COLOR`` in the environment means a screen without colours.

    Raises:
        MissingExtraError: a screen needs rich, which is not installed.
    """
    if not stream.isatty() or os.environ.get("TERM") in _NO_SCREEN:
        return LineView(stream)
    purpose = "the view on a terminal (| cat gives lines without it)"
    require_packages("rich", extra="terminal", purpose=purpose)
    from bstm_daemon.watch.terminal import TerminalView  # noqa: PLC0415  (POSIX, rich)

    return TerminalView(stream, use_color=not os.environ.get("NO_COLOR"))
