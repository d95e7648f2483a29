"""One stop, its log and its results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump
from tests.replayed import replay_log

if TYPE_CHECKING:
    from bstm_daemon.replay.results import Results

ROOT = Path(__file__).parents[3]

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


@pytest.fixture(scope="session")
def car() -> Path:
    """Return the configuration of the example car."""
    return ROOT / "config" / "example_vehicle.toml"


@pytest.fixture(scope="session")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of the drive."""
    path = tmp_path_factory.mktemp("results") / "stop.log"
    encoder = Encoder(ROOT / "dbc" / "example_vehicle.dbc")
    write_candump(path, simulate(parse_drive(DRIVE, "stop")), encoder)
    return path


@pytest.fixture(scope="session")
def results(log: Path, car: Path) -> Results:
    """Return all rows of it."""
    return replay_log(*load_vehicle(car), log).results
