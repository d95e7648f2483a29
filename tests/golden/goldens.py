"""What is golden, how it is computed, stored, compared and stored anew.

Everything goes by the command line, files in and files out, so that nothing
here knows the inside of the package.
"""

from __future__ import annotations

import argparse
import io
import json
import lzma
import math
import os
import sys
import tempfile
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import cantools
import numpy as np

from bstm_daemon.cli.main import main as bstm
from bstm_daemon.cli.vehicle import load_vehicle, read_state
from bstm_daemon.replay.columns import stream_log
from bstm_daemon.replay.results.rows import Collector

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    import numpy.typing as npt

    Series = npt.NDArray[np.float64]

HERE: Final = Path(__file__).parent
ROOT: Final = HERE.parents[1]
LOGS: Final = HERE / "logs"
STORED: Final = HERE / "stored"

TEMPERATURE_K: Final = 1e-6
"""Stored temperatures hold within this."""
SHARE: Final = 1e-6
"""Every other column: within this share of its largest value."""
FITTED: Final = 1e-4
"""Numbers of a match and a gap: within this share of themselves."""
NOTHING: Final = 1e-9
"""Numbers of a result that are smaller than this are not told apart."""

EPISODES: Final = ("flags", "validity", "reasons", "_level", "advice_")
"""Columns of kinds, not of amounts: each row is the same or is not."""
UNITS: Final = {
    "_c": "K",
    "_k": "K",
    "_j": "J",
    "_w": "W",
    "_m": "m",
    "_s": "s",
    "_n": "N",
    "_pa": "Pa",
    "_ms": "m/s",
    "_ms2": "m/s2",
    "_kg": "kg",
    "_percent": "%",
}
FIRST_OF_NAMES: Final = 12
"""Rows of a table that are shown of one golden; the rest are counted."""


@dataclass(frozen=True)
class Recording:
    """A log that is replayed."""

    name: str
    config: Path
    every_s: float
    """From stored row to stored row; frames are all stored."""
    state: Path | None = None

    @property
    def log(self) -> Path:
        """The log."""
        return LOGS / f"{self.name}.log.gz"


RECORDINGS: Final = {
    one.name: one
    for one in (
        Recording("descent", HERE / "alpine.toml", 1.0),
        Recording("stops", HERE / "stops.toml", 0.5),
        Recording("inputs", HERE / "inputs.toml", 0.5),
        Recording(
            "restart", HERE / "alpine.toml", 1.0, LOGS / "restart.state"
        ),
        Recording("circuits", HERE / "circuits.toml", 1.0),
        Recording("subaru", ROOT / "config" / "subaru_wrx_sti.toml", 1.0),
    )
}

RESULTS: Final[dict[str, tuple[list[str], float]]] = {
    "match": (
        [
            *("match", str(LOGS / "drag.log.gz"), "--plain"),
            *("-c", str(HERE / "matched.toml")),
        ],
        FITTED,
    ),
    "gap": (
        [
            *("gap", "run", str(LOGS / "gap.log.gz")),
            *("-c", str(HERE / "matched.toml"), "--anyway"),
        ],
        FITTED,
    ),
    "heat": (
        ["heat", str(LOGS / "stops.log.gz"), "-c", str(HERE / "stops.toml")],
        SHARE,
    ),
}
"""Command and the share of itself within which each number holds."""

GOLDENS: Final = (*RECORDINGS, *RESULTS)


@dataclass(frozen=True)
class Replayed:
    """What a replay gives."""

    columns: dict[str, Series]
    frames: list[str] = field(repr=False)


Golden = Replayed | dict[str, Any]


class Moved(NamedTuple):
    """Something that is not what is stored."""

    golden: str
    what: str
    amount: float
    unit: str
    first: str
    """Where it is seen first, in words."""

    def __str__(self) -> str:
        """Return a line for people."""
        size = f"{self.amount:.4g} {self.unit}".strip()
        return f"{self.golden}: {self.what} moved by {size}, {self.first}"


def compute(name: str) -> Golden:
    """Return the golden *name* as it is now."""
    with tempfile.TemporaryDirectory() as folder:
        if name in RECORDINGS:
            return replayed(RECORDINGS[name], Path(folder))
        return result(name, Path(folder))


def run(*arguments: str) -> None:
    """Run a command of ``bstm`` that has to end with 0."""
    with redirect_stdout(io.StringIO()) as said:
        code = bstm([*arguments, "-qq"])
    if code != 0:
        msg = f"bstm {' '.join(arguments)}: ended with {code}\n"
        raise RuntimeError(msg + said.getvalue())


