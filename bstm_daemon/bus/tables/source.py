"""Interface of a signal table, independent of its file format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from pathlib import Path

    import numpy as np
    import numpy.typing as npt


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
    is read, from 0 to 1.
    """

    truncated = False
    share = 0.0
    _chunk_rows: int

    def __init__(self, path: Path) -> None:
        """Prepare to read *path*."""
        self._path = path

    @abstractmethod
    def names(self) -> list[str]:
        """Return the names of the columns."""

    @abstractmethod
    def chunks(self, columns: Collection[str]) -> Iterator[TableChunk]:
        """Yield the cells of *columns* (names of the table) in order.

        Raises :class:`~bstm_daemon.errors.FileAccessError` and, for a
        damaged table, :class:`~bstm_daemon.errors.LogError`.
        """
