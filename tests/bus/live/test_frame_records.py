"""Records give the samples that their frames give, one by one."""

from __future__ import annotations

import struct
from array import array
from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.bus.live.frame_records import (
    RECORD_BYTES,
    FrameRecords,
    RecordDecoder,
)
from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.expression import parse_expression
from bstm_daemon.bus.signals.extraction import (
    Condition,
    FrameKey,
    MessagePlan,
    Output,
    RawSignal,
)
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.config.service import E2eConfig
from bstm_daemon.native.loader import VARIABLE, live_extension

if TYPE_CHECKING:
    from bstm_daemon.bus.signals.reject_reason import RejectReason
    from bstm_daemon.native.loader import BusExtension

RECORD = struct.Struct("=qqIi4B4x64s")
BUSES = (
    BusConfig(name="a", channel="can0", dbc="a.dbc"),
    BusConfig(name="b", channel="can1", dbc="a.dbc", fd=True),
)
HELD = {3: "third", 5: "fifth"}


class Received(NamedTuple):
    """A frame that came."""

    time_us: int
    bus: int
    can_id: int
    extended: bool
    data: bytes
    is_error: bool = False
    is_remote: bool = False


@pytest.fixture(scope="module")
def live() -> BusExtension:
    found = live_extension()
    if found is None:
        pytest.skip("the compiled form is not installed")
    return found


def records_of(live: BusExtension, frames: list[Received]) -> FrameRecords:
    records = FrameRecords(live, 1)
    for index, frame in enumerate(frames):
        RECORD.pack_into(
            *(records.store, index * RECORD_BYTES, 1, frame.time_us),
            *(frame.can_id, frame.bus, frame.extended, len(frame.data)),
            *(frame.is_error, frame.is_remote, frame.data),
        )
    records.filled = records.ready = len(frames)
    return records


class Outcome(NamedTuple):
    """What came of some frames."""

    samples: list[tuple[int, int, str]]
    """Time, role and the very bits of the value."""
    held: list[tuple[int, str, str]]
    counts: Counter[RejectReason]
    rejected: int


def one_by_one(signal_map: SignalMap, frames: list[Received]) -> Outcome:
    decoder = Decoder(signal_map)
    samples = [
        (frame.time_us, role, float(value).hex())
        for frame in frames
        for role, value in _decode(decoder, frame)
    ]
    return _outcome(samples, decoder)


def in_runs(
    live: BusExtension, signal_map: SignalMap, frames: list[Received]
) -> tuple[Outcome, int]:
    """Return what records give, and how many went one by one."""
    decoder = Decoder(signal_map)
    runs = RecordDecoder(signal_map, HELD)
    records = records_of(live, frames)
    samples: list[tuple[int, int, str]] = []
    held: list[tuple[int, str, float]] = []
    position = single = 0
    while position < len(frames):
        position = runs.decode(records, position, decoder.counts, held)
        samples += [
            (time_us, role, value.hex())
            for time_us, role, value in zip(
                runs.times_us[: runs.count],
                runs.roles[: runs.count],
                runs.values[: runs.count],
                strict=True,
            )
        ]
        if position < len(frames):
            before = len(samples)
            samples += [
                (frames[position].time_us, role, float(value).hex())
                for role, value in _decode(decoder, frames[position])
            ]
            held += [
                (time_us, HELD[role], float.fromhex(value))
                for time_us, role, value in samples[before:]
                if role in HELD
            ]
            position += 1
            single += 1
    found = _outcome(samples, decoder)
    assert [(t, name, value.hex()) for t, name, value in held] == found.held
    return found, single


def _decode(decoder: Decoder, frame: Received) -> Any:
    return decoder.decode(
        *(frame.bus, frame.can_id, frame.extended, frame.data),
        is_error=frame.is_error,
        is_remote=frame.is_remote,
    )


def _outcome(samples: list[tuple[int, int, str]], decoder: Decoder) -> Outcome:
    held = [
        (t, HELD[role], value) for t, role, value in samples if role in HELD
    ]
    return Outcome(samples, held, decoder.counts, decoder.rejected)


