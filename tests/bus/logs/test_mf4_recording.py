"""A logger's MF4 recording, end to end with its DBC."""

import os
from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.bus.opening import EventLog, open_log
from bstm_daemon.bus.signals.signal_map import compile_signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.errors import LogError
from bstm_daemon.roles import ROLE_INDEX

REAL_DATA = os.environ.get("BSTM_REAL_DATA")

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(not REAL_DATA, reason="BSTM_REAL_DATA is not set"),
]


@pytest.fixture
def folder() -> Path:
    pytest.importorskip("asammdf")
    return Path(str(REAL_DATA)) / "canedge-obd-gnss-mf4"


def test_every_record_is_a_frame(folder: Path) -> None:
    reader = open_log(next(folder.glob("*.MF4")))

    times = np.concatenate([chunk.time_us for chunk in reader.chunks()])

    assert reader.lines == reader.frames == len(times) == 73_812
    assert reader.interfaces == ["can2", "can1"]
    assert not reader.refused
    assert 599e6 < times[-1] - times[0] < 601e6


def test_speed_and_altitude_of_the_drive(folder: Path) -> None:
    signals = {
        "gnss_speed": SignalConfig(
            message="gnss_speed", signal="Speed", unit="m/s"
        ),
        "altitude": SignalConfig(
            message="gnss_altitude", signal="Altitude", unit="m"
        ),
    }
    bus = BusConfig(name="imu", dbc="canmod-gps.dbc", channel="can2")
    signal_map = compile_signal_map([bus], signals, folder, 0.3)
    path = next(folder.glob("*.MF4"))
    with pytest.raises(LogError, match=r"interface can1 .*--map can1="):
        list(EventLog(path, signal_map).events())

    log = EventLog(path, signal_map, {"can1": ""})
    events = list(log.events())

    role = np.concatenate([one.role for one in events])
    value = np.concatenate([one.value for one in events])
    speed = value[role == ROLE_INDEX["gnss_speed"]]
    altitude = value[role == ROLE_INDEX["altitude"]]
    assert len(speed) == log.reader.seen[0, 7, False] > 500
    assert len(altitude) == log.reader.seen[0, 4, False] > 500
    assert 3.0 < speed.min() < speed.max() < 24.0
    assert 48.0 < altitude.min() < altitude.max() < 111.0
    assert log.share == 1.0
