"""An effect that ``bstm gap adopt`` wrote works live as it does in replay."""

from __future__ import annotations

import subprocess
from typing import TYPE_CHECKING, Any

import pytest
from cantools.database.can import Database

from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.service.state_file import encode, read, save
from bstm_daemon.simulation import Effects, parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

from .bus_log import (
    GRID_US,
    ROOT,
    Cycles,
    at_their_lines,
    cycles_of,
    is_own,
    lines_of,
    replayed_cycles,
    uncounted,
    write_lines,
)
from .conftest import configured, receivers
from .peers import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from .daemon_process import Daemon

pytestmark = pytest.mark.vcan

HOT_K = 800.0

HEATED = """
[drive]
name = "heated"
description = "a drag, a stop, a soak"
ambient_c = 10.0
thermocouple_logger = true
[[segment]]
speed_kmh = 40.0
rate_ms2 = 1.5
gear = 3
duration_s = 240.0
grade_percent = -10.0
[[segment]]
speed_kmh = 90.0
rate_ms2 = 1.5
gear = 4
duration_s = 40.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 6.0
gear = 0
[[segment]]
parked = true
duration_s = 400.0
"""

LIVE = """
[drive]
name = "live"
description = "brakes released, then a stop"
ambient_c = 10.0
[[segment]]
speed_kmh = 50.0
rate_ms2 = 7.0
gear = 4
duration_s = 4.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 7.0
gear = 3
[[segment]]
parked = true
duration_s = 1.0
"""


def simulated(path: Path, text: str, effects: Effects) -> Path:
    drive = simulate(
        parse_drive(text, path.stem), preset=effects, sensors="n1", seed=4
    )
    write_candump(path, drive, Encoder(ROOT / "dbc" / "example_vehicle.dbc"))
    return path


def pads(frames: list[str]) -> dict[str, float]:
    """Return the last temperature [degC] of each corner's pad face."""
    database = Database()
    database.add_dbc_file(ROOT / "dbc" / "bstm.dbc")
    found = {}
    for frame in frames:
        can_id, _, data = frame.partition("#")
        message = database.get_message_by_frame_id(int(can_id, 16))
        if message.name.endswith("_Temperatures"):
            values: Any = message.decode(bytes.fromhex(data))
            found[message.name] = values["PadFront"]
    return found


def in_order(cycles: Cycles) -> list[str]:
    """Return the frames of *cycles*."""
    return [frame for cycle in cycles.values() for frame in cycle]


def hot_state(running: Daemon, path: Path) -> Path:
    """End the service; return its state with the discs hot."""
    assert running.end() == 0
    document = running.document()
    for corner in document["corners"].values():
        assert "disc" in corner
        corner["disc"] = HOT_K
    save(path, encode(document))
    return path


def test_live_it_does_what_replay_says(
    tmp_path: Path,
    daemon: Callable[..., Daemon],
    program: Callable[[str], str],
    vcan0: str,
) -> None:
    source, adopted = tmp_path / "car.toml", tmp_path / "better.toml"
    # nothing but the bus may hold the service up
    settings = {"bus.channel": vcan0, "metrics.interval_s": 3600.0}
    source.write_text(configured(settings), "utf-8")
    hidden = simulated(
        tmp_path / "heated.log", HEATED, Effects(gap_conduction=2.0)
    )
    log = simulated(tmp_path / "live.log", LIVE, Effects())
    code = main(
        [
            *("gap", "adopt", f"{hidden}", "-c", f"{source}", "--anyway"),
            *("-o", f"{adopted}", "--map", "can0=chassis"),
        ]
    )
    assert code == 0
    text = adopted.read_text("utf-8")
    assert 'name = "gap_conduction"' in text

    start = hot_state(daemon(), tmp_path / "start.state")
    state, bus = tmp_path / "car.state", tmp_path / "bus.log"
    state.write_bytes(start.read_bytes())
    with bus.open("w") as file:
        before = receivers()
        candump = subprocess.Popen(
            [program("candump"), "-L", vcan0], stdout=file
        )
        try:
            wait_until(lambda: receivers() > before, "candump listens")
            service = daemon(edit=lambda _: text, state=state)
            subprocess.run(
                [program("canplayer"), "-I", f"{log}", f"{vcan0}=can0"],
                check=True,
                timeout=60,
            )
            assert service.end() == 0
        finally:
            candump.terminate()
            candump.wait()
    # the file as it was written, nothing else changed
    assert service.config.read_bytes() == adopted.read_bytes()

    lines = lines_of(bus)
    inputs = [line for line in lines if not is_own(line)]
    heard = write_lines(tmp_path / "inputs.log", inputs, vcan0)
    document = read(start).document
    assert document is not None
    begin, end = inputs[0][0], inputs[-1][0] - GRID_US

    def replay(config: Path, sent: set[int]) -> Cycles:
        return replayed_cycles(*load_vehicle(config), heard, document, sent)

    sent, replayed = at_their_lines(
        cycles_of(lines), begin, end, lambda at: replay(adopted, at)
    )
    steps = [*sent]
    assert len(steps) > 0.8 * (steps[-1] - steps[0]) / GRID_US > 50
    # counters go by what was sent before the first frame of others
    live, same = in_order(sent), in_order(replayed)
    assert [*map(uncounted, live)] == [*map(uncounted, same)]
    without = replay(source, set(steps))
    ends = pads(live), pads(in_order(without))
    assert len(ends[0]) == 4
    for name, with_effect_c in ends[0].items():
        assert with_effect_c > ends[1][name] + 20.0, name
