"""A link through python-can, on its ``virtual`` bus."""

import subprocess
import sys
import time
from collections.abc import Iterator

import can
import pytest

from bstm_daemon.bus.live.link import (
    DRAIN_LIMIT,
    LinkEvent,
    LinkState,
    SendResult,
)
from bstm_daemon.bus.live.portable import PortableLink, stamp_or_now_ns
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.errors import ConfigError

CHANNEL = "bstm-test"
NOW_NS = 1_700_000_000_000_000_000


def config(interface: str = "virtual", **more: object) -> BusConfig:
    return BusConfig.model_validate(
        {
            "name": "car",
            "dbc": "car.dbc",
            "interface": interface,
            "channel": CHANNEL,
            **more,
        }
    )


@pytest.fixture
def far() -> Iterator[can.BusABC]:
    """Return another member of the bus."""
    with can.Bus(
        interface="virtual", channel=CHANNEL, preserve_timestamps=True
    ) as bus:
        yield bus


@pytest.fixture
def link() -> Iterator[PortableLink]:
    """Return an open link for two frames that differ in the flag only."""
    made = PortableLink(config(), {(0x100, False), (0x200, True)})
    assert made.open()
    yield made
    made.close()


def test_only_the_wanted_come_through(
    link: PortableLink, far: can.BusABC
) -> None:
    for can_id in (0x100, 0x200):
        for extended in (True, False):
            far.send(
                can.Message(
                    arbitration_id=can_id,
                    is_extended_id=extended,
                    data=[can_id >> 8],
                )
            )

    frames = link.drain()

    assert [frame[1:] for frame in frames] == [
        (0x100, False, b"\1", False, False),
        (0x200, True, b"\2", False, False),
    ]
    assert link.drain() == []


def test_everything_comes_where_nothing_is_picked(far: can.BusABC) -> None:
    link = PortableLink(config())
    link.open()
    far.send(can.Message(arbitration_id=0x7F, is_extended_id=False))

    assert [frame.can_id for frame in link.drain()] == [0x7F]
    link.close()


def test_error_and_remote_frames_are_told_apart(
    link: PortableLink, far: can.BusABC
) -> None:
    far.send(can.Message(arbitration_id=0x100, is_error_frame=True, dlc=8))
    far.send(
        can.Message(
            arbitration_id=0x100,
            is_extended_id=False,
            is_remote_frame=True,
            dlc=8,
        )
    )

    error, remote = link.drain()

    assert (error.is_error, error.extended) == (True, False)
    assert (remote.is_remote, remote.data) == (True, b"")
    assert link.counts == {LinkEvent.ERROR_FRAME: 1}


def test_fd_frames_and_impossible_lengths(
    link: PortableLink, far: can.BusABC
) -> None:
    good = can.Message(
        arbitration_id=0x200, is_fd=True, data=bytes(64), check=True
    )
    bad = can.Message(arbitration_id=0x200, data=bytes(9))
    far.send(good)
    far.send(bad)

    assert [len(frame.data) for frame in link.drain()] == [64]
    assert link.counts == {LinkEvent.MALFORMED: 1}


def test_the_stamp_is_the_adapters_where_it_is_wall_time(
    link: PortableLink, far: can.BusABC
) -> None:
    now_ns = time.time_ns()
    stamp_s = now_ns // 1000 / 1e6 - 0.25
    for stamp in (stamp_s, 12.5):
        far.send(
            can.Message(
                arbitration_id=0x100, is_extended_id=False, timestamp=stamp
            )
        )

    first, second = link.drain()

    assert first.stamp_ns == now_ns // 1000 * 1000 - 250_000_000
    assert now_ns <= second.stamp_ns <= time.time_ns()


@pytest.mark.parametrize(
    "stamp_s", [0.0, 12.5, 1_700_003_600.0, 1e300, float("nan"), float("inf")]
)
def test_what_cannot_be_wall_time_is_the_time_of_reading(
    stamp_s: float,
) -> None:
    assert stamp_or_now_ns(stamp_s, NOW_NS) == NOW_NS


def test_a_stamp_is_whole_microseconds() -> None:
    stamp_ns = stamp_or_now_ns(1_700_000_000.123456, NOW_NS)

    assert stamp_ns == NOW_NS + 123_456_000


