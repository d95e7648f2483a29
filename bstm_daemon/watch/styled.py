"""Lines of styled text: as long as the screen is wide, coloured or not.

Every character that is used takes one cell, so a length is a width.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


class Span(NamedTuple):
    """A piece of text in one style of :data:`STYLES`."""

    text: str
    style: str = "plain"


Line = tuple[Span, ...]

STYLES: Final = {
    "plain": "",
    "strong": "1",
    "faint": "2",
    "good": "32",
    "warning": "33",
    "bad": "31",
    "alarm": "1;37;41",
}
"""Style to SGR parameters (ECMA-48, 8.3.117). The words say the same."""


def length(line: Line) -> int:
    """Return the number of cells of *line*."""
    return sum(len(span.text) for span in line)


def fitted(line: Line, width: int) -> Line:
    """Return *line* cut or filled with blanks to *width* cells."""
    spans = []
    left = width
    for span in line:
        text = span.text[:left]
        spans.append(Span(text, span.style))
        left -= len(text)
    return (*spans, Span(" " * left))


def flowed(spans: Iterable[Span], width: int, gap: str = "  ") -> list[Line]:
    """Return *spans* set into lines of at most *width*, *gap* between them.

    A span that is wider alone is cut.
    """
    lines: list[Line] = []
    current: Line = ()
    for span in spans:
        longer = (*current, Span(gap), span) if current else (span,)
        if current and length(longer) > width:
            lines.append(current)
            longer = (span,)
        current = longer
    if current:
        lines.append(current)
    return lines


def beside(left: Sequence[Line], right: Sequence[Line]) -> list[Line]:
    """Return two blocks of equal height side by side, two cells apart."""
    return [(*a, Span("  "), *b) for a, b in zip(left, right, strict=True)]


def painted(line: Line, *, use_color: bool) -> str:
    """Return *line* as characters for a terminal."""
    if not use_color:
        return "".join(span.text for span in line)
    return "".join(
        f"\x1b[{STYLES[span.style]}m{span.text}\x1b[m"
        if STYLES[span.style] and span.text
        else span.text
        for span in line
    )
