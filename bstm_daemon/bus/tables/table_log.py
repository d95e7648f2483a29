"""A signal table as samples, the counterpart of frames through a DBC.

A row gives a sample for each role whose cell has a number, at the time of
the row, in the order of the configuration.
"""

from bisect import insort
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
import structlog

from bstm_daemon.bus.logs.reader import LINES_KEPT
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.bus.signals.reject_reason import RejectReason, listed
from bstm_daemon.bus.tables import binary, source
from bstm_daemon.bus.tables.channels import Mf4Source, XrkSource
from bstm_daemon.bus.tables.csv_table import CsvSource
from bstm_daemon.bus.tables.table_plan import ColumnOutput, TableMap
from bstm_daemon.bus.tables.time_axis import TimeAxis
from bstm_daemon.bus.tables.vbo import VboSource
from bstm_daemon.errors import LISTED_NAMES, LogError, hint
from bstm_daemon.roles import ROLES
from bstm_daemon.units import UNITS, unit_named

_BINARY: Final[dict[str, type[binary.BinarySource]]] = {
    ".h5": binary.Hdf5Source,
    ".hdf5": binary.Hdf5Source,
    ".mf4": Mf4Source,
    ".parquet": binary.ParquetSource,
    ".xrk": XrkSource,
    ".xrz": XrkSource,
}
_NAMES_KEPT: Final = 1000

_log = structlog.get_logger(__name__)


class TableReader:
    """Reads one signal table, once.

    ``lines`` counts rows, the header not among them, ``frames`` the rows
    with a time and ``refused`` the other rows by reason, so that they add
    up. ``counts`` has the refused cells: unreadable numbers and values out
    of range. ``first_refused`` keeps the first line numbers (of a binary
    table the row numbers) of each reason, cells included. ``time`` has
    unit and laps. ``interfaces`` and ``seen`` are empty: a table has no
    frames.
    """

    def __init__(self, path: Path, table_map: TableMap) -> None:
        """Open *path*; raises what its source raises."""
        self.path = path
        self.interfaces: list[str] = []
        self.seen: Counter[tuple[int, int, bool]] = Counter()
        self.lines = 0
        self.frames = 0
        self.refused: Counter[RejectReason] = Counter()
        self.counts: Counter[RejectReason] = Counter()
        self.first_refused: dict[RejectReason, list[int]] = {}
        self._table = table_map.table
        self._outputs = table_map.outputs
        self._source = open_source(path, self._table.delimiter, self._refuse)
        column = self._table.time or ""
        self._units = self._source.units()
        stated = self._units.get(column, "")
        self.time = TimeAxis(self._table.time_unit, column, stated)
        self._named: Counter[str] = Counter()

    @property
    def truncated(self) -> bool:
        """Whether the file's end is missing."""
        return self._source.truncated

    @property
    def share(self) -> float:
        """How much of the file is read, from 0 to 1."""
        return self._source.share

    def events(self) -> Iterator[Events]:
        """Yield the samples in chunks of rows.

        Raises :class:`LogError` for columns that are not there, for a
        damaged table and, at the end, for one without a single sample;
        :class:`~bstm_daemon.errors.FileAccessError`.
        """
        columns = self._columns()
        samples = 0
        for chunk in self._source.chunks(columns):
            events = self._events(chunk)
            samples += len(events)
            yield events
        self._tell()
        if not samples:
            msg = f"{self.path}: {self._why_empty()}"
            raise LogError(msg)

    def _columns(self) -> list[str]:
        """Return the columns to read; all must be there, once."""
        table = self._table
        wanted = {
            name: f"[table] {key}"
            for key, name in (
                ("time", table.time),
                ("name", table.name),
                ("value", table.value),
            )
            if name is not None
        }
        if table.name is None:
            for output in self._outputs:
                key = f"[signals.{_role(output)}] column"
                wanted.setdefault(output.column, key)
        names = self._source.names()
        problems = []
        for name, key in wanted.items():
            if name not in names:
                problems.append(f"{key} = {name!r}, {hint(name, names, '')}")
            elif names.count(name) > 1:
                problems.append(f"{key} = {name!r} occurs twice")
        if problems:
            msg = f"{self.path}: no such column: {'; '.join(problems)}"
            raise LogError(msg)
        for output in self._outputs:
            text = self._units.get(output.column, "")
            stated = unit_named(text)
            if stated and output.unit and UNITS[stated] != UNITS[output.unit]:
                _log.warning(
                    "unit differs from the table's",
                    log=str(self.path),
                    column=output.column,
                    role=_role(output),
                    unit=output.unit,
                    table_unit=text,
                )
        return list(wanted)

    def _events(self, chunk: source.TableChunk) -> Events:
        self.lines += chunk.rows
        if self._table.time is None:
            step_us = 1e6 / (self._table.rate_hz or 1.0)
            row = np.arange(self.frames, self.frames + len(chunk.line))
            stamps = np.round(row * step_us).astype(np.int64)
            timed = np.ones(len(row), np.bool_)
        else:
            stamps, timed = self.time.stamps(chunk.cells[self._table.time])
        for line in chunk.line[~timed].tolist():
            self._refuse(RejectReason.MALFORMED, line)
        self.frames += int(np.count_nonzero(timed))
        counts: Counter[RejectReason] = Counter()
        rows, roles, values = [], [], []
        for output, picked in self._picked(chunk, timed):
            cells = source.numbers(_at(chunk, self._column(output), picked))
            kept, value, outside = _judged(output, cells.value)
            for reason, which in (
                (RejectReason.NOT_A_NUMBER, cells.unreadable),
                (RejectReason.OUT_OF_RANGE, outside),
            ):
                lines = chunk.line[picked][which]
                if len(lines):
                    counts[reason] += len(lines)
                    for line in lines[:LINES_KEPT].tolist():
                        self._keep(reason, line)
            rows.append(picked[kept])
            roles.append(np.full(len(value), output.role, np.int32))
            values.append(value)
        self.counts.update(counts)
        row = np.concatenate(rows)
        order = np.argsort(row, kind="stable")
        return Events(
            stamps[row][order],
            np.concatenate(roles)[order],
            np.concatenate(values)[order],
            counts,
        )

    def _picked(
        self, chunk: source.TableChunk, timed: npt.NDArray[np.bool_]
    ) -> Iterator[tuple[ColumnOutput, npt.NDArray[np.int64]]]:
        """Yield for each role the rows that may have a value of it."""
        if self._table.name is None:
            every = np.flatnonzero(timed)
            for output in self._outputs:
                yield output, every
            return
        names = source.texts(chunk.cells[self._table.name])
        if len(self._named) < _NAMES_KEPT:
            self._named.update(names)
        for output in self._outputs:
            here = np.fromiter(
                (name == output.column for name in names), np.bool_, len(names)
            )
            yield output, np.flatnonzero(here & timed)

    def _column(self, output: ColumnOutput) -> str:
        return self._table.value or output.column

    def _refuse(self, reason: RejectReason, line: int) -> None:
        self.refused[reason] += 1
        self._keep(reason, line)

    def _keep(self, reason: RejectReason, line: int) -> None:
        # rows are split, timed and read column by column, so later lines
        # may come before earlier ones
        first = self.first_refused.setdefault(reason, [])
        if line not in first:
            insort(first, line)
            del first[LINES_KEPT:]

    def _tell(self) -> None:
        """Log what was found out rather than configured."""
        if self.time.found_by:
            _log.info(
                "time unit found",
                log=str(self.path),
                column=self._table.time,
                time_unit=self.time.unit,
                by=self.time.found_by,
            )
        if self.time.laps_joined:
            _log.info(
                "laps joined", log=str(self.path), count=self.time.laps_joined
            )

    def _why_empty(self) -> str:
        if not self.lines:
            return "the table has no row"
        refused = listed(self.refused + self.counts)
        lines = sorted(chain.from_iterable(self.first_refused.values()))[
            :LINES_KEPT
        ]
        where = (
            f", first in line {', '.join(map(str, lines))}" if lines else ""
        )
        text = (
            f"no sample in {self.lines} rows ({refused or 'all empty'}{where})"
        )
        if self._table.name is not None:
            expected = ", ".join(one.column for one in self._outputs)
            seen = ", ".join(
                name for name, _ in self._named.most_common(LISTED_NAMES)
            )
            text += f": {expected} expected, {seen} seen"
        return text


