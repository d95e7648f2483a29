"""Live and replay are one: the same frames give the same bytes."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from cantools.database.can import Database

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.replay.frames import publications, write_frames
from bstm_daemon.service.state_file import read
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

from .bus_log import (
    GRID_US,
    ROOT,
    at_their_lines,
    cycles_of,
    is_own,
    lines_of,
    replayed_cycles,
    write_lines,
)

if TYPE_CHECKING:
    from collections.abc import Callable

pytestmark = pytest.mark.vcan

# hot enough that a lost sample would show, short enough to play in real time
DRIVE = """
[drive]
name = "stop"
description = "a hard stop, then standing"
ambient_c = 10.0
[[segment]]
speed_kmh = 110.0
rate_ms2 = 6.0
gear = 4
duration_s = 7.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 7.0
gear = 3
[[segment]]
parked = true
duration_s = 4.0
"""


@pytest.fixture
def car(tmp_path: Path, vcan0: str) -> Path:
    """Return the configuration of a publishing car on vcan0."""
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    text = text.replace('"../dbc/', f'"{ROOT}/dbc/')
    text = text.replace('channel = "can0"', f'channel = "{vcan0}"')
    head, publish, tail = text.partition("[publish]")
    tail = tail.replace("enabled = false", "enabled = true", 1)
    tail = tail.replace("\ninterval_s = 10.0", "\ninterval_s = 3600.0", 1)
    path = tmp_path / "car.toml"
    path.write_text(head + publish + tail, encoding="utf-8")
    return path


def test_a_recording_replays_to_the_same_frames(
    tmp_path: Path, car: Path, program: Callable[[str], str]
) -> None:
    log = tmp_path / "drive.log"
    drive = simulate(parse_drive(DRIVE, "stop"))
    write_candump(log, drive, Encoder(ROOT / "dbc" / "example_vehicle.dbc"))
    state, recording = tmp_path / "car.state", tmp_path / "bus.log"
    notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    notices.bind(str(tmp_path / "notify"))
    notices.settimeout(30.0)
    with recording.open("w") as file:
        candump = subprocess.Popen(
            [program("candump"), "-L", "vcan0"], stdout=file
        )
        daemon = subprocess.Popen(
            [
                *(sys.executable, "-m", "bstm_daemon.cli.main", "run"),
                *("-c", str(car), "--state", str(state)),
            ],
            env=os.environ | {"NOTIFY_SOCKET": str(tmp_path / "notify")},
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            while b"READY=1" not in notices.recv(4096):
                pass
            while not state.exists():
                assert daemon.poll() is None
            start = shutil.copy(state, tmp_path / "start.state")
            player = subprocess.run(
                [program("canplayer"), "-I", str(log), "vcan0=can0"],
                check=True,
                timeout=120,
            )
            assert player.returncode == 0
            daemon.send_signal(signal.SIGTERM)
            _, said = daemon.communicate(timeout=30)
        finally:
            daemon.kill()
            candump.terminate()
            candump.wait()
            notices.close()
    assert daemon.returncode == 0, said
    assert "Traceback" not in said
    events = [json.loads(line)["event"] for line in said.splitlines()]
    assert events[-1] == "service_stopping"

    bus = lines_of(recording)
    inputs = [line for line in bus if not is_own(line)]
    others = write_lines(tmp_path / "inputs.log", inputs, "vcan0")
    config, signal_map = load_vehicle(car)
    document = read(Path(start)).document
    assert document is not None
    sent, replayed = at_their_lines(
        cycles_of(bus),
        *(inputs[0][0], inputs[-1][0] - GRID_US),
        lambda at: replayed_cycles(config, signal_map, others, document, at),
    )
    lines = [*sent]
    assert len(lines) > 0.8 * (lines[-1] - lines[0]) / GRID_US > 70
    assert sent == replayed

    # and the log that was played gives the same temperatures
    original = tmp_path / "original.log"
    ticks = publications(
        config, signal_map, log, {"can0": "chassis"}, document
    )
    channel = config.bus[config.publishing_bus].channel
    write_frames(ticks, channel, original)
    compare_ends(original, [frame for us in lines for frame in sent[us]])


def compare_ends(original: Path, live: list[str]) -> None:
    """The last temperatures of both agree within one quantum."""
    database = Database()
    database.add_dbc_file(ROOT / "dbc" / "bstm.dbc")
    ends = []
    for frames in ([f for _, f in lines_of(original)], live):
        end = {}
        for frame in frames:
            can_id, _, data = frame.partition("#")
            message = database.get_message_by_frame_id(int(can_id, 16))
            if message.name.endswith("_Temperatures"):
                end[message.name] = message.decode(bytes.fromhex(data))
        ends.append(end)
    assert len(ends[0]) == 4
    for name, values in ends[0].items():
        for node, quantum_k in (
            ("Disc", 0.5),
            ("PadFront", 0.5),
            ("PadBack", 0.5),
            ("Fluid", 0.1),
        ):
            other = ends[1][name][node]
            assert abs(values[node] - other) <= quantum_k * 1.001, name
    assert ends[0]["BSTM_FL_Temperatures"]["Disc"] > 60.0
