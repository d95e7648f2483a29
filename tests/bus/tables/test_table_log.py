"""Signal tables: every format gives the same samples."""

import gzip
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from structlog.testing import capture_logs

from bstm_daemon.bus.opening import EventLog, open_log
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.tables.table_log import TableReader
from bstm_daemon.bus.tables.table_plan import TableMap, compile_sources
from bstm_daemon.config.sections import SignalConfig, TableConfig
from bstm_daemon.errors import BstmError, LogError
from bstm_daemon.roles import ROLE_INDEX

SIGNALS = {
    "vehicle_speed": {"column": "v", "unit": "km/h"},
    "primary_pressure": {"column": "p", "unit": "bar", "offset": 1.0},
    "brake_switch": {"column": "b", "unit": "bool"},
}
SPEED, PRESSURE, SWITCH = (ROLE_INDEX[role] for role in SIGNALS)


def table_map(
    signals: dict[str, dict[str, Any]] | None = None, **table: Any
) -> TableMap:
    """Return the plan of *signals*, with the time in column t."""
    made = compile_sources(
        [],
        {
            role: SignalConfig(**one)
            for role, one in (signals or SIGNALS).items()
        },
        TableConfig(**({"time": "t", "time_unit": "s"} | table)),
        Path(),
        0.3,
    )
    assert isinstance(made, TableMap)
    return made


def samples(
    path: Path, plan: TableMap | None = None
) -> tuple[TableReader, list[tuple[int, int, float]]]:
    log = EventLog(path, plan or table_map())
    listed = [
        sample
        for events in log.events()
        for sample in zip(
            events.time_us.tolist(),
            events.role.tolist(),
            events.value.tolist(),
            strict=True,
        )
    ]
    assert isinstance(log.reader, TableReader)
    assert log.counts == log.reader.counts
    reader = log.reader
    assert reader.lines == reader.frames + sum(reader.refused.values())
    return reader, listed


