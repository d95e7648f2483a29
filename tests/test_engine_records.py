"""Frames as records give what the same frames give one by one."""

from __future__ import annotations

import struct
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pytest

from bstm_daemon.bus.live.frame_records import RECORD_BYTES, FrameRecords
from bstm_daemon.bus.opening import open_log
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.native.loader import live_extension
from bstm_daemon.simulation.drives import parse_drive
from bstm_daemon.simulation.recorder import Encoder, write_candump
from bstm_daemon.simulation.simulate import simulate

if TYPE_CHECKING:
    from bstm_daemon.engine import Published

ROOT = Path(__file__).resolve().parents[1]
RECORD = struct.Struct("=qqIi4B4x64s")
DRIVE = """
[drive]
name = "short"
description = "two stops"
ambient_c = 10.0
[[segment]]
speed_kmh = 72.0
rate_ms2 = 4.0
gear = 3
duration_s = 6.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 4.0
[[segment]]
parked = true
duration_s = 2.0
"""


class Frame(NamedTuple):
    """One of the drive, or what may come among them."""

    time_us: int
    can_id: int
    data: bytes
    is_error: bool = False


@pytest.fixture(scope="module")
def frames(tmp_path_factory: pytest.TempPathFactory) -> list[Frame]:
    """Return a drive with error frames, foreign ids and wrong lengths."""
    path = tmp_path_factory.mktemp("records") / "short.log"
    encoder = Encoder(ROOT / "dbc" / "example_vehicle.dbc")
    write_candump(path, simulate(parse_drive(DRIVE, "short")), encoder)
    found: list[Frame] = []
    number = 0
    for chunk in open_log(path).chunks():
        for time_us, can_id, length, data in zip(
            chunk.time_us.tolist(),
            chunk.can_id.tolist(),
            chunk.length.tolist(),
            [row.tobytes() for row in chunk.data],
            strict=True,
        ):
            found.append(Frame(time_us, can_id, data[:length]))
            number += 1
            other = number * 7919 % 41
            if other == 0:
                found.append(Frame(time_us, 4, bytes(8), is_error=True))
            elif other == 1:
                found.append(Frame(time_us, 0x7EF, bytes(8)))
            elif other == 2:
                found.append(Frame(time_us, can_id, data[: length - 1]))
            elif other == 3:
                found.append(Frame(time_us, can_id, b"\xff" * length))
    return found


def run(
    frames: list[Frame], *, as_records: bool
) -> tuple[Engine, list[Published]]:
    """Tick every 50 ms over *frames*."""
    engine = Engine(*load_vehicle(ROOT / "config" / "example_vehicle.toml"))
    extension = live_extension()
    if extension is None:
        pytest.skip("the compiled form is not installed")
    records = FrameRecords(extension, 1)
    published = []
    cuts = [0]
    for index, frame in enumerate(frames):
        if frame.time_us // 50_000 != frames[cuts[-1]].time_us // 50_000:
            cuts.append(index)
    for first, end in pairwise([*cuts, len(frames)]):
        part = frames[first:end]
        for index, frame in enumerate(part):
            RECORD.pack_into(
                *(records.store, index * RECORD_BYTES, 1, frame.time_us),
                *(frame.can_id, 0, False, len(frame.data)),
                *(frame.is_error, False, frame.data),
            )
        records.filled = records.ready = len(part)
        index = 0
        while index < len(part):
            if as_records:
                index = engine.frames(records, index)
                if index == len(part):
                    break
            time_us, bus, frame = records[index]
            engine.frame(
                *(bus, frame.can_id, frame.extended, frame.data, time_us),
                is_error=frame.is_error,
            )
            index += 1
        published += engine.tick(part[-1].time_us)
    return engine, published


def test_the_same_is_published(frames: list[Frame]) -> None:
    one_by_one, expected = run(frames, as_records=False)
    in_runs, found = run(frames, as_records=True)

    assert len(expected) > 100
    assert found == expected
    assert in_runs.decoder.counts == one_by_one.decoder.counts
    assert in_runs.decoder.rejected == one_by_one.decoder.rejected
    assert in_runs.export_state() == one_by_one.export_state()
