"""Frames off a socket: the kernel's layouts over a pair of local sockets."""

from __future__ import annotations

import errno
import socket
import struct
import time
from array import array
from collections import Counter
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.live.frame_records import FrameRecords
from bstm_daemon.bus.live.link import DRAIN_LIMIT, Frame, LinkEvent
from bstm_daemon.bus.live.receiver import FrameReceiver, kernel_filters
from bstm_daemon.bus.signals.extraction import FD_LENGTHS
from bstm_daemon.native.loader import live_extension

if TYPE_CHECKING:
    from collections.abc import Iterator

CLASSIC = struct.Struct("=IB3x8s")
FD = struct.Struct("=IBB2x64s")
EXTENDED = 0x80000000
REMOTE = 0x40000000
ERROR = 0x20000000
NONE_LEFT = errno.EAGAIN
FILLER = Frame(0, 0, False, b"", False, False)


COMPILED = live_extension()
FORMS = [False] if COMPILED is None else [False, True]
"""Whether the compiled form reads."""


class Wire:
    """A receiver, and the other end of its socket."""

    def __init__(self, *, compiled: bool) -> None:
        self.far, near = socket.socketpair(
            socket.AF_UNIX, socket.SOCK_SEQPACKET
        )
        self.near = near
        self.counts: Counter[LinkEvent] = Counter()
        self.receiver = FrameReceiver(near, self.counts)
        self.compiled = compiled

    def read(self, limit: int = DRAIN_LIMIT) -> tuple[list[Frame], int]:
        """Return the frames that wait, up to *limit*, and the result."""
        if not self.compiled:
            found = [FILLER] * (DRAIN_LIMIT - limit)
            result = self.receiver.receive(found)
            return found[DRAIN_LIMIT - limit :], result
        assert COMPILED is not None
        records = FrameRecords(COMPILED, 1)
        records.filled = 7
        result = self.receiver.receive_records(records, 3, limit)
        rows = [records.at(index) for index in range(7, records.filled)]
        assert {bus for _, bus, _ in rows} <= {3}
        return [frame for _, _, frame in rows], result

    def frames(self, *messages: bytes) -> list[Frame]:
        """Send *messages*, return what comes of them."""
        for message in messages:
            self.far.send(message)
        found, result = self.read()
        assert result == NONE_LEFT
        return found

    def frame(self, message: bytes) -> tuple[int, bool, bytes, bool, bool]:
        """Send *message*, return its frame without the stamp."""
        [found] = self.frames(message)
        return found[1:]

    def close(self) -> None:
        self.far.close()
        self.near.close()


@pytest.fixture(params=FORMS)
def wire(request: pytest.FixtureRequest) -> Iterator[Wire]:
    made = Wire(compiled=request.param)
    yield made
    made.close()


@pytest.fixture(scope="module", params=FORMS)
def lasting(request: pytest.FixtureRequest) -> Iterator[Wire]:
    """Return one wire for many examples."""
    made = Wire(compiled=request.param)
    yield made
    made.close()


def test_a_standard_frame(wire: Wire) -> None:
    message = CLASSIC.pack(0x123, 3, b"\1\2\3")

    assert wire.frame(message) == (0x123, False, b"\1\2\3", False, False)


def test_an_extended_frame_of_a_small_id(wire: Wire) -> None:
    message = CLASSIC.pack(EXTENDED | 0x100, 8, b"12345678")

    assert wire.frame(message) == (0x100, True, b"12345678", False, False)


def test_a_remote_frame_has_no_data(wire: Wire) -> None:
    message = CLASSIC.pack(REMOTE | 0x7FF, 8, b"rubbish!")

    assert wire.frame(message) == (0x7FF, False, b"", False, True)


@pytest.mark.parametrize("length", FD_LENGTHS)
def test_an_fd_frame_of_every_length(wire: Wire, length: int) -> None:
    data = bytes(range(100, 100 + length))

    message = FD.pack(EXTENDED | 0x1ABCDEF0, length, 5, data)

    assert wire.frame(message) == (0x1ABCDEF0, True, data, False, False)


