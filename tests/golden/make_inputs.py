"""The recordings under ``logs/``: how they were made, and made again.

    python tests/golden/make_inputs.py FOLDER

simulates ``drives/*.toml`` with the sensors n1, thins the frames, spoils what
is to be spoiled and writes the packed logs to FOLDER. The stored logs are
files of their own: a later change of the simulated car moves no golden, and
nothing but a wish for other recordings calls for this script. The goldens
are then stored anew (README.md).
"""

from __future__ import annotations

import argparse
import gzip
import os
import tempfile
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Final

from bstm_daemon.cli.main import main as bstm

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

HERE: Final = Path(__file__).parent
START_US: Final = 1_700_000_000_000_000

TORQUES, WHEELS, PRESSURES, INERTIAL = 0x110, 0x1A0, 0x1A4, 0x1B0
BRAKE_TORQUE, BODY, AMBIENT = 0x1C0, 0x350, 0x3F0
COUPLES = (0x6A0, 0x6A1)
SWITCHES: Final = 0x300
EVERY: Final = {
    TORQUES: 5,
    WHEELS: 5,
    PRESSURES: 5,
    INERTIAL: 5,
    BRAKE_TORQUE: 5,
    BODY: 2,
    AMBIENT: 10,
    **dict.fromkeys(COUPLES, 2),
}
"""Frames of an id that become one: a tenth of a second each, mostly."""


@dataclass(frozen=True)
class Frame:
    """One frame of a log."""

    time_us: int
    channel: str
    can_id: int
    data: bytes

    @property
    def at_s(self) -> float:
        """Time since the drive began."""
        return (self.time_us - START_US) * 1e-6

    def with_word(self, first: int, value: int) -> Frame:
        """Return the frame with the 16 bits from byte *first* on."""
        data = bytearray(self.data)
        data[first : first + 2] = value.to_bytes(2, "little", signed=True)
        return replace(self, data=bytes(data))

    def word(self, first: int) -> int:
        """Return the signed 16 bits from byte *first* on."""
        part = self.data[first : first + 2]
        return int.from_bytes(part, "little", signed=True)


def read(path: Path) -> Iterator[Frame]:
    """Yield the frames of the candump log *path*."""
    for line in path.read_text(encoding="ascii").splitlines():
        stamp, channel, frame = line.split()
        seconds, micros = stamp.strip("()").split(".")
        can_id, data = frame.split("#")
        time_us = int(seconds) * 1_000_000 + int(micros)
        yield Frame(time_us, channel, int(can_id, 16), bytes.fromhex(data))


def write(path: Path, frames: Iterable[Frame]) -> None:
    """Write *frames* to *path*, packed; the same frames, the same bytes."""
    lines = [
        f"({f.time_us // 1_000_000}.{f.time_us % 1_000_000:06d}) {f.channel} "
        f"{f.can_id:03X}#{f.data.hex().upper()}\n"
        for f in frames
    ]
    packed = gzip.compress("".join(lines).encode("ascii"), 9, mtime=0)
    path.write_bytes(packed)


def thinned(frames: Iterable[Frame], every: dict[int, int]) -> list[Frame]:
    """Return every n-th frame of each id of *every*, no others."""
    seen = dict.fromkeys(every, -1)
    kept = []
    for frame in frames:
        if frame.can_id in every:
            seen[frame.can_id] += 1
            if seen[frame.can_id] % every[frame.can_id] == 0:
                kept.append(frame)
    return kept


LOST: Final = (
    (25.0, 28.0, (*EVERY,)),  # the whole bus
    (50.0, 58.0, (PRESSURES,)),
    (140.0, inf, (AMBIENT,)),
    (160.0, 176.0, (WHEELS, INERTIAL, PRESSURES)),
    (184.0, 204.0, (TORQUES,)),
)
"""From, to [s], which ids are not there."""

PRESSURE_PEAKS: Final = (950, 1100)
SPEED_PEAKS: Final = (400, 2300)
"""Tenths of a second in which one sample is far off."""


def is_lost(frame: Frame) -> bool:
    """Whether the bus loses *frame*."""
    return any(
        begin < frame.at_s < end and frame.can_id in ids
        for begin, end, ids in LOST
    )


def spoiled(frames: list[Frame]) -> list[Frame]:
    """Return the drive inputs with what a bus may do to it."""
    kept = [frame for frame in frames if not is_lost(frame)]
    stuck = next(f for f in kept if f.can_id == WHEELS and f.at_s > 70.0)
    change = {
        WHEELS: lambda frame: with_stuck_wheel(frame, stuck.word(0)),
        INERTIAL: with_bad_inertial,
        PRESSURES: with_bad_pressure,
        BODY: with_switch_off,
    }
    changed = [change.get(f.can_id, unchanged_frame)(f) for f in kept]
    # the clock is set back
    return [
        replace(f, time_us=f.time_us - 20_000_000) if f.at_s > 305.0 else f
        for f in changed
    ]


def with_stuck_wheel(frame: Frame, value: int) -> Frame:
    """Return speeds of which the front left one is stuck for a while."""
    return frame.with_word(0, value) if 70.0 < frame.at_s < 88.0 else frame


