"""Mutated logs and tables through the readers.

``fuzz_logs.py [--lines N] [--rows N] [--seed S] [--out FOLDER]``. The same
seed gives the same input. Only a LogError with a message may come out, every
line is counted once, and all ways to read the same bytes give the same.
Exits 1 at the first input that does otherwise, which is then in FOLDER.
"""

from __future__ import annotations

import argparse
import gzip
import logging
import os
import sys
import tempfile
import traceback
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass, fields
from itertools import product
from pathlib import Path
from random import Random
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import structlog
from mutation import candump_line, mutated, table_row

from bstm_daemon.bus.logs.candump import CandumpReader
from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.signals.columns import ChunkDecoder
from bstm_daemon.bus.signals.frame_chunk import FrameChunk, join_in_file_order
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.tables.table_log import TableReader
from bstm_daemon.bus.tables.table_plan import compile_sources
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.sections import SignalConfig, TableConfig
from bstm_daemon.errors import LogError
from bstm_daemon.files import shipped_file
from bstm_daemon.native.loader import VARIABLE, extension

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from bstm_daemon.bus.logs.reader import Wanted
    from bstm_daemon.bus.signals.columns import Events
    from bstm_daemon.bus.signals.signal_map import SignalMap

LINES: Final = 1_000_000
ROWS: Final = 100_000
LINES_AT_ONCE: Final = 2000
ROWS_AT_ONCE: Final = 100

_SIGNALS: Final[dict[str, dict[str, Any]]] = {
    "vehicle_speed": {"column": "v", "unit": "km/h", "min": -1, "max": 400},
    "primary_pressure": {"column": "p", "unit": "bar"},
    "brake_switch": {"column": "b", "unit": "bool"},
}
_WANTED: Final = {"can0": frozenset({(0x100, False), (0x1A0, False)})}
_COUNTERS: Final = (
    *("interfaces", "lines", "frames", "refused", "first_refused", "seen"),
)


class Defect(Exception):  # noqa: N818  (what is found, not what went wrong)
    """A reader did what it must not."""


@dataclass
class Found:
    """What one way of reading gave: counters, frames, error."""

    reader: CandumpReader
    chunk: FrameChunk | None
    error: str


