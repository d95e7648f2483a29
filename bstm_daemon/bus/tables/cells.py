"""Cells of a signal table as numbers and texts."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import nan
from typing import TYPE_CHECKING, Any, Final

import numpy as np

if TYPE_CHECKING:
    import numpy.typing as npt

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
