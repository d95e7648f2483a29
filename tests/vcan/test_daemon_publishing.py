"""What the live service puts on the bus, and what it never does."""

from __future__ import annotations

import itertools
import re
import signal
import subprocess
from typing import TYPE_CHECKING, Any

import cantools.autosar
import pytest
from cantools.database.can import Database

from bstm_daemon.bus.output.e2e import CheckStatus, Profile2Checker
from bstm_daemon.bus.output.layout import (
    ADVICE_OFFSET,
    own_ids,
    published_frames,
)
from bstm_daemon.files import shipped_file

from .peers import stood_s

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

    from .conftest import Recorder
    from .daemon_process import Daemon
    from .peers import Car, Ear

pytestmark = pytest.mark.vcan

CORNERS = ("FL", "FR", "RL", "RR")
BASE = 0x5B0
LAYOUT = {
    can_id: frame
    for can_id, frame in zip(
        own_ids(BASE, CORNERS), published_frames(CORNERS), strict=True
    )
    if frame.id_offset != ADVICE_OFFSET
}
"""What is sent without ``[publish] requests``."""

BITRATE = 500_000
LOAD_LIMIT = 0.03
FAREWELL = 4
"""``State`` of the last status frame: stopping."""

CANDUMP = re.compile(r"\((\d+)\.(\d{6})\) \S+ ([0-9A-F]{3})#([0-9A-F]*)")

DATABASE = Database()
DATABASE.add_dbc_file(shipped_file("dbc/bstm.dbc"))


def decoded(can_id: int, data: bytes) -> dict[str, Any]:
    values = DATABASE.decode_message(can_id, data, decode_choices=False)
    assert isinstance(values, dict)
    return values


def worst_bits(length: int) -> int:
    """Return bits of a standard frame: worst stuffing and intermission."""
    stuffed = 34 + 8 * length  # start of frame to CRC
    return stuffed + (stuffed - 1) // 4 + 10 + 3


def test_it_only_listens_unless_told_otherwise(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
) -> None:
    everything = ear(vcan0, 0, 0x800)
    running = daemon({"publish.enabled": False})
    driven = car()

    running.notice("STATUS=degraded")
    assert running.end() == 0

    driven.close()
    assert not running.said("publishing_started")
    known = {frame.can_id for frame in driven.sent}
    assert {frame.can_id for frame in everything.frames} == known


def test_frames_load_and_protection(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    candump: Recorder,
    vcan0: str,
) -> None:
    """From the first to the last word, as candump of can-utils sees it."""
    recorder = candump(
        # ends by itself once nothing comes any more
        *("-L", "-T", "20000", f"{vcan0},5B0:7F0,5C0:7F0")
    )
    driven = car()
    running = daemon()
    running.notice("STATUS=degraded")
    for _ in range(3):  # a second each
        running.notice("STATUS=degraded", since=len(running.notices))
    assert running.end() == 0
    driven.close()

    assert recorder.stdout is not None
    lines: list[tuple[int, int, bytes]] = []
    while not (
        lines
        and lines[-1][1] == max(LAYOUT)
        and decoded(BASE, lines_of(lines, BASE)[-1])["State"] == FAREWELL
    ):
        found = CANDUMP.match(recorder.stdout.readline())
        assert found is not None
        second, micros, word, text = found.groups()
        stamp_us = int(second) * 1_000_000 + int(micros)
        lines.append((stamp_us, int(word, 16), bytes.fromhex(text)))

    # the load: what was sent between the first and the last line but that
    # of the end, with every frame as long as stuffing can make it
    # but for the first second, in which the service still starts
    regular = [
        line
        for line in lines[: -len(LAYOUT)]
        if line[0] >= lines[0][0] + 1_000_000
    ]
    span_s = (regular[-1][0] - regular[0][0]) * 1e-6
    bits = sum(worst_bits(len(data)) for _, _, data in regular)
    load = bits / span_s / BITRATE
    # the figures, for who asks (pytest -rP)
    print(  # noqa: T201
        f"bus load {load:.2%} of {BITRATE} bit/s over {span_s:.1f} s"
    )
    assert load <= LOAD_LIMIT

    assert {can_id for _, can_id, _ in lines} == set(LAYOUT)
    for can_id, layout in LAYOUT.items():
        checker = Profile2Checker(layout.data_ids)
        datas = lines_of(lines, can_id)
        for data in datas:
            assert checker.check(data) is CheckStatus.OK
            crc = cantools.autosar.compute_profile2_crc(
                data, layout.data_ids[data[1] & 0x0F]
            )
            assert crc == data[0]
        # all that were due in the time; a computer that stood still catches
        # up with some and leaves others out
        due = span_s / (layout.cycle_us * 1e-6)
        sent = sum(word == can_id for _, word, _ in regular)
        allowed = 2 + stood_s(driven.sent) / (layout.cycle_us * 1e-6)
        assert abs(sent - due) <= allowed
    status = [decoded(BASE, data) for data in lines_of(lines, BASE)]
    # what was before the start is not known: degraded for hours
    assert status[-2]["State"] == 2
    assert status[-1]["Validity"] == 15
    for corner in range(4):
        last = decoded(
            BASE + 4 + corner, lines_of(lines, BASE + 4 + corner)[-1]
        )
        assert last["Validity"] == 15
        raw = DATABASE.decode_message(
            BASE + 4 + corner, lines_of(lines, BASE + 4 + corner)[-1]
        )
        assert isinstance(raw, dict)
        assert {str(raw[name]) for name in ("Disc", "PadFront", "Fluid")} == {
            "not_available"
        }