def open_source(
    path: Path,
    delimiter: str | None,
    refuse: Callable[[RejectReason, int], None],
) -> source.TableSource:
    """Return the source of the table *path*, by its ending.

    Args:
        path: the file.
        delimiter: between the cells of a CSV table, None to find it.
        refuse: counts rows of a text without cells, with their line.

    Raises:
        FileAccessError: it cannot be read.
        LogError: it is damaged.
        MissingExtraError: a package is missing.
    """
    ending = Path(path.name.lower().removesuffix(".gz")).suffix
    if ending in _BINARY:
        return _BINARY[ending](path)
    if ending == ".vbo":
        return VboSource(path, None, refuse)
    is_tsv = ending == ".tsv"
    return CsvSource(path, delimiter or ("\t" if is_tsv else None), refuse)


def _role(output: ColumnOutput) -> str:
    known = 0 <= output.role < len(ROLES)
    return ROLES[output.role].name if known else str(output.role)


def _at(
    chunk: source.TableChunk, column: str, rows: npt.NDArray[np.int64]
) -> list[str] | npt.NDArray[np.float64]:
    cells = chunk.cells[column]
    if not isinstance(cells, list):
        return cells[rows]
    if len(rows) == len(cells):
        return cells
    return [cells[row] for row in rows.tolist()]


def _judged(
    output: ColumnOutput, cells: npt.NDArray[np.float64]
) -> tuple[
    npt.NDArray[np.bool_], npt.NDArray[np.float64], npt.NDArray[np.bool_]
]:
    """Return which cells are samples, these in SI, and which are outside."""
    with np.errstate(all="ignore"):
        value = output.gain * cells + output.bias
    there = ~np.isnan(cells)
    good = there & (output.low <= value) & (value <= output.high)
    value = value[good]
    if output.flag:
        value = (value != 0).astype(np.float64)
    return good, value, there & ~good
