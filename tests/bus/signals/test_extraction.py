"""Both executors of the extraction plan against cantools, bit for bit."""

import os
import struct
from collections.abc import Iterator
from pathlib import Path

import cantools.database
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.bus.logs.candump import CandumpReader
from bstm_daemon.bus.signals.columns import ChunkDecoder, Events
from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.extraction import (
    EXTENDED_MAX,
    FD_LENGTHS,
    STANDARD_MAX,
    FrameKey,
)
from bstm_daemon.bus.signals.frame_chunk import FrameChunk
from bstm_daemon.bus.signals.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config.sections import BusConfig, SignalConfig
from bstm_daemon.roles import ROLE_INDEX, ROLES

Database = cantools.database.can.Database
Message = cantools.database.can.Message
Signals = dict[str, SignalConfig]
Multiplexed = tuple[SignalMap, Signals, Database]

# in kelvin a measured temperature is the DBC's value as it is
KELVIN_ROLES = [
    role.name for role in ROLES if role.quantities == ("temperature",)
]
BUS = BusConfig(name="car", dbc="car.dbc", strict=False)


def chunk_of(frames: list[tuple[int, int, bool, bytes]]) -> FrameChunk:
    """Return frames (channel, id, extended, data) as columns.

    Their times run backwards, one microsecond each.
    """
    width = 8 if max(len(frame[3]) for frame in frames) <= 8 else 64
    payloads = b"".join(frame[3].ljust(width, b"\0") for frame in frames)
    return FrameChunk(
        time_us=np.arange(len(frames), dtype=np.int64)[::-1].copy(),
        line=np.arange(1, len(frames) + 1, dtype=np.int64),
        channel=np.array([frame[0] for frame in frames], np.int16),
        can_id=np.array([frame[1] for frame in frames], np.uint32),
        extended=np.array([frame[2] for frame in frames], np.bool_),
        length=np.array([len(frame[3]) for frame in frames], np.uint8),
        data=np.frombuffer(payloads, np.uint8).reshape(len(frames), width),
    )


def bits(value: float) -> bytes:
    return struct.pack("<d", value)


def live_samples(
    decoder: Decoder, frames: list[tuple[int, int, bool, bytes]]
) -> list[tuple[int, int, bytes]]:
    """Return (frame number, role, bits of the value) of each sample."""
    return [
        (number, role, bits(value))
        for number, frame in enumerate(frames)
        for role, value in decoder.decode(*frame)
    ]


def column_samples(
    events: Events, frames: int
) -> list[tuple[int, int, bytes]]:
    """Return the same of the events of a :func:`chunk_of` frames."""
    return [
        (frames - 1 - int(time), int(role), bits(value))
        for time, role, value in zip(
            events.time_us, events.role, events.value, strict=True
        )
    ]


def all_signals(database: Database) -> Signals:
    """Map every signal, one a kelvin role, in the order of the DBC."""
    pairs = [
        (message.name, signal.name)
        for message in database.messages
        for signal in message.signals
    ]
    return {
        role: SignalConfig(message=message, signal=signal, unit="K")
        for role, (message, signal) in zip(KELVIN_ROLES, pairs, strict=False)
    }


NUMBERS = ["1", "2", "-3", "0.1", "1.0", "0.0625", "1e-3", "-0.333", "7.0",
           "36028797018963969", "1.7e18"]  # fmt: skip
OFFSETS = ["0", "0", "-40", "0.5", "-273.15", "3.0", "9007199254740993",
           "0.0", "18446744073709551615"]  # fmt: skip