def replayed(
    recording: Recording, folder: Path, *options: str, every_s: float = 0.0
) -> Replayed:
    """Return the replay of *recording*, its frames through *folder*.

    Estimates are those before a table rounds them.
    """
    frames = folder / "frames.log"
    state = (
        [] if recording.state is None else ["--state", str(recording.state)]
    )
    every_s = every_s or recording.every_s
    run(
        *("replay", str(recording.log), "-c", str(recording.config)),
        *("--every", str(every_s), *state, "-o", str(folder)),
        *("--format", "csv", "--publish", str(frames), *options),
    )
    config, signal_map = load_vehicle(recording.config)
    rows = Collector()
    stream_log(
        config,
        signal_map,
        recording.log,
        [rows],
        every_us=round(every_s * 1e6),
        state=recording.state and read_state(recording.state, "--state"),
        forecast="--no-forecast" not in options,
    )
    return Replayed(
        {
            name: np.asarray(column, np.float64)
            for name, column in rows.results().columns.items()
        },
        frames.read_text(encoding="ascii").splitlines(),
    )


def result(name: str, folder: Path) -> dict[str, Any]:
    """Return what the command of *name* writes with ``--json``."""
    path = folder / "result.json"
    run(*RESULTS[name][0], "--json", str(path))
    found: dict[str, Any] = without_folders(
        json.loads(path.read_text(encoding="utf-8"))
    )
    return found


def without_folders(value: Any, key: str = "") -> Any:
    """Return *value* with names of files in place of their paths."""
    if isinstance(value, dict):
        return {k: without_folders(v, k) for k, v in value.items()}
    if isinstance(value, list):
        return [without_folders(one, key) for one in value]
    if key in {"file", "files"}:
        return Path(value).name
    return value


# -- stored ------------------------------------------------------------------


def files_of(name: str, folder: Path = STORED) -> tuple[Path, ...]:
    """Return the files that hold the golden *name*."""
    if name in RECORDINGS:
        return folder / f"{name}.npz", folder / f"{name}.frames.log.xz"
    return (folder / f"{name}.json.xz",)


def store(name: str, golden: Golden, folder: Path = STORED) -> None:
    """Write *golden*; the same golden gives the same bytes."""
    folder.mkdir(exist_ok=True)
    paths = files_of(name, folder)
    if isinstance(golden, Replayed):
        with paths[0].open("wb") as file:
            np.savez_compressed(
                file,
                names=np.array(list(golden.columns)),
                values=np.array(list(golden.columns.values())),
            )
        text = "".join(f"{line}\n" for line in golden.frames)
    else:
        text = json.dumps(golden, indent=0)
    paths[-1].write_bytes(lzma.compress(text.encode("utf-8"), preset=9))


def load(name: str, folder: Path = STORED) -> Golden:
    """Return the stored golden *name*."""
    paths = files_of(name, folder)
    text = lzma.decompress(paths[-1].read_bytes()).decode("utf-8")
    if name not in RECORDINGS:
        found: dict[str, Any] = json.loads(text)
        return found
    with np.load(paths[0]) as archive:
        names, values = archive["names"].tolist(), archive["values"]
    return Replayed(dict(zip(names, values, strict=True)), text.splitlines())


# -- compared ----------------------------------------------------------------


def compare(name: str, stored: Golden, now: Golden) -> list[Moved]:
    """Return what of the golden *name* is not as stored."""
    if isinstance(stored, Replayed):
        assert isinstance(now, Replayed)
        columns = compare_columns(name, stored.columns, now.columns)
        return [*columns, *compare_frames(name, stored.frames, now.frames)]
    assert not isinstance(now, Replayed)
    return list(compare_values(name, stored, now, RESULTS[name][1]))


def compare_columns(
    name: str, stored: Mapping[str, Series], now: Mapping[str, Series]
) -> list[Moved]:
    """Return the columns that are not as stored."""
    gone = [
        Moved(name, c, math.inf, "", "gone") for c in stored if c not in now
    ]
    new = [Moved(name, c, math.inf, "", "new") for c in now if c not in stored]
    rows = [len(table["time_s"]) for table in (stored, now)]
    if rows[0] != rows[1]:
        told = f"{rows[0]} rows are stored, there are {rows[1]}"
        return [Moved(name, "rows", abs(rows[1] - rows[0]), "rows", told)]
    time_s = stored["time_s"] - stored["time_s"][0]
    both = [c for c in stored if c in now]
    found = (
        compare_column(name, column, time_s, stored[column], now[column])
        for column in both
    )
    moved = [one for one in found if one is not None]
    return [*gone, *new, *ordered(moved)]


