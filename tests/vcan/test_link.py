"""The SocketCAN link on real interfaces, through what happens to them."""

import contextlib
import os
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import pytest

from bstm_daemon.bus.live.frame_records import FrameRecords
from bstm_daemon.bus.live.link import (
    DRAIN_LIMIT,
    Frame,
    LinkEvent,
    LinkState,
    SendResult,
)
from bstm_daemon.bus.live.receiver import ERROR_CLASSES
from bstm_daemon.bus.live.socketcan import FILTER_LIMIT, SocketcanLink
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.native.loader import live_extension
from bstm_daemon.service.clock import SteadyAxis, boot_clock_ns

pytestmark = pytest.mark.vcan

CLASSIC = struct.Struct("=IB3x8s")
FD = struct.Struct("=IBB2x64s")
EXTENDED = 0x80000000
REMOTE = 0x40000000
ERROR = 0x20000000
SPARE = "vcan7"
OTHER = "vcan8"
HOUR_NS = 3600 * 10**9
NOBODY = 65534
DEADLINE_S = 30.0
"""For what takes milliseconds: reached only where it never comes."""
RMEM_MAX = Path("/proc/sys/net/core/rmem_max")

Program = Callable[[str], str]
Ip = Callable[..., None]
Wanted = Collection[tuple[int, bool]] | None


class Station:
    """Another program on the interface, which sends and does not listen."""

    def __init__(self, interface: str) -> None:
        self.raw = socket.socket(
            socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW
        )
        self.raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
        self.raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        self.raw.bind((interface,))

    def send(self, *words: int, data: bytes = b"") -> None:
        for word in words:
            self.raw.send(CLASSIC.pack(word, len(data), data))

    def send_fd(self, word: int, data: bytes) -> None:
        self.raw.send(FD.pack(word, len(data), 1, data))


@pytest.fixture
def station(vcan0: str) -> Iterator[Station]:
    made = Station(vcan0)
    yield made
    made.raw.close()


class RecordLink(SocketcanLink):
    """A link whose frames come by the compiled form."""

    def drain(self) -> list[Frame]:
        extension = live_extension()
        assert extension is not None
        records = FrameRecords(extension, 1)
        self.drain_records(records, 0)
        return [records.at(index)[2] for index in range(records.filled)]


FORMS = [SocketcanLink]
if live_extension() is not None:
    FORMS.append(RecordLink)


@pytest.fixture(params=FORMS)
def links(
    request: pytest.FixtureRequest,
) -> Iterator[Callable[..., SocketcanLink]]:
    """Return what makes a link, closed at the end."""
    with contextlib.ExitStack() as open_links:

        def make(
            channel: str,
            wanted: Wanted = None,
            receive_buffer_bytes: int = 2**22,
            *,
            fd: bool = False,
        ) -> SocketcanLink:
            bus = BusConfig(name="car", dbc="car.dbc", channel=channel, fd=fd)
            link: SocketcanLink = request.param(
                bus, wanted, receive_buffer_bytes
            )
            open_links.callback(link.close)
            return link

        yield make


@pytest.fixture
def link(vcan0: str, links: Callable[..., SocketcanLink]) -> SocketcanLink:
    """Return an open link to the first interface that takes every frame."""
    made = links(vcan0)
    assert made.open()
    assert (made.state, made.reason) == (LinkState.UP, "")
    return made


@pytest.fixture
def ip(net_admin: None, program: Program, vcan0: str) -> Iterator[Ip]:
    """Return ``ip link``; afterwards the interfaces are as before."""
    path = program("ip")

    def run(*arguments: str, check: bool = True) -> None:
        subprocess.run(
            [path, "link", *arguments], check=check, capture_output=not check
        )

    yield run
    run("set", vcan0, "up")
    run("delete", SPARE, check=False)


def received(link: SocketcanLink, last_id: int) -> list[Frame]:
    """Return what *link* drains until the frame *last_id* came.

    The kernel hands frames over in order, but may do so a little later.
    """
    frames: list[Frame] = []
    deadline_s = time.monotonic() + DEADLINE_S
    while not frames or frames[-1].can_id != last_id:
        assert time.monotonic() < deadline_s, f"{last_id:X} never came"
        frames += link.drain()
    return frames


