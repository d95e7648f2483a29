"""What goes wrong in a car: the service goes on, and says what it saw."""

from __future__ import annotations

import contextlib
import socket
import struct
import subprocess
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.bus.output.e2e import protect

from .peers import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from .daemon_process import Daemon
    from .peers import Car, Ear

pytestmark = pytest.mark.vcan

CLASSIC = struct.Struct("=IB3x8s")
FD = struct.Struct("=IBB2x64s")
BASE = 0x5B0
SPARE = "vcan9"
INERTIAL = 0x1B0
BRAKE_PRESSURE = 0x1A4

ERROR = 0x20000000
BUS_ERROR, BUS_OFF, RESTARTED, CONTROLLER = 0x80, 0x40, 0x100, 0x4

DATA_IDS = list(range(17, 33))
E2E = f"""
[[e2e]]
message = "BrakePressure"
profile = 2
data_ids = {DATA_IDS}
max_delta = 3
"""


def labelled(name: str, bus: str = "vcan0") -> str:
    return f'{name}{{bus="chassis",channel="{bus}"}}'


@pytest.fixture
def raw(vcan0: str) -> Iterator[socket.socket]:
    """Return a socket that sends on vcan0."""
    made = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    with contextlib.closing(made):
        made.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
        made.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        made.bind((vcan0,))
        yield made


@pytest.fixture
def on_the_road(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
) -> tuple[Daemon, Car, Ear]:
    """Return a service that sees a car, and the ear that hears it."""
    heard = ear(vcan0)
    running = daemon({"state.interval_s": 0.2})
    driven = car()
    sees_a_car(running)
    return running, driven, heard


def sees_a_car(running: Daemon) -> None:
    """Wait until it does, and the faults of the begin, if told, are over.

    They can come with the first status that knows of the car.
    """
    running.notice("STATUS=degraded.* disc F[LR] 1[1-9]")
    running.notice("STATUS=", since=len(running.notices))
    wait_until(lambda: not running.faults(), "no fault")


def goes_on(running: Daemon, heard: Ear) -> None:
    """Demand that it publishes a rising temperature and ends well."""
    since = len(heard.frames)
    discs = [
        int.from_bytes(frame.data, "little") >> 16 & 0xFFF
        for frame in heard.wait(8, BASE + 4, since=since)
    ]
    assert discs[-1] > discs[0]
    assert running.end() == 0


def test_the_interface_goes_down_and_comes_up(
    on_the_road: tuple[Daemon, Car, Ear],
    vcan0: str,
    ip: Callable[..., None],
) -> None:
    running, _, heard = on_the_road
    since = len(running.events)
    ip("set", vcan0, "down")
    running.event("bus_down", bus="chassis", channel=vcan0)
    running.event("input_fault", since=since, fault="bus silent")
    running.notice("no_input, vcan0 is down")
    since = len(running.events)
    ip("set", vcan0, "up")
    running.event("bus_up", since=since)
    running.event("input_fault_over", since=since, fault="bus silent")
    goes_on(running, heard)


def test_the_interface_is_absent_then_removed_then_made_anew(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ip: Callable[..., None],
) -> None:
    running = daemon({"bus.channel": SPARE})
    running.event(
        "bus_missing", bus="chassis", error=f"there is no interface {SPARE}"
    )
    running.notice(f"there is no interface {SPARE}")
    for turn in range(2):
        since = len(running.events)
        ip("add", SPARE, "type", "vcan")
        ip("set", SPARE, "up")
        running.event("bus_up", since=since, channel=SPARE)
        driven = car(SPARE)
        running.metric(
            labelled("bstm_bus_frames_total", SPARE),
            lambda value, turn=turn: value > 300 * turn + 100,
        )
        driven.close()
        since = len(running.events)
        ip("delete", SPARE)
        running.event("bus_missing", since=since, channel=SPARE)
    assert running.end() == 0
    assert running.document()["corners"]["FL"]["disc"] > 283.5


def test_an_interface_that_is_made_but_never_up(
    daemon: Callable[..., Daemon], ip: Callable[..., None]
) -> None:
    ip("add", SPARE, "type", "vcan")
    running = daemon({"bus.channel": SPARE})
    running.event("bus_down", channel=SPARE)
    running.notice(f"{SPARE} is down")
    assert running.end() == 0


def test_a_flood_of_error_frames(
    on_the_road: tuple[Daemon, Car, Ear], raw: socket.socket
) -> None:
    """Those that tell of every frame, and those that tell of a change."""
    running, _, heard = on_the_road
    events = 'bstm_bus_events_total{bus="chassis",channel="vcan0",event="%s"}'
    for _ in range(2000):
        raw.send(CLASSIC.pack(ERROR | BUS_ERROR, 8, b""))
        raw.send(CLASSIC.pack(ERROR | CONTROLLER, 8, b"\0\x04"))
    warnings = running.metric(events % "warning", lambda value: value >= 2000)
    assert warnings == 2000
    # the others are not even received
    assert running.metric(events % "error_frame", bool) == 2000
    assert not running.said("frames_dropped")
    refused = running.event("frames_refused", reason="error_frame")
    assert refused["count"] > 0
    assert len(running.said("frames_refused")) <= 2
    goes_on(running, heard)