def with_bad_inertial(frame: Frame) -> Frame:
    """Return 5 m/s2 too much for a while, a speed of 300 km/h at times."""
    if 118.0 < frame.at_s < 134.0:
        frame = frame.with_word(0, frame.word(0) + 5000)
    if round(frame.at_s * 10) in SPEED_PEAKS:
        frame = frame.with_word(6, 30000)
    return frame


def with_bad_pressure(frame: Frame) -> Frame:
    """Return 0 bar from some time on, 200 bar at times."""
    if frame.at_s > 240.0:
        frame = frame.with_word(0, 0)
    if round(frame.at_s * 10) in PRESSURE_PEAKS:
        frame = frame.with_word(0, 4000)
    return frame


def with_switch_off(frame: Frame) -> Frame:
    """Return a brake switch that stays off for a while."""
    if not 206.0 < frame.at_s < 222.0:
        return frame
    return replace(frame, data=bytes([frame.data[0] & ~1]) + frame.data[1:])


def unchanged_frame(frame: Frame) -> Frame:
    """Return *frame*."""
    return frame


def switched(frames: list[Frame]) -> list[Frame]:
    """Return the drive circuits with a workshop's bus beside the other."""
    added = []
    for second in range(int(frames[-1].at_s)):
        switches = (
            (6 <= second < 12)
            | (second >= 62) << 1
            | (second >= 118) << 2
            | (second >= 140) << 3
        )
        water = 29 if 80 <= second < 120 else 255  # 2.9 %, not available
        time_us = START_US + second * 1_000_000 + 3000
        added.append(
            Frame(time_us, "can1", SWITCHES, bytes([switches, water]))
        )
    return sorted([*frames, *added], key=lambda frame: frame.time_us)


def later(frames: list[Frame]) -> list[Frame]:
    """Return the drive restart, 9 min on, with brakes that fail twice."""
    change = {PRESSURES: with_odd_pressure, BODY: with_soft_pedal}
    changed = [change.get(f.can_id, unchanged_frame)(f) for f in frames]
    return [replace(f, time_us=f.time_us + 560_000_000) for f in changed]


def with_odd_pressure(frame: Frame) -> Frame:
    """Return 1 bar for a while, later four times what stops the car."""
    if 56.0 < frame.at_s < 60.0:
        return frame.with_word(0, 20).with_word(2, 20)
    if 70.8 < frame.at_s < 73.0:
        return frame.with_word(0, 4 * frame.word(0))
    return frame


def with_soft_pedal(frame: Frame) -> Frame:
    """Return a pedal that goes down to 72 % within 0.8 s, for a while."""
    if not 56.0 < frame.at_s < 60.0:
        return frame
    travel = min(0.16 + 0.7 * (frame.at_s - 56.0), 0.72)
    data = bytes([frame.data[0] | 1, round(200 * travel)]) + frame.data[2:]
    return replace(frame, data=data)


def unchanged(frames: list[Frame]) -> list[Frame]:
    """Return *frames*."""
    return frames


SPARSE: Final = {**EVERY, INERTIAL: 10, WHEELS: 10, PRESSURES: 10}
"""For match and gap: five samples a second, of what feed-forward reads."""

RECORDINGS: Final[
    dict[str, tuple[list[str], dict[int, int], Callable[..., list[Frame]]]]
] = {
    "descent": (["descent"], EVERY, unchanged),
    "stops": (["stops"], EVERY, unchanged),
    "inputs": (["inputs"], EVERY, spoiled),
    "restart": (["restart"], EVERY, later),
    "circuits": (["circuits"], EVERY, switched),
    "drag": (["drag"], SPARSE, unchanged),
    "gap": (["drag", "--effect", "gap_conduction=2"], SPARSE, unchanged),
}


def make(folder: Path) -> None:
    """Write all logs to *folder*."""
    with tempfile.TemporaryDirectory() as scratch:
        raw = Path(scratch) / "raw.log"
        for name, (arguments, every, change) in RECORDINGS.items():
            drive, *options = arguments
            bstm(
                [
                    *(
                        "-q",
                        "simulate",
                        str(HERE / "drives" / f"{drive}.toml"),
                    ),
                    *("-o", str(raw), "--sensors", "n1", *options),
                ]
            )
            log = change(thinned(read(raw), every))
            write(folder / f"{name}.log.gz", log)
    real = os.environ.get("BSTM_REAL_DATA")
    if real is not None:
        write(folder / "subaru.log.gz", subaru(Path(real)))


def subaru(real: Path) -> list[Frame]:
    """Return 60 s of the Subaru's log, 10 to 20 frames a second an id."""
    path = real / "subaru-wrx-sti-candump" / "can_sample.log"
    every = {0xD0: 3, 0xD1: 3, 0xD4: 3, 0x140: 10, 0x141: 10, 0x154: 1}
    frames = thinned(read(path), every)
    first_us = frames[0].time_us
    return [
        frame
        for frame in frames
        if 4_000_000 <= frame.time_us - first_us < 64_000_000
    ]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    make(parser.parse_args().folder)