FACTORS = st.sampled_from([1, 2, -3, 0.1, -0.25, 1e6, (1 << 40) + 1])
OFFSETS = st.sampled_from([0, 5, -7, 0.5, 1 << 50])
LIMITS = st.sampled_from([(-1e300, 1e300), (-100.0, 100.0)])


@st.composite
def plans(draw: st.DrawFn, key: FrameKey) -> MessagePlan:
    size = draw(st.sampled_from([8, 8, 3, 64])) if key.bus else 8
    raws, outputs = [], []
    for number in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, 8 * size - 1))
        length = draw(st.integers(1, min(64, 8 * size - start)))
        floating = length in (32, 64) and draw(st.booleans())
        gaps = draw(st.lists(st.sampled_from([0, 1, (1 << 64) - 1])))
        raws.append(
            RawSignal(
                *(f"s{number}", start, length),
                big_endian=draw(st.booleans()),
                signed=draw(st.booleans()),
                floating=floating,
                scale=draw(FACTORS),
                offset=draw(OFFSETS),
                unavailable=frozenset(g & ((1 << length) - 1) for g in gaps),
            )
        )
        gain, bias = draw(st.sampled_from([(1.0, 0.0), (-1 / 3.6, -40.0)]))
        outputs.append(
            Output(
                *(draw(st.integers(0, 7)), number, None, (), gain, bias),
                *(*draw(LIMITS), draw(st.booleans())),
            )
        )
    if draw(st.integers(0, 5)) == 0:
        outputs[0] = replace(
            outputs[0], conditions=(Condition(0, frozenset({0, 1})),)
        )
    if draw(st.integers(0, 5)) == 0:
        tree = parse_expression("s0 + 1")
        outputs.append(replace(outputs[0], role=7, expression=tree))
    return MessagePlan(key, "M", size, size > 8, tuple(raws), tuple(outputs))


KEYS = [
    FrameKey(0, 0x123, extended=False),
    FrameKey(0, 0x123, extended=True),
    FrameKey(1, 0x124, extended=False),
    FrameKey(1, 0x1ABCDEF0, extended=True),
]


@st.composite
def traffic(draw: st.DrawFn) -> tuple[SignalMap, list[Received]]:
    messages = {key: draw(plans(key)) for key in KEYS}
    frames = []
    for number in range(draw(st.integers(0, 20))):
        key = draw(st.sampled_from(KEYS))
        size = messages[key].length
        data = draw(
            st.one_of(
                st.binary(min_size=size, max_size=size),
                st.sampled_from([bytes(size), b"\xff" * size]),
            )
        )
        frame = Received(number * 7919 % 1000, *key, data)
        kind = draw(st.integers(0, 19))
        if kind == 0:
            frame = frame._replace(is_error=True, extended=False)
        elif kind == 1:
            frame = frame._replace(is_remote=True, data=b"")
        elif kind == 2:
            frame = frame._replace(data=data[:-1])
        elif kind == 3:
            frame = frame._replace(
                can_id=draw(st.sampled_from([0x7FF, 0x124]))
            )
        elif kind == 4:
            frame = frame._replace(bus=1 - key.bus)
        frames.append(frame)
    return SignalMap(BUSES, messages, (1,)), frames


@settings(max_examples=120, deadline=None)
@given(case=traffic())
def test_records_give_what_their_frames_give(
    live: BusExtension, case: tuple[SignalMap, list[Received]]
) -> None:
    signal_map, frames = case

    found, _ = in_runs(live, signal_map, frames)

    assert found == one_by_one(signal_map, frames)


def plain_map(**protected: Any) -> SignalMap:
    """Return two messages of two signals each, one of them protected."""
    raw = RawSignal("s", 0, 8, False, False, False, 0.5, 1)
    outputs = tuple(
        Output(role, 0, None, (), 1.0, 0.0, -1e9, 1e9, False)
        for role in (3, 4)
    )
    messages = {
        key: MessagePlan(key, "M", 8, False, (raw,), outputs)
        for key in KEYS[:2]
    }
    return SignalMap(BUSES, messages, (1,), **protected)


def test_plain_frames_are_decoded_without_a_look_at_each(
    live: BusExtension,
) -> None:
    frames = [
        Received(n, 0, 0x123, n % 2 == 1, bytes([n] * 8)) for n in range(200)
    ]

    found, single = in_runs(live, plain_map(), frames)

    assert single == 0
    assert len(found.samples) == 400
    assert found == one_by_one(plain_map(), frames)