def lines_of(
    lines: Iterable[tuple[int, int, bytes]], can_id: int
) -> list[bytes]:
    return [data for _, found, data in lines if found == can_id]


def test_a_foreign_frame_with_our_id_ends_publication(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    program: Callable[[str], str],
) -> None:
    heard = ear(vcan0)
    car()
    running = daemon({"state.interval_s": 0.2})
    heard.wait(1, BASE)

    subprocess.run([program("cansend"), vcan0, "5B4#0011"], check=True)

    running.event("foreign_frame", bus="chassis", can_id="0x5B4")
    running.notice("NOT PUBLISHING: another sender of 0x5B4")
    count = len(heard.frames)
    before = running.document()["corners"]["FL"]["disc"]
    for _ in range(2):
        running.notice("STATUS=", since=len(running.notices))
    assert len(heard.frames) == count
    # it goes on to estimate, and says no more
    assert running.document()["corners"]["FL"]["disc"] > before + 1.0
    assert len(running.said("foreign_frame")) == 1
    running.metric("bstm_publishing", lambda value: value == 0)

    # whoever has removed the other sender says so
    running.process.send_signal(signal.SIGHUP)
    running.event("config_reloaded")
    heard.wait(3, BASE, since=count)

    assert running.end() == 0


def test_of_two_services_with_the_same_ids_one_sends_at_most(
    daemon: Callable[..., Daemon],
    ear: Callable[..., Ear],
    vcan0: str,
) -> None:
    """The second hears the first, and the first it if it was as quick."""
    heard = ear(vcan0)
    first = daemon()
    heard.wait(1, BASE)
    second = daemon()

    second.event("foreign_frame")
    for running in (first, second):
        running.notice("STATUS=", since=len(running.notices))
    since = len(heard.frames)
    if first.said("foreign_frame"):
        first.notice("NOT PUBLISHING", since=len(first.notices))
        assert len(heard.frames) == since
    else:
        after = heard.wait(10, BASE, since=since)
        counters = [frame.data[1] & 0x0F for frame in after]
        steps = {(b - a) % 16 for a, b in itertools.pairwise(counters)}
        assert steps == {1}

    assert second.end() == 0
    assert first.end() == 0


