"""``bstm init --log TABLE``: accepted by check and replay without an edit."""

import os
from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.config.reading import load_config

REAL = os.environ.get("BSTM_REAL_DATA")
Capture = pytest.CaptureFixture[str]

TIME_S = np.arange(0.0, 60.0, 0.1)
SPEED_KMH = 80.0 + 30.0 * np.sin(TIME_S / 4.0)
BRAKE_BAR = np.maximum(0.0, -20.0 * np.cos(TIME_S / 4.0))


def csv_table(folder: Path) -> Path:
    """Write a table as a spreadsheet with decimal commas has it."""
    path = folder / "drive.csv"
    rows = [
        f"{time_s:.1f};{speed:.2f};{pressure:.2f};1".replace(".", ",")
        for time_s, speed, pressure in zip(
            TIME_S, SPEED_KMH, BRAKE_BAR, strict=True
        )
    ]
    head = ["Fahrt 1", "", "Zeit;Speed;Brake Pressure;Lap", "s;km/h;bar;"]
    path.write_text("\n".join([*head, *rows]))
    return path


def vbo_table(folder: Path) -> Path:
    """Write a table as a VBOX has it."""
    path = folder / "drive.vbo"
    rows = [
        f"10{int(time_s) // 60:02}{time_s % 60:05.2f} {speed:.2f} {bar:.4E}"
        for time_s, speed, bar in zip(
            TIME_S, SPEED_KMH, BRAKE_BAR, strict=True
        )
    ]
    head = """[header]
time
velocity kmh
Brake_Pressure

[channel units]
bar

[column names]
time velocity Brake_Pressure

[data]
"""
    path.write_text(head + "\n".join(rows))
    return path


def prepared(out: Path, log: Path, *options: str) -> None:
    """Write a configuration for *log*, check it and replay the log.

    *options* are those of replay.
    """
    assert main(["init", "--log", str(log), "-o", str(out)]) == 0
    assert main(["check", str(out)]) == 0
    results = out.parent / "results"
    words = ["replay", str(log), "-c", str(out), "-o", str(results)]
    assert main([*words, *options]) == 0
    assert list(results.glob("*.estimates.csv"))


@pytest.mark.parametrize("write", [csv_table, vbo_table])
def test_a_table_is_replayed_as_it_is_proposed(
    tmp_path: Path, capsys: Capture, write: object
) -> None:
    assert callable(write)
    log = write(tmp_path)
    out = tmp_path / "car.toml"

    prepared(out, log)

    signals = load_config(out).signals
    units = {role: one.unit for role, one in signals.items()}
    assert units == {"vehicle_speed": "km/h", "primary_pressure": "bar"}
    said = capsys.readouterr().out
    assert "at most 110 km/h" in said
    if write is csv_table:
        assert "Columns without a role: Lap." in said


def test_a_table_publishes_no_frames_and_says_what_to_do(
    tmp_path: Path, capsys: Capture
) -> None:
    log, out = csv_table(tmp_path), tmp_path / "car.toml"
    assert main(["init", "--log", str(log), "-o", str(out)]) == 0
    frames = tmp_path / "frames.log"

    assert (
        main(
            ["replay", str(log), "-c", str(out), "--publish", str(frames)],
        )
        == 2
    )

    assert "take -o DIR or --report PAGE.html" in capsys.readouterr().err
    assert not frames.exists()


def test_frames_without_a_dbc_say_what_to_do(
    tmp_path: Path, capsys: Capture
) -> None:
    log = tmp_path / "a.log"
    log.write_text("(1.0) can0 1#00\n")

    assert main(["init", "--log", str(log), "-o", f"{tmp_path}/a.toml"]) == 2

    assert "a log of CAN frames needs --dbc" in capsys.readouterr().err


@pytest.mark.real
@pytest.mark.skipif(REAL is None, reason="BSTM_REAL_DATA is not set")
@pytest.mark.parametrize(
    ("pattern", "roles"),
    [
        (
            "f1-five-channel/Hungary.converted.csv",
            {
                "vehicle_speed": "km/h",
                "ambient_temperature": "degC",
                "temp_fl_disc": "degC",
                "temp_fr_disc": "degC",
            },
        ),
        (
            "gr86-cup-barber/*.csv",
            {
                "vehicle_speed": "km/h",
                "primary_pressure": "bar",
                "acceleration_longitudinal": "g",
                "gear": "count",
            },
        ),
        (
            "tesla-model3-trackmode/*03-10*.csv",
            {
                "vehicle_speed": "mph",
                "primary_pressure": "bar",
                "acceleration_longitudinal": "m/s2",
                "acceleration_lateral": "m/s2",
                "yaw_rate": "rad/s",
            },
        ),
    ],
)
def test_tables_of_real_cars(
    tmp_path: Path, pattern: str, roles: dict[str, str]
) -> None:
    out = tmp_path / "car.toml"

    log = next(Path(str(REAL)).glob(pattern))
    # an hour's forecast takes a quarter of a minute
    prepared(out, log, "--no-forecast")

    signals = load_config(out).signals
    assert {role: one.unit for role, one in signals.items()} == roles
