"""Parquet and HDF5 tables, in runs of rows."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bstm_daemon import errors
from bstm_daemon.bus.logs.mf4 import worded_damage
from bstm_daemon.bus.tables.source import TableChunk, TableSource


class BinarySource(TableSource):
    """A table that a library of an extra reads."""

    _chunk_rows = 50_000
    _module: str
    _extra: str
    _kind: str

    def __init__(self, path: Path) -> None:
        """Open *path*.

        Raises :class:`MissingExtraError`, :class:`FileAccessError`,
        :class:`LogError`.
        """
        super().__init__(path)
        try:
            library = import_module(self._module)
        except ImportError as error:
            raise errors.MissingExtraError(
                package=self._module.partition(".")[0],
                extra=self._extra,
                purpose=f"{path}: {self._kind}",
            ) from error
        with naming_damage(path):
            self._open(library)

    @abstractmethod
    def _open(self, library: Any) -> None:
        """Open the file and look at its columns."""


class ParquetSource(BinarySource):
    """A Parquet table (extra ``parquet``)."""

    _module, _extra = "pyarrow.parquet", "parquet"
    _kind = "a Parquet table"

    def _open(self, library: Any) -> None:
        self._file = library.ParquetFile(self._path)

    def names(self) -> list[str]:
        """Return the names of the columns."""
        return [str(name) for name in self._file.schema_arrow.names]

    def chunks(self, columns: Collection[str]) -> Iterator[TableChunk]:
        """Yield the cells of *columns*; raises :class:`LogError`."""
        first = 1
        total = max(self._file.metadata.num_rows, 1)
        batches = self._file.iter_batches(
            self._chunk_rows, columns=list(columns)
        )
        while True:
            with naming_damage(self._path):
                batch = next(batches, None)
                if batch is None:
                    break
                cells = {
                    name: self._cells(name, batch.column(name))
                    for name in columns
                }
            count = batch.num_rows
            self.share = (first - 1 + count) / total
            yield TableChunk(count, np.arange(first, first + count), cells)
            first += count
        self._file.close()

    def _cells(self, name: str, array: Any) -> list[str] | npt.NDArray[Any]:
        from pyarrow import types  # noqa: PLC0415  (an extra)

        kind = array.type
        if types.is_dictionary(kind):
            array = array.dictionary_decode()
            kind = array.type
        if types.is_timestamp(kind):
            nanos = array.cast("timestamp[us]", safe=False)
            return np.asarray(nanos.to_numpy(zero_copy_only=False))
        if types.is_string(kind) or types.is_large_string(kind):
            return [one or "" for one in array.to_pylist()]
        try:
            # what is null becomes nan
            floats = array.cast("float64", safe=False)
        except NotImplementedError as error:
            msg = (
                f"{self._path}: column {name!r} is of type {kind}, neither "
                "numbers nor texts nor times"
            )
            raise errors.LogError(msg) from error
        return np.asarray(floats.to_numpy(zero_copy_only=False))


class Hdf5Source(BinarySource):
    """An HDF5 table (extra ``hdf5``).

    A column is a one-dimensional data set, a field of a compound one, or a
    column of a two-dimensional one whose names stand in a text attribute of
    it, of a group around it or of the file. A name is the path of the data
    set, or its last part where only one data set has it.
    """

    _module, _extra = "h5py", "hdf5"
    _kind = "an HDF5 table"

    def _open(self, library: Any) -> None:
        self._file = library.File(self._path, "r")
        self._columns = self._found(library)

    def names(self) -> list[str]:
        """Return the names of the columns."""
        return list(self._columns)

    def chunks(self, columns: Collection[str]) -> Iterator[TableChunk]:
        """Yield the cells of *columns*.

        Raises :class:`LogError`, also where they differ in length.
        """
        sizes = {name: self._columns[name].size for name in columns}
        if len(set(sizes.values())) > 1:
            listed = ", ".join(f"{n} {size}" for n, size in sizes.items())
            msg = f"{self._path}: columns of different length: {listed}"
            raise errors.LogError(msg)
        total = next(iter(sizes.values()), 0)
        for start in range(0, total, self._chunk_rows):
            end = min(start + self._chunk_rows, total)
            with naming_damage(self._path):
                cells = {
                    name: self._columns[name].read(slice(start, end))
                    for name in columns
                }
            self.share = end / total
            yield TableChunk(end - start, np.arange(start + 1, end + 1), cells)
        self._file.close()

    def _found(self, h5py: Any) -> dict[str, _Column]:
        """Return each column by its name."""
        found: dict[str, _Column] = {}
        short: dict[str, list[_Column]] = {}
        data_sets: list[Any] = []

        def note(_: str, item: Any) -> None:
            if isinstance(item, h5py.Dataset):
                data_sets.append(item)

        self._file.visititems(note)
        for data_set in data_sets:
            path = data_set.name.strip("/")
            for name, column in _columns_of(data_set, self._file).items():
                full = f"{path}/{name}" if name else path
                found[full] = column
                short.setdefault(full.rpartition("/")[2], []).append(column)
        for name, columns in short.items():
            if len(columns) == 1:
                found.setdefault(name, columns[0])
        return found


@dataclass(frozen=True, slots=True)
class _Column:
    """A column of *size* rows: what *index* gives for a run of rows."""

    data_set: Any
    size: int
    index: Callable[[slice], Any]
    field: str | None = None

    def read(self, rows: slice) -> list[str] | npt.NDArray[Any]:
        """Return the cells of *rows*."""
        values = self.data_set[self.index(rows)]
        return _as_cells(values if self.field is None else values[self.field])


def _columns_of(data_set: Any, file: Any) -> dict[str, _Column]:
    """Return the columns in *data_set* by name; "" is the data set itself."""
    shape: tuple[int, ...] = data_set.shape or ()
    if len(shape) == 1:
        fields = data_set.dtype.names
        if fields is None:
            return {"": _Column(data_set, shape[0], _plain)}
        return {
            name: _Column(data_set, shape[0], _plain, name) for name in fields
        }
    if len(shape) != 2:
        return {}
    holder = data_set
    while True:
        for value in holder.attrs.values():
            names = _as_names(value)
            if len(names) in shape:
                by_column = len(names) == shape[1]
                size = shape[0] if by_column else shape[1]
                return {
                    name: _Column(data_set, size, _line_of(i, by_column))
                    for i, name in enumerate(names)
                }
        if holder == file:
            return {}
        holder = holder.parent


def _plain(rows: slice) -> Any:
    return rows


def _line_of(place: int, by_column: bool) -> Callable[[slice], Any]:  # noqa: FBT001
    if by_column:
        return lambda rows: (rows, place)
    return lambda rows: (place, rows)


def _as_names(value: Any) -> list[str]:
    listed = np.asarray(value)
    if listed.ndim != 1 or listed.dtype.kind not in "OSU":
        return []
    return [_text(one).strip() for one in listed.tolist()]


def _as_cells(values: npt.NDArray[Any]) -> list[str] | npt.NDArray[Any]:
    if values.dtype.kind in "biuf" and values.ndim == 1:
        return values
    return [_text(one) for one in values.tolist()]


def _text(one: object) -> str:
    if isinstance(one, bytes):
        return one.decode("utf-8", "replace")
    return str(one)


@contextmanager
def naming_damage(path: Path) -> Iterator[None]:
    """Name *path* in what a library raises of a file."""
    try:
        yield
    except errors.BstmError:
        raise
    except FileNotFoundError as error:
        msg = f"{path}: cannot be read: {error.strerror or error}"
        raise errors.FileAccessError(msg) from error
    except Exception as error:  # they raise anything on damage
        msg = f"{path}: damaged: {worded_damage(error)}"
        raise errors.LogError(msg) from error
