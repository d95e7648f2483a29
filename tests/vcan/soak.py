"""Hours of the daemon on vcan0: ``soak.py prepare|run FILE``.

``prepare`` writes the frames of the simulated drive *long-run*, each id at
most ten times a second. ``run`` starts ``bstm run``, sends them when they are
due and hears what is published, for ``--seconds``. Exit code 1 and the reasons
unless every publication came in order, memory stayed flat, the service had
nothing to complain of and the state was saved. Made for virtual time
(``tests/rig/vcan_run.py --virtual-time``), where two hours take minutes.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.output.e2e import CheckStatus
from bstm_daemon.bus.output.layout import (
    ADVICE_OFFSET,
    CORNERS,
    own_ids,
    published_frames,
)
from bstm_daemon.bus.output.published import PublishedDecoder
from bstm_daemon.files import shipped_file
from bstm_daemon.service.state_file import read

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

DRIVE: Final = "long-run"
INTERVAL_US: Final = 95_000
"""Least time between two frames of an id."""
NOT_SENT: Final = range(0x6A0, 0x6A4)
"""Thermocouples, which the estimator does not read."""
INTERFACE: Final = "vcan0"
ID_BASE: Final = 0x5B0
SECONDS: Final = 7200.0
SETTLING_S: Final = 60.0
"""Inputs may be missing and memory grow for so long after the start."""
GROWTH_BYTES: Final = 2**20
"""Most growth of resident memory from a tenth of the time to the end."""
UNSAVED_S: Final = 310.0
"""Greatest age of the state while the service runs."""

_CLASSIC: Final = struct.Struct("=IB3x8s")
_TIMESPEC: Final = struct.Struct("@qq")
_SO_TIMESTAMPNS: Final = 35
_LINE: Final = re.compile(r"\((\d+)\.(\d{6})\) \S+ ([0-9A-F]{3})#([0-9A-F]*)")


def prepare(path: Path) -> None:
    """Write the thinned frames of the drive to *path*, candump text."""
    # of the whole project only this part needs NumPy
    from bstm_daemon.simulation import load_drive, simulate  # noqa: PLC0415
    from bstm_daemon.simulation.recorder import (  # noqa: PLC0415
        Encoder,
        write_candump,
    )

    whole = path.with_suffix(".whole")
    encoder = Encoder(shipped_file("dbc/example_vehicle.dbc"))
    write_candump(whole, simulate(load_drive(DRIVE)), encoder)
    last: dict[int, int] = {}
    with whole.open(encoding="ascii") as lines, path.open("w") as out:
        for line in lines:
            ((stamp_us, can_id, _),) = _frames([line])
            if can_id in NOT_SENT:
                continue
            if stamp_us - last.get(can_id, 0) >= INTERVAL_US:
                last[can_id] = stamp_us
                out.write(line)
    whole.unlink()


def _frames(lines: Iterable[str]) -> Iterator[tuple[int, int, bytes]]:
    for line in lines:
        found = _LINE.match(line)
        assert found is not None
        seconds, micros, word, data = found.groups()
        stamp_us = int(seconds) * 1_000_000 + int(micros)
        yield stamp_us, int(word, 16), bytes.fromhex(data)


class Ear:
    """Hears the daemon's frames, each in its order."""

    def __init__(self) -> None:
        self._raw = socket.socket(
            socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW
        )
        self._raw.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        filters = b"".join(
            struct.pack("=II", own_id, 0x7FF)
            for own_id in own_ids(ID_BASE, CORNERS)
        )
        self._raw.setsockopt(
            socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters
        )
        self._raw.setblocking(False)
        self._raw.bind((INTERFACE,))
        self._decoder = PublishedDecoder(ID_BASE)
        self.stamps_us: dict[str, tuple[int, int, int]] = {}
        """First stamp, last stamp and number of frames by name."""
        self.faults: list[str] = []

    def listen(self) -> None:
        """Take what came."""
        while True:
            try:
                message, ancillary, _, _ = self._raw.recvmsg(
                    _CLASSIC.size, socket.CMSG_SPACE(_TIMESPEC.size)
                )
            except BlockingIOError:
                return
            can_id, length, data = _CLASSIC.unpack(message)
            seconds, nanoseconds = _TIMESPEC.unpack(ancillary[0][2])
            stamp_us = seconds * 1_000_000 + nanoseconds // 1000
            self._hear(stamp_us, can_id, data[:length])

    def _hear(self, stamp_us: int, can_id: int, data: bytes) -> None:
        found = self._decoder.decode(can_id, data)
        if found is None:
            self.faults.append(f"{stamp_us}: unknown id {can_id:X}")
            return
        name = found.layout.name
        first_us, _, count = self.stamps_us.get(name, (stamp_us, 0, 0))
        self.stamps_us[name] = first_us, stamp_us, count + 1
        if count and found.verdict is not CheckStatus.OK:
            self.faults.append(f"{stamp_us}: {name}: {found.verdict.name}")

    def missing(self) -> list[str]:
        """Return what is wrong with the number of frames."""
        problems = []
        for frame in published_frames(CORNERS):
            if frame.id_offset == ADVICE_OFFSET:
                continue  # needs a switch of its own
            first_us, last_us, count = self.stamps_us.get(
                frame.name, (0, 0, 0)
            )
            expected = round((last_us - first_us) / frame.cycle_us) + 1
            if count < 2 or count != expected:
                problems.append(f"{frame.name}: {count} of {expected}")
        return problems