@pytest.mark.parametrize(
    "message",
    [
        CLASSIC.pack(0x123, 9, b""),
        CLASSIC.pack(0x123, 255, b""),
        FD.pack(0x123, 9, 4, b""),
        FD.pack(0x123, 65, 4, b""),
        FD.pack(REMOTE | 0x123, 8, 4, b""),
        FD.pack(ERROR | 0x40, 8, 4, b""),
        CLASSIC.pack(0x123, 8, b"12345678")[:-1],
        CLASSIC.pack(0x123, 8, b"12345678") + b"\0",
        FD.pack(0x123, 8, 4, b"")[:-1],
        FD.pack(0x123, 8, 4, b"") + b"\0",
        b"\0" * 2060,
        b"\0",
    ],
)
def test_what_cannot_be_is_refused_and_counted(
    wire: Wire, message: bytes
) -> None:
    good = CLASSIC.pack(0x100, 0, b"")

    assert [frame.can_id for frame in wire.frames(message, good)] == [0x100]
    assert wire.counts == {LinkEvent.MALFORMED: 1}


@given(message=st.binary(min_size=1, max_size=80))
def test_no_bytes_break_the_reading(lasting: Wire, message: bytes) -> None:
    lasting.frames(message)


@given(
    message=st.one_of(
        st.binary(min_size=16, max_size=16),
        st.binary(min_size=72, max_size=72),
    )
)
def test_a_message_is_one_frame_or_is_counted(
    lasting: Wire, message: bytes
) -> None:
    before = lasting.counts[LinkEvent.MALFORMED]
    found = lasting.frames(message)
    refused = lasting.counts[LinkEvent.MALFORMED] - before

    assert len(found) + refused == 1
    for frame in found:
        word, length = struct.unpack_from("=IB", message)
        assert frame.is_error == bool(word & ERROR)
        assert frame.can_id <= (
            0x1FFFFFFF if frame.extended or frame.is_error else 0x7FF
        )
        if not frame.is_remote:
            assert frame.data == message[8 : 8 + length]


def test_the_stamp_is_the_kernels(wire: Wire) -> None:
    before_ns = time.time_ns()
    wire.far.send(CLASSIC.pack(1, 0, b""))
    after_ns = time.time_ns()
    late = time.time_ns()
    while time.time_ns() == late:
        pass

    [frame] = wire.frames()

    assert before_ns <= frame.stamp_ns <= after_ns


def test_without_a_stamp_it_is_the_time_of_reading(wire: Wire) -> None:
    wire.near.setsockopt(socket.SOL_SOCKET, 35, 0)
    wire.far.send(CLASSIC.pack(1, 0, b""))
    before_ns = time.time_ns()
    [frame] = wire.frames()

    assert before_ns <= frame.stamp_ns <= time.time_ns()


def test_frames_keep_their_order(wire: Wire) -> None:
    messages = [CLASSIC.pack(n, 0, b"") for n in range(50)]

    found = wire.frames(*messages)

    assert [frame.can_id for frame in found] == list(range(50))
    stamps = [frame.stamp_ns for frame in found]
    assert stamps == sorted(stamps)


@pytest.mark.parametrize("limit", [1, 63, 64, 65, 130])
def test_a_reading_ends_at_the_limit(wire: Wire, limit: int) -> None:
    for number in range(limit + 1):
        wire.far.send(CLASSIC.pack(number, 0, b""))

    found, result = wire.read(limit)

    assert result == 0
    assert [frame.can_id for frame in found] == list(range(limit))
    assert [frame.can_id for frame in wire.frames()] == [limit]


def test_another_end_of_the_reading_is_told(wire: Wire) -> None:
    wire.near.close()

    assert wire.read() == ([], errno.EBADF)


