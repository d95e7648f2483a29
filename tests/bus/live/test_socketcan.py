"""A SocketCAN link as far as it goes without an interface (tests/vcan)."""

import re
import socket

import pytest

from bstm_daemon.bus.live.link import LinkState, SendResult
from bstm_daemon.bus.live.socketcan import SocketcanLink
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.errors import ConfigError


def link(channel: str = "bstm-absent") -> SocketcanLink:
    return SocketcanLink(BusConfig(name="car", dbc="car.dbc", channel=channel))


def has_raw_can() -> bool:
    try:
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except OSError:
        return False
    return True


def test_a_link_begins_closed() -> None:
    made = link()

    assert made.state is LinkState.GONE
    assert made.reason == "not opened yet"
    assert made.drain() == []
    assert made.send(0x100, extended=False, data=b"") is SendResult.LOST
    assert made.dropped == 0


def test_an_absent_interface_is_waited_for() -> None:
    made = link()

    assert not made.open()
    made.poll()

    assert made.state is LinkState.GONE
    expected = (
        "there is no interface bstm-absent"
        if has_raw_can()
        else "the kernel offers no raw CAN sockets here: modprobe can_raw"
    )
    assert made.reason.startswith(expected)
    assert made.drain() == []
    assert made.send(0x100, extended=False, data=b"") is SendResult.LOST
    assert not made.counts
    made.close()
    assert made.reason == "closed"


@pytest.mark.parametrize(
    "channel",
    [
        "sixteen-byte-can",
        "can 0",
        "can/0",
        "can0:1",
        "..",
        "ca\0n",
        "käfig" * 3,
    ],
)
def test_a_name_that_no_interface_can_have(channel: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(repr(channel))):
        link(channel)


def test_a_long_payload_is_no_matter_of_the_bus() -> None:
    with pytest.raises(ValueError, match="at most 8 bytes, 9 given"):
        link().send(0x100, extended=False, data=bytes(9))