def ordered(moved: Iterable[Moved]) -> list[Moved]:
    """Return *moved*, kelvins first, then joules, the furthest first."""
    units = {"K": 0, "J": 1}
    return sorted(moved, key=lambda m: (units.get(m.unit, 2), -m.amount))


def compare_column(
    name: str, column: str, time_s: Series, stored: Series, now: Series
) -> Moved | None:
    """Return how far one column is off, None within the tolerance.

    Of a power the energy counts: how far its integral is off at most.
    """
    there = np.isfinite(stored) & np.isfinite(now)
    same = (stored == now) | (np.isnan(stored) & np.isnan(now))
    apart = np.where(there, now, 0.0) - np.where(there, stored, 0.0)
    off = np.where(there, np.abs(apart), math.inf)
    off[same] = 0.0
    unit = unit_of(column)
    largest = float(np.max(np.abs(stored[there]), initial=0.0))
    limit = TEMPERATURE_K if unit == "K" else SHARE * largest
    if unit == "rows":
        limit = 0.0
    bad = off > limit
    if not bad.any():
        return None
    row = int(np.argmax(bad))
    first = (
        f"first at {time_s[row]:.1f} s: {stored[row]:.9g} is stored, "
        f"{now[row]:.9g} is now"
    )
    amount = float(off.max())
    if unit == "rows" or math.isinf(amount):
        return Moved(name, column, float(bad.sum()), "rows", first)
    if column.endswith(("brake_power_w", "power_ff_w", "power_fb_w")):
        step_s = np.diff(time_s, prepend=time_s[0])
        moved_j = np.cumsum(apart * step_s)
        return Moved(name, column, float(np.abs(moved_j).max()), "J", first)
    return Moved(name, column, amount, unit, first)


def unit_of(column: str) -> str:
    """Return the unit of a difference of *column*; "rows" of a kind."""
    if any(part in column for part in EPISODES) and not column.endswith(
        ("waiting_s", "pedal_feel")
    ):
        return "rows"
    return UNITS.get(f"_{column.rpartition('_')[2]}", "")


def compare_frames(
    name: str, stored: Sequence[str], now: Sequence[str]
) -> Iterator[Moved]:
    """Yield the ids whose frames are not, byte for byte, those stored."""
    if list(stored) == list(now):
        return
    old, new = by_id(stored), by_id(now)
    if old == new:
        pairs = zip(stored, now, strict=True)
        count = sum(ours != theirs for ours, theirs in pairs)
        yield Moved(name, "order of frames", count, "frames", "same data")
    start_s = float(stored[0].split()[0].strip("()"))
    for can_id in sorted({*old, *new}):
        ours, theirs = old.get(can_id, {}), new.get(can_id, {})
        stamps = sorted(
            stamp
            for stamp in {*ours, *theirs}
            if ours.get(stamp) != theirs.get(stamp)
        )
        if not stamps:
            continue
        at = stamps[0]
        first = (
            f"first at {float(at[0]) - start_s:.1f} s: "
            f"{ours.get(at, 'none')} is stored, "
            f"{theirs.get(at, 'none')} is now"
            f"{signals_apart(can_id, ours.get(at), theirs.get(at))}"
        )
        what = f"frame {can_id:03X} {frame_name(can_id)}"
        yield Moved(name, what, len(stamps), "frames", first)


def by_id(lines: Iterable[str]) -> dict[int, dict[tuple[str, int], str]]:
    """Return channel and data by stamp of each id; stamps are numbered."""
    found: dict[int, dict[tuple[str, int], str]] = {}
    for line in lines:
        stamp, channel, frame = line.split()
        can_id, data = frame.split("#")
        of_id = found.setdefault(int(can_id, 16), {})
        number = 0
        while (stamp.strip("()"), number) in of_id:
            number += 1
        of_id[stamp.strip("()"), number] = f"{channel} {data}"
    return found


@cache
def layout() -> cantools.database.can.Database:
    """Return the DBC of the published frames."""
    found = cantools.database.load_file(ROOT / "dbc" / "bstm.dbc")
    assert isinstance(found, cantools.database.can.Database)
    return found


def frame_name(can_id: int) -> str:
    """Return the name of a published frame, "" of one that has none."""
    names = {one.frame_id: one.name for one in layout().messages}
    return names.get(can_id, "")