def ids(frames: list[Frame]) -> list[int]:
    return [frame.can_id for frame in frames]


def test_frames_of_every_kind(link: SocketcanLink, station: Station) -> None:
    station.send(0x123, EXTENDED | 0x123, data=b"\1\2\3")
    station.send(REMOTE | 0x124)

    assert [frame[1:] for frame in received(link, 0x124)] == [
        (0x123, False, b"\1\2\3", False, False),
        (0x123, True, b"\1\2\3", False, False),
        (0x124, False, b"", False, True),
    ]
    assert link.drain() == []


def test_the_stamp_is_taken_where_the_frame_arrives(
    link: SocketcanLink, station: Station
) -> None:
    before_ns = time.time_ns()
    station.send(0x1)
    after_ns = time.time_ns()
    time.sleep(0.02)  # the frame waits; its stamp does not

    [frame] = received(link, 0x1)

    assert before_ns <= frame.stamp_ns <= after_ns


def test_own_frames_do_not_come_back(
    link: SocketcanLink, vcan0: str, links: Callable[..., SocketcanLink]
) -> None:
    other = links(vcan0)
    other.open()

    assert link.send(0x7FF, extended=False, data=b"abc") is SendResult.OK
    assert link.send(0x7FE, extended=True, data=b"") is SendResult.OK

    assert [frame[1:4] for frame in received(other, 0x7FE)] == [
        (0x7FF, False, b"abc"),
        (0x7FE, True, b""),
    ]
    assert link.drain() == []


@pytest.mark.parametrize("extra", [0, FILTER_LIMIT - 1])
def test_only_the_wanted_come_through(
    vcan0: str,
    links: Callable[..., SocketcanLink],
    station: Station,
    extra: int,
) -> None:
    """By the kernel's filter and, with too many ids for it, by our own."""
    wanted = {(0x100, False), (0x200, True)}
    wanted |= {(0x10000 + n, True) for n in range(extra)}
    link = links(vcan0, wanted)
    assert link.open()

    station.send(0x100, 0x101, 0x200, EXTENDED | 0x100, EXTENDED | 0x200)

    assert [frame[1:3] for frame in received(link, 0x200)] == [
        (0x100, False),
        (0x200, True),
    ]


def test_the_kernel_takes_as_many_filters_as_it_says(
    vcan0: str, links: Callable[..., SocketcanLink], station: Station
) -> None:
    link = links(vcan0, {(n, False) for n in range(FILTER_LIMIT)})
    assert link.open()

    station.send(0, FILTER_LIMIT, REMOTE, FILTER_LIMIT - 1)

    assert ids(received(link, FILTER_LIMIT - 1)) == [0, FILTER_LIMIT - 1]


def test_with_nothing_wanted_nothing_comes_but_errors(
    vcan0: str, links: Callable[..., SocketcanLink], station: Station
) -> None:
    link = links(vcan0, set())
    assert link.open()

    station.send(0x1, EXTENDED | 0x1, ERROR | 0x100)

    assert [frame.is_error for frame in received(link, 0x100)] == [True]


def test_fd_frames_come_where_the_bus_is_fd(
    vcan0: str,
    link: SocketcanLink,
    links: Callable[..., SocketcanLink],
    station: Station,
) -> None:
    fd_link = links(vcan0, fd=True)
    assert fd_link.open()
    data = bytes(range(64))

    station.send_fd(0x100, data)
    station.send(0x101)

    assert ids(received(link, 0x101)) == [0x101]
    assert [frame[1:4] for frame in received(fd_link, 0x101)] == [
        (0x100, False, data),
        (0x101, False, b""),
    ]
    # what it sends is classic all the same
    fd_link.send(0x102, extended=False, data=b"8 bytes.")
    assert [frame.data for frame in received(link, 0x102)] == [b"8 bytes."]


