"""Real signal tables as samples, and through the estimator."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.tables.table_log import TableReader
from bstm_daemon.bus.tables.table_plan import TableMap, compile_sources
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import Config
from bstm_daemon.roles import ROLE_INDEX
from tests.replayed import replay_log

REAL_DATA = os.environ.get("BSTM_REAL_DATA")

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not REAL_DATA, reason="BSTM_REAL_DATA is not set"),
]

CAR = """
[vehicle]
id = "car"
mass_kg = 1400.0
wheel_radius_m = 0.32

[[corner]]
name = "FL"
piston_area_m2 = 2.8e-3
effective_radius_m = 0.13
disc = {mass_kg = 7.0, swept_area_m2 = 0.08, total_area_m2 = 0.14}
pad = {area_m2 = 6e-3, thickness_m = 0.011}
"""

TESLA = """
[table]
time = "Elapsed Time (ms)"
[signals.vehicle_speed]
column = "Speed (MPH)"
unit = "mph"
[signals.primary_pressure]
column = "Brake Pressure (bar)"
unit = "bar"
min = -2.0
[signals.acceleration_longitudinal]
column = "Longitudinal Acceleration (m/s^2)"
unit = "m/s2"
[signals.temp_fl_disc]
column = "Brake Temperature Front Left (% est.)"
unit = "degC"
scale = 700.0
"""
GR86 = """
[table]
time = "timestamp"
[signals.vehicle_speed]
column = "speed"
unit = "km/h"
timeout_s = 5.0
[signals.primary_pressure]
column = "pbrake_f"
unit = "bar"
[signals.acceleration_longitudinal]
column = "accx_can"
unit = "g"
"""
F1 = """
[heat]
mode = "measured"
[table]
{time}
[signals.vehicle_speed]
column = "{v}"
unit = "km/h"
min = -1.0
[signals.ambient_temperature]
column = "{a}"
unit = "degC"
[signals.temp_fl_disc]
column = "{t}"
unit = "degC"
"""
F1_CSV = F1.format(
    time='time = "t_s_assumed_50Hz"', v="vCar_kmh", a="TAir_C", t="TBrakeL_C"
)
F1_HDF5 = F1.format(time="rate_hz = 50", v="vCar", a="TAir", t="TBrakeL")


def loaded(folder: Path, text: str) -> tuple[Config, TableMap]:
    path = folder / "car.toml"
    path.write_text(CAR + text)
    config = load_config(path)
    made = compile_sources(
        config.bus, config.signals, config.table, folder, 0.32
    )
    assert isinstance(made, TableMap)
    return config, made


def columns(
    path: Path, plan: TableMap
) -> tuple[TableReader, dict[int, Any], np.ndarray]:
    log = EventLog(path, plan)
    events = list(log.events())
    role = np.concatenate([one.role for one in events])
    value = np.concatenate([one.value for one in events])
    time_us = np.concatenate([one.time_us for one in events])
    assert isinstance(log.reader, TableReader)
    by_role = {number: value[role == number] for number in plan.roles()}
    return log.reader, by_role, time_us


def recording(pattern: str) -> Path:
    return next(Path(str(REAL_DATA)).glob(pattern))


def test_laps_of_a_car_s_own_telemetry(tmp_path: Path) -> None:
    config, plan = loaded(tmp_path, TESLA)
    path = recording("tesla*/*2020-03-10*.csv")

    reader, by_role, time_us = columns(path, plan)

    assert reader.lines == reader.frames == 8670
    assert reader.time.unit == "ms"
    assert reader.time.laps_joined == 3
    assert np.all(np.diff(time_us) >= 0)
    assert 205e6 < time_us[-1] < 225e6
    assert not reader.refused
    pressure = by_role[ROLE_INDEX["primary_pressure"]] / 1e5
    assert -1.0 < pressure.min() < 0.0
    assert 41.0 < pressure.max() < 42.0
    disc_c = by_role[ROLE_INDEX["temp_fl_disc"]] - 273.15
    assert 18.9 < disc_c.min() < disc_c.max() < 21.1

    replay = replay_log(config, plan, path, forecast=False)

    assert 2040 < len(replay.results) < 2250
    assert replay.counts["jumps"] == 0


def test_sparse_cells_of_a_race(tmp_path: Path) -> None:
    config, plan = loaded(tmp_path, GR86)
    path = recording("gr86*/*.csv")

    reader, by_role, time_us = columns(path, plan)

    assert reader.lines == reader.frames == 11_963
    assert reader.time.unit == "iso8601"
    assert len(by_role[ROLE_INDEX["vehicle_speed"]]) == 2461
    assert not reader.counts
    assert 2690 < (time_us[-1] - time_us[0]) * 1e-6 < 2710
    pressure = by_role[ROLE_INDEX["primary_pressure"]] / 1e5
    assert 170.0 < pressure.max() < 180.0

    replay = replay_log(config, plan, path, forecast=False)

    assert 26_900 < len(replay.results) < 27_100


def test_csv_and_hdf5_of_one_recording_agree(tmp_path: Path) -> None:
    pytest.importorskip("h5py")
    config, plan = loaded(tmp_path, F1_CSV)
    _, hdf5_plan = loaded(tmp_path, F1_HDF5)

    reader, by_role, time_us = columns(recording("f1*/Spain*.csv"), plan)
    _, hdf5_by_role, hdf5_time_us = columns(
        recording("f1*/Spain*.hdf5"), hdf5_plan
    )

    assert reader.time.unit == "s"
    assert reader.lines == 57_580
    assert np.array_equal(time_us, hdf5_time_us)
    for role, values in by_role.items():
        np.testing.assert_allclose(values, hdf5_by_role[role], 0.0, 1e-4)
    disc_c = by_role[ROLE_INDEX["temp_fl_disc"]] - 273.15
    assert 1100 < disc_c.max() < 1260

    log = recording("f1*/Spain*.csv")
    replay = replay_log(config, plan, log, forecast=False)

    assert len(replay.results) == pytest.approx(11_516, abs=3)
