"""Advice along a recording is the advice of the frames that the car sent."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from cantools.database import load_file

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.replay.frames import publications
from bstm_daemon.replay.results.rows import ADVICE_COLUMNS
from bstm_daemon.simulation import simulate
from bstm_daemon.simulation.drives import parse_drive
from bstm_daemon.simulation.recorder import Encoder, write_candump
from tests.replayed import replay_log

if TYPE_CHECKING:
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

ROOT = Path(__file__).parents[2]

DRIVE = """
[drive]
name = "steep"
description = "a steep minute and a half down, then parked"
ambient_c = 30.0
start_c = 150.0
propulsion = "engine"

[[segment]]
parked = true
duration_s = 20.0

[[segment]]
speed_kmh = 45.0
rate_ms2 = 1.0
gear = 4
grade_percent = -12.0
duration_s = 100.0

[[segment]]
speed_kmh = 0.0
rate_ms2 = 2.0
gear = 3

[[segment]]
parked = true
duration_s = 90.0
"""

FRAME = {
    "advice_message": "Message",
    "advice_shift": "ShiftAdvice",
    "advice_gearbox": "GearboxRequest",
    "advice_isolation": "FrontIsolation",
    "advice_assist": "EmergencyAssist",
    "advice_intervention": "Intervention",
}


@pytest.fixture(scope="module")
def car() -> tuple[Config, SignalMap]:
    """Return the example car, hot from the start and with a wet fluid."""
    config, signal_map = load_vehicle(ROOT / "config" / "example_vehicle.toml")
    vehicle = config.vehicle.model_copy(update={"ambient_c": 150.0})
    publish = config.publish.model_copy(
        update={"enabled": True, "requests": True}
    )
    fluid = config.fluid.model_copy(update={"water_percent": 4.0})
    changes = {"vehicle": vehicle, "publish": publish, "fluid": fluid}
    return config.model_copy(update=changes), signal_map


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the drive as frames."""
    path = tmp_path_factory.mktemp("advice") / "steep.log"
    encoder = Encoder(ROOT / "dbc" / "example_vehicle.dbc")
    write_candump(path, simulate(parse_drive(DRIVE, "steep.toml")), encoder)
    return path


@pytest.mark.slow
def test_columns_say_what_the_frames_say(
    car: tuple[Config, SignalMap], log: Path
) -> None:
    """Row by row; the drive has a message, a shift and an assist to tell."""
    database = load_file(ROOT / "dbc" / "bstm.dbc")
    message = database.get_message_by_name("BSTM_Advice")
    told: dict[int, dict[str, float]] = {}
    for part in publications(*car, log):
        for published in part:
            if published.frame.can_id == message.frame_id:
                told[published.time_us] = message.decode(
                    published.frame.data, decode_choices=False
                )
    columns = replay_log(*car, log).results.columns
    times_us = np.rint(columns["time_s"] * 1e6).astype(int).tolist()
    rows = [i for i, time_us in enumerate(times_us) if time_us in told]

    assert len(rows) > 200
    for name, signal in FRAME.items():
        mine = [int(columns[name][i]) for i in rows]
        assert mine == [told[times_us[i]][signal] for i in rows], name
    pedal = [told[times_us[i]]["PedalFeel"] for i in rows]
    assert columns["advice_pedal_feel"][rows] * 100.0 == pytest.approx(
        np.array(pedal, float), abs=0.51
    )
    assert {*columns["advice_shift"]} == {0.0, 1.0}
    assert {*columns["advice_message"]} >= {1.0}
    assert np.isfinite(columns["advice_waiting_s"]).any()


def test_no_forecast_no_advice(
    car: tuple[Config, SignalMap], log: Path
) -> None:
    """Without risk there is nothing to advise by: no columns."""
    columns = replay_log(*car, log, forecast=False).results.columns
    assert not {*ADVICE_COLUMNS} & {*columns}