@pytest.mark.skipif(COMPILED is None, reason="not installed")
def test_a_full_store_leaves_the_rest_in_the_socket(wire: Wire) -> None:
    assert COMPILED is not None
    records = FrameRecords(COMPILED, 1)
    records.filled = records.room - 1
    for number in (1, 2):
        wire.far.send(CLASSIC.pack(number, 0, b""))

    assert wire.receiver.receive_records(records, 0, DRAIN_LIMIT) == 0
    assert records.filled == records.room
    assert wire.receiver.receive_records(records, 0, DRAIN_LIMIT) == 0
    assert [frame.can_id for frame in wire.frames()] == [2]


MESSAGES = st.one_of(
    st.binary(max_size=80).filter(len),
    st.builds(
        CLASSIC.pack,
        st.integers(0, 2**32 - 1),
        st.integers(0, 10),
        st.binary(min_size=8, max_size=8),
    ),
    st.builds(
        CLASSIC.pack,
        st.sampled_from([0x100, 0x101, EXTENDED | 0x100]),
        st.integers(0, 8),
        st.binary(min_size=8, max_size=8),
    ),
    st.builds(
        FD.pack,
        st.one_of(st.integers(0, 2**32 - 1), st.just(0x100)),
        st.one_of(st.sampled_from(FD_LENGTHS), st.integers(0, 255)),
        st.integers(0, 255),
        st.binary(min_size=64, max_size=64),
    ),
    st.builds(
        CLASSIC.pack,
        st.integers(0, 0x1FF).map(lambda classes: classes | ERROR),
        st.integers(0, 8),
        st.binary(min_size=8, max_size=8),
    ),
)


@pytest.mark.skipif(COMPILED is None, reason="not installed")
@given(
    messages=st.lists(MESSAGES, max_size=90),
    only=st.none() | st.frozensets(st.sampled_from([0x100, EXTENDED | 0x100])),
)
def test_both_forms_read_the_same(
    messages: list[bytes], only: frozenset[int] | None
) -> None:
    results = []
    for compiled in (False, True):
        wire = Wire(compiled=compiled)
        if only is not None:
            wire.receiver.let_through(only)
        frames = [frame[1:] for frame in wire.frames(*messages)]
        results.append((frames, +wire.counts, wire.receiver.bus_off))
        wire.close()

    assert results[0] == results[1]


@pytest.mark.parametrize(
    "arguments",
    [
        (bytearray(96), -1, 1, None),
        (bytearray(96), 0, -1, None),
        (bytearray(96), 0, 2, None),
        (bytearray(96), 1, 1, None),
        (bytearray(96), 1, 2**63 - 1, None),
        (bytearray(95), 0, 0, None),
        (bytearray(96), 0, 1, array("B", b"\0")),
        (bytearray(96), 0, 1, array("Q", [0])),
    ],
)
def test_the_compiled_reading_keeps_within_its_store(
    wire: Wire, arguments: tuple[bytearray, int, int, array[int] | None]
) -> None:
    if COMPILED is None:
        pytest.skip("the compiled form is not installed")
    wire.far.send(CLASSIC.pack(1, 0, b""))
    store, first, limit, only = arguments
    store = bytearray(store)

    with pytest.raises(ValueError, match=r"records|buffer"):
        COMPILED.receive(wire.near.fileno(), store, first, limit, 0, only)
    store.append(0)  # which would fail, were it held


@pytest.mark.skipif(COMPILED is None, reason="not installed")
@pytest.mark.parametrize("only", [None, array("I", [1])])
def test_nothing_is_held_after_the_compiled_reading(
    wire: Wire, only: array[int] | None
) -> None:
    assert COMPILED is not None
    store = bytearray(96)
    wire.far.send(CLASSIC.pack(1, 0, b""))

    frames, *_ = COMPILED.receive(wire.near.fileno(), store, 0, 1, 0, only)

    assert frames == 1
    store.append(0)
    if only is not None:
        only.append(2)


