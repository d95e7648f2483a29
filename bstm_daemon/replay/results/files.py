"""Results as CSV, Parquet and MF4, written as the rows come.

A file stands under its name when all rows are in it, and not before.
"""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple, TextIO

import numpy as np
import numpy.typing as npt

from bstm_daemon import __version__
from bstm_daemon.errors import FileAccessError, require_packages
from bstm_daemon.files import replacing
from bstm_daemon.replay.results.rows import ADVICE_CODES, Part, Results, Sink

GROUP_ROWS: Final = 4096
"""Rows of a Parquet row group: some 3 MB that are held until it is full."""

ZSTD_LEVEL: Final = 5
"""Level 9 takes 3 % longer for a replay and 2 % less space."""

TIMESTAMP: Final = "timestamp"
"""Column of Parquet: ``time_s`` as a date in UTC."""


class Form(NamedTuple):
    """How the values of a column are written.

    ``decimals`` of CSV, None for six significant digits, and those of the
    binary files; ``whole`` numbers are integers there.
    """

    decimals: int | None
    stored: int | None
    unit: str
    whole: bool = False


_FORMS: Final = {
    ("validity", "reasons", "flags", "_level", *ADVICE_CODES): (
        Form(0, 0, "", whole=True)
    ),
    ("_thickness_m", "_std_m", "_loss_m"): Form(7, 7, "m"),
    ("_c",): Form(3, 2, "degC"),
    ("_k",): Form(3, 2, "K"),
    ("time_s",): Form(6, 6, "s"),
    ("_ms2",): Form(None, None, "m/s2"),
    ("_ms",): Form(3, 3, "m/s"),
    ("_m",): Form(3, 3, "m"),
    ("_w",): Form(1, 1, "W"),
    ("_pa",): Form(1, 1, "Pa"),
    ("_n",): Form(1, 1, "N"),
    ("_j",): Form(1, 1, "J"),
    ("_s",): Form(1, 1, "s"),
    ("_kg",): Form(None, None, "kg"),
    ("_percent",): Form(None, None, "%"),
    ("",): Form(None, None, ""),
}
"""Form of a column by the end of its name, the first that fits."""

_EXACT: Final = ("time_s", "distance_m")
"""Columns that single precision does not hold."""

_SIGNIFICANT: Final = 6


@cache
def form_of(name: str) -> Form:
    """Return how the column *name* is written."""
    return next(f for ends, f in _FORMS.items() if name.endswith(ends))


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
    require_format("parquet")
    with replacing(path) as temporary:
        sink = _ParquetSink(path, temporary)
        try:
            yield sink
            sink.write_rest()
        finally:
            sink.close()


@contextmanager
def mf4_file(path: Path) -> Iterator[Sink]:
    """Give a sink that writes MF4, else like :func:`csv_file`.

    The channels are on the log's own time: the file begins at the stamp of
    the first row, to the microsecond.

    Raises:
        MissingExtraError: asammdf is not installed.
        FileAccessError: *path* can not be written.
    """
    require_format("mf4")
    from asammdf import MDF  # noqa: PLC0415  (an extra, loaded when needed)

    with replacing(path) as temporary, MDF(version="4.10") as mdf:
        sink = _Mf4Sink(mdf)
        yield sink
        with _named(path):
            # the ending is the library's condition
            saved = temporary.with_name(f"{temporary.name}.mf4")
            try:
                mdf.save(saved, compression=2, overwrite=True)
                saved.replace(temporary)
            finally:
                saved.unlink(missing_ok=True)


WRITERS: Final[dict[str, Callable[[Path], AbstractContextManager[Sink]]]] = {
    "csv": csv_file,
    "parquet": parquet_file,
    "mf4": mf4_file,
}
"""Sink of a file by its ending."""

_PACKAGES: Final = {"parquet": "pyarrow", "mf4": "asammdf"}


