"""What candump wrote of a bus, and a log of it to be replayed."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from bstm_daemon.bus.output.layout import own_ids

ROOT: Final = Path(__file__).parents[2]
OWN: Final = {
    f"{can_id:03X}" for can_id in own_ids(0x5B0, ("FL", "FR", "RL", "RR"))
}
"""Identifiers that the example car publishes with."""

GRID_US: Final = 100_000

Line = tuple[int, str]
"""Stamp [us]; id and data as candump writes them."""


def lines_of(path: Path) -> list[Line]:
    """Return the lines of a log in candump's format."""
    found = []
    for line in path.read_text(encoding="ascii").splitlines():
        stamp, _, frame = line.split()
        found.append((round(float(stamp[1:-1]) * 1e6), frame))
    return found


def is_own(line: Line) -> bool:
    """Whether the service has sent it."""
    return line[1].partition("#")[0] in OWN


def write_lines(path: Path, lines: list[Line], channel: str) -> Path:
    """Write *lines* to *path* as candump would have heard them."""
    path.write_text(
        "".join(
            f"({us // 10**6}.{us % 10**6:06d}) {channel} {frame}\n"
            for us, frame in lines
        ),
        encoding="ascii",
    )
    return path
