"""Aligned columns, wrapped lines and numbers for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from textwrap import wrap
from typing import Final

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
