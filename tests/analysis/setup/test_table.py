"""A proposal for the columns of a table."""

from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.analysis.setup.proposal import Candidate
from bstm_daemon.analysis.setup.table import (
    propose_for,
    read_table,
    table_notes,
)
from bstm_daemon.errors import LogError
from bstm_daemon.units import GRAVITY_MS2

TIME_S = np.arange(0.0, 120.0, 0.1)
SPEED_MS = 20.0 + 10.0 * np.sin(TIME_S / 4.0)
ACCEL_MS2 = 2.5 * np.cos(TIME_S / 4.0)
BRAKE_BAR = np.where(ACCEL_MS2 < -0.5, -10.0 * ACCEL_MS2, 0.0)


def write(path: Path, **columns: np.ndarray) -> Path:
    """Write a table with the columns; ``__`` stands for a blank."""
    names = [name.replace("__", " ") for name in columns]
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(f"{cell:.5g}" for cell in row) for row in rows]
    path.write_text("\n".join([",".join(names), *lines]) + "\n")
    return path


def proposed(path: Path) -> tuple[dict[str, Candidate], dict[str, Candidate]]:
    """Return the sure and the unsure candidates by role."""
    proposal = propose_for(read_table([path]))
    return tuple(  # type: ignore[return-value]
        {one.role: one for one in each}
        for each in (proposal.sure, proposal.unsure)
    )


def test_names_with_units_are_roles(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.csv",
        Zeit_s=TIME_S,
        speed_kmh=SPEED_MS * 3.6,
        BrakePressure_bar=BRAKE_BAR,
        accel_long_g=ACCEL_MS2 / GRAVITY_MS2,
        brake_switch=np.where(BRAKE_BAR > 0, 1.0, 0.0),
        oil_foo=TIME_S,
    )
    table = read_table([path])

    proposal = propose_for(table)

    assert table.time == "Zeit_s"
    found = {
        one.role: (table.columns[one.match.signal.name], one.unit)
        for one in proposal.sure
    }
    assert found == {
        "vehicle_speed": ("speed_kmh", "km/h"),
        "primary_pressure": ("BrakePressure_bar", "bar"),
        "acceleration_longitudinal": ("accel_long_g", "g"),
        "brake_switch": ("brake_switch", "bool"),
    }
    assert table_notes(table, proposal) == ["Columns without a role: oil_foo."]


@pytest.mark.parametrize(
    ("speed_unit", "speed", "accel_unit", "accel"),
    [
        ("km/h", 3.6, "g", GRAVITY_MS2),
        ("mph", 1 / 0.44704, "g", GRAVITY_MS2),
        ("m/s", 1.0, "g", GRAVITY_MS2),
        ("km/h", 3.6, "m/s2", 1.0),
        ("mph", 1 / 0.44704, "m/s2", 1.0),
        ("m/s", 1.0, "m/s2", 1.0),
    ],
)
def test_units_that_fit_each_other_are_sure(
    tmp_path: Path,
    speed_unit: str,
    speed: float,
    accel_unit: str,
    accel: float,
) -> None:
    noise = np.random.default_rng(3).normal(0.0, 0.1, len(TIME_S))
    path = write(
        tmp_path / "a.csv",
        time=TIME_S,
        speed=SPEED_MS * speed,
        accx=(ACCEL_MS2 + noise) / accel,
    )

    sure, _ = proposed(path)

    assert sure["vehicle_speed"].unit == speed_unit
    assert sure["acceleration_longitudinal"].unit == accel_unit
    assert "no unit is stated" in sure["vehicle_speed"].reason


def test_a_speed_without_unit_and_proof_is_to_be_checked(
    tmp_path: Path,
) -> None:
    path = write(tmp_path / "a.csv", time=TIME_S, speed=SPEED_MS)

    sure, unsure = proposed(path)

    assert not sure
    assert unsure["vehicle_speed"].unit == "km/h"
    assert "km/h is assumed: check it" in unsure["vehicle_speed"].reason


