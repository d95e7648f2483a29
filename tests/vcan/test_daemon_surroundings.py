"""What the service stands on goes away, and all goes wrong at once."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import socket
import struct
import subprocess
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from .peers import wait_until

if TYPE_CHECKING:
    from collections.abc import Callable

    from .daemon_process import Daemon
    from .peers import Car, Ear

pytestmark = pytest.mark.vcan

BASE = 0x5B0
BRAKE_PRESSURE = 0x1A4
SPARE = "vcan9"
CLASSIC = struct.Struct("=IB3x8s")
FD = struct.Struct("=IBB2x64s")
ERROR = 0x20000000
HOUR_S = 3600
ROUNDS = 3
"""So often each fault comes, in any order."""
SECOND_BUS = """
[[bus]]
name = "brakes"
dbc = "{dbc}"
channel = "{channel}"
"""


def publishes(heard: Ear) -> None:
    heard.wait(10, BASE, since=len(heard.frames))


@pytest.mark.full
def test_a_log_that_nobody_takes(
    daemon: Callable[..., Daemon], ear: Callable[..., Ear], vcan0: str
) -> None:
    """The journal was restarted: every line is an error (EPIPE)."""
    heard = ear(vcan0)
    running = daemon()
    publishes(heard)
    with open(os.devnull, encoding="ascii") as other:  # noqa: PTH123
        os.dup2(other.fileno(), running.process.stderr.fileno())
    good = running.config.read_text("utf-8")
    running.config.write_text("no configuration", "utf-8")
    for _ in range(3):
        since = len(running.notices)
        running.process.send_signal(signal.SIGHUP)
        wait_until(
            lambda since=since: len(running.notices) > since, "it goes on"
        )
    publishes(heard)
    running.config.write_text(good, "utf-8")
    assert running.end() == 0
    assert running.document()["vehicle_id"] == "example-vehicle"


def test_a_service_manager_that_went(
    daemon: Callable[..., Daemon], ear: Callable[..., Ear], vcan0: str
) -> None:
    heard = ear(vcan0)
    running = daemon()
    publishes(heard)
    (running.config.parent / "notify").unlink()
    count = len(running.notices)
    for _ in range(3):
        publishes(heard)
    assert len(running.notices) == count
    assert running.end() == 0


def test_folders_that_are_removed_are_made_again(
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    vcan0: str,
    tmp_path: Path,
) -> None:
    """State and record, with the lock of the state in it."""
    heard = ear(vcan0)
    folder = tmp_path / "state"
    running = daemon(
        {
            "state.interval_s": 0.2,
            "record.enabled": True,
            "record.segment_s": 1.0,
        },
        state=folder / "car.state",
    )
    car()
    wait_until(running.state.exists, "the state is saved")
    shutil.rmtree(folder)
    wait_until(running.state.exists, "the state is saved again")
    publishes(heard)
    assert running.end() == 0
    assert running.document()["corners"]["FL"]["disc"] > 283.2
    assert list((folder / "record").glob("*.gz"))


def test_without_a_configuration_file(
    daemon: Callable[..., Daemon], tmp_path: Path
) -> None:
    """Not 78, which is not tried again: it may be on its way."""
    running = daemon(
        arguments=["-c", str(tmp_path / "absent.toml")], ready=False
    )
    assert running.exit_code() == 74
    assert any("absent.toml" in line for line in running.other_lines)


@pytest.mark.full
def test_reloads_keep_nothing_open(
    daemon: Callable[..., Daemon],
    ear: Callable[..., Ear],
    vcan0: str,
    vcan1: str,
) -> None:
    """Good ones to and fro between two buses, bad ones between them."""
    running = daemon({"record.enabled": True})
    heard = ear(vcan0)
    publishes(heard)
    first = running.config.read_text("utf-8")
    other = first.replace(f'channel = "{vcan0}"', f'channel = "{vcan1}"')
    bad = first.replace('interface = "socketcan"', 'interface = "no"')
    assert len({first, other, bad}) == 3
    files = Path(f"/proc/{running.process.pid}/fd")
    threads = files.with_name("task")

    def reload(text: str, event: str) -> None:
        running.config.write_text(text, "utf-8")
        since = len(running.events)
        running.process.send_signal(signal.SIGHUP)
        running.event(event, since=since)

    found = []
    for _ in range(4):
        reload(other, "config_reloaded")
        reload(bad, "config_refused")
        reload(first, "config_reloaded")
        heard.wait(2, BASE, since=len(heard.frames))
        found.append(
            (len(list(files.iterdir())), len(list(threads.iterdir())))
        )
    # the thread of the record writes to a file now and then
    assert found[-1][0] <= found[0][0] + 1
    assert found[-1][1] <= found[0][1]
    assert running.end() == 0


class Storm:
    """Everything that goes wrong in a car, one thing upon the other."""

    def __init__(
        self,
        running: Daemon,
        driven: Car,
        medium: Path,
        ip: Callable[..., None],
        program: Callable[[str], str],
    ) -> None:
        self._running, self._driven, self._ip = running, driven, ip
        self._medium = medium
        self._mount = program("mount")
        self._queue = [program("tc"), "qdisc"]
        self._good = running.config.read_text("utf-8")
        self._chance = random.Random(20240229)  # noqa: S311
        self._pause = threading.Event()
        self._raw = socket.socket(
            socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW
        )
        self._raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        self._raw.bind(("vcan0",))

    def blow(self) -> None:
        """Let all of it happen; then all is well again."""
        faults = [
            *(self.interface_down, self.interface_removed, self.no_room),
            *(self.clock_stepped, self.stopped, self.full, self.read_only),
            *(self.bad_configuration, self.good_configuration, self.request),
            *(self.noise, self.errors, self.silence),
        ]
        order = faults * ROUNDS
        self._chance.shuffle(order)
        for fault in order:
            fault()
            self._pause.wait(self._chance.uniform(0.0, 0.1))
        self._raw.close()
        self._driven.alter = lambda can_id, data: [(can_id, data)]
        self._running.config.write_text(self._good, "utf-8")

    def interface_down(self) -> None:
        self._ip("set", "vcan0", "down")
        self._pause.wait(self._chance.uniform(0.0, 0.3))
        self._ip("set", "vcan0", "up")

    def interface_removed(self) -> None:
        self._ip("delete", SPARE)
        self._pause.wait(self._chance.uniform(0.0, 0.3))
        self._ip("add", SPARE, "type", "vcan")
        self._ip("set", SPARE, "up")

    def no_room(self) -> None:
        on = ["dev", "vcan0", "root"]
        more = ["pfifo", "limit", "0"]
        subprocess.run([*self._queue, "add", *on, *more], check=True)
        self._pause.wait(0.2)
        subprocess.run([*self._queue, "del", *on], check=True)

    def clock_stepped(self) -> None:
        step_ns = self._chance.choice([-1, 1]) * HOUR_S * 10**9
        now_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
        time.clock_settime_ns(time.CLOCK_REALTIME, now_ns + step_ns)

    def stopped(self) -> None:
        self._running.process.send_signal(signal.SIGSTOP)
        self._pause.wait(self._chance.uniform(0.0, 0.5))
        self._running.process.send_signal(signal.SIGCONT)

    def full(self) -> None:
        ballast = self._medium / "ballast"
        with contextlib.suppress(OSError), ballast.open("wb") as file:
            while True:
                file.write(b"x" * 512)
                file.flush()
        self._pause.wait(0.3)
        ballast.unlink()

    def read_only(self) -> None:
        for how in ("ro", "rw"):
            # busy where a file is open for writing just now
            subprocess.run(
                [self._mount, "-o", f"remount,{how}", str(self._medium)],
                check=False,
                capture_output=True,
            )
            self._pause.wait(0.3)

    def bad_configuration(self) -> None:
        cut = self._chance.randrange(len(self._good))
        self._running.config.write_text(self._good[:cut] + "=", "utf-8")
        self._running.process.send_signal(signal.SIGHUP)

    def good_configuration(self) -> None:
        self._running.config.write_text(self._good, "utf-8")
        self._running.process.send_signal(signal.SIGHUP)

    def request(self) -> None:
        self._running.process.send_signal(signal.SIGUSR1)

    def noise(self) -> None:
        chance = random.Random(self._chance.random())  # noqa: S311

        def alter(can_id: int, data: bytes) -> list[tuple[int, bytes]]:
            length = chance.choice([8, 8, 8, 8, 0, 3, 7])
            value = data if chance.random() < 0.5 else chance.randbytes(8)
            times = chance.choice([0, 1, 1, 1, 2, 8])
            return [(can_id, value[:length])] * times

        self._driven.alter = alter

    def errors(self) -> None:
        with contextlib.suppress(OSError):
            for kind in (0x80, 0x4, 0x40, 0x100) * 50:
                self._raw.send(CLASSIC.pack(ERROR | kind, 8, b"\0\x04"))
                self._raw.send(FD.pack(BRAKE_PRESSURE, 64, 1, b"\xff" * 64))

    def silence(self) -> None:
        self._driven.silent = True
        self._pause.wait(0.3)
        self._driven.silent = False


@pytest.mark.full
def test_everything_at_once(  # noqa: PLR0917
    daemon: Callable[..., Daemon],
    car: Callable[..., Car],
    ear: Callable[..., Ear],
    ip: Callable[..., None],
    program: Callable[[str], str],
    medium: Path,
    vcan0: str,
    own_clock: None,
) -> None:
    """The process lives, and after it all is as if nothing had been."""
    heard = ear(vcan0)
    ip("add", SPARE, "type", "vcan")
    ip("set", SPARE, "up")

    def edit(text: str) -> str:
        dbc = text.partition('\ndbc = "')[2].partition('"')[0]
        message = 'message = "BrakePressure"\n'
        text = text.replace(message, message + 'bus = "brakes"\n')
        return text + SECOND_BUS.format(dbc=dbc, channel=SPARE)

    running = daemon(
        {
            "state.interval_s": 0.2,
            "record.enabled": True,
            "record.folder": str(medium / "record"),
            "record.segment_s": 1.0,
            "metrics.file": str(medium / "bstm.prom"),
            "daemon.reopen_s": 0.1,
        },
        edit=edit,
        state=medium / "car.state",
    )
    driven = car(vcan0, SPARE, places={BRAKE_PRESSURE: 1})
    publishes(heard)

    Storm(running, driven, medium, ip, program).blow()

    assert running.process.poll() is None
    since = len(running.events)
    running.process.send_signal(signal.SIGHUP)
    running.event("config_reloaded", since=since)
    running.metrics_file = medium / "bstm.prom"
    for bus, channel in (("chassis", vcan0), ("brakes", SPARE)):
        up = f'bstm_bus_state{{bus="{bus}",channel="{channel}",state="up"}}'
        running.metric(up, lambda value: value == 1.0)
    before = running.metric("bstm_state_saves_total", bool)
    running.metric("bstm_state_saves_total", lambda value: value > before + 2)
    publishes(heard)
    # inputs that were noise are believed again, and none is missing
    running.notice(
        "STATUS=degraded, disc [FR][LR] [0-9]+ degC",
        since=len(running.notices),
    )
    assert running.end() == 0
    assert not running.other_lines
    corners = running.document()["corners"]
    for corner in corners.values():
        assert all(250.0 < kelvin < 1800.0 for kelvin in nodes(corner))


def nodes(corner: dict[str, float]) -> list[float]:
    """Return the temperatures of *corner*, which has memories besides."""
    return [corner[name] for name in ("disc", "pad_front", "fluid")]
