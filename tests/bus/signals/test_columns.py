"""Columns against the live decoder: values, order and counts."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.bus.signals.columns import ChunkDecoder, Events
from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.expression import parse_expression
from bstm_daemon.bus.signals.extraction import (
    Condition,
    FrameKey,
    MessagePlan,
    Output,
    RawSignal,
)
from bstm_daemon.bus.signals.frame_chunk import (
    PREFIX_MASKS,
    FrameChunk,
    columns_for,
    join_in_file_order,
)
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.signals.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.native.loader import VARIABLE, extension

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


FORMS = ["reference"] if extension() is None else ["reference", "any"]
"""What decides between NumPy and the compiled pass."""


def decoded(
    form: str,
    signal_map: SignalMap,
    chunk: FrameChunk,
    bus_of_channel: Sequence[int] = BUS_OF_CHANNEL,
) -> Events:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, form)
        return ChunkDecoder(signal_map).decode(chunk, bus_of_channel)


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
        decoder.counts[RejectReason.UNKNOWN_INTERFACE] = unread

    chunk = join_in_file_order(parts) if parts else columns_for(0)
    for form in FORMS:
        events = decoded(form, signal_map, chunk)

        found = zip(
            events.time_us.tolist(),
            events.role.tolist(),
            events.value.tolist(),
            strict=True,
        )
        assert list(found) == expected
        assert events.counts == decoder.counts
        assert len(events) == len(expected)


SIGNALS_OF_64 = st.tuples(
    st.integers(0, 63), st.integers(1, 64), st.booleans(), st.booleans()
).filter(lambda signal: signal[0] + signal[1] <= 64)
FACTORS = st.sampled_from([1, 2, -3, 0.1, -0.25, 1e6, (1 << 40) + 1])
OFFSETS = st.sampled_from([0, 5, -7, 0.5, 1 << 50])


RAW_SIGNALS = st.builds(
    lambda place, factors, gaps: RawSignal(
        "s",
        place[0],
        place[1],
        place[2],
        place[3],
        floating=False,
        scale=factors[0],
        offset=factors[1],
        unavailable=frozenset(gap & ((1 << place[1]) - 1) for gap in gaps),
    ),
    SIGNALS_OF_64,
    st.tuples(FACTORS, OFFSETS),
    st.lists(st.sampled_from([0, 1, 0xFE, (1 << 64) - 1]), max_size=2),
)
OUTPUTS_OF_ONE = st.tuples(
    st.sampled_from([1.0, 0.7, -1 / 3.6]),
    st.sampled_from([0.0, -40.0]),
    st.sampled_from([(-1e300, 1e300), (-100.0, 100.0)]),
    st.booleans(),
)
SWITCHES = st.tuples(
    st.integers(0, 60),
    st.integers(1, 4),
    *(st.booleans(), st.booleans()),
    st.sampled_from([1, 1, 1, 2]),
    st.frozensets(st.integers(-9, 17)),
)
PAYLOADS = st.one_of(
    st.binary(min_size=8, max_size=8),
    st.sampled_from([b"\0" * 8, b"\xff" * 8, b"\xfe" * 8]),
)


@settings(max_examples=300, deadline=None)
@given(
    signals=st.lists(
        st.tuples(RAW_SIGNALS, OUTPUTS_OF_ONE), min_size=1, max_size=5
    ),
    switches=st.lists(SWITCHES, max_size=2),
    sum_of_all=st.booleans(),
    payloads=st.lists(PAYLOADS, min_size=1, max_size=9),
)
def test_signals_side_by_side_give_what_single_frames_give(
    signals: list[tuple[RawSignal, Any]],
    switches: list[tuple[int, int, bool, bool, int, frozenset[int]]],
    payloads: list[bytes],
    *,
    sum_of_all: bool,
) -> None:
    """With multiplexers before every second one."""
    raws = tuple(
        replace(raw, name=f"s{number}")
        for number, (raw, _) in enumerate(signals)
    )
    outputs = [
        Output(number, number, None, (), gain, bias, low, high, flag)
        for number, (_, (gain, bias, (low, high), flag)) in enumerate(signals)
    ]
    if sum_of_all:
        tree = parse_expression(" + ".join(raw.name for raw in raws))
        first = outputs[0]
        outputs.append(replace(first, role=77, expression=tree))
    conditions = tuple(
        Condition(len(raws) + number, values)
        for number, (*_, values) in enumerate(switches)
    )
    outputs[::2] = [replace(o, conditions=conditions) for o in outputs[::2]]
    raws += tuple(
        RawSignal(f"m{number}", *place, False, scale, 0)
        for number, (*place, scale, _) in enumerate(switches)
    )
    key = FrameKey(0, 0x123, extended=False)
    plan = MessagePlan(key, "M", 8, False, raws, tuple(outputs))
    signal_map = SignalMap((BUSES[0],), {key: plan}, (1,))
    decoder = Decoder(signal_map)
    expected = [
        sample
        for payload in payloads
        for sample in decoder.decode(0, 0x123, False, payload)
    ]
    chunk = join_in_file_order(
        [
            one_frame(number, (0, 0x123, False, payload))
            for number, payload in enumerate(payloads)
        ]
    )

    for form in FORMS:
        events = decoded(form, signal_map, chunk, [0])

        assert events.role.tolist() == [role for role, _ in expected]
        values = np.array([value for _, value in expected], np.float64)
        assert events.value.tobytes() == values.tobytes()
        assert events.counts == decoder.counts


@settings(max_examples=200, deadline=None)
@given(
    signal=SIGNALS_OF_64,
    factors=st.tuples(FACTORS, OFFSETS),
    shift_bytes=st.sampled_from([0, 3, 56]),
    limits=st.sampled_from([(-1e300, 1e300), (-100.0, 100.0)]),
    flag=st.booleans(),
    payload=st.lists(st.binary(min_size=64, max_size=64), max_size=9),
)
def test_any_signal_gives_the_same_bits_in_both_forms(
    signal: tuple[int, int, bool, bool],
    factors: tuple[float, float],
    shift_bytes: int,
    limits: tuple[float, float],
    *,
    flag: bool,
    payload: list[bytes],
) -> None:
    start, length, big_endian, signed = signal
    size = 64 if shift_bytes else 8
    floating = length in (16, 32, 64) and signed and start % 8 == 0
    raw = RawSignal(
        "s",
        start + 8 * shift_bytes,
        length,
        big_endian,
        signed,
        floating,
        *factors,
    )
    output = Output(3, 0, None, (), 0.7, 0.1, *limits, flag)
    key = FrameKey(0, 0x123, extended=False)
    plan = MessagePlan(key, "M", size, size > 8, (raw,), (output,))
    signal_map = SignalMap((BUSES[0],), {key: plan}, (1,))
    parts = [
        one_frame(number, (0, 0x123, False, data[:size]))
        for number, data in enumerate(payload)
    ]
    chunk = join_in_file_order(parts) if parts else columns_for(0)

    first, *others = (decoded(f, signal_map, chunk, [0]) for f in FORMS)

    for other in others:
        assert other.time_us.tobytes() == first.time_us.tobytes()
        assert other.role.tobytes() == first.role.tobytes()
        assert other.value.tobytes() == first.value.tobytes()
        assert other.counts == first.counts


PLAN: dict[str, Any] = {
    "standard": np.zeros(2048, np.int32),
    "keys": np.array([5]),
    "messages": np.zeros(1, np.int32),
    "lengths": np.array([8]),
    "starts": np.array([0, 1]),
    "outputs": np.array([[0, 0, 56, 0, 0, 8, *([0] * 9)]]),
    "factors": np.ones((1, 6)),
    "gaps": np.zeros(1, np.uint64),
    "conditions": np.zeros(0, np.int64),
    "by_hand": np.zeros(1, np.uint8),
}
"""The tables of one message with one output."""


def extracted(compiled: Any, **changes: Any) -> tuple[int, int]:
    """Call the compiled pass for one frame, with some arguments changed."""
    arguments: dict[str, Any] = {
        "plan": tuple(
            (PLAN | {k: changes.pop(k) for k in PLAN if k in changes}).values()
        ),
        "first": 0,
        "samples": 0,
        "channel": np.zeros(1, np.int16),
        "can_id": np.zeros(1, np.uint32),
        "extended": np.zeros(1, np.bool_),
        "length": np.full(1, 8, np.uint8),
        "time_us": np.zeros(1, np.int64),
        "data": np.zeros((1, 8), np.uint8),
        "buses": np.array([0]),
        "times": np.zeros(1, np.int64),
        "roles": np.zeros(1, np.int32),
        "values": np.zeros(1),
        "frame_counts": np.zeros(3, np.int64),
        "sample_counts": np.zeros(3, np.int64),
    }
    found: tuple[int, int] = compiled.extract(*(arguments | changes).values())
    return found


def output_row(
    base: int = 0,
    shift: int = 56,
    beyond: int = 0,
    length: int = 8,
    raw: int = 0,
    gaps: tuple[int, int] = (0, 0),
    *,
    conditions: tuple[int, int] = (0, 0),
) -> npt.NDArray[np.int64]:
    """Return the row of one output for the compiled pass."""
    return np.array(
        [
            [
                *(0, base, shift, beyond, 0, length, raw),
                *(0, 0, 0, 0, *gaps, *conditions),
            ]
        ]
    )


@pytest.mark.parametrize(
    "change",
    [
        {"channel": np.array([1], np.int16)},
        {"channel": np.array([-1], np.int16)},
        {"channel": np.zeros(2, np.int16)},
        {"can_id": np.zeros(1, np.int64)},
        {"extended": np.zeros(0, np.bool_)},
        {"length": np.zeros(2, np.uint8)},
        {"length": np.full(1, 12, np.uint8), "lengths": np.array([12])},
        {"time_us": np.zeros(2, np.int64)},
        {"data": np.zeros((1, 7), np.uint8)},
        {"data": np.zeros((2, 8), np.uint8)},
        {"first": -1},
        {"samples": -1},
        {"samples": 1},
        {"samples": 2},
        {"plan": ()},
        {"standard": np.zeros(2047, np.int32)},
        {"keys": np.zeros(2, np.int64)},
        {"lengths": np.zeros(2, np.int64)},
        {"lengths": np.array([65])},
        {"starts": np.array([0, 2])},
        {"starts": np.array([1, 1])},
        {"starts": np.array([0])},
        {
            "starts": np.array([0, 2, 1]),
            "lengths": np.array([8, 8]),
            "by_hand": np.zeros(2, np.uint8),
        },
        {"outputs": np.append(output_row(), 0)},
        {"outputs": output_row(base=-1)},
        {"outputs": output_row(base=1)},
        {"outputs": output_row(base=57)},
        {"outputs": output_row(shift=64)},
        {"outputs": output_row(shift=-1)},
        {"outputs": output_row(beyond=1)},
        {"outputs": output_row(beyond=8)},
        {"outputs": output_row(shift=0, beyond=1)},
        {"outputs": output_row(length=0)},
        {"outputs": output_row(length=65)},
        {"outputs": output_row(length=16, raw=2)},
        {"outputs": output_row(gaps=(0, 2))},
        {"outputs": output_row(gaps=(-1, 1))},
        {"outputs": output_row(gaps=(1, 0))},
        {"outputs": output_row(conditions=(0, 1))},
        {"outputs": output_row(conditions=(-1, 0))},
        {
            "outputs": output_row(conditions=(1, 0)),
            "conditions": output_row(),
        },
        {
            "outputs": output_row(conditions=(0, 1)),
            "conditions": output_row(base=1),
        },
        {
            "outputs": output_row(conditions=(0, 1)),
            "conditions": output_row(gaps=(0, 2)),
        },
        {"conditions": np.zeros(14, np.int64)},
        {"factors": np.ones((1, 5))},
        {"times": np.zeros(2, np.int64)},
        {"roles": np.zeros(2, np.int32)},
        {"values": np.zeros(1, np.float32)},
        {"frame_counts": np.zeros(2, np.int64)},
        {"sample_counts": np.zeros(2, np.int64)},
    ],
)
def test_the_compiled_pass_refuses_what_would_lead_outside(
    change: dict[str, Any],
) -> None:
    compiled = extension()
    if compiled is None:
        pytest.skip("the compiled pass is not installed")
    assert extracted(compiled) == (1, 1)

    with pytest.raises(
        ValueError, match=r"plan|place|column|sign|items|chann|mess"
    ):
        extracted(compiled, **change)


@pytest.mark.parametrize(
    "change",
    [{}, {"plan": ()}, {"samples": -1}, {"roles": np.zeros(1, np.int64)}],
)
def test_nothing_is_held_after_the_compiled_pass(
    change: dict[str, Any],
) -> None:
    compiled = extension()
    if compiled is None:
        pytest.skip("the compiled pass is not installed")
    data = bytearray(8)

    with suppress(ValueError):
        extracted(compiled, data=data, **change)

    data.append(0)  # which would fail, were it held


@pytest.mark.parametrize(("switch", "samples"), [(3, 1), (5, 1), (4, 0)])
def test_a_sample_is_where_the_multiplexer_has_one_of_its_values(
    switch: int, samples: int
) -> None:
    compiled = extension()
    if compiled is None:
        pytest.skip("the compiled pass is not installed")

    found = extracted(
        compiled,
        data=np.array([[switch, 0, 0, 0, 0, 0, 0, 0]], np.uint8),
        outputs=output_row(conditions=(0, 1)),
        conditions=output_row(shift=0, gaps=(0, 2)),
        gaps=np.array([3, 5], np.uint64),
    )

    assert found == (1, samples)


def test_an_unknown_message_of_the_plan_gives_no_sample() -> None:
    compiled = extension()
    if compiled is None:
        pytest.skip("the compiled pass is not installed")

    for changes in (
        {"standard": np.ones(2048, np.int32)},
        {"standard": np.full(2048, -1, np.int32)},
        {"can_id": np.full(1, 2048, np.uint32)},
        {"buses": np.array([1])},
    ):
        counts = np.zeros(3, np.int64)
        assert extracted(compiled, frame_counts=counts, **changes) == (1, 0)
        assert counts.tolist() == [0, 1, 0]


@pytest.mark.parametrize("form", FORMS)
def test_counts_are_of_one_chunk(
    signal_map: SignalMap, monkeypatch: pytest.MonkeyPatch, form: str
) -> None:
    monkeypatch.setenv(VARIABLE, form)
    decoder = ChunkDecoder(signal_map)
    chunk = one_frame(0, (0, 999, False, bytes(8)))

    counts = [decoder.decode(chunk, BUS_OF_CHANNEL).counts for _ in range(2)]

    assert counts == [{RejectReason.UNKNOWN_ID: 1}] * 2


@pytest.mark.parametrize("size", [8, 64])
def test_a_mask_keeps_the_first_bytes_of_a_payload(size: int) -> None:
    payload = np.arange(1, size + 1, dtype=np.uint8)

    kept = PREFIX_MASKS[size] & payload.view("<u8")

    for count, row in enumerate(kept.view(np.uint8)):
        assert row.tolist() == [*payload[:count], *[0] * (size - count)]


def test_a_reason_is_told_by_its_name() -> None:
    for reason in RejectReason:
        assert reason.value == reason.name.lower()


def test_parts_join_in_the_order_of_their_lines() -> None:
    frames = [(0, 256, False, bytes([n])) for n in range(4)]
    parts = [one_frame(n, frames[n]) for n in (3, 0, 2, 1)]

    joined = join_in_file_order(parts)

    assert joined.line.tolist() == [1, 2, 3, 4]
    assert joined.data[:, 0].tolist() == [0, 1, 2, 3]