def signals_apart(can_id: int, stored: str | None, now: str | None) -> str:
    """Return the signals in which two frames differ, in words."""
    if stored is None or now is None or not frame_name(can_id):
        return ""
    message = layout().get_message_by_frame_id(can_id)
    old, new = (
        message.decode(bytes.fromhex(data.split()[1]), decode_choices=False)
        for data in (stored, now)
    )
    told = [
        f"{key} {old[key]} to {new[key]}"
        for key in old
        if old[key] != new[key] and key not in {"CRC", "Counter"}
    ]
    return f" ({', '.join(told)})" if told else ""


def compare_values(
    name: str, stored: Any, now: Any, share: float, path: str = ""
) -> Iterator[Moved]:
    """Yield what of a result in JSON is not as stored."""
    if isinstance(stored, dict) and isinstance(now, dict):
        for key in dict.fromkeys([*stored, *now]):
            below = f"{path}.{key}" if path else key
            if key not in now or key not in stored:
                where = "gone" if key in stored else "new"
                yield Moved(name, below, math.inf, "", where)
            else:
                yield from compare_values(
                    name, stored[key], now[key], share, below
                )
    elif isinstance(stored, list) and isinstance(now, list):
        if len(stored) != len(now):
            told = f"{len(stored)} entries are stored, there are {len(now)}"
            yield Moved(name, path, abs(len(stored) - len(now)), "", told)
        for i, (old, new) in enumerate(zip(stored, now, strict=False)):
            yield from compare_values(name, old, new, share, f"{path}[{i}]")
    elif is_number(stored) and is_number(now):
        room = share * max(abs(stored), abs(now), NOTHING)
        if not abs(now - stored) <= room:
            told = f"{stored:.9g} is stored, {now:.9g} is now"
            yield Moved(name, path, abs(now - stored), unit_in(path), told)
    elif stored != now:
        told = f"{stored!r} is stored, {now!r} is now"
        yield Moved(name, path, math.inf, "", told)


def is_number(value: object) -> bool:
    """Whether *value* is a number; a truth is none."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def unit_in(path: str) -> str:
    """Return the unit that the names of *path* tell, innermost first."""
    for part in reversed(path.replace("[", ".").split(".")):
        unit = UNITS.get(f"_{part.rpartition('_')[2]}")
        if "_" in part and unit is not None:
            return unit
    return ""


# -- stored anew -------------------------------------------------------------


def table(moved: Sequence[Moved]) -> str:
    """Return the table of what moved, for a commit message."""
    if not moved:
        return "nothing moved"
    rows = [("golden", "what", "moved by at most", "")]
    for name in dict.fromkeys(one.golden for one in moved):
        mine = ordered(one for one in moved if one.golden == name)
        rows += [
            (m.golden, m.what, f"{m.amount:.3g}", m.unit)
            for m in mine[:FIRST_OF_NAMES]
        ]
        if len(mine) > FIRST_OF_NAMES:
            rest = len(mine) - FIRST_OF_NAMES
            rows.append((name, f"and {rest} more", "", ""))
    widths = [max(len(row[i]) for row in rows) for i in range(3)]
    return "\n".join(
        f"{row[0]:{widths[0]}}  {row[1]:{widths[1]}}  "
        f"{row[2]:>{widths[2]}} {row[3]}".rstrip()
        for row in rows
    )


def refresh(
    names: Iterable[str], folder: Path = STORED, *, write: bool = True
) -> list[Moved]:
    """Store anew each golden that moved; one that did not stays as it is."""
    moved: list[Moved] = []
    for name in names:
        now = compute(name)
        if all(path.exists() for path in files_of(name, folder)):
            found = compare(name, load(name, folder), now)
        else:
            found = [Moved(name, "everything", math.inf, "", "new")]
        moved += found
        if found and write:
            store(name, now, folder)
    return moved


def main(arguments: Sequence[str] | None = None) -> int:
    """Store the goldens anew and print what moved."""
    parser = argparse.ArgumentParser(
        prog="refresh.py",
        description="Store the goldens anew, print what moved, in K and J. "
        "The table belongs into the commit message.",
    )
    parser.add_argument("names", nargs="*", metavar="GOLDEN")
    parser.add_argument(
        "--check", action="store_true", help="write nothing; 1 if one moved"
    )
    parser.add_argument("--folder", type=Path, default=STORED)
    args = parser.parse_args(arguments)
    unknown = sorted(set(args.names) - set(GOLDENS))
    if unknown:
        parser.error(f"no golden {unknown}; there are {', '.join(GOLDENS)}")
    # without it the forecast is another one
    os.environ["BSTM_KERNEL"] = "compiled"
    moved = refresh(args.names or GOLDENS, args.folder, write=not args.check)
    sys.stdout.write(f"{table(moved)}\n")
    return int(bool(moved) and args.check)
