"""The table of estimates: its columns, its files, its rows."""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.errors import FileAccessError, MissingExtraError
from bstm_daemon.replay import replay_log
from bstm_daemon.results import (
    Results,
    has_parquet,
    write_csv,
    write_parquet,
)
from bstm_daemon.roles import CORNERS
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.frames import Encoder
from bstm_daemon.simulation.recorder import write_candump

if TYPE_CHECKING:
    import numpy.typing as npt

ROOT = Path(__file__).parents[1]
CAR = ROOT / "config" / "example_vehicle.toml"

DRIVE = """
[drive]
name = "stop"
description = "one stop and a pause; the car's own bus sleeps at last"
ambient_c = 10.0
thermocouple_logger = true
[[segment]]
speed_kmh = 100.0
rate_ms2 = 4.0
gear = 4
duration_s = 10.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 5.0
[[segment]]
parked = true
duration_s = 10.0
[[segment]]
parked = true
ignition = false
duration_s = 4.0
"""

QUANTITIES = (
    "disc_c",
    "pad_front_c",
    *(f"pad_{i}_c" for i in range(1, 11)),
    "pad_back_c",
    "backplate_c",
    "fluid_c",
    "margin_k",
    "brake_power_w",
    "validity",
    "brake_power_ff_w",
    "brake_power_fb_w",
    "pressure_pa",
)
MEASURED = ("disc", "disc_2", "pad_front", "pad_back", "fluid", "caliper")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of the drive."""
    path = tmp_path_factory.mktemp("results") / "stop.log"
    encoder = Encoder(ROOT / "dbc" / "example_vehicle.dbc")
    write_candump(path, simulate(parse_drive(DRIVE, "stop")), encoder)
    return path


@pytest.fixture(scope="module")
def results(log: Path) -> Results:
    """Return all rows of it."""
    return replay_log(*load_vehicle(CAR), log).results


def read_csv(path: Path) -> dict[str, npt.NDArray[np.float64]]:
    """Return the columns of a CSV file; an empty cell is nan."""
    with path.open(encoding="utf-8", newline="") as file:
        names, *rows = csv.reader(file)
    table = np.array([[float(c or "nan") for c in row] for row in rows])
    return dict(zip(names, table.T, strict=True))


def test_columns(results: Results) -> None:
    """Names and order; measured ones only where something was measured."""
    expected = ["time_s", "speed_ms", "distance_m", "brake_force_fb_n"]
    expected.append("flags")
    for corner in CORNERS:
        expected += [f"{corner}.{quantity}" for quantity in QUANTITIES]
        if corner[0] == "F":
            expected += [f"{corner}.{node}_measured_c" for node in MEASURED]

    assert list(results.columns) == expected
    assert results.corners == results.modelled == CORNERS
    assert {len(column) for column in results.columns.values()} == {
        len(results)
    }


def test_units_and_meaning(results: Results) -> None:
    """Degrees Celsius, metres, watts, and the margin to 155 degC of DOT 4."""
    columns = results.columns

    assert columns["speed_ms"].max() == pytest.approx(100 / 3.6, rel=0.01)
    travelled = columns["speed_ms"].sum() * 0.1
    assert columns["distance_m"][-1] == pytest.approx(travelled, rel=0.01)
    assert columns["FL.disc_c"][0] == pytest.approx(10.0, abs=0.5)
    assert 30.0 < columns["FL.disc_c"].max() < 100.0
    np.testing.assert_allclose(
        columns["FL.margin_k"], 155.0 - columns["FL.fluid_c"], atol=1e-9
    )
    # 5 m/s2 less the resistances of a car of 2.2 t, at 100 km/h
    power = [columns[f"{corner}.brake_power_w"] for corner in CORNERS]
    assert np.sum(power, axis=0).max() == pytest.approx(
        2300 * 5 * 27, rel=0.15
    )
    assert set(columns["FL.validity"].tolist()) == {1.0}


def test_both_files_hold_the_same(results: Results, tmp_path: Path) -> None:
    """CSV to its digits, Parquet to the bit; the same names in one order."""
    from pyarrow import parquet  # noqa: PLC0415

    write_csv(tmp_path / "r.csv", results)
    write_parquet(tmp_path / "r.parquet", results)

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
    write_csv(
        tmp_path / "r.csv", Results(gap, results.corners, results.modelled)
    )

    text = (tmp_path / "r.csv").read_text(encoding="utf-8")
    header, *rows = text.splitlines()
    at = header.split(",").index("FL.disc_measured_c")
    assert {row.split(",")[at] for row in rows} == {""}
    assert "nan" not in text
    assert rows[0].startswith("1700000000.")


@pytest.mark.parametrize("every_us", [200_000, 1_000_000, 5_000_000])
def test_fewer_rows_keep_the_energy(
    log: Path, results: Results, every_us: int
) -> None:
    """Temperatures are those of the moment, power is the mean since."""
    config, signal_map = load_vehicle(CAR)
    fewer = replay_log(
        config, signal_map, log, every_us=every_us
    ).results.columns
    full = results.columns
    every_s = every_us * 1e-6

    assert np.allclose(np.diff(fewer["time_s"]), every_s)
    rows = np.searchsorted(full["time_s"], fewer["time_s"] - 1e-3)
    for name in ("FL.disc_c", "RR.fluid_c", "distance_m", "FL.margin_k"):
        assert np.array_equal(fewer[name], full[name][rows])
    first_s, last_s = fewer["time_s"][0] - every_s, fewer["time_s"][-1]
    inside = (full["time_s"] > first_s + 1e-3) & (
        full["time_s"] < last_s + 1e-3
    )
    for name in ("FL.brake_power_w", "RR.brake_power_ff_w"):
        energy_j = fewer[name].sum() * every_s
        assert energy_j == pytest.approx(full[name][inside].sum() * 0.1)
        assert energy_j > 5e4


def test_brake_power_is_the_heat_that_went_in(log: Path) -> None:
    """By pressure or by motion, as the mode says; both are always there."""
    config, signal_map = load_vehicle(CAR)
    for mode in ("ff", "fb"):
        heat = config.heat.model_copy(update={"mode": mode})
        car = config.model_copy(update={"heat": heat})
        columns = replay_log(car, signal_map, log).results.columns
        np.testing.assert_allclose(
            columns["FL.brake_power_w"],
            columns[f"FL.brake_power_{mode}_w"],
            rtol=1e-6,
            atol=1e-3,
        )
        assert columns["FL.brake_power_ff_w"].max() > 1e4
        assert columns["FL.brake_power_fb_w"].max() > 1e4


def test_a_drum_has_power_and_no_temperature(
    log: Path, tmp_path: Path
) -> None:
    """Its columns say what is known of it."""
    dbc = (ROOT / "dbc" / "example_vehicle.dbc").as_posix()
    text = CAR.read_text(encoding="utf-8")
    text = text.replace("../dbc/example_vehicle.dbc", dbc)
    start = text.index('[[corner]]\nname = "RR"')
    end = text.index("# Tunable parameters")
    drum = (
        '[[corner]]\nname = "RR"\ntype = "drum"\n'
        "piston_area_m2 = 3e-4\neffective_radius_m = 0.11\n"
        "drum_brake_factor = 2.5\n"
    )
    car = tmp_path / "drum.toml"
    car.write_text(text[:start] + drum + text[end:], encoding="utf-8")

    results = replay_log(*load_vehicle(car), log).results

    assert results.corners == CORNERS
    assert results.modelled == ("FL", "FR", "RL")
    names = {n for n in results.columns if n.startswith("RR.")}
    assert names == {
        "RR.brake_power_w",
        "RR.brake_power_ff_w",
        "RR.brake_power_fb_w",
        "RR.pressure_pa",
    }
    assert results.columns["RR.brake_power_w"].max() > 1e3


def test_files_that_can_not_be_written(
    results: Results, tmp_path: Path
) -> None:
    """A missing folder is an access error for both forms."""
    for write in (write_csv, write_parquet):
        with pytest.raises(FileAccessError, match="cannot be written"):
            write(tmp_path / "none" / "r", results)


def test_parquet_without_pyarrow(
    results: Results, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The extra is named; nothing is written."""
    monkeypatch.setitem(sys.modules, "pyarrow", None)

    assert not has_parquet()
    with pytest.raises(MissingExtraError, match=r"bstm-daemon\[parquet\]"):
        write_parquet(tmp_path / "r.parquet", results)
    assert list(tmp_path.iterdir()) == []