def test_bus_off_and_restart(
    on_the_road: tuple[Daemon, Car, Ear], raw: socket.socket
) -> None:
    running, _, heard = on_the_road
    raw.send(CLASSIC.pack(ERROR | BUS_OFF, 8, b""))
    running.event("bus_off", bus="chassis", channel="vcan0")
    raw.send(CLASSIC.pack(ERROR | RESTARTED, 8, b""))
    running.event("bus_restarted", bus="chassis", channel="vcan0")
    goes_on(running, heard)


def test_nothing_is_sent_into_bus_off(
    daemon: Callable[..., Daemon],
    ear: Callable[..., Ear],
    raw: socket.socket,
    vcan0: str,
) -> None:
    """A driver would take the frames, and send them stale once it is on."""
    heard = ear(vcan0)
    # a look at the interface would show that this one is not really off
    running = daemon({"daemon.reopen_s": 60.0})
    heard.wait(5, BASE)

    raw.send(CLASSIC.pack(ERROR | BUS_OFF, 8, b""))
    running.event("bus_off", bus="chassis", channel="vcan0")
    running.notice("vcan0 is bus-off")
    count = len(heard.frames)
    running.event("send_failed", bus="chassis")
    running.notice("STATUS=", since=len(running.notices))
    assert len(heard.frames) == count

    raw.send(CLASSIC.pack(ERROR | RESTARTED, 8, b""))
    after = heard.wait(10, BASE, since=count)
    assert after[9].stamp_ns - after[0].stamp_ns > 0.6e9
    assert running.end() == 0


@pytest.mark.parametrize("fd", [False, True])
def test_fd_frames_among_classic_ones(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    raw: socket.socket,
    vcan0: str,
    fd: bool,  # noqa: FBT001
) -> None:
    """With the id of a message of 8 bytes; not received on a classic bus."""
    heard = ear(vcan0)
    running = daemon({"bus.fd": fd})
    car()
    running.notice("STATUS=degraded.* disc F[LR] 1[1-9]")
    for _ in range(50):
        raw.send(FD.pack(INERTIAL, 64, 1, b"\xff" * 64))
    if fd:
        refused = running.event("frames_refused", reason="wrong_length")
        assert refused["count"] == 50
    else:
        running.notice("STATUS=", since=len(running.notices))
        assert not running.said("frames_refused")
    goes_on(running, heard)


def test_a_wrong_length(
    on_the_road: tuple[Daemon, Car, Ear], raw: socket.socket
) -> None:
    running, _, heard = on_the_road
    for length in (0, 1, 7):
        raw.send(CLASSIC.pack(INERTIAL, length, b"\xff" * length))
    refused = running.event("frames_refused", reason="wrong_length")
    assert refused["count"] == 3
    status = heard.wait(3, BASE, since=len(heard.frames))[-1]
    assert status.data[6] == 3  # RejectedFrames
    goes_on(running, heard)


class Protector:
    """Gives the car's brake pressure the protection that is asked for."""

    def __init__(self) -> None:
        self.counter = 0
        self.stuck = False
        self.swapped = False
        self.doubled = False
        self._late: bytes | None = None

    def __call__(self, can_id: int, data: bytes) -> list[tuple[int, bytes]]:
        if can_id != BRAKE_PRESSURE:
            return [(can_id, data)]
        if not self.stuck:
            self.counter = (self.counter + 1) % 16
        frame = protect(b"\0\0" + data[:4] + b"\0\0", self.counter, DATA_IDS)
        if not self.swapped:
            return [(can_id, frame)] * (2 if self.doubled else 1)
        if self._late is None:
            self._late = frame
            return []
        late, self._late = self._late, None
        return [(can_id, frame), (can_id, late)]


@pytest.fixture
def protected(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    tmp_path: Path,
) -> tuple[Daemon, Protector, Ear]:
    """Return the same with a brake pressure under E2E profile 2."""
    heard = ear(vcan0)

    def edit(text: str) -> str:
        path = text.partition('\ndbc = "')[2].partition('"')[0]
        with open(path, encoding="utf-8") as file:  # noqa: PTH123
            dbc = file.read()
        for start, moved in ((0, 16), (16, 32)):
            name = "PressurePrimary" if start == 0 else "PressureSecondary"
            old = f"SG_ {name} : {start}|16@1-"
            assert old in dbc
            dbc = dbc.replace(old, f"SG_ {name} : {moved}|16@1-")
        own = tmp_path / "protected.dbc"
        own.write_text(dbc, "utf-8")
        return text.replace(path, str(own))

    running = daemon(edit=edit, more=E2E)
    driven = car()
    protector = Protector()
    driven.alter = protector
    sees_a_car(running)
    return running, protector, heard


