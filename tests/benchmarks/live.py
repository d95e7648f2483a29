"""The live service on paced traffic: CPU, latency, memory, start.

Every part is a program of its own, so that its CPU time and memory are only
its own: the sender of the frames, python-can's reader, our reader, the whole
daemon.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any, Final
from unittest import mock

from live_link import pair
from live_sender import pack_frames
from side_by_side import LOADED, Goal, Outcome, Table
from traffic import RATES_HZ, write_traffic

from bstm_daemon.bus.live.receiver import FrameReceiver
from bstm_daemon.bus.output.layout import TEN_HERTZ_US
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.engine import Engine
from bstm_daemon.estimator.estimator import STEP_US
from bstm_daemon.files import shipped_file
from bstm_daemon.native.loader import VARIABLE

if TYPE_CHECKING:
    from bstm_daemon.bus.live.link import Frame

EXAMPLE: Final = "config/example_vehicle.toml"
FRAMES_PER_S: Final = 4000
PERIOD_S: Final = 60
"""Length of the traffic, which then begins again."""
SETTLING_S: Final = 3.0
"""After the start, not measured."""

CPU_SHARE: Final = 0.04
"""With heat, risk and forecast; without them it would be 0.03."""
LATENCY_S: Final = 0.015
MEMORY_BYTES: Final = 60 * 2**20
READY_S: Final = 1.0
STEP_ADDITIONS: Final = 80_000
"""What a pure-Python step may cost, in additions of a Python loop."""
HERE: Final = Path(__file__).parent
_TICKS_PER_S: Final = os.sysconf("SC_CLK_TCK")


def run(*, full: bool) -> Outcome:
    """Measure receive path, daemon and the pure-Python step."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        frames = write_frames(folder)
        rounds = [
            receive(frames, 20.0 if full else 6.0)
            for _ in range(5 if full else 3)
        ]
        starts = [
            start_time_s(folder / f"start{n}") for n in range(9 if full else 3)
        ]
        daemon = whole_daemon(
            folder / "daemon", frames, 120.0 if full else 12.0
        )
    steps = [
        (reference_step_s(), addition_s()) for _ in range(5 if full else 1)
    ]
    return outcome(rounds, starts, daemon, steps)


def write_frames(folder: Path) -> Path:
    """Write the traffic as the sender reads it."""
    config, signal_map = load_vehicle(shipped_file(EXAMPLE))
    log = folder / "traffic.log"
    write_traffic(log, PERIOD_S, config, FRAMES_PER_S)
    wanted = {can_id for can_id, _ in signal_map.wanted(0)}
    path = folder / "traffic.frames"
    path.write_bytes(pack_frames(log.read_bytes(), wanted))
    return path


# -- the receive path ------------------------------------------------------


@dataclass(frozen=True)
class Received:
    """CPU seconds per second of traffic."""

    peer: float
    ours: float
    filtered: float


def receive(frames: Path, seconds: float) -> Received:
    """Let all readers read the same frames at the same time.

    Raises:
        AssertionError: a reader has not all samples.
    """
    places = ("peer", "ours", "ours")
    with ExitStack() as opened:
        pairs = [[opened.enter_context(end) for end in pair()] for _ in places]
        readers = [
            program("live_receiver.py", who, fd, seconds, pass_fds=[fd])
            for who, (_, far) in zip(places, pairs, strict=True)
            for fd in (far.fileno(),)
        ]
        for _, far in pairs:
            far.close()
        near = [ends[0].fileno() for ends in pairs]
        sender = program(
            "live_sender.py",
            frames,
            seconds + 1.0,
            *near[:2],
            f"{near[2]}w",
            pass_fds=near,
        )
        for reader in readers:
            assert reader.stdout is not None
            assert reader.stdout.readline() == "ready\n"
        begin(sender)
        time.sleep(0.2)
        for reader in readers:
            begin(reader)
        told = [json.loads(finish(reader)) for reader in readers]
        finish(sender)
    samples = [one["samples"] for one in told]
    least = min(samples)
    # begun one after the other: they differ by what came meanwhile
    assert max(samples) - least < 0.05 * least, samples
    return Received(*(one["cpu_s"] / seconds for one in told))


# -- the whole daemon ------------------------------------------------------


