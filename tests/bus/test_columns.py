"""Columns against the live decoder: values, order and counts."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.bus.columns import decode_chunk
from bstm_daemon.bus.decoder import Decoder
from bstm_daemon.bus.frame_chunk import (
    FrameChunk,
    empty_chunk,
    join_in_file_order,
)
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.bus.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config import BusConfig, SignalConfig

DBC = """VERSION ""
BU_: X
BO_ 256 BRAKE: 8 X
 SG_ p1 : 7|12@0- (0.1,0) [0|0] "" X
 SG_ p2 : 16|12@1- (0.3,-1) [0|0] "" X
 SG_ real : 32|32@1- (1,0) [0|0] "" X
BO_ 2147483904 MOTION: 4 X
 SG_ kind M : 0|2@1+ (1,0) [0|0] "" X
 SG_ ax m1 : 8|16@1- (0.01,0) [0|0] "" X
 SG_ switch : 2|1@1+ (1,0) [0|0] "" X
BO_ 257 WIDE: 20 X
 SG_ far : 150|10@1- (1,0) [0|0] "" X

SIG_VALTYPE_ 256 real : 1;
"""
BUSES = [
    BusConfig(name="a", dbc="car.dbc", channel="can0"),
    BusConfig(name="b", dbc="car.dbc", channel="can1"),
]
SIGNALS = {
    "primary_pressure": SignalConfig(
        message="BRAKE", signal="p1", unit="bar", min=-20.0, max=150.0
    ),
    "secondary_pressure": SignalConfig(
        message="BRAKE", expression="max(p1, p2) / abs(p1 - p2)", unit="bar"
    ),
    "yaw_rate": SignalConfig(message="BRAKE", signal="real", unit="deg/s"),
    "acceleration_longitudinal": SignalConfig(
        message="MOTION", signal="ax", unit="g", bus="b", sign=-1, scale=0.7
    ),
    "brake_switch": SignalConfig(
        message="MOTION", signal="switch", unit="bool", bus="b"
    ),
    "ambient_temperature": SignalConfig(
        message="WIDE", signal="far", unit="degF", bus="b", offset=0.1
    ),
}
BUS_OF_CHANNEL = [1, -1, 0]


@pytest.fixture(scope="module")
def signal_map(tmp_path_factory: pytest.TempPathFactory) -> SignalMap:
    base = tmp_path_factory.mktemp("columns")
    (base / "car.dbc").write_text(DBC)
    return compile_signal_map(BUSES, SIGNALS, base, 0.3)


FRAMES = st.tuples(
    st.integers(0, 2),
    st.sampled_from([256, 256, 257, 258]),
    st.booleans(),
    st.sampled_from([8, 8, 8, 4, 4, 20, 7]).flatmap(
        lambda size: st.one_of(
            st.binary(min_size=size, max_size=size),
            st.sampled_from([b"\0" * size, b"\xff" * size]),
        )
    ),
)


def one_frame(number: int, frame: tuple[int, int, bool, bytes]) -> FrameChunk:
    channel, can_id, extended, data = frame
    width = 8 if len(data) <= 8 else 64
    payload = np.frombuffer(data.ljust(width, b"\0"), np.uint8)
    return FrameChunk(
        time_us=np.array([(number * 7919) % 1000], np.int64),
        line=np.array([number + 1], np.int64),
        channel=np.array([channel], np.int16),
        can_id=np.array([can_id], np.uint32),
        extended=np.array([extended], np.bool_),
        length=np.array([len(data)], np.uint8),
        data=payload[np.newaxis],
    )


@settings(max_examples=200, deadline=None)
@given(frames=st.lists(FRAMES, max_size=30))
def test_a_chunk_gives_what_its_frames_give(
    signal_map: SignalMap, frames: list[tuple[int, int, bool, bytes]]
) -> None:
    parts = [one_frame(*numbered) for numbered in enumerate(frames)]
    decoder = Decoder(signal_map)
    expected = []
    unread = 0
    for number, (channel, can_id, extended, data) in enumerate(frames):
        bus = BUS_OF_CHANNEL[channel]
        if bus < 0:
            unread += 1
            continue
        expected += [
            ((number * 7919) % 1000, role, value)
            for role, value in decoder.decode(bus, can_id, extended, data)
        ]
    if unread:
        decoder.counts[Refusal.UNKNOWN_INTERFACE] = unread

    chunk = join_in_file_order(parts) if parts else empty_chunk()
    events = decode_chunk(signal_map, chunk, BUS_OF_CHANNEL)

    found = zip(
        events.time_us.tolist(),
        events.role.tolist(),
        events.value.tolist(),
        strict=True,
    )
    assert list(found) == expected
    assert events.counts == decoder.counts
    assert len(events) == len(expected)


def test_parts_join_in_the_order_of_their_lines() -> None:
    frames = [(0, 256, False, bytes([n])) for n in range(4)]
    parts = [one_frame(n, frames[n]) for n in (3, 0, 2, 1)]

    joined = join_in_file_order(parts)

    assert joined.line.tolist() == [1, 2, 3, 4]
    assert joined.data[:, 0].tolist() == [0, 1, 2, 3]