def test_own_frames_are_never_input(
    daemon: Callable[..., Daemon],
    ear: Callable[..., Ear],
    vcan0: str,
) -> None:
    heard = ear(vcan0)
    running = daemon()

    heard.wait(30, BASE)

    assert "0 frames" in running.notice("STATUS=", since=len(running.notices))
    assert not running.said("foreign_frame")
    assert running.end() == 0


@pytest.fixture
def no_room(
    program: Callable[[str], str], vcan0: str, net_admin: None
) -> Iterator[Callable[[str], None]]:
    """Return what sets a transmit queue without any room, or takes it."""

    def run(action: str) -> None:
        more = ["pfifo", "limit", "0"] if action == "add" else []
        subprocess.run(
            [program("tc"), "qdisc", action, "dev", vcan0, "root", *more],
            check=action == "add",
            capture_output=True,
        )

    yield run
    run("del")


def test_what_finds_no_room_is_lost_and_counted(
    daemon: Callable[..., Daemon],
    ear: Callable[..., Ear],
    vcan0: str,
    no_room: Callable[[str], None],
) -> None:
    lost = 'bstm_bus_send_lost_frames_total{bus="chassis",channel="vcan0"}'
    sent = 'bstm_bus_sent_frames_total{bus="chassis",channel="vcan0"}'
    heard = ear(vcan0)
    running = daemon()
    heard.wait(5, BASE)

    no_room("add")
    running.event("send_failed", bus="chassis")
    running.notice("vcan0 takes no frames: No buffer space available")
    missing = running.metric(lost, lambda value: value >= 20)
    count = len(heard.frames)
    no_room("del")

    after = heard.wait(10, BASE, since=count)
    taken = running.metric(sent, lambda value: value >= count + 20)
    assert missing > 0
    assert taken > 0
    # what was never sent has no number: a receiver takes the next one
    counters = [frame.data[1] & 0x0F for frame in after]
    assert (counters[0] - heard_before(heard, count)) % 16 == 1
    steps = {(b - a) % 16 for a, b in itertools.pairwise(counters)}
    assert steps == {1}
    assert running.end() == 0


def heard_before(heard: Ear, count: int) -> int:
    """Return the counter of the last status frame among the first *count*."""
    status = [f for f in heard.frames[:count] if f.can_id == BASE]
    counter: int = status[-1].data[1] & 0x0F
    return counter


def test_nothing_is_queued_across_an_outage(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    ip: Callable[..., None],
) -> None:
    heard = ear(vcan0)
    car()
    running = daemon()
    heard.wait(5, BASE)

    ip("set", vcan0, "down")
    running.event("bus_down", bus="chassis")
    running.notice("vcan0 is down")
    count = len(heard.frames)
    running.notice("STATUS=", since=len(running.notices))
    ip("set", vcan0, "up")

    after = heard.wait(10, BASE, since=count)
    stamps = [frame.stamp_ns for frame in after]
    # one frame per cycle, the first ones too
    assert stamps[9] - stamps[0] > 0.6e9
    running.event("bus_up", since=len(running.said("bus_up")))
    assert running.end() == 0


def test_dropped_frames_are_published(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    tmp_path: Path,
) -> None:
    heard = ear(vcan0)
    driven = car()
    # room for some cycles, not for the stop
    running = daemon({"daemon.receive_buffer_bytes": 32768})
    heard.wait(1, BASE)
    series = 'bstm_bus_dropped_frames_total{bus="chassis",channel="vcan0"}'
    # on a busy machine the service may have missed frames before
    before = running.metric(series, lambda _: True)

    running.process.send_signal(signal.SIGSTOP)
    count = len(driven.sent)
    while len(driven.sent) < count + 200:
        driven._over.wait(0.01)
    running.process.send_signal(signal.SIGCONT)

    total = running.metric(series, lambda value: value > before + 100)
    assert total <= len(driven.sent)
    assert running.event("frames_dropped", bus="chassis")["count"] <= total
    status = heard.wait(3, BASE, since=len(heard.frames))[-1]
    assert decoded(BASE, status.data)["DroppedFrames"] == min(total, 125)
    assert running.end() == 0
