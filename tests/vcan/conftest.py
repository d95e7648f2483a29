"""Fixtures of tests on real SocketCAN interfaces (``pytest -m vcan``)."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import pytest

from bstm_daemon.daemon.clock import boot_clock_ns
from bstm_daemon.daemon.monitor import BusOverride, build_monitor
from bstm_daemon.daemon.state_file import read
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.frames import Encoder

ROOT = Path(__file__).resolve().parents[2]
IFF_UP = 1
CAP_NET_ADMIN = 12
DEADLINE_S = 30.0
"""For what takes milliseconds: reached only where it never comes."""

Recorder = Callable[..., subprocess.Popen[str]]

CLASSIC = struct.Struct("=IB3x8s")
TIMESPEC = struct.Struct("@qq")
SO_TIMESTAMPNS = 35  # Python's socket module has no name for it

ID_BASE = 0x5B0
STATUS = ID_BASE
DISC = {"FL": ID_BASE + 4, "FR": ID_BASE + 5}

DRIVE = """
[drive]
name = "hold"
description = "a descent of 8 % held at 72 km/h"
ambient_c = 10.0
[[segment]]
speed_kmh = 72.0
rate_ms2 = 4.0
gear = 0
grade_percent = -8.0
duration_s = 30.0
"""
SETTLED_US = 15_000_000
PERIOD_US = 10_000_000
"""Of this drive the car repeats ten seconds from here on: speed and pressure
are constant there, the front discs get 3 K/s hotter."""
THERMOCOUPLES = range(0x6A0, 0x6A4)


def missing(reason: str) -> NoReturn:
    """Skip for *reason*; in the rig, which has everything, fail."""
    if os.environ.get("BSTM_RIG") == "required":
        pytest.fail(f"in the rig: {reason}")
    pytest.skip(reason)


def interface(name: str) -> str:
    """Return *name* of an interface that is there and up."""
    flags = Path("/sys/class/net", name, "flags")
    if not flags.exists():
        missing(f"no interface {name}")
    if not int(flags.read_text(), 16) & IFF_UP:
        missing(f"{name} is down")
    return name


@pytest.fixture
def vcan0() -> str:
    """Return the name of the first interface."""
    return interface("vcan0")


@pytest.fixture
def vcan1() -> str:
    """Return the name of the second interface."""
    return interface("vcan1")


@pytest.fixture
def net_admin() -> None:
    """Demand the right to set interfaces up and down."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    effective = int(status.partition("CapEff:")[2].split()[0], 16)
    if not effective >> CAP_NET_ADMIN & 1:
        missing("needs CAP_NET_ADMIN")


@pytest.fixture
def own_clock() -> Iterator[None]:
    """Allow the test to step the wall clock, and set it right again."""
    if os.environ.get("BSTM_RIG") != "required":
        pytest.skip("steps the wall clock: in the rig only")
    boot_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME)
    wall_ns = time.clock_gettime_ns(time.CLOCK_REALTIME)
    yield
    passed_ns = time.clock_gettime_ns(time.CLOCK_BOOTTIME) - boot_ns
    time.clock_settime_ns(time.CLOCK_REALTIME, wall_ns + passed_ns)


@pytest.fixture
def program() -> Callable[[str], str]:
    """Return what finds a program of can-utils or iproute2."""

    def find(name: str) -> str:
        found = shutil.which(name)
        if not found:
            missing(f"no {name}: apt install can-utils iproute2")
        return found

    return find


@pytest.fixture
def candump(program: Callable[[str], str]) -> Iterator[Recorder]:
    """Return what starts ``candump`` and waits until it listens.

    Its arguments are candump's; standard output is a pipe of text.
    """
    path = program("candump")
    with contextlib.ExitStack() as running:

        def start(*arguments: str) -> subprocess.Popen[str]:
            before = receivers()
            process = subprocess.Popen(
                [path, *arguments], stdout=subprocess.PIPE, text=True
            )
            running.callback(stop, process)
            wait_until(
                lambda: receivers() > before or process.poll() is not None,
                f"candump {arguments} listens",
            )
            return process

        yield start


def stop(process: subprocess.Popen[str]) -> None:
    """End *process* and close its pipe."""
    process.terminate()
    process.communicate(timeout=DEADLINE_S)


def receivers() -> int:
    """Return how many receivers raw sockets have registered."""
    lists = Path("/proc/net/can").glob("rcvlist_*")
    return sum(
        line.endswith(" raw")
        for path in lists
        for line in path.read_text(encoding="ascii").splitlines()
    )


def wait_until(reached: Callable[[], bool], what: str) -> None:
    """Return once *reached* holds; fail with *what* if it never does."""
    deadline_s = time.monotonic() + DEADLINE_S
    while not reached():
        if time.monotonic() > deadline_s:
            pytest.fail(f"never: {what}")
        time.sleep(0.005)


