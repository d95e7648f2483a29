"""Frames off a socket: the kernel's layouts over a pair of local sockets."""

import errno
import socket
import struct
import time
from collections import Counter
from collections.abc import Iterator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.extraction import FD_LENGTHS
from bstm_daemon.bus.link import DRAIN_LIMIT, Frame, LinkEvent
from bstm_daemon.bus.link_receiver import FrameReceiver, kernel_filters

CLASSIC = struct.Struct("=IB3x8s")
FD = struct.Struct("=IBB2x64s")
EXTENDED = 0x80000000
REMOTE = 0x40000000
ERROR = 0x20000000
NONE_LEFT = errno.EAGAIN


class Wire:
    """A receiver, and the other end of its socket."""

    def __init__(self) -> None:
        self.far, near = socket.socketpair(
            socket.AF_UNIX, socket.SOCK_SEQPACKET
        )
        self.near = near
        self.counts: Counter[LinkEvent] = Counter()
        self.receiver = FrameReceiver(near, self.counts)

    def frames(self, *messages: bytes) -> list[Frame]:
        """Send *messages*, return what comes of them."""
        for message in messages:
            self.far.send(message)
        found: list[Frame] = []
        assert self.receiver.receive(found) == NONE_LEFT
        return found

    def frame(self, message: bytes) -> tuple[int, bool, bytes, bool, bool]:
        """Send *message*, return its frame without the stamp."""
        [found] = self.frames(message)
        return found[1:]

    def close(self) -> None:
        self.far.close()
        self.near.close()


@pytest.fixture
def wire() -> Iterator[Wire]:
    made = Wire()
    yield made
    made.close()


@pytest.fixture(scope="module")
def lasting() -> Iterator[Wire]:
    """Return one wire for many examples."""
    made = Wire()
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


def test_a_reading_ends_at_the_limit(wire: Wire) -> None:
    wire.far.send(CLASSIC.pack(1, 0, b""))
    wire.far.send(CLASSIC.pack(2, 0, b""))
    [filler] = wire.frames()[:1]
    found = [filler] * (DRAIN_LIMIT - 1)
    for n in (3, 4):
        wire.far.send(CLASSIC.pack(n, 0, b""))

    assert wire.receiver.receive(found) == 0
    assert len(found) == DRAIN_LIMIT
    assert found[-1].can_id == 3
    assert [frame.can_id for frame in wire.frames()] == [4]


def test_another_end_of_the_reading_is_told(wire: Wire) -> None:
    wire.near.close()

    assert wire.receiver.receive([]) == errno.EBADF


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
    wire.receiver.only = frozenset({0x100, EXTENDED | 0x200})

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