def main(arguments: list[str] | None = None) -> int:
    """Fuzz as asked for; 1 where a defect was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--lines", type=int, default=LINES, metavar="N")
    parser.add_argument("--rows", type=int, default=ROWS, metavar="N")
    parser.add_argument("--seed", type=int, default=1, metavar="S")
    parser.add_argument("--out", type=Path, default=Path(), metavar="FOLDER")
    args = parser.parse_args(arguments)
    passed = 0
    say(f"forms of the candump reader: {', '.join(forms())}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        candump, table = CandumpCheck(folder), TableCheck(folder)
        for what, count, at_once, check in (
            ("candump lines", args.lines, LINES_AT_ONCE, candump),
            ("table rows", args.rows, ROWS_AT_ONCE, table),
        ):
            for first in range(0, count, at_once):
                rng = Random(f"{args.seed} {what} {first}")  # noqa: S311
                number = min(at_once, count - first)
                content = check.make(rng, number)
                try:
                    check.check(content, rng)
                except Exception:  # noqa: BLE001  (any is the finding)
                    kept = args.out / f"fuzz-{args.seed}-{first}{check.ending}"
                    kept.write_bytes(content)
                    say(traceback.format_exc())
                    say(f"failed: {what} from {first}, kept in {kept}")
                    return 1
                passed += number
            told = ", ".join(
                f"{number} {reason}"
                for reason, number in check.outcomes.most_common()
            )
            say(f"{count} mutated {what}: {told}")
    say(f"{passed} passed")
    return 0


class CandumpCheck:
    """Candump text through every way to read it."""

    ending = ".log"

    def __init__(self, folder: Path) -> None:
        """Write logs to *folder*; the compiled form is read where it is."""
        self._forms = forms()
        self.outcomes: Counter[str] = Counter()
        self._path = folder / "a.log"
        self._packed = folder / "a.log.gz"
        vehicle = load_vehicle(shipped_file("config/example_vehicle.toml"))
        self._signal_map: SignalMap = vehicle[1]

    @staticmethod
    def make(rng: Random, count: int) -> bytes:
        """Return *count* mutated lines and half as many sound ones."""
        sound = [candump_line(rng) for _ in range(count // 2 + 1)]
        lines = [mutated(rng.choice(sound), sound, rng) for _ in range(count)]
        lines += sound
        rng.shuffle(lines)
        return b"".join(lines)

    def check(self, content: bytes, rng: Random) -> None:
        """Raise :class:`Defect` or whatever comes out of a reader."""
        self._path.write_bytes(content)
        lines = content.count(b"\n") + (content[-1:] not in (b"", b"\n"))
        for wanted in (None, _WANTED.get):
            with taken("reference"):
                slow = read_frames(self._path, wanted)
            expect(not slow.error, slow.error)
            expect(slow.reader.lines == lines, "lines of the file")
            self._adds_up(slow, wanted)
            for form, chunk_bytes in product(
                self._forms, (1 << 21, rng.choice((4001, 30_011)))
            ):
                with taken(form):
                    fast = read_frames(
                        self._path, wanted, chunk_bytes=chunk_bytes
                    )
                expect(not fast.error, fast.error)
                same_frames(slow, fast, form)
            if wanted is None:
                self.outcomes["frames"] += slow.reader.frames
                for reason, number in slow.reader.refused.items():
                    self.outcomes[str(reason)] += number
        self._decode()
        self._through_event_log()
        self._damaged_gzip(content, rng)

    @staticmethod
    def _adds_up(found: Found, wanted: Wanted | None) -> None:
        reader = found.reader
        refused = reader.refused
        expect(
            reader.lines == reader.frames + sum(refused.values()),
            f"{reader.lines} lines, {reader.frames} frames, {refused}",
        )
        unwanted: Counter[RejectReason] = Counter()
        for (channel, can_id, extended), number in reader.seen.items():
            ids = wanted(reader.interfaces[channel]) if wanted else ()
            if ids is None:
                unwanted[RejectReason.UNKNOWN_INTERFACE] += number
            elif wanted and (can_id, extended) not in ids:
                unwanted[RejectReason.UNKNOWN_ID] += number
        for reason in (
            RejectReason.UNKNOWN_INTERFACE,
            RejectReason.UNKNOWN_ID,
        ):
            expect(unwanted[reason] == refused[reason], f"count of {reason}")

    def _decode(self) -> None:
        """Decode what has an id of the example car, as a replay does."""
        decoded = []
        for form in self._forms:
            with taken(form):
                reader = CandumpReader(self._path, self._ids)
                decoded.append(
                    [
                        ChunkDecoder(self._signal_map).decode(
                            chunk,
                            [0] * len(reader.interfaces),
                        )
                        for chunk in reader.chunks()
                    ]
                )
        for events in decoded:
            expect(
                all(np.isfinite(one.value).all() for one in events),
                "a sample is not finite",
            )
            same_events(decoded[0], events, times=True)
        self.outcomes["samples"] += sum(map(len, decoded[0]))
        counts = [sum((e.counts for e in es), Counter()) for es in decoded]
        expect(counts[0] == counts[-1], f"decoded: {counts}")

    def _ids(self, interface: str) -> Collection[tuple[int, bool]] | None:
        return self._signal_map.wanted(0) if interface == "can0" else None

    def _through_event_log(self) -> None:
        try:
            for _ in EventLog(self._path, self._signal_map).events():
                pass
        except LogError as error:
            has_message(error, self._path)

    def _damaged_gzip(self, content: bytes, rng: Random) -> None:
        packed = bytearray(gzip.compress(content[:20_000], 1))
        for _ in range(rng.randrange(3)):
            packed[rng.randrange(len(packed))] ^= 1 << rng.randrange(8)
        if rng.random() < 0.5:
            del packed[rng.randrange(len(packed)) :]
        self._packed.write_bytes(packed)
        found = read_frames(self._packed, None)
        self._adds_up(found, None)
        self.outcomes["damaged gzip"] += bool(found.error)


class TableCheck:
    """CSV text through the reader of tables, whole and in small chunks."""

    ending = ".csv"

    def __init__(self, folder: Path) -> None:
        """Write tables to *folder*."""
        self.outcomes: Counter[str] = Counter()
        self._path = folder / "a.csv"
        signals = {role: SignalConfig(**one) for role, one in _SIGNALS.items()}
        named = {
            role: one.model_copy(update={"column": column})
            for (role, one), column in zip(
                signals.items(), ("12", "x", "a, b"), strict=True
            )
        }
        self._plans = {
            name: compile_sources([], roles, table, Path(), 0.3)
            for name, roles, table in (
                ("wide", signals, TableConfig(time="t", time_unit="s")),
                ("found unit", signals, TableConfig(time="t")),
                ("no time", signals, TableConfig(rate_hz=50.0)),
                (
                    "long",
                    named,
                    TableConfig(time="t", time_unit="s", name="n", value="v"),
                ),
            )
        }

    @staticmethod
    def make(rng: Random, count: int) -> bytes:
        """Return a table of *count* mutated rows and half as many sound."""
        delimiter = rng.choice((b",", b",", b";", b"\t", b"|"))
        sound = [
            table_row(rng, number, delimiter)
            for number in range(count // 2 + 1)
        ]
        rows = [mutated(rng.choice(sound), sound, rng) for _ in range(count)]
        rows += sound
        rng.shuffle(rows)
        header = delimiter.join((b"t", b"v", b"p", b"b", b"n")) + b"\n"
        if rng.random() < 0.1:
            header = mutated(header, rows, rng)
        return header + b"".join(rows)

    def check(self, content: bytes, rng: Random) -> None:
        """Raise :class:`Defect` or whatever comes out of the reader."""
        self._path.write_bytes(content)
        small = rng.choice((1, 3, 17))
        for name, plan in self._plans.items():
            whole, whole_events, error = self._read(plan, None)
            parts, part_events, other = self._read(plan, small)
            self._adds_up(whole, whole_events, content, error)
            self._adds_up(parts, part_events, content, other)
            # a found unit rests on the first chunk, joined laps on its step
            if name != "found unit":
                expect(error == other, f"{error!r} and in chunks {other!r}")
                same_counts(whole, parts)
                same_events(
                    whole_events,
                    part_events,
                    times=not whole.time.laps_joined,
                )
            if name == "wide":
                self.outcomes["rows with a time"] += whole.frames
                self.outcomes["tables refused"] += bool(error)
                for reason, number in (whole.refused + whole.counts).items():
                    self.outcomes[str(reason)] += number

    def _read(
        self, plan: Any, chunk_rows: int | None
    ) -> tuple[TableReader, list[Events], str]:
        reader = TableReader(self._path, plan)
        if chunk_rows is not None:
            reader._source._chunk_rows = chunk_rows  # type: ignore[attr-defined]
        events: list[Events] = []
        try:
            events.extend(reader.events())
        except LogError as error:
            return reader, events, has_message(error, self._path)
        return reader, events, ""

    @staticmethod
    def _adds_up(
        reader: TableReader, events: list[Events], content: bytes, error: str
    ) -> None:
        expect(
            reader.lines == reader.frames + sum(reader.refused.values()),
            f"{reader.lines} rows, {reader.frames} used, {reader.refused}",
        )
        samples = sum(len(one) for one in events)
        cells = samples + sum(reader.counts.values())
        expect(cells <= reader.frames * len(_SIGNALS), "more than its cells")
        expect(
            all(np.isfinite(one.value).all() for one in events),
            "a sample is not finite",
        )
        told: Counter[RejectReason] = Counter()
        for one in events:
            told.update(one.counts)
        expect(told == reader.counts, "refused cells of the chunks")
        plain = not set(b'"\r') & set(content)
        if plain and "no such column" not in error:
            rows = content.count(b"\n") - content.endswith(b"\n")
            expect(reader.lines == rows, f"{reader.lines} of {rows} rows")


def read_frames(path: Path, wanted: Wanted | None, **options: Any) -> Found:
    """Read *path* to its end, or to its error."""
    reader = CandumpReader(path, wanted, **options)
    chunks: list[FrameChunk] = []
    error = ""
    try:
        chunks.extend(reader.chunks())
    except LogError as found:
        error = has_message(found, path)
    whole = join_in_file_order(chunks) if chunks else None
    return Found(reader, whole, error)


def forms() -> tuple[str, ...]:
    """Return the forms in which logs can be read here."""
    return ("reference", "compiled")[: 2 if extension() else 1]


@contextmanager
def taken(form: str) -> Iterator[None]:
    """Have the readers take their compiled or their reference form."""
    before = os.environ.get(VARIABLE, "")
    os.environ[VARIABLE] = form
    try:
        yield
    finally:
        os.environ[VARIABLE] = before


def same_frames(one: Found, two: Found, form: str) -> None:
    """Raise :class:`Defect` unless both readings are alike in all."""
    for name in _COUNTERS:
        a, b = getattr(one.reader, name), getattr(two.reader, name)
        expect(a == b, f"{name}: {a} line by line, {b} {form}")
    if one.chunk is None or two.chunk is None:
        expect(one.chunk is two.chunk, "chunks")
        return
    for field in fields(FrameChunk):
        a, b = getattr(one.chunk, field.name), getattr(two.chunk, field.name)
        expect(np.array_equal(a, b), f"column {field.name}, {form}")


def same_counts(one: TableReader, two: TableReader) -> None:
    """Raise :class:`Defect` unless both have counted the same."""
    for name in ("lines", "frames", "refused", "counts"):
        a, b = getattr(one, name), getattr(two, name)
        expect(a == b, f"{name}: {a} as a whole, {b} in chunks")


def same_events(one: list[Events], two: list[Events], *, times: bool) -> None:
    """Raise :class:`Defect` unless both have the same samples."""
    for name in ("role", "value", *(["time_us"] if times else [])):
        a, b = (
            np.concatenate([getattr(e, name) for e in events] or [[]])
            for events in (one, two)
        )
        expect(np.array_equal(a, b), f"samples: {name}")


def has_message(error: LogError, path: Path) -> str:
    """Return the message of *error*, which has to name the file."""
    message = str(error)
    expect(path.name in message and len(message) > 20, repr(message))
    return message


def expect(holds: bool | np.bool_, message: str) -> None:  # noqa: FBT001
    """Raise :class:`Defect` with *message* unless it *holds*."""
    if not holds:
        raise Defect(message)


def say(line: str) -> None:
    """Write *line* at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR)
    )
    sys.exit(main())
