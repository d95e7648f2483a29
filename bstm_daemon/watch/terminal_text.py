r"""Text that comes from files, shown on a terminal without commanding it.

The name of a message, of a channel or of a file may hold characters that a
terminal obeys (ESC, OSC, the C1 controls) or that turn the reading direction
of the whole line (bidi). They are shown as Python writes them in a string:
``\x1b``, ``\u202e``.
"""

import re
from typing import Any, Final, TextIO, cast

_PARTS: Final = re.compile(r"[^ -~]")


def visible(text: str, kept: str = "") -> str:
    """Return *text* with all that is not printable escaped, but for *kept*.

    Half of a surrogate pair, as a file name that
    is no UTF-8 has, is escaped too: no stream could encode it.
    """
    if text.isprintable():
        return text

    def shown(found: re.Match[str]) -> str:
        character = found[0]
        if character.isprintable() or character in kept:
            return character
        return character.encode("unicode_escape").decode("ascii")

    return _PARTS.sub(shown, text)


class VisibleStream:
    """A text stream that writes all but line breaks and tabs visible."""

    def __init__(self, stream: TextIO) -> None:
        """Write to *stream*, which anything else is left to."""
        self.raw = stream

    def write(self, text: str) -> int:
        """Write *text* and return how much of it that was: all."""
        self.raw.write(visible(text, "\n\t"))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        """Return what the stream itself has of that name."""
        return getattr(self.raw, name)


def visible_stream(stream: TextIO) -> TextIO:
    """Return what writes to *stream* in visible characters only."""
    return cast("TextIO", VisibleStream(stream))


def raw_stream(stream: TextIO | VisibleStream) -> TextIO:
    """Return the stream beneath, for who draws by control characters."""
    return stream.raw if isinstance(stream, VisibleStream) else stream
