"""Results as CSV and Parquet, written as the rows come.

A file stands under its name when all rows are in it, and not before.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.errors import FileAccessError, require_packages
from bstm_daemon.files import replacing

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import TextIO

    from bstm_daemon.replay.results.rows import Results, Sink

GROUP_ROWS: Final = 4096
"""Rows of a Parquet row group: some 3 MB that are held until it is full."""


_FORMS: Final = {
    ("validity", "reasons", "flags", "_level"): "%.0f",
    ("thickness_m", "std_m", "loss_m"): "%.7f",
    ("_c", "_k", "_ms", "_m"): "%.3f",
    ("_w", "_pa", "_n", "_j", "_s"): "%.1f",
}
"""Form of a column's values by the end of its name, the first that fits."""


@contextmanager
def csv_file(path: Path) -> Iterator[Sink]:
    """Give a sink that writes CSV: a header, then a row a publication.

    A value that is not there is an empty cell. *path* is replaced at the
    end; on any exception it stays as it was.

    Raises:
        FileAccessError: *path* can not be written.
    """
    with (
        replacing(path) as temporary,
        temporary.open("w", encoding="utf-8") as file,
    ):
        yield _CsvSink(path, file)


@contextmanager
def parquet_file(path: Path) -> Iterator[Sink]:
    """Give a sink that writes Parquet, else like :func:`csv_file`.

    Raises:
        MissingExtraError: pyarrow is not installed.
        FileAccessError: *path* can not be written.
    """
    require_packages("pyarrow", extra="parquet", purpose="--format parquet")
    with replacing(path) as temporary:
        sink = _ParquetSink(path, temporary)
        try:
            yield sink
            sink.write_rest()
        finally:
            sink.close()


def has_parquet() -> bool:
    """Whether Parquet can be written here."""
    from importlib.util import find_spec  # noqa: PLC0415

    return find_spec("pyarrow") is not None


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Name *path* in an error of writing: other files may be open too."""
    try:
        yield
    except OSError as error:
        msg = f"{path}: cannot be written: {error.strerror or error}"
        raise FileAccessError(msg) from error


class _CsvSink:
    def __init__(self, path: Path, file: TextIO) -> None:
        self._path = path
        self._file = file
        self._form = ""

    def write(self, rows: Results) -> None:
        names = list(rows.columns)
        with _named(self._path):
            if not self._form:
                self._form = ",".join(map(_format, names)) + "\n"
                self._file.write(",".join(names) + "\n")
            for stretch in rows.stretches():
                table = np.column_stack(list(stretch.columns.values()))
                self._file.writelines(
                    (self._form % tuple(row)).replace("nan", "")
                    for row in table.tolist()
                )


class _ParquetSink:
    def __init__(self, path: Path, temporary: Path) -> None:
        self._path = path
        self._temporary = temporary
        self._writer: Any = None
        self._waiting: Any = None

    def write(self, rows: Results) -> None:
        import pyarrow as pa  # noqa: PLC0415  (an extra, loaded when needed)

        table = pa.table(rows.columns)
        if self._waiting is not None:
            table = pa.concat_tables([self._waiting, table])
        while len(table) >= GROUP_ROWS:
            self._write_group(table.slice(0, GROUP_ROWS))
            table = table.slice(GROUP_ROWS)
        self._waiting = table

    def write_rest(self) -> None:
        """Write the last group, or the columns alone if there is no row."""
        if self._waiting is not None and (
            len(self._waiting) or self._writer is None
        ):
            self._write_group(self._waiting)

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()

    def _write_group(self, table: Any) -> None:
        from pyarrow import parquet  # noqa: PLC0415

        with _named(self._path):
            if self._writer is None:
                self._writer = parquet.ParquetWriter(
                    self._temporary,
                    table.schema,
                    compression="zstd",
                    use_dictionary=False,
                    use_byte_stream_split=True,
                    # of the others they would be most of the file's end,
                    # which is kept in memory
                    write_statistics=["time_s"],
                )
            self._writer.write_table(table)


def _format(name: str) -> str:
    if name == "time_s":
        return "%.6f"
    return next(
        (form for ends, form in _FORMS.items() if name.endswith(ends)), "%.6g"
    )