def test_error_frames_of_the_classes_asked_for(
    link: SocketcanLink, station: Station
) -> None:
    for bit in range(10):
        station.send(ERROR | 1 << bit, data=b"\0\x10\0\0\0\0\0\0")

    frames = received(link, 0x100)

    assert all(frame.is_error for frame in frames)
    assert sum(ids(frames)) == ERROR_CLASSES
    assert link.counts == {
        LinkEvent.ERROR_FRAME: 5,
        LinkEvent.TX_TIMEOUT: 1,
        LinkEvent.PASSIVE: 1,
        LinkEvent.TRANSCEIVER: 1,
        LinkEvent.BUS_OFF: 1,
        LinkEvent.RESTARTED: 1,
    }


def test_nothing_is_sent_into_bus_off(
    link: SocketcanLink, station: Station
) -> None:
    station.send(ERROR | 0x40)
    received(link, 0x40)
    assert link.reason.startswith("vcan0 is bus-off")
    assert link.send(0x1, extended=False, data=b"") is SendResult.LOST

    station.send(ERROR | 0x100)
    received(link, 0x100)
    assert link.reason == ""
    assert link.send(0x1, extended=False, data=b"") is SendResult.OK

    station.send(ERROR | 0x40)
    received(link, 0x40)
    link.poll()  # the word of the restart was lost; the carrier is there
    assert link.send(0x1, extended=False, data=b"") is SendResult.OK


def test_every_frame_is_read_or_counted_as_dropped(
    vcan0: str,
    link: SocketcanLink,
    links: Callable[..., SocketcanLink],
    station: Station,
) -> None:
    """*link*, with its large buffer, tells when all have been delivered."""
    small = links(vcan0, receive_buffer_bytes=4096)
    read = 0
    for turn in (1, 2):
        # the kernel's count begins anew with a socket, ours goes on
        assert small.open()
        station.send(*range(500))
        assert len(received(link, 499)) == 500
        waiting = len(small.drain())
        station.send(0x7FF)

        assert 0 < waiting < 500
        assert ids(received(small, 0x7FF)) == [0x7FF]
        received(link, 0x7FF)
        read += waiting + 1
        assert read + small.dropped == 501 * turn
    assert link.dropped == 0


def test_a_large_buffer_holds_seconds_of_a_busy_bus(
    link: SocketcanLink,
    vcan0: str,
    links: Callable[..., SocketcanLink],
    station: Station,
    net_admin: None,
) -> None:
    """4 MiB hold a full 500 kbit/s bus, 4000 frames a second, for 2 s."""
    witness = links(vcan0, receive_buffer_bytes=2**25)
    assert witness.open()
    for _ in range(80):
        station.send(*range(100))
        assert len(received(witness, 99)) == 100

    assert len(link.drain()) == 8000
    station.send(0x1)
    received(link, 0x1)
    assert link.dropped == 0


def test_a_drain_has_an_end(
    vcan0: str,
    links: Callable[..., SocketcanLink],
    station: Station,
    net_admin: None,
) -> None:
    link = links(vcan0, receive_buffer_bytes=2**24)
    witness = links(vcan0)
    assert link.open()
    assert witness.open()
    for _ in range(0, DRAIN_LIMIT + 1, 100):
        station.send(*range(100))
        received(witness, 99)

    assert len(link.drain()) == DRAIN_LIMIT
    assert len(link.drain()) == 100 - DRAIN_LIMIT % 100


def test_a_removed_interface_is_read_to_the_end(
    links: Callable[..., SocketcanLink], ip: Ip, spare: Callable[..., Station]
) -> None:
    station = spare()
    link = links(SPARE, receive_buffer_bytes=2**24)
    witness = links(SPARE)
    assert link.open()
    assert witness.open()
    for _ in range(0, DRAIN_LIMIT + 1, 100):
        station.send(*range(100))
        received(witness, 99)

    ip("delete", SPARE)

    assert len(link.drain()) == DRAIN_LIMIT
    assert link.state is LinkState.GONE
    assert len(link.drain()) == 100 - DRAIN_LIMIT % 100
    assert link.drain() == []