def test_each_of_many_extended_ids_is_found(live: BusExtension) -> None:
    [plan, _] = plain_map().messages.values()
    keys = [FrameKey(n % 2, 0x10000 + n, extended=True) for n in range(20)]
    messages = {key: replace(plan, key=key) for key in keys}
    signal_map = SignalMap(BUSES, messages, (1,))
    frames = [Received(0, *key, bytes(8)) for key in keys]

    found, single = in_runs(live, signal_map, frames)

    assert single == 0
    assert found == one_by_one(signal_map, frames)


def test_more_samples_than_find_room_come_in_several_runs(
    live: BusExtension,
) -> None:
    frames = [
        Received(n, 0, 0x123, False, bytes([n % 256] * 8)) for n in range(5000)
    ]
    records = records_of(live, frames)
    decoder = RecordDecoder(plain_map(), {})
    position, found = 0, []
    while position < len(frames):
        position = decoder.decode(records, position, Counter(), [])
        assert decoder.count
        found += decoder.times_us[: decoder.count : 2].tolist()

    assert found == list(range(5000))


def test_a_protected_message_is_left_to_its_guard(live: BusExtension) -> None:
    config = E2eConfig(message="M", profile=2, data_ids=list(range(16)))
    signal_map = plain_map(protected={KEYS[0]: config})
    frames = [Received(n, 0, 0x123, n != 3, bytes([n] * 8)) for n in range(9)]
    decoder = RecordDecoder(signal_map, {})

    records = records_of(live, frames)

    assert decoder.decode(records, 0, Counter(), []) == 3
    assert decoder.decode(records, 3, Counter(), []) == 3
    assert decoder.decode(records, 4, Counter(), []) == 9


@pytest.mark.parametrize(
    ("odd", "reason"),
    [
        ({"is_remote": True}, "REMOTE_FRAME"),
        ({"is_error": True}, "ERROR_FRAME"),
        ({"data": bytes(range(1, 8))}, "WRONG_LENGTH"),
        ({"data": bytes(range(1, 13))}, "WRONG_LENGTH"),
        ({"data": b""}, "WRONG_LENGTH"),
        ({"can_id": 0x124}, "UNKNOWN_ID"),
        ({"bus": 1}, "UNKNOWN_ID"),
    ],
)
def test_no_sample_comes_of_what_is_no_frame_of_a_message(
    live: BusExtension, odd: dict[str, Any], reason: str
) -> None:
    """Each has bytes that would decode, eight of them or more or less."""
    whole = bytes(range(1, 9))
    plain = [Received(n, 0, 0x123, False, whole) for n in range(3)]
    frames = [plain[0], plain[1]._replace(**odd), plain[2]]
    records = records_of(live, frames)
    decoder = RecordDecoder(plain_map(), {})

    assert decoder.decode(records, 0, Counter(), []) == 1
    assert decoder.times_us[: decoder.count].tolist() == [0, 0]
    assert decoder.values[: decoder.count].tolist() == [1.5, 1.5]
    assert decoder.decode(records, 1, Counter(), []) == 1
    assert decoder.count == 0
    assert decoder.decode(records, 2, Counter(), []) == 3
    assert decoder.times_us[: decoder.count].tolist() == [2, 2]

    found, single = in_runs(live, plain_map(), frames)
    assert single == 1
    assert [sample[0] for sample in found.samples] == [0, 0, 2, 2]
    assert found == one_by_one(plain_map(), frames)
    assert [one.name for one in found.counts if found.counts[one]] == [reason]


def test_an_id_too_high_is_not_one_of_the_next_bus(
    live: BusExtension,
) -> None:
    """The ids of standard frames stand bus after bus in one table."""
    key = FrameKey(1, 0x124, extended=False)
    [plan, _] = plain_map().messages.values()
    signal_map = SignalMap(BUSES, {key: replace(plan, key=key)}, (1,))
    frames = [Received(0, *one, bytes(8)) for one in (key, (0, 0x924, False))]
    records = records_of(live, frames)
    decoder = RecordDecoder(signal_map, {})

    assert decoder.decode(records, 0, Counter(), []) == 1
    assert decoder.count == 2
    assert decoder.decode(records, 1, Counter(), []) == 1
    assert decoder.count == 0


