"""Sending now or never, and never beside another sender of our ids."""

from __future__ import annotations

from typing import TYPE_CHECKING

import can
import pytest

from bstm_daemon.bus.live.portable import PortableLink
from bstm_daemon.bus.output.e2e import CheckStatus, Profile2Checker
from bstm_daemon.bus.output.layout import CORNERS, published_frames
from bstm_daemon.bus.output.publication import Publication
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.engine import Published
from bstm_daemon.estimate import CornerEstimate, Estimate
from bstm_daemon.service.sender import Sender

if TYPE_CHECKING:
    from collections.abc import Iterator

BASE = 0x5B0
STATUS, FRONT_LEFT = 0x5B0, 0x5B4
IDS = frozenset({STATUS, FRONT_LEFT})
DATA_IDS = {frame.name: frame.data_ids for frame in published_frames(CORNERS)}


class Source:
    """Publishes a disc that has as many kelvin as it was published."""

    def __init__(self) -> None:
        self.publication = Publication(CORNERS, BASE)
        self._number = 0

    def tick(self, count: int = 1) -> list[Published]:
        """Publish *count* times."""
        found = []
        for _ in range(count):
            self._number += 1
            time_us = self._number * 100_000
            disc_k = 273.15 + self._number
            corners = {"FL": CornerEstimate(disc_k=disc_k)}
            found += [
                Published(time_us, frame)
                for frame in self.publication.encode(
                    Estimate(time_us, corners)
                )
                if frame.can_id in IDS
            ]
        return found


def disc_c(message: can.Message) -> float:
    return (int.from_bytes(message.data, "little") >> 16 & 0xFFF) * 0.5 - 60.0


def counters(messages: list[can.Message]) -> list[int]:
    return [m.data[1] & 0x0F for m in messages]


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
    source = Source()
    sender = Sender(link, IDS, source.publication)

    sender.publish(source.tick(3))

    messages = received(peer)
    assert [m.arbitration_id for m in messages] == [STATUS, FRONT_LEFT]
    assert disc_c(messages[1]) == 3.0
    assert not any(m.is_extended_id for m in messages)
    assert (sender.sent, sender.lost) == (2, 0)


def test_a_stall_leaves_no_gap_in_the_counters(
    link: PortableLink, peer: can.BusABC
) -> None:
    """A receiver that accepts no lost frame takes every one."""
    source = Source()
    sender = Sender(link, IDS, source.publication)
    strict = Profile2Checker(DATA_IDS["BSTM_FL_Temperatures"], max_delta=1)

    for due in (1, 5, 1, 20, 0, 1):
        sender.publish(source.tick(due))
    sender.leave_out(source.tick(7))
    sender.publish(source.tick())

    messages = [m for m in received(peer) if m.arbitration_id == FRONT_LEFT]
    assert [disc_c(m) for m in messages] == [1.0, 6.0, 7.0, 27.0, 28.0, 36.0]
    assert counters(messages) == [0, 1, 2, 3, 4, 5]
    verdicts = [strict.check(bytes(m.data)) for m in messages]
    assert verdicts == [CheckStatus.OK] * 6
    # as the state file will have it
    assert source.publication.counters["BSTM_FL_Temperatures"] == 5


def test_nothing_of_an_outage_is_sent_after_it(
    link: PortableLink, peer: can.BusABC
) -> None:
    source = Source()
    sender = Sender(link, IDS, source.publication)
    sender.publish(source.tick())
    link.close()
    for _ in range(4):
        sender.publish(source.tick())
    assert link.open()

    sender.publish(source.tick())

    messages = received(peer)
    discs_c = [disc_c(m) for m in messages if m.arbitration_id == FRONT_LEFT]
    assert discs_c == [1.0, 6.0]
    assert counters(messages) == [0, 0, 1, 1]
    assert (sender.sent, sender.lost) == (4, 8)


def test_a_foreign_frame_ends_sending(
    link: PortableLink, peer: can.BusABC
) -> None:
    source = Source()
    sender = Sender(link, IDS, source.publication)
    assert sender.is_own(0x5B4, extended=False)
    assert not sender.is_own(0x5B4, extended=True)
    assert not sender.is_own(0x5B5, extended=False)

    assert sender.note_foreign(0x5B4)
    assert not sender.note_foreign(0x5B0)

    sender.publish(source.tick())
    assert received(peer) == []
    assert not sender.is_sending
    assert sender.foreign_id == 0x5B4


def test_without_a_link_nothing_is_sent_or_lost() -> None:
    source = Source()
    sender = Sender(None, frozenset(), source.publication)

    sender.publish(source.tick())

    assert not sender.is_sending
    assert (sender.sent, sender.lost) == (0, 0)