def test_the_buffer_is_what_the_kernel_grants(
    vcan0: str, links: Callable[..., SocketcanLink], net_admin: None
) -> None:
    link = links(vcan0)
    assert link.open()
    assert link.receive_buffer_bytes == 2 * 2**22  # the kernel doubles


def test_without_the_capability_the_buffer_is_the_systems_limit(
    vcan0: str, links: Callable[..., SocketcanLink]
) -> None:
    limit_bytes = int(RMEM_MAX.read_text(encoding="ascii"))
    link = links(vcan0)
    was = os.geteuid()
    if was == 0:
        os.seteuid(NOBODY)
    try:
        assert link.open()
    finally:
        os.seteuid(was)
    assert link.receive_buffer_bytes == 2 * min(limit_bytes, 2**22)


def test_down_and_up_again(
    link: SocketcanLink, station: Station, ip: Ip, vcan0: str
) -> None:
    station.send(0x1)
    ip("set", vcan0, "down")

    # what came before is still read
    assert ids(received(link, 0x1)) == [0x1]
    assert link.drain() == []
    assert link.state is LinkState.DOWN
    assert link.reason == "vcan0 is down (ip link set vcan0 up)"
    assert link.drain() == []
    assert link.send(0x2, extended=False, data=b"") is SendResult.LOST
    link.poll()
    assert link.state is LinkState.DOWN

    ip("set", vcan0, "up")
    with contextlib.suppress(OSError):
        station.send(0x3)  # the station's own notice of the outage
    station.send(0x4)

    received(link, 0x4)
    assert link.state is LinkState.UP
    assert link.reason == ""
    assert link.send(0x5, extended=False, data=b"") is SendResult.OK
    assert link.counts == {LinkEvent.WENT_DOWN: 1}


def test_a_poll_notices_up_on_a_silent_bus(
    link: SocketcanLink, ip: Ip, vcan0: str
) -> None:
    ip("set", vcan0, "down")
    link.drain()
    ip("set", vcan0, "up")
    assert link.state is LinkState.DOWN

    link.poll()

    assert link.state is LinkState.UP


def test_an_outage_that_is_over_costs_no_frame(
    link: SocketcanLink, ip: Ip, vcan0: str
) -> None:
    for turn in (1, 2):
        ip("set", vcan0, "down")
        ip("set", vcan0, "up")
        if turn == 1:
            sent = link.send(0x1, extended=False, data=b"")
            assert sent is SendResult.OK
        assert link.drain() == []

        assert link.state is LinkState.UP
        assert link.counts == {LinkEvent.WENT_DOWN: turn}


def test_opened_while_down(
    vcan0: str, links: Callable[..., SocketcanLink], station: Station, ip: Ip
) -> None:
    ip("set", vcan0, "down")
    link = links(vcan0)

    assert link.open()
    assert link.state is LinkState.DOWN
    assert link.drain() == []
    assert not link.counts

    ip("set", vcan0, "up")
    with contextlib.suppress(OSError):
        station.send(0x1)
    station.send(0x2)
    received(link, 0x2)
    assert link.state is LinkState.UP


def test_absent_at_the_start(
    links: Callable[..., SocketcanLink], ip: Ip
) -> None:
    link = links(SPARE)

    assert not link.open()
    assert link.state is LinkState.GONE
    assert link.reason == f"there is no interface {SPARE}"
    link.poll()
    assert link.state is LinkState.GONE

    ip("add", SPARE, "type", "vcan")
    link.poll()
    assert link.state is LinkState.DOWN
    ip("set", SPARE, "up")
    link.poll()

    assert link.state is LinkState.UP
    assert link.send(0x1, extended=False, data=b"") is SendResult.OK
    assert not link.counts


@pytest.fixture
def spare(ip: Ip) -> Iterator[Callable[..., Station]]:
    """Return what makes a spare interface and a station on it."""
    with contextlib.ExitStack() as stations:

        def make(*more: str) -> Station:
            ip("add", SPARE, *more, "type", "vcan")
            ip("set", SPARE, "up")
            station = Station(SPARE)
            stations.callback(station.raw.close)
            return station

        yield make