def test_what_is_sent_is_classic_and_does_not_come_back(
    link: PortableLink, far: can.BusABC
) -> None:
    assert link.send(0x200, extended=True, data=b"ab") is SendResult.OK
    assert link.drain() == []

    message = far.recv(timeout=0)

    assert message is not None
    assert (message.arbitration_id, message.is_extended_id) == (0x200, True)
    assert (message.is_fd, bytes(message.data)) == (False, b"ab")
    with pytest.raises(ValueError, match="9 given"):
        link.send(0x200, extended=True, data=bytes(9))


def test_a_frame_that_finds_no_room_is_lost(link: PortableLink) -> None:
    with can.Bus(
        interface="virtual", channel=CHANNEL, rx_queue_size=1
    ) as full:
        assert link.send(0x100, extended=False, data=b"") is SendResult.OK
        assert link.send(0x100, extended=False, data=b"") is SendResult.LOST
        assert link.reason.startswith(f"{CHANNEL} takes no frames: ")
        full.recv(timeout=0)
        assert link.send(0x100, extended=False, data=b"") is SendResult.OK
    assert link.reason == ""


def test_an_adapter_that_fails_is_opened_again(
    link: PortableLink, far: can.BusABC
) -> None:
    link._bus.shutdown()  # as if unplugged

    assert link.drain() == []
    assert link.state is LinkState.GONE
    assert link.reason == f"{CHANNEL}: Cannot operate on a closed bus"
    assert link.send(0x100, extended=False, data=b"") is SendResult.LOST
    assert link.counts == {LinkEvent.WENT_GONE: 1}

    link.poll()
    far.send(can.Message(arbitration_id=0x100, is_extended_id=False))

    assert link.state is LinkState.UP
    assert len(link.drain()) == 1
    link.poll()
    assert link.state is LinkState.UP


def test_a_drain_has_an_end(link: PortableLink, far: can.BusABC) -> None:
    message = can.Message(arbitration_id=0x100, is_extended_id=False)
    for _ in range(DRAIN_LIMIT + 1):
        far.send(message)

    assert len(link.drain()) == DRAIN_LIMIT
    assert len(link.drain()) == 1


def test_what_the_bus_section_says_reaches_the_adapter(
    far: can.BusABC,
) -> None:
    link = PortableLink(config(fd=True, bitrate=500_000))
    link.open()
    far.send(can.Message(arbitration_id=1, is_fd=True, data=bytes(12)))

    assert [len(frame.data) for frame in link.drain()] == [12]
    link.close()


def test_an_interface_that_python_can_does_not_know() -> None:
    link = PortableLink(config("no-such-thing"))

    with pytest.raises(ConfigError, match=r"'car': .*'no-such-thing'"):
        link.open()


def test_an_adapter_that_is_absent_is_waited_for() -> None:
    link = PortableLink(config("socketcan", channel="bstm-absent"))

    assert not link.open()
    link.poll()

    assert link.state is LinkState.GONE
    assert link.reason.startswith("bstm-absent: ")
    assert link.drain() == []


def test_python_can_is_loaded_by_opening_only() -> None:
    code = (
        "import sys\n"
        "import bstm_daemon.bus.live.portable\n"
        "import bstm_daemon.bus.live.socketcan\n"
        "assert 'can' not in sys.modules\n"
        "assert 'numpy' not in sys.modules\n"
    )

    subprocess.run([sys.executable, "-c", code], check=True)


def test_own_frames_do_not_come_back_from_an_adapter_that_returns_them(
    far: can.BusABC, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another sender of the same id is heard all the same."""
    monkeypatch.setenv("CAN_CONFIG", '{"receive_own_messages": true}')
    link = PortableLink(config(), {(0x100, False)})
    assert link.open()

    for number in range(3):
        assert link.send(0x100, False, bytes([number])) is SendResult.OK
    for number in (2, 3):
        far.send(
            can.Message(
                arbitration_id=0x100, is_extended_id=False, data=[number]
            )
        )
    seen = [frame.data for frame in link.drain()]

    # five came: our 0, 1, 2, then a 2 that was not ours, and a 3
    assert seen == [b"\2", b"\3"]
    link.close()
