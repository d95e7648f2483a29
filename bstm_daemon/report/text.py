"""Aligned columns, wrapped lines and numbers for a terminal."""

from collections.abc import Callable, Iterable, Sequence
from math import isfinite
from textwrap import wrap
from typing import Final, Generic, TypeVar

T = TypeVar("T")

WIDTH: Final = 100
"""Columns that a result takes at most, on a terminal and in a pipe."""


def columns(rows: Sequence[Sequence[str]], left: int | None = 1) -> list[str]:
    """Return *rows* as aligned lines, narrower gaps where they are too wide.

    Args:
        rows: the heading, if any, then the rows; all of one length.
        left: number of columns aligned to the left, the others are to the
            right; None aligns all to the left.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    gap = "  " if sum(widths) + 2 * (len(widths) - 1) <= WIDTH else " "
    return [
        gap.join(
            cell.ljust(width)
            if left is None or i < left
            else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


class Columns(Generic[T]):
    """A table as data: of each column its heading, and its text of an item.

    A column without a text counts the items.
    """

    def __init__(
        self, *columns: tuple[str, Callable[[T], str] | None]
    ) -> None:
        """Take the columns from the left."""
        self.head = tuple(head for head, _ in columns)
        self._texts = [text for _, text in columns]

    def rows(self, items: Iterable[T]) -> list[tuple[str, ...]]:
        """Return a row for each of *items*."""
        return [
            tuple(
                f"{i}" if text is None else text(one) for text in self._texts
            )
            for i, one in enumerate(items, 1)
        ]

    def lines(self, items: Iterable[T], left: int | None = 1) -> list[str]:
        """Return the table as lines, aligned as by :func:`columns`."""
        return columns([self.head, *self.rows(items)], left)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return *head* and *rows* as lines, all columns to the left."""
    return columns([head, *rows], left=None)


def wrapped(
    lines: Sequence[str], mark: str = "- ", indent: str = "  "
) -> list[str]:
    """Return *lines* broken at :data:`WIDTH`, each begun with *mark*.

    The lines after a break begin with *indent*.
    """
    return [
        part
        for line in lines
        for part in wrap(
            f"{mark}{line}",
            WIDTH,
            subsequent_indent=indent,
            break_on_hyphens=False,
        )
    ]


def number(value: float, digits: int = 4) -> str:
    """Return *value* with *digits* significant digits, a dash for none."""
    return f"{value:.{digits}g}" if isfinite(value) else "-"


def percent(share: float) -> str:
    """Return *share* in per cent; never 0 or 100 % unless it is."""
    if 0.0 < share < 0.001:
        return "< 0.1 %"
    if 0.999 < share < 1.0:
        return "> 99.9 %"
    text = f"{100 * share:.1f}".removesuffix(".0")
    return f"{text} %"