def test_an_unknown_unit_is_named_and_not_guessed(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("time;Speed [furlong]\n0;1\n1;2\n2;3\n")
    table = read_table([path])

    proposal = propose_for(table)

    assert not proposal.sure
    assert "its stated unit is 'furlong'" in proposal.unsure[0].reason
    assert table_notes(table, proposal) == [
        "Units that are not known: Speed [furlong] in 'furlong'."
    ]


def test_the_speed_of_a_receiver_is_better_than_none(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", Time=TIME_S, GPS__Speed_kmh=SPEED_MS)

    sure, unsure = proposed(path)

    assert not unsure
    assert sure["vehicle_speed"].match.signal.name == "GPS Speed"
    assert "of a receiver, so it lags; up to 8.3 m/s" in (
        sure["vehicle_speed"].reason
    )


HARD_BAR = np.where(ACCEL_MS2 < -1.5, -10.0 * ACCEL_MS2, 0.6)
DISC_C = 200.0 + np.cumsum(np.where(HARD_BAR > 1.0, 6.0, -2.0))


@pytest.mark.parametrize(
    "names",
    [
        "Ground Speed|Brake Pres Front|Brake Temp FL|Brake Temp FR",
        "Corr Speed|Brake Pressure|Disc Temp Front Left|Disc Temp Front Right",
        "GPS Speed|BRAKE_FRONT|Brk Temp FL|Brk Temp FR",
        "speed|pbrake_f|tbrake_fl|tbrake_fr",
        "Geschwindigkeit|Bremsdruck VA|T_Bremsscheibe_VL|T_Bremsscheibe_VR",
    ],
)
def test_names_of_track_loggers(tmp_path: Path, names: str) -> None:
    speed, pressure, left, right = names.split("|")
    path = write(
        tmp_path / "a.csv",
        **{
            "Time [s]": TIME_S,
            f"{speed} [km/h]": 3.6 * SPEED_MS,
            f"{pressure} [bar]": HARD_BAR,
            f"{left} [C]": DISC_C,
            f"{right} [C]": DISC_C + 1.0,
        },
    )

    sure, _ = proposed(path)

    assert {role: one.match.signal.name for role, one in sure.items()} == {
        "vehicle_speed": speed,
        "primary_pressure": pressure,
        "temp_fl_disc": left,
        "temp_fr_disc": right,
    }


def test_a_pressure_without_a_name_must_slow_the_car(tmp_path: Path) -> None:
    """Fuel, oil and boost rise when the car is driven, not when it slows."""
    driven = np.where(ACCEL_MS2 > 1.5, 4.0 * ACCEL_MS2, 0.6)
    path = write(
        tmp_path / "a.csv",
        Time=TIME_S,
        speed_kmh=SPEED_MS * 3.6,
        P1_bar=driven,
    )

    assert "primary_pressure" not in proposed(path)[0]


def test_gaps_of_the_speed_prove_nothing(tmp_path: Path) -> None:
    """Between samples far apart a straight line would contradict."""
    sparse = SPEED_MS.copy()
    sparse[(TIME_S % 20.0) > 8.0] = np.nan
    path = write(
        tmp_path / "a.csv",
        time=TIME_S,
        speed_kmh=sparse * 3.6,
        accx_g=ACCEL_MS2 / GRAVITY_MS2,
        pbrake_f=BRAKE_BAR,
    )

    sure, _ = proposed(path)

    assert sure["acceleration_longitudinal"].scale == 1.0
    assert sure["primary_pressure"].unit == "bar"


def test_two_tables_are_joined(tmp_path: Path) -> None:
    columns = {"time": TIME_S, "speed_kmh": SPEED_MS * 3.6}
    logs = [write(tmp_path / f"{n}.csv", **columns) for n in "ab"]

    recording = read_table(logs).recording

    assert recording.duration_s == pytest.approx(2 * 119.9)
    assert len(recording.samples["table", "speed"].value) == 2 * len(TIME_S)


def test_signals_of_mf4_and_their_time(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    path = tmp_path / "a.mf4"
    mdf = asammdf.MDF(version="4.11")
    for name, unit, values in (
        ("Speed", "km/h", SPEED_MS * 3.6),
        ("BrakePressure", "bar", BRAKE_BAR),
    ):
        mdf.append([asammdf.Signal(values, TIME_S, unit, name)])
    mdf.save(path)
    mdf.close()

    table = read_table([path])

    assert table.time == "time"
    found = {one.role: one.unit for one in propose_for(table).sure}
    assert found == {"vehicle_speed": "km/h", "primary_pressure": "bar"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a,b\n1,2\n2,3\n", "no column has name and values of a time: name"),
        ("time,b\n5,2\n5,3\n", r"of a time \(time do not rise\): name"),
        ("lap time,v\n0,2\n1,3\n", "no column has name and values of a time"),
    ],
)
def test_a_table_without_time_says_what_to_do(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "a.csv"
    path.write_text(text)

    with pytest.raises(LogError, match=message):
        read_table([path])
