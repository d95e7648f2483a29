"""Interface of a signal table, independent of its file format; its cells."""

import re
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.units import unit_named

Booleans = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.float64]

_NUMBER: Final = re.compile(
    r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?inf(inity)?",
    re.ASCII | re.IGNORECASE,
)
_WORDS: Final = {"true": 1.0, "false": 0.0}
_EMPTY: Final = ("", "nan", "+nan", "-nan")


@dataclass(frozen=True, slots=True)
class Numbers:
    """A column as numbers: nan where ``unreadable`` or empty."""

    value: Floats
    unreadable: Booleans


def numbers(cells: list[str] | npt.NDArray[Any]) -> Numbers:
    """Return *cells* as numbers; true and false are 1 and 0.

    An empty cell and a nan are no number, but not unreadable either.
    """
    if not isinstance(cells, list):
        if cells.dtype.kind in "biuf":
            value = cells.astype(np.float64)
            return Numbers(value, np.zeros(len(value), np.bool_))
        cells = [str(cell) for cell in cells.tolist()]
    joined = "\n".join(cells)
    if joined.isascii() and "_" not in joined:
        try:
            quick = [float(cell) if cell else nan for cell in cells]
        except ValueError:
            pass
        else:
            value = np.array(quick, np.float64)
            return Numbers(value, np.zeros(len(value), np.bool_))
    value = np.full(len(cells), nan)
    unreadable = np.zeros(len(cells), np.bool_)
    for place, cell in enumerate(cells):
        text = cell.strip()
        if _NUMBER.fullmatch(text):
            value[place] = float(text)
        elif text.lower() in _WORDS:
            value[place] = _WORDS[text.lower()]
        else:
            unreadable[place] = text.lower() not in _EMPTY
    return Numbers(value, unreadable)


def texts(cells: list[str] | npt.NDArray[Any]) -> list[str]:
    """Return *cells* as texts without blanks around them."""
    listed = cells if isinstance(cells, list) else cells.tolist()
    return [str(cell).strip() for cell in listed]


_IN_BRACKETS: Final = re.compile(
    r"(.*\S)\s*(?:\[([^\[\]]+)\]|\(((?:[^()]|\([^()]*\))+)\))"
)
_LAST_WORD: Final = re.compile(r"(.*[^\s_])[\s_](\S{2,}|[gmcCK])")


def split_unit(name: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit's text.

    ``Speed [km/h]`` and ``Speed (km/h)`` have one, known or not, ``speed_kmh``
    one that is known; a name without one is returned as it is, with "".
    """
    inside = _IN_BRACKETS.fullmatch(name)
    if inside:
        return inside[1], (inside[2] or inside[3]).strip()
    last = _LAST_WORD.fullmatch(name)
    return (last[1], last[2]) if last and unit_named(last[2]) else (name, "")


def units_in_names(names: Iterable[str]) -> dict[str, str]:
    """Return the unit texts in names of columns, by name."""
    return {name: unit for name in names if (unit := split_unit(name)[1])}


@dataclass(frozen=True, slots=True)
class TableChunk:
    """Rows of a table: *rows* were read, these of them have cells.

    ``line`` is the line number in a text, else the row number, from 1;
    ``cells`` has per column texts, numbers or ``datetime64``.
    """

    rows: int
    line: npt.NDArray[np.int64]
    cells: Mapping[str, list[str] | npt.NDArray[Any]]


class TableSource(ABC):
    """Reads one table, once, in runs of ``_chunk_rows`` rows.

    ``truncated`` marks a file without its end, ``share`` how much of it
    is read, from 0 to 1. ``time`` is the column that has the time in every
    file of the format, "" where there is none.
    """

    time = ""
    truncated = False
    share = 0.0
    _chunk_rows: int

    def __init__(self, path: Path) -> None:
        """Prepare to read *path*."""
        self._path = path

    @abstractmethod
    def names(self) -> list[str]:
        """Return the names of the columns."""

    def units(self) -> dict[str, str]:
        """Return the unit texts that the table states, by column."""
        return units_in_names(self.names())

    @abstractmethod
    def chunks(self, columns: Collection[str]) -> Iterator[TableChunk]:
        """Yield the cells of *columns* (names of the table) in order.

        Raises :class:`~bstm_daemon.errors.FileAccessError` and, for a
        damaged table, :class:`~bstm_daemon.errors.LogError`.
        """
