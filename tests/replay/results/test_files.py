"""Tables of estimates on disk: CSV and Parquet."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.errors import FileAccessError, LogError, MissingExtraError
from bstm_daemon.replay.columns import stream_log
from bstm_daemon.replay.results import (
    Chosen,
    Results,
    csv_file,
    is_one_of_few,
    require_format,
)
from bstm_daemon.replay.results.files import (
    GROUP_ROWS,
    TIMESTAMP,
    mf4_file,
    parquet_file,
)
from bstm_daemon.simulation import load_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from pathlib import Path

    import numpy.typing as npt

    from bstm_daemon.replay.results import Sink

FORMS = (csv_file, parquet_file)

FULL = """
import resource, signal, sys
from pathlib import Path
import numpy as np
from bstm_daemon.errors import FileAccessError
from bstm_daemon.replay.results import Results, csv_file
from bstm_daemon.replay.results.files import parquet_file
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
folder = Path(sys.argv[1])
rows = Results({"time_s": np.arange(100_000.0)}, (), ())
try:
    with csv_file(folder / "a.csv") as a, parquet_file(folder / "b") as b:
        a.write(rows)
        b.write(rows)
except FileAccessError as error:
    print(error)
"""


def read_csv(path: Path) -> dict[str, npt.NDArray[np.float64]]:
    """Return the columns of a CSV file; an empty cell is nan."""
    with path.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    table = np.array([[float(c or "nan") for c in row] for row in rows])
    return dict(zip(names, table.T, strict=True))


def steps(name: str) -> tuple[float, float]:
    """Return how far CSV and the binary files may be from the estimate."""
    digits = {
        "_c": (5e-4, 5e-3),
        "_k": (5e-4, 5e-3),
        "_ms": (5e-4, 5e-4),
        **dict.fromkeys(("_w", "_pa", "_n", "_j", "_s"), (0.05, 0.05)),
        **dict.fromkeys(("thickness_m", "std_m", "loss_m"), (5e-8, 5e-8)),
        "_kg": (5e-3, 5e-3),
    }
    found = (d for end, d in digits.items() if name.endswith(end))
    return next(found, (5e-4, 5e-4))


def test_all_files_hold_the_same(results: Results, tmp_path: Path) -> None:
    """To their digits; the same names in one order."""
    from asammdf import MDF  # noqa: PLC0415
    from pyarrow import parquet  # noqa: PLC0415

    with (
        csv_file(tmp_path / "r.csv") as text_table,
        parquet_file(tmp_path / "r.parquet") as binary_table,
        mf4_file(tmp_path / "r.mf4") as measurement,
    ):
        text_table.write(results)
        binary_table.write(results)
        for stretch in results.stretches():
            measurement.write(stretch)

    text = read_csv(tmp_path / "r.csv")
    table = parquet.read_table(tmp_path / "r.parquet")
    assert list(text) == list(results.columns)
    assert table.column_names == [TIMESTAMP, *results.columns]
    with MDF(tmp_path / "r.mf4") as mdf:
        start_s = mdf.start_time.timestamp()
        signals = {one.name: one for one in mdf.iter_channels()}
    assert set(signals) == {*results.columns} - {"time_s"}
    for name, column in results.columns.items():
        near, stored = steps(name)
        # a float of single precision has 24 bits
        finite = np.abs(column[np.isfinite(column)])
        stored += 1e-7 * np.max(finite, initial=0.0)
        binary = table.column(name).to_numpy(zero_copy_only=False)
        np.testing.assert_allclose(text[name], column, atol=1.01 * near)
        np.testing.assert_allclose(binary, column, atol=1.01 * stored)
        if name == "time_s":
            continue
        signal = signals[name]
        values = signal.samples.astype(float)
        if signal.invalidation_bits is not None:
            values[np.asarray(signal.invalidation_bits)] = np.nan
        np.testing.assert_array_equal(values, binary)
        at_s = start_s + signal.timestamps
        np.testing.assert_allclose(at_s, results.columns["time_s"], atol=1e-6)


def test_parquet_says_what_its_columns_are(
    results: Results, tmp_path: Path
) -> None:
    from pyarrow import parquet  # noqa: PLC0415

    with parquet_file(tmp_path / "r.parquet") as table:
        table.write(results)

    file = parquet.ParquetFile(tmp_path / "r.parquet")
    schema = file.schema_arrow
    assert schema.metadata[b"program"].startswith(b"bstm-daemon ")
    assert [
        (name, str(schema.field(name).type), schema.field(name).metadata)
        for name in ("time_s", "FL.disc_c", "FL.validity", "risk_level")
    ] == [
        ("time_s", "double", {b"unit": b"s"}),
        ("FL.disc_c", "float", {b"unit": b"degC"}),
        ("FL.validity", "int16", {b"unit": b""}),
        ("risk_level", "int16", {b"unit": b""}),
    ]
    assert str(schema.field(TIMESTAMP).type) == "timestamp[us, tz=UTC]"
    first = file.read([TIMESTAMP]).column(0)[0].as_py().timestamp()
    assert first == pytest.approx(results.columns["time_s"][0], abs=1e-6)
    group = file.metadata.row_group(0)
    encodings = {
        group.column(i).path_in_schema: group.column(i).encodings
        for i in range(group.num_columns)
    }
    assert "BYTE_STREAM_SPLIT" in encodings["FL.disc_c"]
    assert "DELTA_BINARY_PACKED" in encodings["flags"]


def test_a_temperature_has_no_digits_of_its_unit(tmp_path: Path) -> None:
    """284.45 K less 273.15 is 11.300000000000011 in double precision."""
    from pyarrow import parquet  # noqa: PLC0415

    columns = {"time_s": np.zeros(1), "FL.disc_c": np.array([284.45 - 273.15])}
    with parquet_file(tmp_path / "r.parquet") as table:
        table.write(Results(columns, ("FL",), ("FL",)))

    (cell,) = parquet.read_table(tmp_path / "r.parquet").column("FL.disc_c")
    assert str(np.float32(cell.as_py())) == "11.3"


@pytest.mark.slow
@pytest.mark.full
def test_85_minutes_of_parquet_are_small(tmp_path: Path, car: Path) -> None:
    """19.7 MB in double precision; the log takes as much."""
    path = tmp_path / "simalp.log"
    encoder = Encoder(car.parents[1] / "dbc" / "example_vehicle.dbc")
    write_candump(path, simulate(load_drive("simalp"), sensors="n2"), encoder)
    with (
        parquet_file(tmp_path / "all") as table,
        parquet_file(tmp_path / "few") as few,
    ):
        chosen = Chosen(few, is_one_of_few)
        stream_log(*load_vehicle(car), path, [table, chosen])

    assert (tmp_path / "all").stat().st_size < 4_000_000
    assert (tmp_path / "few").stat().st_size < 2_000_000


def test_csv_has_an_empty_cell_for_what_is_not_there(
    results: Results, tmp_path: Path
) -> None:
    """No word that a spreadsheet would take for text."""
    gap = dict(results.columns)
    gap["FL.disc_measured_c"] = np.full(len(results), np.nan)
    with csv_file(tmp_path / "r.csv") as table:
        table.write(Results(gap, results.corners, results.modelled))

    text = (tmp_path / "r.csv").read_text(encoding="utf-8")
    header, *rows = text.splitlines()
    at = header.split(",").index("FL.disc_measured_c")
    assert {row.split(",")[at] for row in rows} == {""}
    assert "nan" not in text
    assert rows[0].startswith("1700000000.")


def test_files_that_can_not_be_written(
    tmp_path: Path,
) -> None:
    """A missing folder is an access error for both forms."""
    for form in FORMS:
        with (
            pytest.raises(FileAccessError, match="cannot be written"),
            form(tmp_path / "none" / "r"),
        ):
            pytest.fail("opened")


def test_parquet_without_pyarrow(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The extra is named; nothing is written."""
    monkeypatch.setitem(sys.modules, "pyarrow", None)

    with pytest.raises(MissingExtraError):
        require_format("parquet")
    with (
        pytest.raises(MissingExtraError, match=r"bstm-daemon\[parquet\]"),
        parquet_file(tmp_path / "r.parquet"),
    ):
        pytest.fail("opened")
    assert list(tmp_path.iterdir()) == []