@pytest.mark.parametrize(
    ("low_us", "high_us", "latest_us", "placed", "late"),
    [
        (-2000, 9000, 9000, 4, 2),
        (-1000, 9000, 9000, 2, 1),
        (-1001, 4000, 9000, 4, 2),
        (-2000, 3999, 9000, 0, 0),
        (-2000, 9000, 3999, 0, 0),
    ],
)
def test_records_are_placed_in_time_up_to_one_that_is_far(
    live: BusExtension,
    low_us: int,
    high_us: int,
    latest_us: int,
    placed: int,
    late: int,
) -> None:
    """Stamps are rounded down, and time does not go back."""
    records = FrameRecords(live, 1)
    stamps_ns = [5_000_999, 3_000_000, -1, 4_000_000]
    for index, stamp_ns in enumerate(stamps_ns):
        RECORD.pack_into(
            *(records.store, index * RECORD_BYTES, stamp_ns, 77),
            *(0, 0, 0, 0, 0, 0, b""),
        )
    shift_us, passed_us = 1000, 3000

    found = live.place_in_time(
        *(records.store, 0, len(stamps_ns), shift_us),
        *(low_us, high_us, latest_us, passed_us),
    )

    assert found == (placed, late)
    on_axis = [4000, 3000, 3000, 3000][:placed]
    assert [records.at(n)[0] for n in range(len(stamps_ns))] == [
        *on_axis,
        *[77] * (len(stamps_ns) - placed),
    ]


def test_only_ready_records_are_decoded(live: BusExtension) -> None:
    frames = [Received(n, 0, 0x123, False, bytes(8)) for n in range(9)]
    records = records_of(live, frames)
    records.ready = 4

    decoder = RecordDecoder(plain_map(), {})

    assert decoder.decode(records, 0, Counter(), []) == 4
    records.drop_ready()
    assert [records.at(n)[0] for n in range(records.filled)] == [4, 5, 6, 7, 8]


@pytest.mark.parametrize(
    ("place", "other"),
    [
        (1, -1),
        (2, 3),
        (2, 2**62),
        (3, ()),
        (5, b"\0"),
        (6, b"\0" * 8),
        (7, b"\0" * 8),
        (8, (None,)),
        (6, array("q", bytes(1 << 17))),
        (7, array("f", bytes(1 << 17))),
    ],
)
def test_the_compiled_pass_refuses_what_would_lead_outside(
    live: BusExtension, place: int, other: Any
) -> None:
    """Its plan is that of a log, which test_columns.py puts to the test."""
    decoder = RecordDecoder(plain_map(), HELD)
    frames = [Received(n, 0, 0x123, False, bytes(8)) for n in range(2)]
    store = bytearray(records_of(live, frames).store[: 2 * RECORD_BYTES])
    good: list[Any] = [store, 0, 2, *decoder._arguments, []]
    assert live.take(*good) == (2, 4)
    bad = list(good)
    if isinstance(other, bytes):
        original = memoryview(good[place])
        other = memoryview(bytearray(other)).cast("B")
        if len(other) % original.itemsize == 0:
            other = other.cast(original.format)
    bad[place] = other

    with pytest.raises(ValueError, match=r"plan|record|column|items|role"):
        live.take(*bad)
    store.append(0)  # which would fail, were it held


@settings(max_examples=50, deadline=None)
@given(st.lists(st.integers(0, 9), max_size=80), st.integers(-1, 10))
def test_records_are_put_in_order_as_sorted_does(
    live: BusExtension, times: list[int], until_us: int
) -> None:
    """Those of one time stay in the order in which they came."""
    frames = [Received(t, 0, n, False, b"") for n, t in enumerate(times)]
    records = records_of(live, frames)

    records.sort(until_us)

    found = [records.at(n) for n in range(len(frames))]
    assert [(time_us, frame.can_id) for time_us, _, frame in found] == [
        (one.time_us, one.can_id)
        for one in sorted(frames, key=lambda one: one.time_us)
    ]
    assert records.ready == sum(t <= until_us for t in times)


def test_the_reference_form_has_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "reference")

    assert live_extension() is None