@dataclass
class Measured:
    """What was measured of the daemon."""

    cpu_share: float
    resident_bytes: int
    peak_bytes: int
    sent: int
    late_s: float
    latencies_s: list[float] = field(default_factory=list)

    @property
    def lost(self) -> int:
        """Publications that never came."""
        return self.latencies_s.count(inf)

    def latency_s(self, share: float) -> float:
        """Return the latency that *share* of the frames do not exceed."""
        ordered = sorted(self.latencies_s)
        return ordered[min(int(share * len(ordered)), len(ordered) - 1)]


class Daemon:
    """A running daemon and what the service manager sees of it."""

    def __init__(self, folder: Path, far: socket.socket) -> None:
        """Start it on *far*, with its files in *folder*."""
        folder.mkdir()
        config = folder / "config" / "car.toml"
        config.parent.mkdir()
        shutil.copytree(
            shipped_file(EXAMPLE).parents[1] / "dbc", folder / "dbc"
        )
        text = shipped_file(EXAMPLE).read_text("utf-8")
        head, section, rest = text.partition("[publish]")
        assert section
        rest = rest.replace("enabled = false", "enabled = true", 1)
        config.write_text(head + section + rest, "utf-8")
        address = folder / "notify"
        self.notices = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.notices.bind(str(address))
        self.notices.settimeout(60.0)
        self.log = folder / "log"
        self._begin_s = time.monotonic()
        with self.log.open("wb") as log:
            self.process = program(
                "live_daemon.py",
                far.fileno(),
                *("-c", config, "--state", folder / "state"),
                pass_fds=[far.fileno()],
                stderr=log,
                env=os.environ
                | {
                    "NOTIFY_SOCKET": str(address),
                    "WATCHDOG_USEC": "10000000",
                    "RUNTIME_DIRECTORY": str(folder),
                    VARIABLE: "compiled",
                },
            )

    def ready(self) -> float:
        """Wait until it is ready; return the seconds since its start."""
        while b"READY=1" not in self.notices.recv(4096).split(b"\n"):
            pass
        return time.monotonic() - self._begin_s

    def cpu_s(self) -> float:
        """Return user and system time so far."""
        stat = Path(f"/proc/{self.process.pid}/stat").read_text("ascii")
        fields = stat.rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / _TICKS_PER_S

    def memory_bytes(self, name: str) -> int:
        """Return the line *name* of its status."""
        status = Path(f"/proc/{self.process.pid}/status").read_text("ascii")
        found = re.search(rf"^{name}:\s*(\d+) kB$", status, re.MULTILINE)
        assert found is not None
        return int(found[1]) * 1024

    def hear(self) -> None:
        """Take what it told the service manager, as that would."""
        self.notices.setblocking(False)
        try:
            while self.notices.recv(4096):
                pass
        except BlockingIOError:
            pass

    def stop(self) -> None:
        """End it; it must end well, and have lost nothing that came."""
        self.process.send_signal(signal.SIGTERM)
        finish(self.process)
        self.notices.close()
        text = self.log.read_text("utf-8")
        unwelcome = re.findall(r".*(?:dropped|failed|Error).*", text)
        assert not unwelcome, unwelcome


def start_time_s(folder: Path) -> float:
    """Return the seconds from the start of the process to READY=1."""
    near, far = pair()
    with near, far:
        daemon = Daemon(folder, far)
        ready_s = daemon.ready()
        daemon.stop()
    return ready_s


def whole_daemon(folder: Path, frames: Path, seconds: float) -> Measured:
    """Run the daemon on the wanted frames.

    Raises:
        AssertionError: the daemon complained.
    """
    near, far = pair()
    with near, far:
        daemon = Daemon(folder, far)
        receiver = FrameReceiver(near, Counter())
        daemon.ready()
        sender = program(
            "live_sender.py",
            frames,
            seconds + SETTLING_S + 1.0,
            f"{near.fileno()}w",
            pass_fds=[near.fileno()],
        )
        begin(sender)
        published: list[Frame] = []
        _collect(receiver, daemon, published, SETTLING_S)
        published.clear()
        before_s, begin_s = daemon.cpu_s(), time.monotonic()
        _collect(receiver, daemon, published, seconds)
        spent_s = daemon.cpu_s() - before_s
        share = spent_s / (time.monotonic() - begin_s)
        found = Measured(
            share,
            daemon.memory_bytes("VmRSS"),
            daemon.memory_bytes("VmHWM"),
            *_told(finish(sender)),
        )
        daemon.stop()
    found.latencies_s = latencies(published)
    return found


