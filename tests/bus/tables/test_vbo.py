"""Racelogic VBO files."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from structlog.testing import capture_logs

from bstm_daemon.bus.tables.vbo import VboSource
from bstm_daemon.errors import BstmError, LogError

Reader = Callable[..., Any]

HEAD = """\
File created on 14/05/2024 at 10:11:12

[header]
satellites
time
latitude
longitude
velocity kmh
heading
height
vertical velocity m/s
Brake_Pressure
Ambient

[channel units]
bar
{last_unit}
{blanks}[comments]
(c) Racelogic

[column names]
sats time lat long velocity heading height vert-vel Brake_Pressure Ambient

[data]
"""
ROLES = {
    "gnss_speed": {"column": "velocity", "unit": "km/h"},
    "primary_pressure": {"column": "Brake_Pressure", "unit": "bar"},
}


def write(
    path: Path,
    rows: list[tuple[str, float, float]],
    last_unit: str = "(null)",
    blanks: str = "\n",
) -> Path:
    """Write clock, speed [km/h] and pressure [bar] of each row."""
    text = HEAD.format(last_unit=last_unit, blanks=blanks) + "".join(
        f"012 {clock} +03119.09973 -00058.49277 {speed:07.3f} 321.85 "
        f"+00152.58 -000.010 {pressure:+.6E} +2.000000E+01\n"
        for clock, speed, pressure in rows
    )
    path.write_text(text, "utf-8", newline="\r\n")
    return path


def test_values_times_and_midnight(tmp_path: Path, samples_of: Reader) -> None:
    path = write(
        tmp_path / "a.VBO",
        [
            ("235959.50", 36.0, 0.5),
            ("235959.90", 72.0, -1.0),
            ("000000.30", 36.0, 0.0),
        ],
    )

    assert samples_of(path, ROLES) == [
        (pytest.approx(86399.5), "gnss_speed", 10.0),
        (pytest.approx(86399.5), "primary_pressure", 0.5e5),
        (pytest.approx(86399.9), "gnss_speed", 20.0),
        (pytest.approx(86399.9), "primary_pressure", -1e5),
        (pytest.approx(86400.3), "gnss_speed", 10.0),
        (pytest.approx(86400.3), "primary_pressure", 0.0),
    ]


def test_units_of_long_names_and_of_channels(tmp_path: Path) -> None:
    path = write(tmp_path / "a.vbo", [], last_unit="°C")

    assert VboSource(path, None, lambda *_: None).units() == {
        "time": "hhmmss",
        "velocity": "kmh",
        "heading": "deg",
        "height": "m",
        "vert-vel": "m/s",
        "Brake_Pressure": "bar",
        "Ambient": "°C",
    }


def test_units_that_may_be_of_other_channels_are_unknown(
    tmp_path: Path,
) -> None:
    path = write(tmp_path / "a.vbo", [], last_unit="", blanks="\n")

    with capture_logs() as logs:
        units = VboSource(path, None, lambda *_: None).units()

    assert units == {"time": "hhmmss", "heading": "deg", "height": "m"}
    assert "units unknown" in logs[0]["event"]


def test_rows_of_another_width_and_no_time_are_counted(
    tmp_path: Path, samples_of: Reader
) -> None:
    path = write(tmp_path / "a.vbo", [("250000.00", 1.0, 1.0)])
    with path.open("a") as file:
        file.write("012 100000.00 broken\n")

    with pytest.raises(
        LogError, match=r"a\.vbo: no sample in 2 rows \(2 malformed, .*26, 27"
    ):
        samples_of(path, ROLES)


@pytest.mark.parametrize(
    ("lost", "missing"),
    [("[column names]", r"\[column names\]"), ("[data]", r"\[data\]")],
)
def test_a_file_without_a_section_is_named(
    tmp_path: Path, samples_of: Reader, lost: str, missing: str
) -> None:
    path = write(tmp_path / "a.vbo", [("100000.00", 1.0, 1.0)])
    path.write_text(path.read_text("utf-8").replace(lost, "[other]"), "utf-8")

    with pytest.raises(
        LogError, match=rf"a\.vbo: no section {missing} up to line \d+: a VBO"
    ):
        samples_of(path, ROLES)


@settings(
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 8_639_999),
            st.floats(0, 400).map(lambda x: round(x, 3)),
            st.floats(-2, 200).map(lambda x: round(x, 4)),
        ),
        min_size=1,
        max_size=40,
        unique_by=lambda row: row[0],
    )
)
def test_what_is_written_is_read(
    tmp_path: Path,
    samples_of: Reader,
    rows: list[tuple[int, float, float]],
) -> None:
    rows = sorted(rows)
    clocks = [
        f"{n // 360_000:02}{n // 6_000 % 60:02}{n % 6_000 / 100:05.2f}"
        for n, *_ in rows
    ]
    path = write(
        tmp_path / "a.vbo",
        [
            (clock, *values)
            for clock, (_, *values) in zip(clocks, rows, strict=True)
        ],
    )

    read = samples_of(path, ROLES)

    assert read == [
        one
        for n, speed, pressure in rows
        for one in (
            (pytest.approx(n / 100), "gnss_speed", pytest.approx(speed / 3.6)),
            (
                pytest.approx(n / 100),
                "primary_pressure",
                pytest.approx(pressure * 1e5, rel=1e-6, abs=1e-6),
            ),
        )
    ]


@settings(
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(st.data())
def test_no_damage_escapes_as_an_exception(
    tmp_path: Path, samples_of: Reader, data: st.DataObject
) -> None:
    path = write(tmp_path / "a.vbo", [("100000.00", 36.0, 1.0)] * 3)
    text = path.read_bytes()
    begin = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(begin, len(text)))
    path.write_bytes(
        text[:begin] + data.draw(st.binary(max_size=20)) + text[end:]
    )

    refused = ""
    read = []
    try:
        read = samples_of(path, ROLES)
    except BstmError as error:
        refused = str(error)

    assert read or "a.vbo" in refused