def write(folder: Path, text: str, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8", newline="")
    return path


TIMES = [0.0, 0.02, 0.04, 0.06]
COLUMNS: dict[str, list[float | None]] = {
    "t": list(TIMES),
    "v": [36.0, None, 72.0, 72.0],
    "p": [-1.0, 9.0, None, None],
    "b": [0.0, 1.0, 1.0, None],
    "other": [1.0, 2.0, 3.0, 4.0],
}
EXPECTED = [
    *((0, SPEED, 10.0), (0, PRESSURE, 0.0), (0, SWITCH, 0.0)),
    *((20_000, PRESSURE, 1e6), (20_000, SWITCH, 1.0)),
    *((40_000, SPEED, 20.0), (40_000, SWITCH, 1.0)),
    (60_000, SPEED, 20.0),
]


def csv_text(delimiter: str = ",") -> str:
    rows = zip(*COLUMNS.values(), strict=True)
    lines = [delimiter.join(COLUMNS)] + [
        delimiter.join("" if cell is None else f"{cell:g}" for cell in row)
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def hdf5_columns() -> dict[str, np.ndarray]:
    return {
        name: np.array([np.nan if x is None else x for x in column])
        for name, column in COLUMNS.items()
    }


def write_format(folder: Path, kind: str) -> Path:
    """Write the table in a format."""
    if kind in (",", ";", "\t", "|"):
        return write(folder, csv_text(kind))
    if kind == "quoted":
        text = csv_text().replace("\n", "\r\n").replace("36", '"36"')
        return write(folder, "\ufeff" + text)
    if kind == "gz":
        path = folder / "a.csv.gz"
        path.write_bytes(gzip.compress(csv_text().encode()))
        return path
    if kind == "tsv":
        return write(folder, csv_text("\t"), "a.tsv")
    if kind.startswith("parquet"):
        pa = pytest.importorskip("pyarrow")
        import pyarrow.parquet as pq  # noqa: PLC0415

        path = folder / "a.parquet"
        made = pa.table(COLUMNS)
        if kind == "parquet texts":
            text = {
                name: ["" if x is None else f"{x:g}" for x in column]
                for name, column in COLUMNS.items()
            }
            made = pa.table(text)
        pq.write_table(made, path)
        return path
    return write_hdf5(folder, kind)


def write_hdf5(folder: Path, kind: str) -> Path:
    """Write the table as one of the forms of HDF5."""
    h5py = pytest.importorskip("h5py")
    path = folder / "a.hdf5"
    columns = hdf5_columns()
    with h5py.File(path, "w") as file:
        if kind == "hdf5 sets":
            group = file.create_group("run")
            for name, column in columns.items():
                group[name] = column
        elif kind == "hdf5 compound":
            file["run"] = np.rec.fromarrays(
                list(columns.values()), names=",".join(columns)
            )
        else:
            matrix = np.column_stack(list(columns.values()))
            if kind == "hdf5 rows":
                matrix = matrix.T
            file["data"] = matrix
            file.attrs["channel_names"] = list(columns)
    return path


@pytest.mark.parametrize(
    "kind",
    [
        *(",", ";", "\t", "|", "quoted", "gz", "tsv", "parquet"),
        *("parquet texts", "hdf5 sets", "hdf5 compound", "hdf5 matrix"),
        "hdf5 rows",
    ],
)
def test_a_table_gives_its_samples(tmp_path: Path, kind: str) -> None:
    reader, listed = samples(write_format(tmp_path, kind))

    assert [one[:2] for one in listed] == [one[:2] for one in EXPECTED]
    assert [one[2] for one in listed] == pytest.approx(
        [one[2] for one in EXPECTED]
    )
    assert reader.lines == reader.frames == 4
    assert reader.share == 1.0
    assert not reader.counts
    assert not reader.truncated


def test_chunks_are_bounded_and_join(tmp_path: Path) -> None:
    rows = "".join(f"{n},{n % 200},,\n" for n in range(45_000))
    path = write(tmp_path, "t,v,p,b\n" + rows)

    log = EventLog(path, table_map())
    chunks = list(log.events())

    assert [len(one) for one in chunks] == [20_000, 20_000, 5_000]
    times = np.concatenate([one.time_us for one in chunks])
    assert np.array_equal(times, np.arange(45_000) * 1_000_000)


def test_unreadable_cells_are_counted_with_their_lines(
    tmp_path: Path,
) -> None:
    plan = table_map(
        {"vehicle_speed": {"column": "v", "unit": "km/h", "max": 400.0}}
    )
    path = write(
        tmp_path,
        "t,v\n0,36\n1,abc\n2,1_0\n\nx,36\n4,500\n5,inf\n6, 72 \n7,1,1\n8,nan\n"
        "9\n10,٣\n11,-nan\n",
    )

    reader, listed = samples(path, plan)

    assert listed == [
        (0, SPEED, pytest.approx(10)),
        (6_000_000, SPEED, pytest.approx(20)),
    ]
    assert reader.counts == {
        RejectReason.NOT_A_NUMBER: 3,
        RejectReason.OUT_OF_RANGE: 2,
    }
    assert reader.refused == {
        RejectReason.NOT_A_FRAME: 1,
        RejectReason.MALFORMED: 3,
    }
    assert reader.first_refused == {
        RejectReason.NOT_A_NUMBER: [3, 4, 13],
        RejectReason.NOT_A_FRAME: [5],
        RejectReason.MALFORMED: [6, 10, 12],
        RejectReason.OUT_OF_RANGE: [7, 8],
    }


def test_the_first_lines_are_kept_whatever_column_they_are_in(
    tmp_path: Path,
) -> None:
    """Five of each reason, a line with two bad cells once."""
    rows = [f"{i},1,1,1" for i in range(40)]
    rows[30:] = [f"{i},x,1e9,1" for i in range(30, 40)]
    rows[3], rows[5], rows[7] = "3,x,x,x", "5,1,x,1", "7,1,1e9,1"
    rows[9], rows[11] = "?,1,1,1", "11,1,1,1,1"
    signals = {**SIGNALS, "primary_pressure": {
        "column": "p", "unit": "bar", "max": 200.0,
    }}  # fmt: skip
    path = write(tmp_path, "t,v,p,b\n" + "\n".join(rows) + "\n")

    reader, _ = samples(path, table_map(signals))

    assert reader.first_refused == {
        RejectReason.NOT_A_NUMBER: [5, 7, 32, 33, 34],
        RejectReason.OUT_OF_RANGE: [9, 32, 33, 34, 35],
        RejectReason.MALFORMED: [11, 13],
    }
    assert reader.counts == {
        RejectReason.NOT_A_NUMBER: 14,
        RejectReason.OUT_OF_RANGE: 11,
    }


@pytest.mark.parametrize(
    ("column", "cells", "unit", "expected"),
    [
        ("t", ["0", "0.5", "1.0"], "s", [0, 500_000, 1_000_000]),
        ("t", ["0", "20", "40"], "ms", [0, 20_000, 40_000]),
        ("t", ["0", "20000", "40000"], "us", [0, 20_000, 40_000]),
        ("time (ms)", ["0", "1", "2"], "ms", [0, 1000, 2000]),
        ("t_s", ["0", "10", "20"], "s", [0, 10**7, 2 * 10**7]),
        ("t", ["1700000000.5"], "s", [1_700_000_000_500_000]),
        ("t", ["1700000000500"], "ms", [1_700_000_000_500_000]),
        ("t", ["1700000000500000"], "us", [1_700_000_000_500_000]),
        ("t", ["2023-11-14T22:13:20.5Z"], "iso8601", [1_700_000_000_500_000]),
        ("t", ["2023-11-15 00:13:20.5+02:00", "2023-11-14T22:13:20.5"],
         "iso8601", [1_700_000_000_500_000] * 2),
        ("t", ["23:59:59.5", "0:00:00"], "hhmmss",
         [86_399_500_000, 86_400_000_000]),
        ("clock [hhmmss]", ["095237.6", "95238"], "hhmmss",
         [35_557_600_000, 35_558_000_000]),
        ("t (sec)", ["0", "900"], "s", [0, 900_000_000]),
    ],
)  # fmt: skip
def test_the_time_unit_is_found(
    tmp_path: Path,
    column: str,
    cells: list[str],
    unit: str,
    expected: list[int],
) -> None:
    rows = "".join(f"{cell},36\n" for cell in cells)
    path = write(tmp_path, f"{column},v\n{rows}")
    signals = {"vehicle_speed": SIGNALS["vehicle_speed"]}

    found = samples(path, table_map(signals, time=column, time_unit=None))
    given_unit = samples(path, table_map(signals, time=column, time_unit=unit))

    assert [one[0] for one in found[1]] == expected
    assert found[1] == given_unit[1]
    assert found[0].time.unit == unit
    assert found[0].time.found_by
    assert not given_unit[0].time.found_by


@pytest.mark.parametrize(
    ("column", "role", "warned"),
    [
        ("v [mph]", {"unit": "km/h"}, True),
        ("v_bar", {"unit": "km/h"}, True),
        ("v [kmh]", {"unit": "km/h"}, False),
        ("v [furlong]", {"unit": "km/h"}, False),
        ("v [mph]", {"unit": "km/h", "scale": 1.609}, False),
        ("v", {"unit": "km/h"}, False),
    ],
)
def test_a_unit_that_differs_from_the_tables_is_logged(
    tmp_path: Path, column: str, role: dict[str, Any], *, warned: bool
) -> None:
    plan = table_map({"vehicle_speed": {"column": column} | role})

    with capture_logs() as logs:
        samples(write(tmp_path, f"t,{column}\n0,36\n"), plan)

    assert [one["column"] for one in logs] == [column] * warned
    assert all("unit differs" in one["event"] for one in logs)


def test_laps_that_begin_at_zero_are_joined(tmp_path: Path) -> None:
    laps = ["0.04,0.5,30,60.0", "0.02,0.5,40", "0,0.04,50"]
    rows = "".join(f"{t},36\n" for lap in laps for t in lap.split(","))
    signals = {"vehicle_speed": SIGNALS["vehicle_speed"]}

    reader, listed = samples(
        write(tmp_path, "t,v\n" + rows), table_map(signals)
    )

    stamps = [one[0] for one in listed]
    assert stamps[:7] == [
        *(40_000, 500_000, 30_000_000, 60_000_000),
        *(60_020_000, 60_500_000, 100_000_000),
    ]
    # a lap that begins at zero itself: one usual step behind
    assert stamps[7] > stamps[6]
    assert stamps[9] - stamps[7] == 50_000_000
    assert reader.time.laps_joined == 2


def test_laps_are_joined_across_chunks(tmp_path: Path) -> None:
    rows = "".join(f"{n % 15_000},36\n" for n in range(45_000))
    signals = {"vehicle_speed": SIGNALS["vehicle_speed"]}
    plan = table_map(signals, time_unit="ms")

    reader, listed = samples(write(tmp_path, "t,v\n" + rows), plan)

    assert [one[0] for one in listed] == [n * 1000 for n in range(45_000)]
    assert reader.time.laps_joined == 2


def test_a_little_backwards_is_no_new_lap(tmp_path: Path) -> None:
    signals = {"vehicle_speed": SIGNALS["vehicle_speed"]}
    path = write(tmp_path, "t,v\n0.9,1\n0.5,1\n30,1\n20,1\n")

    reader, listed = samples(path, table_map(signals))

    assert [one[0] for one in listed] == [900_000, 500_000, 30_000_000,
                                          20_000_000]  # fmt: skip
    assert reader.time.laps_joined == 0


def test_a_table_without_time_has_a_rate(tmp_path: Path) -> None:
    signals = {"vehicle_speed": SIGNALS["vehicle_speed"]}
    plan = table_map(signals, time=None, time_unit=None, rate_hz=50.0)

    _, listed = samples(write(tmp_path, "v\n36\n36\n\n36\n"), plan)

    assert [one[0] for one in listed] == [0, 20_000, 40_000]


def test_one_value_a_row(tmp_path: Path) -> None:
    path = write(
        tmp_path,
        "t,what,x\n0,v,36\n0,p,9\n0,unused,x\n1,v,\n1, b ,true\n2,v,72\n",
    )

    _, listed = samples(path, table_map(name="what", value="x"))

    assert listed == [
        (0, SPEED, pytest.approx(10)),
        (0, PRESSURE, 1e6),
        (1_000_000, SWITCH, 1.0),
        (2_000_000, SPEED, pytest.approx(20)),
    ]


def test_points_in_time_of_a_parquet_table(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    import pyarrow.parquet as pq  # noqa: PLC0415

    stamps = pa.array([5_000_000_123, None, 7_000_000_000], pa.timestamp("ns"))
    path = tmp_path / "a.parquet"
    pq.write_table(pa.table({"t": stamps, "v": [36, 36, 36]}), path)
    signals = {"vehicle_speed": SIGNALS["vehicle_speed"]}

    reader, listed = samples(path, table_map(signals, time_unit=None))

    assert [one[0] for one in listed] == [5_000_000, 7_000_000]
    assert reader.refused == {RejectReason.MALFORMED: 1}


@pytest.mark.parametrize(
    ("text", "plan", "message"),
    [
        (
            "t,V,pp\n",
            {},
            (
                r"a\.csv: no such column: \[signals\.vehicle_speed\] column "
                r"= 'v', known are V, pp, t; .*, did you mean 'pp'\?"
            ),
        ),
        (
            "tim,v,p,b\n",
            {"time": "time"},
            r"\[table\] time = 'time', did you mean 'tim'\?",
        ),
        ("t,v,v,p,b\n", {}, "'v' occurs twice"),
        ("t,v,p,b\n", {}, "the table has no row"),
        ("t,v,p,b\n0,,,\n", {}, "no sample in 1 rows .all empty"),
        ("t,v,p,b\nx,1,1,1\n", {}, "1 malformed, first in line 2"),
        (
            "t,n,x\n0,speed,1\n",
            {"name": "n", "value": "x"},
            "v, p, b expected, speed seen",
        ),
    ],
)
def test_a_table_that_gives_nothing_says_why(
    tmp_path: Path, text: str, plan: dict[str, str], message: str
) -> None:
    with pytest.raises(LogError, match=message):
        samples(write(tmp_path, text), table_map(**plan))


@pytest.mark.parametrize("ending", [".parquet", ".h5"])
def test_a_damaged_binary_table_is_an_error(
    tmp_path: Path, ending: str
) -> None:
    kind = "parquet" if ending == ".parquet" else "hdf5 matrix"
    content = write_format(tmp_path, kind).read_bytes()
    path = tmp_path / f"b{ending}"
    path.write_bytes(content[: len(content) // 2])

    with pytest.raises(LogError, match=rf"b\{ending}: damaged"):
        samples(path)


def test_columns_of_different_length_are_an_error(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        for place, name in enumerate("tvpb"):
            file[name] = np.zeros(place + 1)

    with pytest.raises(LogError, match=r"different length: t 1, v 2"):
        samples(path)


def test_a_cut_gzip_table_gives_what_is_there(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    rows = "".join(f"{n},{rng.random()},1,1\n" for n in range(9000))
    packed = gzip.compress(f"t,v,p,b\n{rows}".encode())
    path = tmp_path / "a.csv.gz"
    path.write_bytes(packed[: len(packed) // 2])

    reader, listed = samples(path)

    assert reader.truncated
    assert len(listed) > 1000


def test_cp1252_names_are_read(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes("t;T [°C]\n0;20\n".encode("cp1252"))
    plan = table_map(
        {"ambient_temperature": {"column": "T [°C]", "unit": "degC"}}
    )

    _, listed = samples(path, plan)

    assert listed == [(0, ROLE_INDEX["ambient_temperature"], 293.15)]


def test_frames_and_tables_are_not_taken_for_each_other(
    tmp_path: Path,
) -> None:
    with pytest.raises(LogError, match="is a log of CAN frames"):
        EventLog(write(tmp_path, "(1.0) can0 1#\n", "a.log"), table_map())
    with pytest.raises(LogError, match="a signal table has no CAN frames"):
        open_log(write(tmp_path, csv_text()))


def test_an_angular_wheel_speed_uses_the_radius(tmp_path: Path) -> None:
    plan = table_map(
        {"wheel_speed_fl": {"column": "v", "unit": "rad/s", "sign": -1}}
    )

    _, listed = samples(write(tmp_path, "t,v\n0,-10\n"), plan)

    assert listed == [(0, ROLE_INDEX["wheel_speed_fl"], pytest.approx(3.0))]


CELL = st.one_of(
    st.sampled_from(
        ["", "0", "1.5", "-1e3", "1e999", "nan", "inf", "true", "x", "1,5",
         "1_0", '"', '"a', "2024-01-01", "2024-01-01T00:00:00Z", "٣", "\0",
         "9" * 400, "\ufeff", "0x10"]
    ),
    st.floats(width=32).map(str),
    st.text(max_size=8),
)  # fmt: skip


@pytest.mark.slow
@settings(
    max_examples=200,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    rows=st.lists(st.lists(CELL, max_size=6), max_size=12),
    unit=st.sampled_from([None, "s", "us", "iso8601", "hhmmss"]),
    long=st.booleans(),
)
def test_no_cell_escapes_as_an_exception(
    tmp_path: Path,
    rows: list[list[str]],
    unit: str | None,
    long: bool,  # noqa: FBT001
) -> None:
    text = "t,v,p,b\n" + "\n".join(",".join(row) for row in rows)
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode("utf-8", "replace"))
    form = {"name": "v", "value": "p"} if long else {}

    with suppress(BstmError):
        _, listed = samples(path, table_map(time_unit=unit, **form))

        assert np.isfinite([one[2] for one in listed]).all()
