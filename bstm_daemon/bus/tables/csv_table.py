"""CSV tables, row by row into chunks of columns."""

from __future__ import annotations

import csv
import gzip
import zlib
from codecs import BOM_UTF8
from functools import cached_property
from itertools import chain, islice
from typing import TYPE_CHECKING, Any, Final, cast

import numpy as np

from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.tables.csv_head import HEAD_LINES, Head, read_head
from bstm_daemon.bus.tables.source import TableChunk, TableSource
from bstm_daemon.errors import FileAccessError, LogError

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator, Sequence
    from pathlib import Path
    from typing import BinaryIO

_LINE_LIMIT: Final = 1 << 20
"""Bytes of a line that are read."""
_NUMBER_BEGINS: Final = tuple("+-,0123456789")


class CsvSource(TableSource):
    """A CSV table, plain or packed with gzip.

    The text is UTF-8, or cp1252 where its head is not.
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
        return self._head.names

    def units(self) -> dict[str, str]:
        """Return the unit texts of names and unit row; raises as names."""
        return self._head.units

    def chunks(self, columns: Collection[str]) -> Iterator[TableChunk]:
        """Yield the cells of *columns*; raises as :meth:`names`."""
        rows = self._read(columns)
        next(rows)
        for _, chunk in rows:
            yield chunk

    @cached_property
    def _head(self) -> Head:
        return next(self._read(()))[0]

    def _read(
        self, columns: Collection[str]
    ) -> Iterator[tuple[Head, TableChunk]]:
        """Yield the head and an empty chunk first, then the chunks."""
        try:
            size = max(self._path.stat().st_size, 1)
            with self._path.open("rb") as file:
                raw = self._lines(file)
                first = self._first(raw)
                first[:1] = [one.removeprefix(BOM_UTF8) for one in first[:1]]
                encoding = _encoding(b"".join(first))
                lines = (
                    one.decode(encoding, "replace")
                    for one in chain(first, raw)
                )
                begin = list(islice(lines, len(first)))
                head = self._head_of(begin)
                yield head, TableChunk(0, np.empty(0, np.int64), {})
                places = {name: head.names.index(name) for name in columns}
                reader = csv.reader(
                    chain(begin[head.lines :], lines),
                    delimiter=head.delimiter,
                    skipinitialspace=head.delimiter == " ",
                )
                for chunk in self._chunks(reader, head, places):
                    self.share = min(file.tell() / size, 1.0)
                    yield head, chunk
        except (gzip.BadGzipFile, zlib.error) as error:
            msg = f"{self._path}: damaged: {error}"
            raise LogError(msg) from error
        except OSError as error:
            msg = f"{self._path}: cannot be read: {error.strerror or error}"
            raise FileAccessError(msg) from error

    def _first(self, raw: Iterator[bytes]) -> list[bytes]:
        """Return the lines that have the head; *raw* is then behind them."""
        return list(islice(raw, HEAD_LINES))

    def _head_of(self, lines: Sequence[str]) -> Head:
        """Return the head in *lines*, what :meth:`_first` gave."""
        return read_head(lines, self._delimiter)

    def _lines(self, file: BinaryIO) -> Iterator[bytes]:
        packed = self._path.suffix.lower() == ".gz"
        stream = (
            cast("BinaryIO", gzip.GzipFile(fileobj=file)) if packed else file
        )
        try:
            while raw := stream.readline(_LINE_LIMIT):
                yield raw
                while len(raw) == _LINE_LIMIT and not raw.endswith(b"\n"):
                    raw = stream.readline(_LINE_LIMIT)
        except EOFError:
            self.truncated = True

    def _chunks(
        self, reader: Any, head: Head, places: dict[str, int]
    ) -> Iterator[TableChunk]:
        width = len(head.names)
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
                if head.decimal_comma:
                    cells = {n: _with_points(one) for n, one in cells.items()}
                yield TableChunk(total, np.array(lines, np.int64), cells)
                kept, lines, total = [], [], 0
            if row is None:
                return
            total += 1
            line = reader.line_num + head.lines
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


def _with_points(cells: list[str]) -> list[str]:
    return [
        cell.replace(",", ".") if cell.strip()[:1] in _NUMBER_BEGINS else cell
        for cell in cells
    ]