@pytest.mark.parametrize("first", ["drain", "send", "poll"])
@pytest.mark.parametrize("index", [(), ("index", "77")])
def test_removed_and_made_anew(
    links: Callable[..., SocketcanLink],
    ip: Ip,
    spare: Callable[..., Station],
    first: str,
    index: tuple[str, ...],
) -> None:
    """Whoever notices, and even where the new one has the old number."""
    old = spare(*index)
    link = links(SPARE)
    assert link.open()
    old.send(0x1)
    ip("delete", SPARE)
    if first == "send":
        assert link.send(0x2, extended=False, data=b"") is SendResult.LOST
        assert link.state is LinkState.GONE
    if first == "poll":
        link.poll()
    else:
        assert ids(received(link, 0x1)) == [0x1]
    assert link.state is LinkState.GONE
    assert link.send(0x2, extended=False, data=b"") is SendResult.LOST
    assert link.drain() == []
    link.poll()
    assert link.reason == f"there is no interface {SPARE}"

    new = spare(*index)
    link.poll()
    new.send(0x3)

    assert link.state is LinkState.UP
    assert ids(received(link, 0x3)) == [0x3]
    assert link.send(0x4, extended=False, data=b"") is SendResult.OK
    assert link.counts == {LinkEvent.WENT_GONE: 1}


@pytest.mark.parametrize("index", [(), ("index", "77")])
@pytest.mark.parametrize("first", ["drain", "poll", "send"])
def test_replaced_before_anybody_looks(
    links: Callable[..., SocketcanLink],
    ip: Ip,
    spare: Callable[..., Station],
    first: str,
    index: tuple[str, ...],
) -> None:
    spare(*index)
    link = links(SPARE)
    assert link.open()
    ip("delete", SPARE)
    new = spare(*index)

    if first == "send":
        assert link.send(0x1, extended=False, data=b"") is SendResult.LOST
    if first == "poll":
        link.poll()
    if first != "send":
        link.drain()
    link.poll()
    new.send(0x2)

    assert link.state is LinkState.UP
    assert ids(received(link, 0x2)) == [0x2]
    assert link.counts == {LinkEvent.WENT_GONE: 1}


@pytest.fixture
def renamed(
    links: Callable[..., SocketcanLink],
    ip: Ip,
    spare: Callable[..., Station],
) -> Iterator[SocketcanLink]:
    """Return a link whose interface has another name by now, and is down."""
    spare()
    link = links(SPARE)
    assert link.open()
    ip("set", SPARE, "down")
    ip("set", SPARE, "name", OTHER)
    yield link
    ip("delete", OTHER)


@pytest.mark.parametrize("first", ["drain", "send", "poll"])
def test_renamed_away(renamed: SocketcanLink, ip: Ip, first: str) -> None:
    """The socket could go on, but that is another bus now."""
    if first == "poll":
        renamed.poll()
    elif first == "drain":
        assert renamed.drain() == []
    else:
        sent = renamed.send(0x1, extended=False, data=b"")
        assert sent is SendResult.LOST
    assert renamed.state is LinkState.GONE

    ip("set", OTHER, "up")
    assert renamed.send(0x1, extended=False, data=b"") is SendResult.LOST
    renamed.poll()

    assert renamed.state is LinkState.GONE
    assert renamed.reason == f"there is no interface {SPARE}"


def test_renamed_away_and_another_has_the_name(
    renamed: SocketcanLink, spare: Callable[..., Station]
) -> None:
    new = spare()

    renamed.poll()
    new.send(0x2)

    assert ids(received(renamed, 0x2)) == [0x2]
    assert renamed.counts == {LinkEvent.WENT_GONE: 1}


def test_a_socket_that_fails_for_good_is_replaced(
    link: SocketcanLink, station: Station
) -> None:
    assert link._receiver is not None
    link._receiver.source.close()

    assert link.drain() == []
    assert link.state is LinkState.GONE
    assert link.reason == "vcan0: Bad file descriptor"
    link.poll()
    station.send(0x1)

    assert link.state is LinkState.UP
    assert ids(received(link, 0x1)) == [0x1]