def long_results(rows: int) -> Results:
    """Return *rows* rows of a few columns."""
    rng = np.random.default_rng(rows)
    columns = {
        "time_s": 1.7e9 + 0.1 * np.arange(rows),
        "speed_ms": rng.normal(20.0, 5.0, rows),
        "FL.disc_c": rng.normal(200.0, 50.0, rows),
    }
    return Results(columns, ("FL",), ("FL",))


@pytest.mark.parametrize("rows", [1, GROUP_ROWS, 3 * GROUP_ROWS + 5])
def test_written_in_stretches_or_at_once(tmp_path: Path, rows: int) -> None:
    """The same bytes; Parquet in row groups of one size."""
    from pyarrow import parquet  # noqa: PLC0415

    results = long_results(rows)
    for form in FORMS:
        with form(tmp_path / "whole") as table:
            table.write(results)
        with form(tmp_path / "parts") as table:
            for stretch in results.stretches():
                table.write(stretch)
        whole = (tmp_path / "whole").read_bytes()
        assert (tmp_path / "parts").read_bytes() == whole

    groups = parquet.ParquetFile(tmp_path / "parts").metadata
    sizes = [
        groups.row_group(i).num_rows for i in range(groups.num_row_groups)
    ]
    assert set(sizes[:-1]) <= {GROUP_ROWS}
    assert sum(sizes) == rows