@pytest.mark.parametrize(
    ("classes", "data", "events"),
    [
        (0x040, b"", {LinkEvent.BUS_OFF}),
        (0x100, bytes(8), {LinkEvent.RESTARTED}),
        (0x001, bytes(8), {LinkEvent.TX_TIMEOUT}),
        (0x010, bytes(8), {LinkEvent.TRANSCEIVER}),
        (0x004, b"\0\x04", {LinkEvent.WARNING}),
        (0x004, b"\0\x08", {LinkEvent.WARNING}),
        (0x004, b"\0\x10", {LinkEvent.PASSIVE}),
        (0x004, b"\0\x20", {LinkEvent.PASSIVE}),
        (0x004, b"\0\x01", {LinkEvent.OVERRUN}),
        (0x004, b"\0\x40", set()),
        (0x004, b"", set()),
        (0x008, b"\0\xff", set()),
        (0x044, b"\0\x30", {LinkEvent.BUS_OFF, LinkEvent.PASSIVE}),
    ],
)
def test_error_frames_are_counted_by_what_they_report(
    wire: Wire, classes: int, data: bytes, events: set[LinkEvent]
) -> None:
    message = CLASSIC.pack(ERROR | classes, len(data), data)

    assert wire.frame(message) == (classes, False, data, True, False)
    assert wire.counts == dict.fromkeys(events | {LinkEvent.ERROR_FRAME}, 1)


def test_a_restart_ends_bus_off(wire: Wire) -> None:
    off, restarted, warning = (
        CLASSIC.pack(ERROR | classes, 8, b"\0\x04")
        for classes in (0x40, 0x100, 0x4)
    )

    wire.frames(off, warning)
    assert wire.receiver.bus_off
    wire.frames(restarted)
    assert not wire.receiver.bus_off


def test_only_the_wanted_come_through_but_errors_always(wire: Wire) -> None:
    wire.receiver.let_through({0x100, EXTENDED | 0x200})

    found = wire.frames(
        CLASSIC.pack(0x100, 0, b""),
        CLASSIC.pack(EXTENDED | 0x100, 0, b""),
        CLASSIC.pack(0x200, 0, b""),
        CLASSIC.pack(EXTENDED | 0x200, 0, b""),
        CLASSIC.pack(ERROR | 0x100, 8, b""),
    )

    assert [(frame.can_id, frame.extended) for frame in found] == [
        (0x100, False),
        (0x200, True),
        (0x100, False),
    ]
    assert [frame.is_error for frame in found] == [False, False, True]


def test_what_the_kernel_drops_is_counted(wire: Wire) -> None:
    """Datagrams over a loopback whose receiver has little room."""
    wire.close()
    wire.near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    wire.far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    wire.near.bind(("127.0.0.1", 0))
    wire.far.connect(wire.near.getsockname())
    wire.receiver = FrameReceiver(wire.near, wire.counts)
    wire.near.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)
    sent = 50

    came = len(wire.frames(*[CLASSIC.pack(1, 0, b"")] * sent))
    assert 0 < came < sent
    assert wire.receiver.dropped == 0
    wire.frame(CLASSIC.pack(2, 0, b""))

    assert wire.receiver.dropped == sent - came
    assert wire.frames() == []
    assert wire.receiver.dropped == sent - came


def test_each_of_many_ids_is_let_through_and_none_between(wire: Wire) -> None:
    wire.receiver.let_through({2 * number for number in range(1, 20)})

    found = wire.frames(*(CLASSIC.pack(n, 0, b"") for n in range(50)))

    assert [frame.can_id for frame in found] == list(range(2, 40, 2))


def test_the_count_of_drops_wraps_at_32_bits(wire: Wire) -> None:
    for total in (5, 5, 0xFFFFFFFE, 3):
        wire.receiver.note_drops(total)

    assert wire.receiver.dropped == 0xFFFFFFFE + 5


def test_filters_name_every_bit_and_flag() -> None:
    filters = kernel_filters({(0x100, True), (0x100, False), (0x7FF, False)})

    assert list(struct.iter_unpack("=II", filters)) == [
        (0x100, 0xC00007FF),
        (0x80000100, 0xDFFFFFFF),
        (0x7FF, 0xC00007FF),
    ]


def test_nothing_wanted_is_no_filter_at_all() -> None:
    assert kernel_filters(set()) == b""