def require_format(form: str) -> None:
    """Refuse the format *form* where its package is absent.

    Raises:
        MissingExtraError: it is; extra and format have one name.
    """
    if form in _PACKAGES:
        purpose = f"--format {form}"
        require_packages(_PACKAGES[form], extra=form, purpose=purpose)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Name *path* in an error of writing: other files may be open too."""
    try:
        yield
    except OSError as error:
        msg = f"{path}: cannot be written: {error.strerror or error}"
        raise FileAccessError(msg) from error


class _CsvSink:
    parts = Part.ALL

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
    parts = Part.ALL

    def __init__(self, path: Path, temporary: Path) -> None:
        self._path = path
        self._temporary = temporary
        self._schema: Any = None
        self._writer: Any = None
        self._waiting: Any = None

    def write(self, rows: Results) -> None:
        import pyarrow as pa  # noqa: PLC0415  (an extra, loaded when needed)

        time_us = np.rint(rows.columns["time_s"] * 1e6).astype(np.int64)
        arrays = [pa.array(time_us, pa.timestamp("us", "UTC"))]
        for name, column in rows.columns.items():
            values, absent = _stored(name, column)
            arrays.append(pa.array(values, mask=absent))
        if self._schema is None:
            fields = [pa.field(TIMESTAMP, arrays[0].type)]
            for name, values in zip(rows.columns, arrays[1:], strict=True):
                unit = {"unit": form_of(name).unit}
                fields.append(pa.field(name, values.type, metadata=unit))
            about = {"program": f"bstm-daemon {__version__}"}
            self._schema = pa.schema(fields, metadata=about)
        table = pa.table(arrays, self._schema)
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
        from pyarrow import parquet, types  # noqa: PLC0415

        with _named(self._path):
            if self._writer is None:
                encodings = {
                    field.name: "BYTE_STREAM_SPLIT"
                    if types.is_floating(field.type)
                    else "DELTA_BINARY_PACKED"
                    for field in table.schema
                }
                self._writer = parquet.ParquetWriter(
                    self._temporary,
                    table.schema,
                    compression="zstd",
                    compression_level=ZSTD_LEVEL,
                    use_dictionary=False,
                    column_encoding=encodings,
                    # of the others they would be most of the file's end,
                    # which is kept in memory
                    write_statistics=[TIMESTAMP, "time_s"],
                )
            self._writer.write_table(table)


class _Mf4Sink:
    parts = Part.ALL

    def __init__(self, mdf: Any) -> None:
        self._mdf = mdf
        self._start_us: int | None = None

    def write(self, rows: Results) -> None:
        from asammdf import Signal  # noqa: PLC0415  (an extra)

        time_us = np.rint(rows.columns["time_s"] * 1e6).astype(np.int64)
        begun = self._start_us is not None
        if self._start_us is None:
            self._start_us = int(time_us[0]) if len(time_us) else 0
            seconds, micros = divmod(self._start_us, 1_000_000)
            start = datetime.fromtimestamp(seconds, UTC)
            self._mdf.start_time = start.replace(microsecond=micros)
        time_s = (time_us - self._start_us) * 1e-6
        stored = {
            name: _stored(name, column)
            for name, column in rows.columns.items()
            if name != "time_s"
        }
        if begun:
            self._mdf.extend(0, [(time_s, None), *stored.values()])
            return
        self._mdf.append(
            [
                Signal(
                    values,
                    time_s,
                    name=name,
                    unit=form_of(name).unit,
                    invalidation_bits=absent,
                )
                for name, (values, absent) in stored.items()
            ],
            acq_name="estimates",
            comment=f"bstm-daemon {__version__}",
            common_timebase=True,
        )


def _stored(
    name: str, column: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[Any], npt.NDArray[np.bool_] | None]:
    """Return the values of a binary file, and where an integer is absent.

    They have no more digits than the estimate is worth, so that they take
    little room; a float that is absent is NaN.
    """
    form = form_of(name)
    if form.whole:
        absent = np.isnan(column)
        codes = np.where(absent, 0.0, column)
        return codes.astype("i8" if name == "flags" else "i2"), absent
    scale: Any
    if form.stored is None:
        known = np.isfinite(column) & (column != 0.0)
        size = np.log10(np.abs(column, where=known, out=np.ones(len(column))))
        scale = 10.0 ** (_SIGNIFICANT - 1 - np.floor(size))
    else:
        scale = 10.0**form.stored
    rounded = np.rint(column * scale) / scale
    return rounded.astype("f8" if name in _EXACT else "f4"), None


def _format(name: str) -> str:
    decimals = form_of(name).decimals
    return f"%.{_SIGNIFICANT}g" if decimals is None else f"%.{decimals}f"
