"""Base of the readers of CAN logs: chunks of frames, and counts.

Every line (of a binary log: object or record) ends as a frame handed out or
under a named reason, so that the counts add up.
"""

from __future__ import annotations

import gzip
import io
import zlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from bstm_daemon.bus.signals.extraction import (
    EXTENDED_MAX,
    FD_LENGTHS,
    STANDARD_MAX,
)
from bstm_daemon.bus.signals.frame_chunk import FrameChunk, rows_of
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.errors import FileAccessError, LogError

Wanted = Callable[[str], Collection[tuple[int, bool]] | None]
"""Gives the (id, extended) to read from an interface, by its name.

None for an interface that is not to be read at all.
"""

LINES_KEPT: Final = 5
"""First line numbers kept of each reason."""

UNWANTED: Final = (RejectReason.UNKNOWN_ID, RejectReason.UNKNOWN_INTERFACE)

_EXTENDED: Final = 1 << 29
_CHANNEL: Final = 1 << 30
_IS_LENGTH: Final = np.isin(np.arange(256), FD_LENGTHS)


class FrameReader(ABC):
    """Reads one CAN log, once, as chunks of columns.

    Attributes:
        path: The log.
        interfaces: Names of the interfaces in order of appearance; a chunk's
            ``channel`` is a position in this list.
        lines: Lines read; of a binary log, its objects or records.
        frames: Data frames handed out.
        refused: All other lines by reason.
        first_refused: The first ``LINES_KEPT`` line numbers of each reason,
            except for frames that are merely not wanted.
        seen: Sound frames by (channel, id, extended), wanted or not.
        truncated: Whether the log lacks its end.
        share: How much of the file has been read, from 0 to 1.
    """

    counted: str = "line"
    """What ``lines`` counts, for messages."""

    _chunk_frames = 20_000

    def __init__(self, path: Path, wanted: Wanted | None = None) -> None:
        """Prepare to read *path*, every id of every interface by default."""
        self.path = path
        self.interfaces: list[str] = []
        self.lines = 0
        self.frames = 0
        self.refused: Counter[RejectReason] = Counter()
        self.first_refused: dict[RejectReason, list[int]] = {}
        self.seen: Counter[tuple[int, int, bool]] = Counter()
        self.truncated = False
        self.share = 0.0
        self.is_packed = path.suffix.lower() == ".gz"
        self._file: BinaryIO | None = None
        self._wanted = wanted
        self._channels: dict[str, int] = {}
        self._ids: list[Collection[tuple[int, bool]] | None] = []

    @abstractmethod
    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames in file order; a chunk may be empty.

        Raises:
            FileAccessError: The file cannot be read.
            LogError: The log is damaged.
        """

    @contextmanager
    def opened(self) -> Iterator[io.BufferedReader]:
        """Open the log, unpacked where it is packed with gzip.

        Where a gzip file is cut off, the stream ends and ``truncated`` is
        set.

        Raises:
            FileAccessError: The file cannot be read.
            LogError: The gzip file is damaged.
        """
        try:
            with self.path.open("rb") as file:
                self._file = file
                if self.is_packed:
                    yield io.BufferedReader(_Unpacked(file, self))
                else:
                    yield file
        except (gzip.BadGzipFile, zlib.error) as error:
            raise self.damaged(error) from error
        except OSError as error:
            msg = f"{self.path}: cannot be read: {error.strerror or error}"
            raise FileAccessError(msg) from error

    def damaged(self, reason: object) -> LogError:
        """Return what to raise of a damaged log, with the place."""
        place = f"damaged after {self.counted} {self.lines}"
        return LogError(f"{self.path}: {place}: {reason}")

    def channel(self, name: str) -> int:
        """Return the number of the interface *name*, entered when new."""
        number = self._channels.get(name)
        if number is None:
            number = self._channels[name] = self.add_interface(name)
        return number

    def add_interface(self, name: str) -> int:
        """Enter a new interface *name* and return its number."""
        self.interfaces.append(name)
        self._ids.append(self._wanted(name) if self._wanted else None)
        return len(self.interfaces) - 1

    def why_unwanted(
        self,
        channel: int,
        can_id: int,
        extended: bool,  # noqa: FBT001  (part of a frame's key)
    ) -> RejectReason | None:
        """Return why such frames are not handed out; None: they are."""
        ids = self._ids[channel]
        if self._wanted is None:
            return None
        if ids is None:
            return RejectReason.UNKNOWN_INTERFACE
        wanted = (can_id, extended) in ids
        return None if wanted else RejectReason.UNKNOWN_ID

    def refuse(self, reason: RejectReason, line: int) -> None:
        """Count the *line* as refused for *reason*."""
        self.refused[reason] += 1
        if reason in UNWANTED:
            return
        first = self.first_refused.setdefault(reason, [])
        if len(first) < LINES_KEPT:
            first.append(line)

    def in_chunks(self, rows: Iterator[FrameRow]) -> Iterator[FrameChunk]:
        """Yield the wanted frames of *rows*, counted, in chunks."""
        more = True
        while more:
            chunk = chunk_of(islice(rows, self._chunk_frames))
            more = len(chunk) == self._chunk_frames
            yield self.wanted_frames(chunk)

    def wanted_frames(self, chunk: FrameChunk) -> FrameChunk:
        """Return the wanted frames of *chunk*; count them and the others.

        A frame whose id or length no CAN frame can have is malformed.
        """
        limits = np.array([STANDARD_MAX, EXTENDED_MAX], np.uint32)
        sound = chunk.can_id <= limits[chunk.extended.view(np.uint8)]
        sound &= _IS_LENGTH[chunk.length]
        for line in chunk.line[~sound].tolist():
            self.refuse(RejectReason.MALFORMED, line)
        # without extended ids the keys are few enough to be counted in place
        few = not chunk.extended.any()
        width = STANDARD_MAX + 1 if few else _CHANNEL
        keys = chunk.channel.astype(np.int64)
        keys *= width
        keys += chunk.can_id
        keys[~sound] = 0
        if few:
            counts = np.bincount(keys[sound])
            unique = np.flatnonzero(counts)
            counts = counts[unique]
        else:
            keys[chunk.extended] += _EXTENDED
            unique, counts = np.unique(keys[sound], return_counts=True)
        accepted = [
            self._count(*divmod(key, width), count)
            for key, count in zip(
                unique.tolist(), counts.tolist(), strict=True
            )
        ]
        if few:
            is_wanted = np.zeros(int(keys.max(initial=0)) + 1, np.bool_)
            is_wanted[unique] = accepted
            kept = sound & is_wanted[keys]
        else:
            kept = sound & np.isin(keys, unique[np.array(accepted, bool)])
        self.frames += int(np.count_nonzero(kept))
        self.note_share()
        return chunk if kept.all() else rows_of(chunk, kept)

    def note_share(self) -> None:
        """Note how far the opened log has been read; a pipe has no length."""
        if self._file is not None and self._file.seekable():
            size = max(self.path.stat().st_size, 1)
            self.share = min(self._file.tell() / size, 1.0)

    def _count(self, channel: int, rest: int, count: int) -> bool:
        """Count frames of one key; whether they are wanted."""
        is_extended, can_id = divmod(rest, _EXTENDED)
        key = channel, can_id, bool(is_extended)
        self.seen[key] += count
        reason = self.why_unwanted(*key)
        if reason is not None:
            self.refused[reason] += count
        return reason is None


class _Unpacked(io.RawIOBase):
    """A gzip file that ends where it is cut off."""

    def __init__(self, file: BinaryIO, reader: FrameReader) -> None:
        self._packed = gzip.GzipFile(fileobj=file)
        self._reader = reader

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        try:
            data = self._packed.read1(len(buffer))
        except EOFError:
            self._reader.truncated = True
            return 0
        buffer[: len(data)] = data
        return len(data)


FrameRow = tuple[int, int, int, int, bool, bytes]
"""Stamp [us], line, channel, id, extended, payload of up to 64 bytes."""


def chunk_of(rows: Iterable[FrameRow]) -> FrameChunk:
    """Return frames as columns."""
    time_us: list[int] = []
    line: list[int] = []
    channel: list[int] = []
    can_id: list[int] = []
    extended: list[bool] = []
    data: list[bytes] = []
    # kept as columns: many tuples cost time in the garbage collection
    for row in rows:
        time_us.append(row[0])
        line.append(row[1])
        channel.append(row[2])
        can_id.append(row[3])
        extended.append(row[4])
        data.append(row[5])
    lengths = [len(one) for one in data]
    width = 8 if max(lengths, default=0) <= 8 else 64
    payload = b"".join(one.ljust(width, b"\0") for one in data)
    return FrameChunk(
        time_us=np.array(time_us, np.int64),
        line=np.array(line, np.int64),
        channel=np.array(channel, np.int16),
        can_id=np.array(can_id, np.uint32),
        extended=np.array(extended, np.bool_),
        length=np.array(lengths, np.uint8),
        data=np.frombuffer(payload, np.uint8).reshape(-1, width),
    )