def test_a_stuck_counter(protected: tuple[Daemon, Protector, Ear]) -> None:
    running, protector, heard = protected
    since = len(running.events)
    protector.stuck = True
    running.event("frames_refused", since=since, reason="repeated_counter")
    running.event("input_fault", since=since, fault="pressure missing")
    protector.stuck = False
    since = len(running.events)
    running.event("input_fault_over", since=since, fault="pressure missing")
    goes_on(running, heard)


def test_frames_out_of_order(protected: tuple[Daemon, Protector, Ear]) -> None:
    """Of two that changed places the later one is refused, not both."""
    running, protector, heard = protected
    protector.swapped = True
    refused = running.event("frames_refused", reason="wrong_sequence")
    assert refused["count"] > 0
    goes_on(running, heard)


def test_protected_duplicates(
    protected: tuple[Daemon, Protector, Ear],
) -> None:
    """The second of two is refused; the input is there all the time."""
    running, protector, heard = protected
    since = len(running.events)
    protector.doubled = True
    refused = running.event(
        "frames_refused", since=since, reason="repeated_counter"
    )
    assert refused["count"] > 0
    heard.wait(20, BASE, since=len(heard.frames))
    running.notice("STATUS=", since=len(running.notices))
    later = running.events[since:]
    assert "input_fault" not in [event["event"] for event in later]
    assert not running.faults()
    goes_on(running, heard)


def test_duplicates_change_nothing(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    marched: Callable[..., dict[str, dict[str, Any]]],
    vcan0: str,
) -> None:
    heard = ear(vcan0)
    running = daemon()
    driven = car()
    driven.alter = lambda can_id, data: [(can_id, data)] * 2
    heard.wait(20, BASE)
    assert running.end() == 0
    driven.close()

    document = running.document()
    expected = marched(running.config, driven.sent[::2], document, 0.05)
    for name, corner in document["corners"].items():
        assert corner == expected[name]
    assert document["corners"]["FL"]["disc"] > 285.0


@pytest.mark.full
def test_a_full_disk(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    medium: Path,
) -> None:
    """State, record and metrics on it; all go on once there is room."""
    heard = ear(vcan0)
    running = daemon(
        {
            "state.interval_s": 0.2,
            "record.enabled": True,
            "record.folder": str(medium / "record"),
            "record.segment_s": 1.0,
            "metrics.file": str(medium / "bstm.prom"),
        },
        state=medium / "car.state",
    )
    car()
    saves = "bstm_state_saves_total"
    running.metrics_file = medium / "bstm.prom"
    running.metric(saves, lambda value: value > 3)

    ballast = medium / "ballast"
    with contextlib.suppress(OSError), ballast.open("wb") as file:
        while True:
            file.write(b"x" * 512)
            file.flush()
    failed = running.event("state_save_failed", file=str(running.state))
    assert "No space left on device" in failed["error"]
    running.event("metrics_failed")
    running.event("record_failed")
    # what is there is whole
    old = running.document()["boot_us"]
    heard.wait(10, BASE, since=len(heard.frames))
    ballast.unlink()

    before = running.metric(saves, lambda value: value > 0)
    running.metric(saves, lambda value: value > before + 3)
    goes_on(running, heard)
    assert running.document()["boot_us"] > old


def mounted(program: Callable[[str], str], place: Path, *how: str) -> None:
    subprocess.run([program("mount"), *how, str(place)], check=True)


def test_a_folder_that_becomes_read_only(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    medium: Path,
    program: Callable[[str], str],
) -> None:
    heard = ear(vcan0)
    running = daemon(
        {
            "state.interval_s": 0.2,
            "metrics.file": str(medium / "bstm.prom"),
        },
        state=medium / "car.state",
    )
    car()
    running.metrics_file = medium / "bstm.prom"
    running.metric("bstm_state_saves_total", lambda value: value > 3)

    # a second mount over it: the lock is open for writing in the first
    mounted(program, medium, "--bind", str(medium))
    mounted(program, medium, "-o", "remount,bind,ro")
    failed = running.event("state_save_failed", file=str(running.state))
    assert "Read-only file system" in failed["error"]
    old = running.document()["boot_us"]
    # the end, too, is a clean one
    goes_on(running, heard)
    assert running.document()["boot_us"] == old
    subprocess.run([program("umount"), str(medium)], check=True)


@pytest.mark.full
def test_a_folder_that_is_read_only_from_the_start(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    medium: Path,
    program: Callable[[str], str],
) -> None:
    first = daemon(state=medium / "car.state")
    assert first.end() == 0
    mounted(program, medium, "-o", "remount,ro")

    heard = ear(vcan0)
    running = daemon(
        {
            "state.interval_s": 0.2,
            "record.enabled": True,
            "record.folder": str(medium / "record"),
            "record.segment_s": 1.0,
        },
        state=medium / "car.state",
    )
    running.event("state_loaded")
    running.event("state_save_failed")
    car()
    running.event("record_failed")
    mounted(program, medium, "-o", "remount,rw")

    running.metric("bstm_state_saves_total", lambda value: value > 3)
    goes_on(running, heard)
