"""Sending now or never, and never beside another sender of our ids."""

from __future__ import annotations

from typing import TYPE_CHECKING

import can
import pytest

from bstm_daemon.bus.live.portable import PortableLink
from bstm_daemon.bus.output.publication import OutputFrame
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.engine import Published
from bstm_daemon.service.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Iterator

IDS = frozenset({0x5B0, 0x5B4})


def published(number: int, can_id: int = 0x5B0) -> Published:
    frame = OutputFrame(can_id, False, bytes([number] * 8), f"F{can_id}")
    return Published(number * 100_000, frame)


@pytest.fixture
def link(request: pytest.FixtureRequest) -> Iterator[PortableLink]:
    bus = BusConfig(
        name="b", dbc="x.dbc", interface="virtual", channel=request.node.name
    )
    link = PortableLink(bus)
    assert link.open()
    yield link
    link.close()


@pytest.fixture
def peer(link: PortableLink) -> Iterator[can.BusABC]:
    bus = can.Bus(interface="virtual", channel=link.channel)
    yield bus
    bus.shutdown()


def received(peer: can.BusABC) -> list[can.Message]:
    found = []
    while (message := peer.recv(0)) is not None:
        found.append(message)
    return found


def test_of_a_stall_only_the_newest_goes_out(
    link: PortableLink, peer: can.BusABC
) -> None:
    sender = Sender(link, IDS)

    sender.publish(
        [published(1), published(1, 0x5B4), published(2), published(3)]
    )

    messages = received(peer)
    assert [(m.arbitration_id, m.data[0]) for m in messages] == [
        (0x5B0, 3),
        (0x5B4, 1),
    ]
    assert not any(m.is_extended_id for m in messages)
    assert (sender.sent, sender.lost) == (2, 0)


def test_nothing_of_an_outage_is_sent_after_it(
    link: PortableLink, peer: can.BusABC
) -> None:
    sender = Sender(link, IDS)
    link.close()
    sender.publish([published(1)])
    assert link.open()

    sender.publish([published(2)])

    assert [m.data[0] for m in received(peer)] == [2]
    assert (sender.sent, sender.lost) == (1, 1)


def test_a_foreign_frame_ends_sending(
    link: PortableLink, peer: can.BusABC
) -> None:
    sender = Sender(link, IDS)
    assert sender.is_own(0x5B4, extended=False)
    assert not sender.is_own(0x5B4, extended=True)
    assert not sender.is_own(0x5B5, extended=False)

    assert sender.note_foreign(0x5B4)
    assert not sender.note_foreign(0x5B0)

    sender.publish([published(1)])
    assert received(peer) == []
    assert not sender.is_sending
    assert sender.foreign_id == 0x5B4


def test_without_a_link_nothing_is_sent_or_lost() -> None:
    sender = Sender(None, frozenset())

    sender.publish([published(1)])

    assert not sender.is_sending
    assert (sender.sent, sender.lost) == (0, 0)
