"""Peak memory at ten times the lines.

Each reading is a process of its own. The peak is ``VmHWM``, not
``ru_maxrss``: that one starts from the peak of the process that forked.
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from side_by_side import Goal, Outcome, Table
from traffic import FRAMES_PER_S, OTHER_IDS, write_traffic

from bstm_daemon.bus.opening import EventLog
from bstm_daemon.cli.main import main
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.files import shipped_file

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

TIMES: Final = 10
LIMIT: Final = 1.1
EXAMPLE: Final = "config/example_vehicle.toml"


def events(_: Config, signal_map: SignalMap, path: Path) -> int:
    """Read and decode."""
    log = EventLog(path, signal_map)
    samples = sum(len(one) for one in log.events())
    assert samples
    return log.reader.lines


def replay(_: Config, __: SignalMap, path: Path) -> int:
    """Replay as ``bstm replay LOG -c C -o DIR`` does: both tables."""
    return _replay_command(path)


def replay_report(_: Config, __: SignalMap, path: Path) -> int:
    """Replay with the HTML page besides."""
    return _replay_command(path, "--report", str(path.with_suffix(".html")))


def _replay_command(path: Path, *options: str) -> int:
    """Run the command on *path*; returns the lines of it."""
    out = path.with_suffix(".tables")
    config = str(shipped_file(EXAMPLE))
    code = main(["replay", str(path), "-c", config, "-o", str(out), *options])
    if code:
        msg = f"the replay ended with {code}"
        raise AssertionError(msg)
    with path.open("rb") as file:
        return sum(1 for _ in file)


READINGS: Final[dict[str, Callable[[Config, SignalMap, Path], int]]] = {
    one.__name__: one for one in (events, replay, replay_report)
}


@dataclass(frozen=True)
class Peak:
    """Lines read and the peak of resident memory."""

    lines: int
    bytes: int


def run(*, full: bool) -> Outcome:
    """Measure 1.08 and 10.8 million lines (quick: a third of it)."""
    config = load_vehicle(shipped_file(EXAMPLE))[0]
    seconds = 540 if full else 180
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "short.log"
        write_traffic(path, seconds, config)
        short = {reading: peak(reading, path) for reading in READINGS}
        dense = Path(name) / "dense.log"
        write_denser(path, dense)
        denser = {reading: peak(reading, dense) for reading in READINGS}
        dense.unlink()
        long = Path(name) / "long.log"
        write_traffic(long, TIMES * seconds, config)
        longer = {reading: peak(reading, long) for reading in READINGS}
    outcome = Outcome(
        "Memory",
        f"Peak resident memory of a process that reads a candump file of "
        f"{short['events'].lines / 1e6:.2f} million lines ({seconds} s, "
        f"{FRAMES_PER_S} frames a second), and {TIMES} times as many: as the "
        f"same drive on a bus with {TIMES} times the frames, and as a drive "
        f"{TIMES} times as long. A replay is `bstm replay LOG -c C -o DIR`: "
        "CSV, Parquet and the summary on screen.",
    )
    for reading, found, text in (
        ("events", longer, "reading and decoding, longer drive"),
        ("replay", denser, "replay, same drive"),
        ("replay", longer, "replay, longer drive"),
    ):
        growth = found[reading].bytes / short[reading].bytes
        outcome.goals.append(
            Goal(
                f"{text}: {LIMIT} against the growth of the peak",
                LIMIT / growth,
                at_least=1.0,
                tolerance=0.0,
            )
        )
    texts = {
        "events": "read and decode",
        "replay": "replay to CSV and Parquet",
        "replay_report": "replay with the HTML page",
    }
    outcome.tables = [
        Table(
            "Peak resident memory",
            (
                *("", f"{short['events'].lines / 1e6:.2f} M lines, MB"),
                *(f"{TIMES}x the frames, MB", "growth"),
                *(f"{TIMES}x the drive, MB", "growth"),
            ),
            tuple(
                (
                    text,
                    f"{short[reading].bytes / 1e6:.1f}",
                    *(
                        cell
                        for found in (denser[reading], longer[reading])
                        for cell in (
                            f"{found.bytes / 1e6:.1f}",
                            f"{found.bytes / short[reading].bytes:.3f}x",
                        )
                    ),
                )
                for reading, text in texts.items()
            ),
        )
    ]
    return outcome


def write_denser(path: Path, out: Path) -> None:
    """Write *path* with ``TIMES - 1`` unwanted frames behind each line."""
    ids = OTHER_IDS[: TIMES - 1]
    with path.open(encoding="ascii") as lines, out.open("w") as file:
        for line in lines:
            stamp = line[: line.index(" ")]
            file.write(line)
            file.writelines(
                f"{stamp} can0 {can_id:03X}#0011223344556677\n"
                for can_id in ids
            )


def peak(reading: str, path: Path) -> Peak:
    """Return the peak of *reading* over *path* in a process of its own."""
    done = subprocess.run(
        [sys.executable, __file__, reading, str(path)],
        check=True,
        capture_output=True,
        text=True,
    )
    lines, most = done.stdout.split()[-2:]
    return Peak(int(lines), int(most))


def read_here() -> None:
    """Read as the command line says; write lines and peak in bytes."""
    reading, path = sys.argv[1:]
    config, signal_map = load_vehicle(shipped_file(EXAMPLE))
    lines = READINGS[reading](config, signal_map, Path(path))
    status = Path("/proc/self/status").read_text("ascii")
    found = re.search(r"^VmHWM:\s*(\d+) kB$", status, re.MULTILINE)
    assert found is not None
    sys.stdout.write(f"{lines} {int(found[1]) * 1024}\n")


if __name__ == "__main__":
    read_here()
