"""What candump wrote of a bus, and a log of it to be replayed."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.output.layout import own_ids
from bstm_daemon.replay.frames import publications

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from typing import Any

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.engine import Engine

ROOT: Final = Path(__file__).parents[2]
OWN: Final = {
    f"{can_id:03X}" for can_id in own_ids(0x5B0, ("FL", "FR", "RL", "RR"))
}
"""Identifiers that the example car publishes with."""

GRID_US: Final = 100_000

Line = tuple[int, str]
"""Stamp [us]; id and data as candump writes them."""

Cycles = dict[int, list[str]]
"""Grid line [us] to the frames sent for it."""

MOST_LATE: Final = 15
"""Cycles that a busy machine may send a line late, of about 150; a service
that always does is wrong."""


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


def cycles_of(lines: list[Line]) -> Cycles:
    """Return what the service sent in *lines* by the grid line [us].

    Up to the last frame of others: what says goodbye belongs to no line.
    Its first frame is that of ``BSTM_Status``, of the lowest id. A cycle goes
    out after its line: it is that of the last one before it, or of an
    earlier one if the next cycle has that line.
    """
    sent: list[tuple[int, list[str]]] = []
    end = max(i for i, line in enumerate(lines) if not is_own(line))
    for us, frame in filter(is_own, lines[:end]):
        if frame.startswith("5B0#"):
            sent.append((us // GRID_US * GRID_US, []))
        sent[-1][1].append(frame)
    found: Cycles = {}
    following = (lines[end][0] // GRID_US + 1) * GRID_US
    for line, cycle in reversed(sent):
        following = min(line, following - GRID_US)
        found[following] = cycle
    return dict(reversed(found.items()))


def replayed_cycles(
    config: Config,
    signal_map: SignalMap,
    log: Path,
    state: Mapping[str, Any],
    sent: set[int],
) -> Cycles:
    """Return the frames of a replay of *log* by the grid line [us].

    A busy machine makes a service leave out a line: its frames go out with
    those of the next, only the newest of each name, counted as sent. So are
    these, for a service that sent at the lines *sent* only.
    """
    engines: list[Engine] = []
    ticks = publications(
        config, signal_map, log, state=state, built=engines.append
    )
    found, newest = {}, {}
    for tick in ticks:
        publication = engines[0].publication
        publication.take_back(item.frame.name for item in tick)
        for line, cycle in groupby(tick, lambda item: item.time_us):
            newest |= {item.frame.name: item.frame for item in cycle}
            if line in sent:
                found[line] = [
                    f"{frame.can_id:03X}#{frame.data.hex().upper()}"
                    for frame in map(publication.numbered, newest.values())
                ]
                newest = {}
    return found


def uncounted(frame: str) -> str:
    """Return *frame* without CRC and counter."""
    can_id, _, data = frame.partition("#")
    return f"{can_id}#{data[2]}{data[4:]}"


def at_their_lines(
    sent: Cycles, begin: int, end: int, replay: Callable[[set[int]], Cycles]
) -> tuple[Cycles, Cycles]:
    """Return what was *sent* and replayed for the lines in [begin, end).

    A busy machine may send a cycle after the next line, which it leaves out:
    it is that of the line before if only there the replay says the same.
    """
    moved = 0
    while True:
        replayed = replay(set(sent))
        lines = [us for us in sent if begin <= us < end]
        wrong = next(
            (
                us
                for us in lines
                if [*map(uncounted, sent[us])]
                != [*map(uncounted, replayed[us])]
            ),
            None,
        )
        before = None if wrong is None else wrong - GRID_US
        if before is None or before in sent or moved == MOST_LATE:
            return (
                {us: sent[us] for us in lines},
                {us: replayed[us] for us in lines},
            )
        moved += 1
        sent = {
            before if us == wrong else us: cycle for us, cycle in sent.items()
        }
