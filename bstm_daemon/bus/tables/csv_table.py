"""CSV tables, row by row into chunks of columns."""

from __future__ import annotations

import csv
import gzip
import zlib
from codecs import BOM_UTF8
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.tables.source import TableChunk, TableSource
from bstm_daemon.errors import FileAccessError, LogError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator
    from pathlib import Path
    from typing import BinaryIO

_LINE_LIMIT: Final = 1 << 20
"""Bytes of a line that are read."""
_DELIMITERS: Final = ",;\t|"


class CsvSource(TableSource):
    """A CSV table, plain or packed with gzip.

    The text is UTF-8, or cp1252 where its header is not.
    """

    _chunk_rows = 20_000

    def __init__(
        self,
        path: Path,
        delimiter: str | None,
        refuse: Callable[[RejectReason, int], None],
    ) -> None:
        """Prepare to read *path*; *refuse* counts rows without cells."""
        super().__init__(path)
        self._delimiter = delimiter
        self._refuse = refuse

    def names(self) -> list[str]:
        """Return the names of the columns.

        Raises :class:`FileAccessError`, :class:`LogError`.
        """
        return next(self._read(()))[0]

    def chunks(self, columns: Collection[str]) -> Iterator[TableChunk]:
        """Yield the cells of *columns*; raises as :meth:`names`."""
        rows = self._read(columns)
        next(rows)
        for _, chunk in rows:
            yield chunk

    def _read(
        self, columns: Collection[str]
    ) -> Iterator[tuple[list[str], TableChunk]]:
        """Yield the names and an empty chunk first, then the chunks."""
        try:
            size = max(self._path.stat().st_size, 1)
            with self._path.open("rb") as file:
                lines = self._lines(file)
                header = next(lines, "")
                delimiter = self._delimiter or _likely_delimiter(header)
                names = _cells(header, delimiter)
                yield names, TableChunk(0, np.empty(0, np.int64), {})
                places = {name: names.index(name) for name in columns}
                reader = csv.reader(lines, delimiter=delimiter)
                for chunk in self._chunks(reader, len(names), places):
                    self.share = min(file.tell() / size, 1.0)
                    yield names, chunk
        except (gzip.BadGzipFile, zlib.error) as error:
            msg = f"{self._path}: damaged: {error}"
            raise LogError(msg) from error
        except OSError as error:
            msg = f"{self._path}: cannot be read: {error.strerror or error}"
            raise FileAccessError(msg) from error

    def _lines(self, file: BinaryIO) -> Iterator[str]:
        packed = self._path.suffix.lower() == ".gz"
        stream = (
            cast("BinaryIO", gzip.GzipFile(fileobj=file)) if packed else file
        )
        encoding = ""
        try:
            while raw := stream.readline(_LINE_LIMIT):
                if not encoding:
                    raw = raw.removeprefix(BOM_UTF8)
                    encoding = _encoding(raw)
                yield raw.decode(encoding, "replace")
                while len(raw) == _LINE_LIMIT and not raw.endswith(b"\n"):
                    raw = stream.readline(_LINE_LIMIT)
        except EOFError:
            self.truncated = True

    def _chunks(
        self, reader: Any, width: int, places: dict[str, int]
    ) -> Iterator[TableChunk]:
        kept: list[list[str]] = []
        lines: list[int] = []
        total = 0
        while True:
            try:
                row = next(reader, None)
            except csv.Error:
                row = ["", *[""] * width, ""]
            full = len(kept) >= self._chunk_rows
            if row is None or full:
                cells = {
                    name: [one[place] for one in kept]
                    for name, place in places.items()
                }
                yield TableChunk(total, np.array(lines, np.int64), cells)
                kept, lines, total = [], [], 0
            if row is None:
                return
            total += 1
            # the header is line 1
            line = reader.line_num + 1
            if len(row) == width + 1 and not row[-1].strip():
                row.pop()
            if not any(cell.strip() for cell in row) and len(row) <= width:
                self._refuse(RejectReason.NOT_A_FRAME, line)
            elif len(row) != width:
                self._refuse(RejectReason.MALFORMED, line)
            else:
                kept.append(row)
                lines.append(line)


def _encoding(header: bytes) -> str:
    try:
        header.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def _likely_delimiter(header: str) -> str:
    return max(_DELIMITERS, key=lambda one: len(_cells(header, one)))


def _cells(header: str, delimiter: str) -> list[str]:
    try:
        row = next(csv.reader([header], delimiter=delimiter), [])
    except csv.Error:
        return []
    return [name.strip() for name in row]
