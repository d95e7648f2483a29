"""Several buses in one loop: the order of the frames is that of the stamps."""

from __future__ import annotations

import gzip
import itertools
import signal
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from .daemon_process import Daemon
    from .peers import Car, Ear

pytestmark = pytest.mark.vcan

BASE = 0x5B0
BRAKE_PRESSURE = 0x1A4
CYCLE_S = 0.1
FULL = 16
"""So many times the frames of the car fill the bus."""
SECOND_BUS = """
[[bus]]
name = "brakes"
dbc = "{dbc}"
channel = "{channel}"
"""


def with_second_bus(channel: str) -> Callable[[str], str]:
    """Return what moves the pressures to a bus of their own."""

    def edit(text: str) -> str:
        dbc = text.partition('\ndbc = "')[2].partition('"')[0]
        message = 'message = "BrakePressure"\n'
        assert text.count(message) == 2
        text = text.replace(message, message + 'bus = "brakes"\n')
        return text + SECOND_BUS.format(dbc=dbc, channel=channel)

    return edit


def test_frames_of_all_buses_in_the_order_of_their_stamps(  # noqa: PLR0917
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    marched: Callable[..., dict[str, dict[str, Any]]],
    vcan0: str,
    vcan1: str,
    tmp_path: Path,
) -> None:
    """Also where a stop of the process has filled both sockets."""
    heard = ear(vcan0)
    running = daemon(
        {"record.enabled": True, "state.interval_s": 0.2},
        edit=with_second_bus(vcan1),
    )
    driven = car(vcan0, vcan1, places={BRAKE_PRESSURE: 1})
    heard.wait(10, BASE)
    running.process.send_signal(signal.SIGSTOP)
    count = len(driven.sent)
    while len(driven.sent) < count + 200:
        driven._over.wait(0.01)
    running.process.send_signal(signal.SIGCONT)
    heard.wait(10, BASE, since=len(heard.frames))
    assert running.end() == 0
    driven.close()

    lines = [
        line.split()
        for path in sorted((running.state.parent / "record").glob("*.gz"))
        for line in gzip.decompress(path.read_bytes()).decode().splitlines()
    ]
    stamps = [line[0] for line in lines]
    assert stamps == sorted(stamps)
    assert {line[1] for line in lines} == {vcan0, vcan1}
    ids = [int(line[2].partition("#")[0], 16) for line in lines]
    assert ids == [frame.can_id for frame in driven.sent[: len(ids)]]
    # all but those of the last milliseconds
    assert len(driven.sent) - 100 < len(ids)

    document = running.document()
    expected = marched(running.config, driven.sent, document, 0.03)
    for name, corner in document["corners"].items():
        assert corner == expected[name]
    assert document["corners"]["FL"]["disc"] > 285.0


def test_one_bus_without_an_interface_does_not_hold_up_the_other(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    vcan0: str,
    ip: Callable[..., None],
) -> None:
    running = daemon(edit=with_second_bus("vcan9"))
    missing = running.event("bus_missing", bus="brakes", channel="vcan9")
    assert missing["error"] == "there is no interface vcan9"
    running.event("bus_up", bus="chassis")

    ip("add", "vcan9", "type", "vcan")
    ip("set", "vcan9", "up")
    running.event("bus_up", bus="brakes")
    car(vcan0, "vcan9", places={BRAKE_PRESSURE: 1})

    running.event("input_fault_over", fault="pressure missing")
    running.notice("disc F[LR] 1[1-9] degC")
    assert running.end() == 0


def test_a_full_bus_costs_no_frame(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
) -> None:
    """All frames of a full 500 kbit/s bus, 4000 a second, are wanted ones."""
    heard = ear(vcan0)
    driven = car()
    running = daemon()
    heard.wait(3, BASE)

    begin = len(heard.frames)
    driven.alter = lambda can_id, data: [(can_id, data)] * FULL
    count = len(driven.sent)
    while len(driven.sent) < count + 3 * 4000:
        driven._over.wait(0.01)
    end = len(heard.frames)
    driven.silent = True

    received = running.metric(
        'bstm_bus_frames_total{bus="chassis",channel="vcan0"}',
        lambda value: value >= len(driven.sent) - count,
    )
    status = [f for f in heard.frames[begin:end] if f.can_id == BASE]
    span_s = (status[-1].stamp_ns - status[0].stamp_ns) * 1e-9
    rate_hz = (len(driven.sent) - count) / span_s
    counters = [frame.data[1] & 0x0F for frame in status]
    steps = [(b - a) % 16 for a, b in itertools.pairwise(counters)]
    # the figures, for who asks (pytest -rP)
    due = span_s / CYCLE_S
    print(  # noqa: T201
        f"{rate_hz:.0f} frames/s, {received:.0f} received, "
        f"{len(status)} of {due:.0f} sent"
    )
    # how many of those due are sent does not lie with the service alone: car,
    # ear and service share the guest's one processor
    assert set(steps) == {1}
    assert len(steps) <= due + 1
    assert not running.said("frames_dropped")
    assert running.end() == 0