class Sent(NamedTuple):
    """A frame of the car; ``boot_us`` is just before it was sent."""

    boot_us: int
    bus: int
    can_id: int
    data: bytes


class Heard(NamedTuple):
    """A frame on the bus, stamped by the kernel [ns of wall time]."""

    stamp_ns: int
    can_id: int
    data: bytes


class Car:
    """A car on a descent, its frames sent when they are due.

    ``buses`` are interfaces; ``places`` says of an id which of them it is
    sent on, by default the first. ``alter`` makes of one frame those that
    are really sent. While ``silent`` nothing is.
    """

    def __init__(
        self, buses: list[str], places: Mapping[int, int] | None = None
    ) -> None:
        self.silent = False
        self.alter: Callable[[int, bytes], Iterable[tuple[int, bytes]]] = (
            lambda can_id, data: [(can_id, data)]
        )
        self.sent: list[Sent] = []
        self.refused = 0
        """Frames that the interface did not take."""
        self._places = places or {}
        self._buses = buses
        self._sockets = [sender(bus) for bus in buses]
        self._frames = descent()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._drive)
        self._thread.start()

    def close(self) -> None:
        """Stop the car."""
        self._over.set()
        self._thread.join()
        for raw in self._sockets:
            raw.close()

    def _drive(self) -> None:
        start_s = time.monotonic()
        turn_us = 0
        while True:
            for offset_us, can_id, data in self._frames:
                due_s = start_s + (turn_us + offset_us) * 1e-6
                if self._over.wait(max(due_s - time.monotonic(), 0.0)):
                    return
                for frame in self.alter(can_id, data):
                    if not self.silent:
                        self._send(*frame)
            turn_us += PERIOD_US

    def _send(self, can_id: int, data: bytes) -> None:
        bus = self._places.get(can_id, 0)
        made = Sent(boot_clock_ns() // 1000, bus, can_id, data)
        try:
            self._sockets[bus].send(CLASSIC.pack(can_id, len(data), data))
        except OSError as error:
            self.refused += 1
            if error.errno in {errno.ENODEV, errno.ENXIO}:
                with contextlib.suppress(OSError):
                    fresh = sender(self._buses[bus])
                    self._sockets[bus].close()
                    self._sockets[bus] = fresh
        else:
            self.sent.append(made)


class Ear:
    """Hears what is sent on an interface; of errors and remotes nothing."""

    def __init__(self, interface: str, low_id: int, high_id: int) -> None:
        self.frames: list[Heard] = []
        self._changed = threading.Condition()
        self._over = False
        self._ids = range(low_id, high_id)
        self._raw = socket.socket(
            socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW
        )
        self._raw.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self._raw.settimeout(0.1)
        self._raw.bind((interface,))
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def wait(
        self, count: int, can_id: int | None = None, since: int = 0
    ) -> list[Heard]:
        """Return frames *since* that index once *count* of the id came."""

        def found() -> list[Heard]:
            return [
                frame
                for frame in self.frames[since:]
                if can_id in {None, frame.can_id}
            ]

        with self._changed:
            if not self._changed.wait_for(
                lambda: len(found()) >= count, DEADLINE_S
            ):
                pytest.fail(f"only {len(found())} of {count} frames came")
            return found()

    def close(self) -> None:
        """Stop listening."""
        self._over = True
        self._thread.join()
        self._raw.close()

    def _listen(self) -> None:
        while not self._over:
            try:
                message, ancillary, _, _ = self._raw.recvmsg(
                    CLASSIC.size, socket.CMSG_SPACE(TIMESPEC.size)
                )
            except TimeoutError:
                continue
            except OSError:  # the interface went; a test that waits fails
                time.sleep(0.01)
                continue
            word, length, data = CLASSIC.unpack(message)
            if word not in self._ids:
                continue
            seconds, nanoseconds = TIMESPEC.unpack(ancillary[0][2])
            stamp_ns = seconds * 10**9 + nanoseconds
            with self._changed:
                self.frames.append(Heard(stamp_ns, word, data[:length]))
                self._changed.notify_all()


@dataclass
class Daemon:
    """``bstm run`` as a process of its own, and what it said so far."""

    process: subprocess.Popen[str]
    notify: socket.socket
    config: Path
    state: Path
    metrics_file: Path
    events: list[dict[str, Any]] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    other_lines: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Begin to hear it."""
        self._changed = threading.Condition()
        self._readers = [
            threading.Thread(target=self._read_log),
            threading.Thread(target=self._read_notices),
        ]
        self._ended = False
        for reader in self._readers:
            reader.start()

    def event(
        self, name: str, since: int = 0, **fields: Any
    ) -> dict[str, Any]:
        """Wait for the first event *name* with *fields*, and return it.

        *since* is an index of ``events``.
        """

        def found() -> dict[str, Any] | None:
            for event in self.events[since:]:
                if event["event"] == name and fields.items() <= event.items():
                    return event
            return None

        self._wait(lambda: found() is not None, f"event {name} {fields}")
        event = found()
        assert event is not None
        return event

    def said(self, name: str) -> list[dict[str, Any]]:
        """Return the events *name* so far."""
        return [event for event in self.events if event["event"] == name]

    def notice(self, pattern: str, since: int = 0) -> str:
        """Wait for a notification that *pattern* is found in; return it."""

        def found() -> str | None:
            for text in self.notices[since:]:
                if re.search(pattern, text):
                    return text
            return None

        self._wait(lambda: found() is not None, f"notification {pattern}")
        text = found()
        assert text is not None
        return text

    def metric(self, series: str, reached: Callable[[float], bool]) -> float:
        """Wait until *series* has a value that is *reached*; return it."""
        values: list[float] = []

        def good() -> bool:
            values[:] = self._metric(series)
            return bool(values) and reached(values[0])

        wait_until(good, f"{series}, now {values}")
        return values[0]

    def document(self) -> dict[str, Any]:
        """Return what the state file holds, which must be whole."""
        loaded = read(self.state)
        assert loaded.problem is None
        assert loaded.document is not None
        return loaded.document

    def end(self, number: int = signal.SIGTERM) -> int:
        """Send signal *number* and return the exit code."""
        self.process.send_signal(number)
        return self.exit_code()

    def exit_code(self) -> int:
        """Wait for the process to end by itself; return the exit code."""
        code = self.process.wait(DEADLINE_S)
        self._ended = True
        for reader in self._readers:
            reader.join()
        return code

    def close(self) -> None:
        """End it, whatever became of it."""
        if self.process.poll() is None:
            self.process.kill()
        self.exit_code()
        self.notify.close()
        assert self.process.stderr is not None
        self.process.stderr.close()

    def _wait(self, reached: Callable[[], bool], what: str) -> None:
        with self._changed:
            self._changed.wait_for(
                lambda: reached() or self._ended_early(), DEADLINE_S
            )
            if not reached():
                code = self.process.poll()
                said = [*self.events, *self.notices, *self.other_lines]
                text = "\n".join(map(str, said))
                pytest.fail(f"never: {what}; exit code {code}; said:\n{text}")

    def _ended_early(self) -> bool:
        return not self._readers[0].is_alive()

    def _read_log(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            with self._changed:
                try:
                    self.events.append(
                        json.loads(line, parse_constant=no_constant)
                    )
                except ValueError:
                    self.other_lines.append(line)
                self._changed.notify_all()
        with self._changed:
            self._changed.notify_all()

    def _read_notices(self) -> None:
        while True:
            try:
                text = self.notify.recv(4096).decode()
            except TimeoutError:
                if self._ended:
                    return
                continue
            with self._changed:
                self.notices.append(text)
                self._changed.notify_all()

    def _metric(self, series: str) -> list[float]:
        try:
            text = self.metrics_file.read_text(encoding="utf-8")
        except OSError:
            return []
        return [
            float(line.rpartition(" ")[2])
            for line in text.splitlines()
            if line.rpartition(" ")[0] == series
        ]


def no_constant(text: str) -> NoReturn:
    """Refuse NaN and infinities, which JSON has not."""
    raise ValueError(text)


def sender(interface: str) -> socket.socket:
    """Return a socket that sends on *interface* and receives nothing."""
    raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
    try:
        raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
        raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        raw.bind((interface,))
    except OSError:
        raw.close()
        raise
    return raw


def descent() -> list[tuple[int, int, bytes]]:
    """Return (time in the period [us], id, data) of a car's frames."""
    streams = Encoder(ROOT / "dbc" / "example_vehicle.dbc").streams(
        simulate(parse_drive(DRIVE, "hold"))
    )
    return sorted(
        (stamp_us - SETTLED_US, stream.frame_id, payload.to_bytes(8, "little"))
        for stream in streams
        if stream.frame_id not in THERMOCOUPLES
        for stamp_us, payload in zip(
            stream.stamp_us.tolist(), stream.payload.tolist(), strict=True
        )
        if SETTLED_US <= stamp_us < SETTLED_US + PERIOD_US
    )


def configured(changes: Mapping[str, Any]) -> str:
    """Return the example car's configuration on vcan0 with *changes*.

    Their keys are ``section.key``; a key that is a comment in the example
    may be changed too.
    """
    text = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
    settings = {
        "bus.channel": "vcan0",
        "bus.dbc": str(ROOT / "dbc" / "example_vehicle.dbc"),
        "publish.enabled": True,
        "daemon.reopen_s": 0.1,
        "metrics.interval_s": 0.5,
        **changes,
    }
    for name, value in settings.items():
        section, _, key = name.rpartition(".")
        pattern = (
            rf"(?ms)(^\[\[?{re.escape(section)}\]\]?$(?:(?!^\[).)*?)"
            rf"^(?:# )?{key} = [^\n]*"
        )
        line = f"{key} = {json.dumps(value)}"
        text, count = re.subn(
            pattern, lambda found, line=line: found[1] + line, text, count=1
        )
        assert count, f"no {name} in the example"
    return text


@pytest.fixture
def car(vcan0: str) -> Iterator[Callable[..., Car]]:
    """Return what sends a car off, by default on vcan0."""
    with contextlib.ExitStack() as cars:

        def start(*buses: str, places: Mapping[int, int] | None = None) -> Car:
            made = Car(list(buses) or [vcan0], places)
            cars.callback(made.close)
            return made

        yield start


@pytest.fixture
def ear() -> Iterator[Callable[..., Ear]]:
    """Return what listens on an interface, by default for our frames."""
    with contextlib.ExitStack() as ears:

        def listen(
            interface: str, low_id: int = ID_BASE, high_id: int = ID_BASE + 20
        ) -> Ear:
            made = Ear(interface, low_id, high_id)
            ears.callback(made.close)
            return made

        yield listen


@pytest.fixture
def daemon(tmp_path: Path, vcan0: str) -> Iterator[Callable[..., Daemon]]:
    """Return what starts ``bstm run`` and waits until it is ready.

    Its arguments: changes of the example's configuration by ``section.key``;
    ``more`` is text added to it, ``edit`` a function of the whole text;
    ``state`` the state file, ``folder`` that of all files; ``arguments`` are
    further ones of the command line. With ``ready=False`` nothing is waited
    for.
    """
    # asammdf, which python-can imports where it is, takes a second to load
    hidden = tmp_path / "hidden"
    hidden.mkdir()
    (hidden / "asammdf.py").write_text("raise ImportError\n", "utf-8")
    with contextlib.ExitStack() as daemons:

        def start(
            changes: Mapping[str, Any] | None = None,
            *,
            more: str = "",
            edit: Callable[[str], str] = str,
            state: Path | None = None,
            arguments: Iterable[str] = (),
            ready: bool = True,
        ) -> Daemon:
            number = len(list(tmp_path.glob("daemon*")))
            folder = tmp_path / f"daemon{number}"
            folder.mkdir()
            config = folder / "car.toml"
            metrics_file = folder / "bstm.prom"
            settings = {"metrics.file": str(metrics_file), **(changes or {})}
            config.write_text(edit(configured(settings)) + more, "utf-8")
            state = state or folder / "car.state"
            notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
            notify.settimeout(0.1)
            notify.bind(str(folder / "notify"))
            paths = f"{hidden}:{ROOT}:{os.environ.get('PYTHONPATH', '')}"
            made = Daemon(
                subprocess.Popen(
                    [
                        *(sys.executable, "-m", "bstm_daemon.cli.main"),
                        *("run", "-c", str(config), "--state", str(state)),
                        *arguments,
                    ],
                    stderr=subprocess.PIPE,
                    text=True,
                    env={
                        **os.environ,
                        "PYTHONPATH": paths,
                        "NOTIFY_SOCKET": str(folder / "notify"),
                    },
                ),
                notify,
                config,
                state,
                metrics_file,
            )
            daemons.callback(made.close)
            if ready:
                made.notice("READY=1")
            return made

        yield start


@pytest.fixture
def ip(
    net_admin: None, program: Callable[[str], str], vcan0: str
) -> Iterator[Callable[..., None]]:
    """Return ``ip link``; afterwards the interfaces are as before."""
    path = program("ip")

    def run(*arguments: str, check: bool = True) -> None:
        subprocess.run(
            [path, "link", *arguments], check=check, capture_output=not check
        )

    yield run
    run("set", vcan0, "up")
    run("delete", "vcan9", check=False)


@pytest.fixture
def marched() -> Callable[..., dict[str, dict[str, float]]]:
    """Return what gives the temperatures that frames lead to.

    Frames carry their time since boot, which no step of the wall clock
    moves: the result is that of a drive without one, at the time of a saved
    *document*.
    """

    def march(
        config: Path, sent: Iterable[Sent], document: Mapping[str, Any]
    ) -> dict[str, dict[str, float]]:
        engine = build_monitor(config, BusOverride()).engine
        until_us = document["time_us"]
        # as on the axis of the service, for the same grid
        shift_us = until_us - document["boot_us"]
        for frame in sent:
            stamp_us = frame.boot_us + shift_us
            if stamp_us <= until_us:
                engine.frame(
                    frame.bus, frame.can_id, False, frame.data, stamp_us
                )
        engine.tick(until_us)
        corners: dict[str, dict[str, float]] = engine.export_state()["corners"]
        return corners

    return march
