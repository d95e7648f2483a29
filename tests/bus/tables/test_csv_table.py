"""Heads of CSV tables as loggers and spreadsheets write them."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bstm_daemon.bus.tables.csv_table import read_head
from bstm_daemon.bus.tables.source import units_in_names

Reader = Callable[..., Any]

AIM = """\
"Format","AIM CSV File"
"Venue","Track"
"Sample Rate","20"
"Beacon Markers","45.1","95.2","140.9"
"Segment Times","0:45.100","0:50.100","0:45.700"

"Time","GPS Speed","Brake Press","Oil Temp"
"sec","km/h","bar","C"

"0.000","36.0","1.5","90"
"0.050","72.0","2.5","90"
"""
MOTEC = """\
"Format","MoTeC CSV File",,,"Workbook",""
"Venue","Track",,,"Worksheet",""

"Time","Ground Speed","Brake Pressure"
"s","km/h","bar"


"0.000","36.0","1.5"
"0.020","72.0","2.5"
"""
RACECHRONO = """\
This file is created using a phone
Format,3
Session title,"Track, morning"

timestamp,fragment_id,speed
unix time,,m/s
,,100: gps
1556000000.1,0,10.0
1556000000.2,0,20.0
"""
GERMAN = "Zeit [s];v (km/h);p_bar\n0,00;36,0;1,5\n0,02;72,0;2,5\n"


@pytest.mark.parametrize(
    ("text", "names", "units", "lines"),
    [
        (
            AIM,
            ["Time", "GPS Speed", "Brake Press", "Oil Temp"],
            {
                "Time": "sec",
                "GPS Speed": "km/h",
                "Brake Press": "bar",
                "Oil Temp": "C",
            },
            9,
        ),
        (
            MOTEC,
            ["Time", "Ground Speed", "Brake Pressure"],
            {"Time": "s", "Ground Speed": "km/h", "Brake Pressure": "bar"},
            7,
        ),
        (
            RACECHRONO,
            ["timestamp", "fragment_id", "speed"],
            {"timestamp": "unix time", "speed": "m/s"},
            7,
        ),
        (
            GERMAN,
            ["Zeit [s]", "v (km/h)", "p_bar"],
            {"Zeit [s]": "s", "v (km/h)": "km/h", "p_bar": "bar"},
            1,
        ),
        ("t,v\n", ["t", "v"], {}, 1),
        ("1,2\n3,4\n", ["1", "2"], {}, 1),
        # a damaged first row is not taken for units
        ("t,v\nx,y\n0,1\n", ["t", "v"], {}, 1),
        ("t\tv\n0,5\t1,5\n", ["t", "v"], {}, 1),
        ("", [], {}, 1),
    ],
)
def test_names_units_and_first_row(
    text: str, names: list[str], units: dict[str, str], lines: int
) -> None:
    head = read_head(text.splitlines(keepends=True), None)

    assert head.names == names
    assert head.units == units
    assert head.lines == lines


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("t;v\n0,5;1,5\n", True),
        ("t;v\n0.5;1.5\n", False),
        ('t,v\n"0,5","1,25"\n', True),
        # a thousand, or one: not guessed
        ('t,v\n1,"1,250"\n', False),
        ("t;v\n1;1,250\n", True),
    ],
)
def test_a_decimal_comma_is_seen(text: str, *, expected: bool) -> None:
    assert read_head(text.splitlines(), None).decimal_comma is expected


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("Speed [km/h]", "km/h"),
        ("Speed (km/h)", "km/h"),
        ("acc (m/(s^2))", "m/(s^2)"),
        ("Brake (front) [bar]", "bar"),
        ("Slip (% est.)", "% est."),
        ("speed_kmh", "kmh"),
        ("velocity kmh", "kmh"),
        ("TAir_C", "C"),
        ("accel_g", "g"),
        ("pbrake_f", None),
        ("gear", None),
        ("kmh", None),
        ("[km/h]", None),
        ("temp_rear", None),
    ],
)
def test_the_unit_of_a_name(name: str, unit: str | None) -> None:
    assert units_in_names([name]).get(name) == unit


@pytest.mark.parametrize("text", [AIM, MOTEC, GERMAN])
def test_values_of_an_export(
    tmp_path: Path, samples_of: Reader, text: str
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text, "utf-8")
    head = read_head(text.splitlines(), None)
    time, speed, pressure, *_ = head.names
    step_s = 0.05 if text == AIM else 0.02

    assert samples_of(
        path,
        {
            "vehicle_speed": {"column": speed, "unit": "km/h"},
            "primary_pressure": {"column": pressure, "unit": "bar"},
        },
        time=time,
    ) == [
        (0.0, "vehicle_speed", 10.0),
        (0.0, "primary_pressure", 1.5e5),
        (pytest.approx(step_s), "vehicle_speed", 20.0),
        (pytest.approx(step_s), "primary_pressure", 2.5e5),
    ]


CELLS = st.floats(-1e6, 1e6, allow_nan=False).map(lambda x: f"{x:.4f}")


@given(
    st.integers(2, 5).flatmap(
        lambda width: st.lists(
            st.lists(CELLS, min_size=width, max_size=width),
            min_size=1,
            max_size=30,
        )
    ),
    st.sampled_from([(",", "."), (";", ","), (";", "."), ("\t", ",")]),
    st.booleans(),
    st.integers(0, 20),
)
def test_any_table_keeps_names_and_rows(
    rows: list[list[str]],
    form: tuple[str, str],
    has_units: bool,  # noqa: FBT001
    preamble: int,
) -> None:
    delimiter, point = form
    width = len(rows[0])
    names = [f"name {n}" for n in range(width)]
    lines = [f"note {n}" for n in range(preamble)] + [delimiter.join(names)]
    if has_units:
        lines.append(delimiter.join(["km/h", *["x"] * (width - 1)]))
    begin = len(lines)
    lines += [delimiter.join(row).replace(".", point) for row in rows]

    head = read_head(lines, None)

    assert head.names == names
    assert head.delimiter == delimiter
    assert head.decimal_comma is (point == ",")
    assert head.lines == begin
    assert (head.units.get(names[0]) == "km/h") is has_units


@settings(
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    st.lists(st.floats(-50, 400).map(lambda x: round(x, 3)), min_size=1),
    st.sampled_from([(",", "."), (";", ","), (",", ",")]),
    st.sampled_from(["", "Vehicle;;x\n", "a\n\nb,c,d,e\n"]),
)
def test_values_that_are_written_are_read(
    tmp_path: Path,
    samples_of: Reader,
    values: list[float],
    form: tuple[str, str],
    preamble: str,
) -> None:
    delimiter, point = form
    rows = [
        delimiter.join(
            f'"{cell:.4f}"'.replace(".", point) for cell in (n / 10, value)
        )
        for n, value in enumerate(values)
    ]
    head = delimiter.join(["time [s]", "v"])
    path = tmp_path / "a.csv"
    path.write_text(preamble + "\n".join([head, *rows]) + "\n")

    read = samples_of(
        path,
        {"vehicle_speed": {"column": "v", "unit": "m/s"}},
        time="time [s]",
    )

    assert [value for *_, value in read] == values
    assert [round(time_s * 10) for time_s, *_ in read] == list(
        range(len(values))
    )


@given(st.lists(st.text(max_size=30), max_size=12), st.none() | st.just(";"))
def test_any_text_has_a_head(lines: list[str], delimiter: str | None) -> None:
    head = read_head(lines, delimiter)

    assert 1 <= head.lines <= max(len(lines), 1)