def test_results_without_a_row_are_columns(tmp_path: Path) -> None:
    """A table of no rows is one that can be read."""
    from pyarrow import parquet  # noqa: PLC0415

    results = long_results(0)
    for form, name in zip(FORMS, ("r.csv", "r.parquet"), strict=True):
        with form(tmp_path / name) as table:
            table.write(results)

    assert (tmp_path / "r.csv").read_text() == "time_s,speed_ms,FL.disc_c\n"
    table = parquet.read_table(tmp_path / "r.parquet")
    assert (len(table), table.column_names) == (
        0,
        [TIMESTAMP, *results.columns],
    )


def _begin_and_fail(
    folder: Path, table: Sink, rows: Results, error: type[BaseException]
) -> None:
    table.write(rows)
    assert sum(file.stat().st_size for file in folder.iterdir()) > 10_000
    raise error


@pytest.mark.parametrize("error", [KeyboardInterrupt, LogError])
def test_half_a_table_never_stands(
    tmp_path: Path, error: type[BaseException]
) -> None:
    """What was there stays, and nothing else is left."""
    results = long_results(2 * GROUP_ROWS)
    for form in FORMS:
        path = tmp_path / "table"
        path.write_text("old")
        with pytest.raises(error), form(path) as table:
            _begin_and_fail(tmp_path, table, results, error)
        assert path.read_text() == "old"
        assert [f.name for f in tmp_path.iterdir()] == ["table"]


@pytest.mark.slow
@pytest.mark.skipif(
    not hasattr(os, "fork"), reason="needs a limit on file sizes"
)
def test_a_full_disk_names_the_table(tmp_path: Path) -> None:
    """With several open, the one that could not be written."""
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )

    assert done.stdout.split("\n")[0] == (
        f"{tmp_path / 'a.csv'}: cannot be written: File too large"
    )
    assert list(tmp_path.iterdir()) == []


def test_streamed_rows_are_those_in_memory(
    results: Results, log: Path, car: Path, tmp_path: Path
) -> None:
    """A replay into a table writes what a replay into memory holds."""
    for form in FORMS:
        with form(tmp_path / "kept") as table:
            table.write(results)
        with form(tmp_path / "streamed") as table:
            stream_log(*load_vehicle(car), log, [table])
        kept = (tmp_path / "kept").read_bytes()
        assert (tmp_path / "streamed").read_bytes() == kept