@st.composite
def signal_line(
    draw: st.DrawFn, name: str, start: int, length: int, *, big: bool
) -> str:
    """Return a signal whose bits are ``start ..`` in its own counting."""
    dbc_start = 8 * (start // 8) + 7 - start % 8 if big else start
    sign = draw(st.sampled_from("+-"))
    scale, offset = (
        draw(st.sampled_from(NUMBERS)),
        draw(st.sampled_from(OFFSETS)),
    )
    return (
        f" SG_ {name} : {dbc_start}|{length}@{0 if big else 1}{sign} "
        f'({scale},{offset}) [0|0] "" X\n'
    )


@st.composite
def message_text(draw: st.DrawFn, number: int) -> tuple[str, str]:
    """Return a message and the value types of its float signals.

    Its first bytes hold little endian signals, the others big endian ones.
    """
    size = draw(st.sampled_from([*range(1, 9), 12, 20, 64, 8, 8]))
    split = draw(st.integers(0, size))
    text = f"BO_ {100 + number} M{number}: {size} X\n"
    types = ""
    count = 0
    for big, first, last in ((False, 0, split), (True, split, size)):
        at = 8 * first
        while count < 6 and at < 8 * last and draw(st.booleans()):
            at += draw(st.integers(0, min(9, 8 * last - at - 1)))
            room = 8 * last - at
            length = draw(st.integers(1, min(64, room)))
            kind = draw(st.integers(0, 3))
            if kind in (1, 2) and room >= 32 * kind:
                length = 32 * kind
                name = f"S{number}_{count}"
                types += f"SIG_VALTYPE_ {100 + number} {name} : {kind};\n"
            text += draw(
                signal_line(f"S{number}_{count}", at, length, big=big)
            )
            at += length
            count += 1
    return text, types


@st.composite
def databases(draw: st.DrawFn) -> str:
    parts = [draw(message_text(number)) for number in range(3)]
    return (
        'VERSION ""\nBU_: X\n'
        + "".join(part[0] for part in parts)
        + "".join(part[1] for part in parts)
    )


SPECIAL_FLOATS = [
    struct.pack("<f", value) * 16
    for value in (float("nan"), float("inf"), -0.0, 1e-45, -3.4e38)
] + [struct.pack("<d", -0.0) * 8, struct.pack(">d", 1e308) * 8]
PAYLOADS = st.one_of(
    st.binary(min_size=64, max_size=64),
    st.sampled_from([b"\xff" * 64, b"\0" * 64, b"\x80" + b"\0" * 63]),
    st.sampled_from(SPECIAL_FLOATS),
)


def expected_samples(
    database: Database, signals: Signals, frames: list
) -> Iterator[tuple[int, int, bytes]]:
    for number, (_, can_id, _, data) in enumerate(frames):
        message = database.get_message_by_frame_id(can_id)
        decoded = message.decode(data, decode_choices=False)
        for role, source in signals.items():
            if source.message == message.name:
                value = float(decoded[source.signal])
                if np.isfinite(value):
                    # adding 0.0: the map to SI makes 0.0 of -0.0
                    yield number, ROLE_INDEX[role], bits(value + 0.0)


@settings(max_examples=80, deadline=None)
@given(text=databases(), payloads=st.lists(PAYLOADS, min_size=1, max_size=6))
def test_both_executors_equal_cantools(
    tmp_path_factory: pytest.TempPathFactory, text: str, payloads: list[bytes]
) -> None:
    base = tmp_path_factory.getbasetemp()
    (base / "car.dbc").write_text(text)
    database = cantools.database.load_string(text, "dbc")
    signals = all_signals(database)
    signal_map = compile_signal_map([BUS], signals, base, 0.3)
    frames = [
        (0, message.frame_id, False, padded(payload[: message.length]))
        for payload in payloads
        for message in database.messages
    ]
    expected = list(expected_samples(database, signals, frames))

    decoder = Decoder(signal_map)
    live = live_samples(decoder, frames)
    events = ChunkDecoder(signal_map).decode(chunk_of(frames), [0])

    assert live == expected
    assert decoder.counts == events.counts
    assert column_samples(events, len(frames)) == expected


def padded(payload: bytes) -> bytes:
    """Return *payload* as a frame carries it."""
    size = min(length for length in FD_LENGTHS if length >= len(payload))
    return payload.ljust(size, b"\xcc")


EDGES = [
    *(b"\0" * 8, b"\xff" * 8, b"\x80" + b"\0" * 7, b"\0" * 7 + b"\x80"),
    *(b"\x7f" + b"\xff" * 7, b"\xff" * 7 + b"\x7f", b"\x55" * 8),
    *(bytes(range(1, 9)), bytes(range(0xF8, 0x100))),
]


@pytest.mark.parametrize("length", [53, 54, 63, 64])
@pytest.mark.parametrize("sign", "+-")
@pytest.mark.parametrize("scale", NUMBERS)
def test_large_numbers_are_rounded_once(
    tmp_path: Path, length: int, sign: str, scale: str
) -> None:
    """Beyond 2**53 the order of multiplying, adding and rounding shows."""
    cases = [
        (offset, big) for offset in sorted(set(OFFSETS)) for big in (0, 1)
    ]
    text = 'VERSION ""\nBU_: X\n' + "".join(
        f"BO_ {100 + number} M{number}: 8 X\n"
        f" SG_ S{number} : {7 * big}|{length}@{1 - big}{sign} "
        f'({scale},{offset}) [0|0] "" X\n'
        for number, (offset, big) in enumerate(cases)
    )
    # a value table is ignored; cantools then keeps the scale as it is written
    text += "".join(
        f'VAL_ {100 + number} S{number} 1 "one" 85 "other" ;\n'
        for number, (_, big) in enumerate(cases)
        if big
    )
    (tmp_path / "car.dbc").write_text(text)
    database = cantools.database.load_string(text, "dbc")
    signals = all_signals(database)
    signal_map = compile_signal_map([BUS], signals, tmp_path, 0.3)
    frames = [
        (0, message.frame_id, False, data)
        for data in EDGES
        for message in database.messages
    ]
    expected = list(expected_samples(database, signals, frames))

    events = ChunkDecoder(signal_map).decode(chunk_of(frames), [0])

    assert live_samples(Decoder(signal_map), frames) == expected
    assert column_samples(events, len(frames)) == expected


MULTIPLEXED = """VERSION ""
BU_: X
BO_ 256 PLAIN: 8 X
 SG_ selector M : 0|8@1+ (1,0) [0|0] "" X
 SG_ a m1 : 8|16@1- (0.1,0) [0|0] "" X
 SG_ b m2 : 8|16@1+ (1,-5) [0|0] "" X
 SG_ always : 24|8@1+ (1,0) [0|0] "" X
BO_ 512 SCALED: 8 X
 SG_ half M : 0|8@1+ (0.5,0) [0|0] "" X
 SG_ c m3 : 8|16@1- (0.1,0) [0|0] "" X
BO_ 2147483904 NESTED: 8 X
 SG_ top M : 0|4@1+ (1,0) [0|0] "" X
 SG_ middle m1M : 4|4@1+ (1,1) [0|0] "" X
 SG_ leaf m3 : 8|16@1+ (1,0) [0|0] "" X
 SG_ other m2 : 8|16@1+ (1,0) [0|0] "" X

SG_MUL_VAL_ 2147483904 middle top 1-1;
SG_MUL_VAL_ 2147483904 leaf middle 3-4, 6-6;
SG_MUL_VAL_ 2147483904 other top 2-2, 5-5;
"""


@pytest.fixture
def multiplexed(
    tmp_path: Path,
) -> Multiplexed:
    (tmp_path / "car.dbc").write_text(MULTIPLEXED)
    database = cantools.database.load_string(MULTIPLEXED, "dbc")
    signals = all_signals(database)
    return compile_signal_map([BUS], signals, tmp_path, 0.3), signals, database


@pytest.mark.parametrize(
    ("name", "can_id", "extended", "hits"),
    [
        ("PLAIN", 256, False, 1),
        ("NESTED", 256, True, 3),
        ("SCALED", 512, False, 2),
    ],
)
def test_multiplexed_signals_equal_cantools(
    multiplexed: Multiplexed,
    *,
    name: str,
    can_id: int,
    extended: bool,
    hits: int,
) -> None:
    """Also: standard and extended 0x100 are two messages."""
    signal_map, signals, database = multiplexed
    message = database.get_message_by_name(name)
    frames = [
        (0, can_id, extended, bytes([first, *range(0x11, 0x88, 0x11)]))
        for first in range(256)
    ]

    decoder = Decoder(signal_map)
    events = ChunkDecoder(signal_map).decode(chunk_of(frames), [0])

    live = live_samples(decoder, frames)
    assert live == column_samples(events, len(frames))
    deepest = 0
    for number, (_, _, _, data) in enumerate(frames):
        found = {role: raw for n, role, raw in live if n == number}
        try:
            decoded = message.decode(data, decode_choices=False)
        except cantools.database.DecodeError:
            # cantools gives up on a multiplexer value without signals
            continue
        wanted = {
            ROLE_INDEX[role]: bits(decoded[source.signal])
            for role, source in signals.items()
            if source.message == name and source.signal in decoded
        }
        deepest += not {"a", "c", "leaf"}.isdisjoint(decoded)
        assert found == wanted
    assert deepest == hits


def test_a_multiplexer_value_without_signals_keeps_the_others(
    multiplexed: Multiplexed,
) -> None:
    signal_map, signals, _ = multiplexed
    frame = (0, 256, False, bytes([99, 1, 2, 7, 0, 0, 0, 0]))
    always = next(
        ROLE_INDEX[role]
        for role, source in signals.items()
        if source.signal == "always"
    )

    samples = dict(Decoder(signal_map).decode(*frame))

    assert samples[always] == 7.0
    assert len(samples) == 2  # and the multiplexer itself


REAL_DATA = os.environ.get("BSTM_REAL_DATA")
RECORDINGS = [
    ("subaru-wrx-sti-candump", "can_sample.log", "sample_can_spec.dbc", True),
    (
        "toyota-rav4-comma2k19",
        "rav4_bus0_bus1.converted.candump.log",
        "toyota_new_mc_pt_generated.dbc",
        False,
    ),
]


@pytest.mark.real
@pytest.mark.skipif(not REAL_DATA, reason="BSTM_REAL_DATA is not set")
@pytest.mark.parametrize(("folder", "log", "dbc", "strict"), RECORDINGS)
def test_every_value_of_a_real_log_equals_cantools(
    *, folder: str, log: str, dbc: str, strict: bool
) -> None:
    base = Path(REAL_DATA or "") / folder
    database = cantools.database.load_file(base / dbc, strict=strict)
    reader = CandumpReader(base / log)
    chunks = list(reader.chunks())
    seen = {can_id for channel, can_id, _ in reader.seen if channel == 0}
    bus = BusConfig(name="car", dbc=dbc, strict=strict)
    todo = [
        (message.name, signal.name)
        for message in database.messages
        if message.frame_id in seen and not overlapping(message)
        for signal in message.signals
    ]
    assert len(todo) > 15
    compared = 0
    for first in range(0, len(todo), len(KELVIN_ROLES)):
        signals = {
            role: SignalConfig(message=message, signal=signal, unit="K")
            for role, (message, signal) in zip(
                KELVIN_ROLES, todo[first:], strict=False
            )
        }
        signal_map = compile_signal_map([bus], signals, base, 0.3)
        for chunk in chunks:
            compared += compare_chunk(signal_map, signals, database, chunk)
    assert compared > 90_000


def overlapping(message: Message) -> bool:
    """Whether lenient cantools misreads *message* (it counts gaps)."""
    try:
        message.refresh(strict=True)
    except cantools.database.Error:
        return True
    return False


def compare_chunk(
    signal_map: SignalMap,
    signals: Signals,
    database: Database,
    chunk: FrameChunk,
) -> int:
    """Compare a chunk of a log with cantools; return the values compared."""
    # interfaces beyond the first are another bus
    events = ChunkDecoder(signal_map).decode(chunk, [0, -1])
    decoder = Decoder(signal_map)
    live = []
    expected = []
    mine = chunk.channel == 0
    for can_id, data, length, time_us in zip(
        chunk.can_id[mine].tolist(),
        chunk.data[mine],
        chunk.length[mine].tolist(),
        chunk.time_us[mine].tolist(),
        strict=True,
    ):
        plan = signal_map.messages.get(FrameKey(0, can_id, False))
        if plan is None:
            continue
        payload = data[:length].tobytes()
        live += [
            (time_us, role, value)
            for role, value in decoder.decode(0, can_id, False, payload)
        ]
        if length != plan.length:
            continue
        decoded = database.get_message_by_frame_id(can_id).decode(
            payload, decode_choices=False
        )
        expected += [
            (time_us, ROLE_INDEX[role], decoded[source.signal])
            for role, source in signals.items()
            if source.message == plan.name
        ]
    columns = list(
        zip(
            events.time_us.tolist(),
            events.role.tolist(),
            events.value.tolist(),
            strict=True,
        )
    )
    assert live == expected
    assert columns == expected
    return len(expected)


def test_ids_end_where_iso_11898_ends_them() -> None:
    """At 11 and 29 bits."""
    assert (STANDARD_MAX, EXTENDED_MAX) == (2**11 - 1, 2**29 - 1)