def test_an_interface_that_is_no_can(
    links: Callable[..., SocketcanLink], vcan0: str
) -> None:
    link = links("lo")

    assert not link.open()
    assert link.reason == "lo is no CAN interface, or just vanished"


@pytest.fixture
def full(program: Program, vcan0: str, net_admin: None) -> Iterator[None]:
    """Give the interface a transmit queue without any room."""
    queue = [program("tc"), "qdisc"]
    subprocess.run(
        [*queue, "add", "dev", vcan0, "root", "pfifo", "limit", "0"],
        check=True,
    )
    yield
    subprocess.run([*queue, "del", "dev", vcan0, "root"], check=False)


def test_a_frame_that_finds_no_room_is_lost(
    link: SocketcanLink, full: None, vcan0: str, program: Program
) -> None:
    assert link.send(0x1, extended=False, data=b"") is SendResult.LOST
    assert link.state is LinkState.UP
    assert link.reason == "vcan0 takes no frames: No buffer space available"

    subprocess.run(
        [program("tc"), "qdisc", "del", "dev", vcan0, "root"], check=True
    )
    assert link.send(0x1, extended=False, data=b"") is SendResult.OK
    assert link.reason == ""


def test_a_closed_link_may_be_opened_again(
    link: SocketcanLink, station: Station
) -> None:
    link.close()
    assert link.drain() == []
    assert (link.state, link.reason) == (LinkState.GONE, "closed")

    assert link.open()
    station.send(0x1)

    assert ids(received(link, 0x1)) == [0x1]
    assert not link.counts


@pytest.mark.parametrize("step_ns", [HOUR_NS, -HOUR_NS])
@pytest.mark.parametrize("amid", [False, True])
def test_the_axis_runs_on_while_the_wall_clock_is_stepped(
    link: SocketcanLink,
    station: Station,
    own_clock: None,
    step_ns: int,
    amid: bool,  # noqa: FBT001
) -> None:
    """Stepped between two drains, or *amid* one, after its reading."""
    axis = SteadyAxis()
    # axis time of a moment, known to the microseconds between two readings
    offset_ns = narrowest_offset_ns()
    slack_us = 1000
    spent_us = 0.0

    def send(word: int) -> tuple[float, float]:
        before_ns = boot_clock_ns()
        station.send(word)
        after_ns = boot_clock_ns()
        return (
            (before_ns + offset_ns) / 1000 - slack_us,
            (after_ns + offset_ns) / 1000 + slack_us,
        )

    seen = []
    sent = []
    for turn in range(20):
        if amid:
            axis.read()
        sent.append(send(2 * turn))
        if turn == 10:
            before_ns = boot_clock_ns()
            now_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
            time.clock_settime_ns(time.CLOCK_REALTIME, now_ns + step_ns)
            # by so much less it was stepped, at the most
            spent_us = (boot_clock_ns() - before_ns) / 1000
        sent.append(send(2 * turn + 1))
        if not amid:
            axis.read()
        frames = received(link, 2 * turn + 1)
        seen += [axis.of_stamp(frame.stamp_ns) for frame in frames]
    axis.read()

    assert len(seen) == len(sent) == 40
    assert seen == sorted(seen)
    for at_us, (low_us, high_us) in zip(seen, sent, strict=True):
        assert low_us <= at_us <= high_us
    assert axis.steps == 1
    short_us = step_ns / 1000 - axis.last_step_us
    assert -slack_us < short_us < spent_us + slack_us
    low_us = time.time_ns() / 1000 - slack_us
    wall_us = axis.wall_of(axis.read())
    assert low_us < wall_us < time.time_ns() / 1000 + slack_us


def narrowest_offset_ns() -> int:
    """Return wall time less boot time, of the reading least held up."""
    readings = []
    for _ in range(20):
        before_ns, wall_ns = boot_clock_ns(), time.time_ns()
        after_ns = boot_clock_ns()
        readings.append((after_ns - before_ns, wall_ns - after_ns))
    return min(readings)[1]
