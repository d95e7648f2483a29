"""CSV tables: their head, and their rows as chunks of columns.

Loggers write some lines about the session, a row of names and a row of units
before the values. Which row is which follows from the values: the names are
the texts above the first rows of numbers that have as many cells.
"""

import csv
import gzip
import re
import zlib
from codecs import BOM_UTF8
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, islice, pairwise
from pathlib import Path
from typing import Any, BinaryIO, Final, cast

import numpy as np

from bstm_daemon.bus.signals.dbc_text import guess_encoding
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.tables import source
from bstm_daemon.errors import FileAccessError, LogError
from bstm_daemon.units import unit_named

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
        return Head(names, one, units=source.units_in_names(names))
    one, rows, place, first, like = best
    names, below = rows[place], rows[place + 1]
    units = source.units_in_names(names)
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
    unreadable = source.numbers(there).unreadable.tolist()
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


_LINE_LIMIT: Final = 1 << 20
"""Bytes of a line that are read."""
_NUMBER_BEGINS: Final = tuple("+-,0123456789")


class CsvSource(source.TableSource):
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

    def chunks(self, columns: Collection[str]) -> Iterator[source.TableChunk]:
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
    ) -> Iterator[tuple[Head, source.TableChunk]]:
        """Yield the head and an empty chunk first, then the chunks."""
        try:
            size = max(self._path.stat().st_size, 1)
            with self._path.open("rb") as file:
                raw = self._lines(file)
                first = self._first(raw)
                first[:1] = [one.removeprefix(BOM_UTF8) for one in first[:1]]
                encoding = guess_encoding(b"".join(first))
                lines = (
                    one.decode(encoding, "replace")
                    for one in chain(first, raw)
                )
                begin = list(islice(lines, len(first)))
                head = self._head_of(begin)
                yield head, source.TableChunk(0, np.empty(0, np.int64), {})
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
    ) -> Iterator[source.TableChunk]:
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
                yield source.TableChunk(
                    total, np.array(lines, np.int64), cells
                )
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


def _with_points(cells: list[str]) -> list[str]:
    return [
        cell.replace(",", ".") if cell.strip()[:1] in _NUMBER_BEGINS else cell
        for cell in cells
    ]