def _collect(
    receiver: FrameReceiver,
    daemon: Daemon,
    published: list[Frame],
    seconds: float,
) -> None:
    end_s = time.monotonic() + seconds
    while (left_s := end_s - time.monotonic()) > 0.0:
        time.sleep(min(left_s, 0.5))
        receiver.receive(published)
        daemon.hear()


def _told(line: str) -> tuple[int, float]:
    sent, late_s = line.split()
    return int(sent), float(late_s)


def latencies(published: list[Frame]) -> list[float]:
    """Return the time from each publication's grid line to its frames.

    The stamps are the kernel's, of the arrival in our socket. The frame that
    completes the step is stamped at the line or later: from it to the
    publication it is less. One that never came, as after a stall of more than
    100 ms, is infinitely late.
    """
    by_id: dict[int, list[int]] = {}
    for frame in published:
        by_id.setdefault(frame.can_id, []).append(frame.stamp_ns // 1000)
    most = max(map(len, by_id.values()))
    # the others are those sent once a second
    cycles = [one for one in by_id.values() if len(one) > most / 2]
    assert len(cycles) == 6, sorted(by_id)
    found = []
    for stamps_us in cycles:
        lines = [stamp_us // TEN_HERTZ_US for stamp_us in stamps_us]
        assert lines == list(range(lines[0], lines[0] + len(lines)))
        found += [(stamp_us % TEN_HERTZ_US) * 1e-6 for stamp_us in stamps_us]
    return found


# -- the pure-Python step --------------------------------------------------


def reference_step_s(seconds: int = PERIOD_S) -> float:
    """Return the CPU time of a step of four corners with its samples."""
    with mock.patch.dict(os.environ, {VARIABLE: "reference"}):
        config, signal_map = load_vehicle(shipped_file(EXAMPLE))
        engine = Engine(config, signal_map)
    assert not engine.estimator.compiled
    assert len(engine.estimator.programs) == 4
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "wanted.log"
        write_traffic(path, seconds, config, sum(RATES_HZ.values()))
        samples = _by_step(engine, path)
    begin_s = time.process_time()
    for times_us, roles, values in samples:
        engine.estimator.advance(times_us, roles, values)
    return (time.process_time() - begin_s) / len(samples)


def addition_s(count: int = 2_000_000) -> float:
    """Return the CPU time of an addition in a loop: how fast Python is."""
    total = 0.0
    begin_s = time.process_time()
    for _ in range(count):
        total += 0.5
    return (time.process_time() - begin_s) / count


def _by_step(engine: Engine, path: Path) -> list[tuple[Any, Any, Any]]:
    """Return the samples of the log *path*, split at the grid lines."""
    found: dict[int, tuple[list[int], list[int], list[float]]] = {}
    for line in path.read_text("ascii").splitlines():
        stamp, _, frame = line.split()
        can_id, _, text = frame.partition("#")
        stamp_us = int(stamp[1:-1].replace(".", ""))
        step = found.setdefault(stamp_us // STEP_US, ([], [], []))
        times_us, roles, values = step
        for role, value in engine.decoder.decode(
            0, int(can_id, 16), False, bytes.fromhex(text)
        ):
            times_us.append(stamp_us)
            roles.append(role)
            values.append(value)
    return list(found.values())


# -- what all parts need ---------------------------------------------------


def program(name: str, *arguments: object, **options: Any) -> Any:
    """Start a program of this folder."""
    return subprocess.Popen(
        [sys.executable, str(HERE / name), *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        **options,
    )


def begin(process: subprocess.Popen[str]) -> None:
    """Let *process*, which waits, begin."""
    assert process.stdin is not None
    process.stdin.write("go\n")
    process.stdin.flush()


def finish(process: subprocess.Popen[str]) -> str:
    """Wait for the end of *process*; return what it wrote."""
    text, _ = process.communicate(timeout=100)
    assert process.returncode == 0, process.args
    return text


def outcome(
    rounds: list[Received],
    starts: list[float],
    daemon: Measured,
    steps: list[tuple[float, float]],
) -> Outcome:
    """Return the figures beside their goals."""
    found = Outcome(
        "Live service",
        f"{FRAMES_PER_S} frames a second, {sum(RATES_HZ.values())} of them of "
        "the example car, over a socket pair with kernel stamps, read by the "
        "code for SocketCAN. Receive path: from the socket to decoded "
        "samples, no step marched; beside it at the same time python-can's "
        "Notifier, with a listener that decodes the wanted ids by cantools. "
        "With filters only the wanted frames arrive; python-can's figure "
        "stays that without. Daemon: `bstm run` with 4 corners, compiled, "
        "publishing, with state file, metrics file and watchdog, filtered, "
        "extras hidden. Latency: from the grid line that ends a step to the "
        "published frame in the receiver's socket, with the 2 ms that late "
        "frames are waited for. Pure-Python step: pass over the samples and "
        "march of 4 corners.",
    )
    found.goals = [
        Goal(
            "receive path without filters: python-can's CPU over ours",
            median(one.peer / one.ours for one in rounds),
            4.0,
            0.2,
        ),
        Goal(
            "receive path with filters: python-can's CPU without over ours",
            median(one.peer / one.filtered for one in rounds),
            20.0,
            # on an idle computer most of it is the waking up, 20 a second
            0.5,
        ),
        Goal(
            f"daemon: {CPU_SHARE * 100:.0f} % of a core over its CPU",
            CPU_SHARE / daemon.cpu_share,
            1.0,
            LOADED,
        ),
        Goal(
            "daemon: 15 ms over latency p99",
            LATENCY_S / daemon.latency_s(0.99),
            1.0,
            LOADED,
        ),
        Goal(
            "daemon: 60 MiB over peak memory",
            MEMORY_BYTES / daemon.peak_bytes,
            1.0,
            0.0,
        ),
        Goal(
            "daemon: 1 s over start to READY=1",
            READY_S / median(starts),
            1.0,
            LOADED,
        ),
        Goal(
            f"pure Python: {STEP_ADDITIONS} additions over a step of 4 "
            "corners",
            STEP_ADDITIONS / median(step_s / own_s for step_s, own_s in steps),
            1.0,
            LOADED,
        ),
    ]
    found.tables = [
        Table(
            "CPU of the receive path",
            ("reader", "frames/s arriving", "of a core", "us/frame"),
            tuple(
                (
                    text,
                    str(rate),
                    f"{cpu:.2%}",
                    f"{cpu / rate * 1e6:.1f}",
                )
                for text, rate, cpu in (
                    (
                        "python-can, cantools",
                        FRAMES_PER_S,
                        median(one.peer for one in rounds),
                    ),
                    (
                        "ours",
                        FRAMES_PER_S,
                        median(one.ours for one in rounds),
                    ),
                    (
                        "ours, filtered",
                        sum(RATES_HZ.values()),
                        median(one.filtered for one in rounds),
                    ),
                )
            ),
        ),
        Table(
            "The daemon and the step",
            ("figure", "measured", "goal"),
            (
                ("CPU", f"{daemon.cpu_share:.2%}", f"{CPU_SHARE:.0%}"),
                *(
                    (
                        f"latency {text}, ms",
                        f"{daemon.latency_s(share) * 1e3:.2f}",
                        goal,
                    )
                    for text, share, goal in (
                        ("p50", 0.5, ""),
                        ("p99", 0.99, "15"),
                    )
                ),
                (
                    "publications that never came",
                    f"{daemon.lost} of {len(daemon.latencies_s)}",
                    "",
                ),
                (
                    "resident memory, MiB",
                    f"{daemon.resident_bytes / 2**20:.1f}",
                    "60",
                ),
                ("peak of it, MiB", f"{daemon.peak_bytes / 2**20:.1f}", "60"),
                ("start to READY=1, s", f"{median(starts):.2f}", "1"),
                (
                    "step of 4 corners in pure Python, ms",
                    f"{median(step_s for step_s, _ in steps) * 1e3:.3f}",
                    "-",
                ),
            ),
        ),
    ]
    return found
