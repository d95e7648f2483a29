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
    Results,
    csv_file,
    has_parquet,
    parquet_file,
)
from bstm_daemon.replay.results.files import GROUP_ROWS

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
from bstm_daemon.replay.results import Results, csv_file, parquet_file
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


def test_both_files_hold_the_same(results: Results, tmp_path: Path) -> None:
    """CSV to its digits, Parquet to the bit; the same names in one order."""
    from pyarrow import parquet  # noqa: PLC0415

    with (
        csv_file(tmp_path / "r.csv") as text_table,
        parquet_file(tmp_path / "r.parquet") as binary_table,
    ):
        text_table.write(results)
        binary_table.write(results)

    text = read_csv(tmp_path / "r.csv")
    table = parquet.read_table(tmp_path / "r.parquet")
    assert table.column_names == list(text) == list(results.columns)
    digits = {
        "_c": 5e-4,
        "_k": 5e-4,
        "_ms": 5e-4,
        "_w": 0.05,
        "_pa": 0.05,
        "_n": 0.05,
        "_j": 0.05,
        "thickness_m": 5e-8,
        "std_m": 5e-8,
        "loss_m": 5e-8,
        "_s": 0.05,
        "_kg": 5e-3,
    }
    for name, column in results.columns.items():
        binary = table.column(name).to_numpy()
        assert np.array_equal(binary, column, equal_nan=True), name
        near = next(
            (d for end, d in digits.items() if name.endswith(end)), 5e-4
        )
        np.testing.assert_allclose(text[name], column, atol=1.01 * near)


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

    assert not has_parquet()
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
    assert (len(table), table.column_names) == (0, list(results.columns))


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