@dataclass
class Soak:
    """The daemon and what was seen of it."""

    process: subprocess.Popen[bytes]
    folder: Path
    ear: Ear
    memory_bytes: list[tuple[float, int]] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)

    def look(self, elapsed_s: float) -> None:
        """Note memory and the age of the state."""
        status = Path(f"/proc/{self.process.pid}/status").read_text("ascii")
        found = re.search(r"^VmRSS:\s*(\d+) kB$", status, re.MULTILINE)
        assert found is not None
        self.memory_bytes.append((elapsed_s, int(found[1]) * 1024))
        age_s = time.time() - (self.folder / "state").stat().st_mtime
        if age_s > UNSAVED_S:
            self.problems.append(f"{elapsed_s:.0f} s: state {age_s:.0f} s old")

    def judge(self, seconds: float) -> list[str]:
        """Return everything that is not as it has to be."""
        problems = self.problems + self.ear.faults[:20] + self.ear.missing()
        early = [
            memory
            for elapsed_s, memory in self.memory_bytes
            if elapsed_s <= max(seconds / 10, SETTLING_S)
        ]
        growth = self.memory_bytes[-1][1] - early[-1]
        if growth > GROWTH_BYTES:
            problems.append(f"memory grew by {growth} bytes")
        if self.process.returncode != 0:
            problems.append(f"exit code {self.process.returncode}")
        loaded = read(self.folder / "state")
        if loaded.document is None:
            problems.append(loaded.problem or "no state was saved")
        return problems + self._complaints()

    def _complaints(self) -> list[str]:
        """Return what the log says from warning on, but of the start."""
        lines = (self.folder / "log").read_text("utf-8").splitlines()
        events = []
        for line in lines:
            try:
                events.append(json.loads(line))
            except ValueError:
                return [f"in the log: {line}"]
        started = events[0]["timestamp"]
        return [
            json.dumps(event)
            for event in events
            if event["level"] not in ("debug", "info")
            and _seconds(event["timestamp"]) - _seconds(started) > SETTLING_S
        ]


def _seconds(stamp: str) -> float:
    date = time.strptime(stamp.partition(".")[0], "%Y-%m-%dT%H:%M:%S")
    return time.mktime(date)


def configuration(folder: Path) -> Path:
    """Write the example car to *folder*, on the interface, publishing."""
    source = shipped_file("config/example_vehicle.toml")
    (folder / "config").mkdir()
    shutil.copytree(source.parents[1] / "dbc", folder / "dbc")
    text = source.read_text("utf-8")
    head, section, rest = text.partition("[publish]")
    rest = rest.replace("enabled = false", "enabled = true", 1)
    text = head.replace('"can0"', f'"{INTERFACE}"') + section + rest
    path = folder / "config" / "car.toml"
    path.write_text(text, "utf-8")
    return path


def run(path: Path, seconds: float) -> list[str]:
    """Soak for *seconds*; returns all problems."""
    with (
        path.open(encoding="ascii") as lines,
        tempfile.TemporaryDirectory() as name,
    ):
        folder = Path(name)
        ear = Ear()
        raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"")
        raw.bind((INTERFACE,))
        with (folder / "log").open("wb") as log:
            command = (
                "import sys; from bstm_daemon.cli.main import main; "
                "sys.exit(main(sys.argv[1:]))"
            )
            process = subprocess.Popen(
                [
                    *(sys.executable, "-c", command, "run"),
                    *("-c", str(configuration(folder))),
                    *("--state", str(folder / "state")),
                ],
                stderr=log,
            )
        soak = Soak(process, folder, ear)
        try:
            _drive(raw, _frames(lines), seconds, soak)
            process.send_signal(signal.SIGTERM)
            process.wait(30)
        finally:
            process.kill()
            process.wait()
        sys.stdout.write(_told(soak))
        return soak.judge(seconds)


def _drive(
    raw: socket.socket,
    frames: Iterator[tuple[int, int, bytes]],
    seconds: float,
    soak: Soak,
) -> None:
    """Send *frames* when they are due; look at the daemon every minute."""
    start_us = next(frames)[0]
    # the state is saved at the start: then it listens
    while not (soak.folder / "state").exists():
        time.sleep(0.1)
        if soak.process.poll() is not None:
            return
    begin_s = time.monotonic()
    next_look_s = SETTLING_S
    for stamp_us, can_id, data in frames:
        due_s = (stamp_us - start_us) * 1e-6
        wait_s = begin_s + due_s - time.monotonic()
        if wait_s > 0.0:
            time.sleep(wait_s)
            soak.ear.listen()
        if due_s >= next_look_s:
            soak.look(due_s)
            next_look_s += 60.0
        if due_s > seconds or soak.process.poll() is not None:
            return
        raw.send(_CLASSIC.pack(can_id, len(data), data))


def _told(soak: Soak) -> str:
    counts = sum(count for _, _, count in soak.ear.stamps_us.values())
    (begin_s, first), (end_s, last) = (
        soak.memory_bytes[0],
        soak.memory_bytes[-1],
    )
    return (
        f"{counts} frames published; {first / 2**20:.1f} MiB after "
        f"{begin_s:.0f} s, {last / 2**20:.1f} MiB after {end_s:.0f} s\n"
    )


def main() -> int:
    """Do what the command line says."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("prepare", "run"))
    parser.add_argument("file", type=Path)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    args = parser.parse_args()
    if args.what == "prepare":
        prepare(args.file)
        return 0
    problems = run(args.file, args.seconds)
    sys.stdout.write("".join(f"{problem}\n" for problem in problems))
    return int(bool(problems))


if __name__ == "__main__":
    sys.exit(main())
