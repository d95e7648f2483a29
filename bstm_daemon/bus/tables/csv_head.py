"""The head of a CSV table: preamble, names, units, and how cells are written.

Loggers write some lines about the session, a row of names and a row of units
before the values. Which row is which follows from the values: the names are
the texts above the first rows of numbers that have as many cells.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.tables.cells import numbers
from bstm_daemon.bus.tables.source import units_in_names
from bstm_daemon.units import unit_named

if TYPE_CHECKING:
    from collections.abc import Sequence

HEAD_LINES: Final = 100
"""Lines in which the first values are looked for."""

_DELIMITERS: Final = ",;\t|"
_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d.*|\d+:\d\d(:\d\d)?(\.\d+)?")
_TIME_UNITS: Final = ("s", "sec", "ms", "us")
_COMMA: Final = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")
_THOUSANDS: Final = re.compile(r"[+-]?\d{1,3},\d{3}")


@dataclass(frozen=True, slots=True)
class Head:
    """What the first lines say of a table.

    ``units`` has the unit texts by column, ``lines`` the number of lines
    before the first row.
    """

    names: list[str]
    delimiter: str
    lines: int = 1
    decimal_comma: bool = False
    units: dict[str, str] = field(default_factory=dict)


def read_head(lines: Sequence[str], delimiter: str | None) -> Head:
    """Return the head of a table that begins with *lines*.

    Where no row of names stands above rows of values, the first line has the
    names.

    Args:
        lines: the first of the file, :data:`HEAD_LINES` are enough.
        delimiter: between the cells, None to find it.
    """
    best, most = None, 0
    for one in delimiter or _DELIMITERS:
        rows = [cells_of(line, one) for line in lines]
        for first, row in enumerate(rows):
            width = len(row)
            place = _names_above(rows, first) if _is_values(row) else None
            if place is None:
                continue
            like = [
                each
                for each in rows[first:]
                if len(each) == width and _is_values(each)
            ]
            if len(like) * width > most:
                most = len(like) * width
                best = one, rows, place, first, like
    if best is None:
        beginning = lines[0] if lines else ""
        rows = [cells_of(beginning, one) for one in delimiter or _DELIMITERS]
        names = max(rows, key=len)
        one = (delimiter or _DELIMITERS)[rows.index(names)]
        return Head(names, one, units=units_in_names(names))
    one, rows, place, first, like = best
    names, below = rows[place], rows[place + 1]
    units = units_in_names(names)
    if place + 1 < first and _is_units(below):
        stated = zip(names, below, strict=False)
        units |= {name: text for name, text in stated if text}
    else:
        # any other row above the values is counted as a damaged one
        first = place + 1
    return Head(names, one, first, _has_decimal_comma(like, one), units)


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of *line* without blanks around them."""
    try:
        row = next(csv.reader([line], delimiter=delimiter), [])
    except csv.Error:
        return []
    return [cell.strip() for cell in row]


def _names_above(rows: Sequence[list[str]], first: int) -> int | None:
    """Return the row of names for values that begin in row *first*."""
    above = first - 1
    while above >= 0 and not any(rows[above]):
        above -= 1
    width = len(rows[first])
    texts = []
    while above >= 0 and any(rows[above]) and len(rows[above]) == width:
        if _is_values(rows[above]):
            return None
        texts.append(above)
        above -= 1
    for unit_row, names in pairwise(texts):
        if _is_units(rows[unit_row]):
            return names
    return texts[-1] if texts else None


def _is_values(row: list[str]) -> bool:
    """Whether more than half of the cells that are there are values."""
    there = [cell.replace(",", ".") for cell in row if cell]
    unreadable = numbers(there).unreadable.tolist()
    values = [
        not is_text or _DATE.fullmatch(cell)
        for cell, is_text in zip(there, unreadable, strict=True)
    ]
    return 2 * sum(map(bool, values)) > len(there)


def _is_units(row: list[str]) -> bool:
    return any(unit_named(cell) for cell in row) or (
        bool(row) and row[0].lower() in _TIME_UNITS
    )


def _has_decimal_comma(rows: Sequence[list[str]], delimiter: str) -> bool:
    """Whether cells such as ``1,5`` are numbers.

    Quoted between commas, ``1,500`` may be a thousand as well.
    """
    commas = [cell for row in rows for cell in row if _COMMA.fullmatch(cell)]
    return any(
        delimiter != "," or not _THOUSANDS.fullmatch(cell) for cell in commas
    )
