"""The files of the recorder: a ring of segments, and the records kept.

``<start>-<number>.log.gz`` is a segment: one gzip file of candump text that
begins at the UTC time ``<start>``; the numbers rise in the order of writing,
also over restarts and where the clock is set back. ``kept/<time>-<reason>/``
has the segments around an occasion. Segments are written under another
name, synced and renamed, so that every file of this name is whole.

Everything here blocks on the disk and belongs on a thread of its own.
"""

import gzip
import os
import re
import time
from calendar import timegm
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import structlog

from bstm_daemon.config.service import RecordConfig

_LOG = structlog.get_logger()

KEPT: Final = "kept"
"""Folder of the records beside the ring."""

_ENDING: Final = ".log.gz"
_PART: Final = ".part"
_NAME: Final = re.compile(
    r"(\d{8}T\d{6})-(\d{6})Z-(\d{6,})" + re.escape(_ENDING)
)
_UTC: Final = "%Y%m%dT%H%M%S"
_MICRO: Final = 1_000_000
_LAST_STAMP_S: Final = 253_402_300_799
"""The end of the year 9999; later stamps get this time in their name."""
_GZIP_LEVEL: Final = 6
_FILE_MODE: Final = 0o640
_FOLDER_MODE: Final = 0o750
"""A recording shows where the car was: for owner and group only."""
_REASON_CHARACTERS: Final = 40


@dataclass(frozen=True, slots=True)
class Segment:
    """One file; ``start_us`` is the wall stamp of its first frame."""

    name: str
    number: int
    start_us: int
    size: int


@dataclass(slots=True, eq=False)
class _Record:
    """The segments kept for one event; open while more are added."""

    path: Path
    reason: str
    sizes: dict[str, int] = field(default_factory=dict)
    newest: int = -1
    from_us: int = 0
    until_us: int | None = None
    is_full: bool = False

    @property
    def size(self) -> int:
        return sum(self.sizes.values())


class RecordStore:
    """Ring and records in a folder; neither outgrows its bound.

    Every method may raise :class:`OSError`; the next call tries again what
    is needed, so a disk that recovers is used again.
    """

    def __init__(self, config: RecordConfig, folder: Path) -> None:
        """Keep the files in *folder*, made with the first :meth:`write`."""
        self._config = config
        self._folder = folder
        self._segment_us = round(config.segment_s * _MICRO)
        self._adopted = False
        self._ring: list[Segment] = []
        self._records: list[_Record] = []
        self._number = 0

    @property
    def ring_bytes(self) -> int:
        """Size of all segments of the ring."""
        return sum(segment.size for segment in self._ring)

    @property
    def kept_bytes(self) -> int:
        """Size of all kept records."""
        return sum(record.size for record in self._records)

    def write(self, start_us: int, text: bytes | bytearray) -> Segment:
        """Add *text*, whose first frame is stamped *start_us* [us].

        The oldest segments go first, so that the ring keeps its bound at any
        time.
        """
        self._adopt()
        data = gzip.compress(text, _GZIP_LEVEL, mtime=0)
        while (
            self._ring
            and self.ring_bytes + len(data) > self._config.ring_bytes
        ):
            (self._folder / self._ring[0].name).unlink(missing_ok=True)
            del self._ring[0]
        name = f"{_time_text(start_us)}-{self._number:06d}{_ENDING}"
        _write_whole(self._folder / name, data)
        segment = Segment(name, self._number, start_us, len(data))
        self._ring.append(segment)
        self._number += 1
        return segment

    def extend(self, segment: Segment) -> None:
        """Add *segment*, the newest, to the open records."""
        # a copy: closed records may be dropped meanwhile to make room
        for record in self._records.copy():
            if record.until_us is None:
                continue
            if record.from_us <= segment.start_us <= record.until_us:
                self._add(record, segment)
            else:
                record.until_us = None

    def keep(self, reason: str, stamp_us: int) -> None:
        """Keep the segments around *stamp_us* [us], for *reason*.

        Those of the ring at once, the newest first, later ones as they come.
        The same reason again extends its record while that is open.
        """
        self._adopt()
        slug = re.sub(r"[^A-Za-z0-9_-]+", "-", reason)[:_REASON_CHARACTERS]
        from_us = stamp_us - round(self._config.before_s * _MICRO)
        until_us = stamp_us + round(self._config.after_s * _MICRO)
        record = self._record(slug, stamp_us)
        if record.until_us is None:
            record.from_us, record.until_us = from_us, until_us
        record.from_us = min(record.from_us, from_us)
        record.until_us = max(record.until_us, until_us)
        for segment in reversed(self._ring.copy()):
            end_us = segment.start_us + self._segment_us
            if segment.start_us <= until_us and end_us >= from_us:
                self._add(record, segment)
        if record.sizes:
            _sync_folder(record.path)

    def _record(self, slug: str, stamp_us: int) -> _Record:
        """Return the open record of *slug*, or a new one."""
        path = self._folder / KEPT / f"{_time_text(stamp_us)[:15]}Z-{slug}"
        for record in self._records:
            until_us = record.until_us
            is_open = until_us is not None and (
                record.from_us <= stamp_us <= until_us
            )
            if (is_open and record.reason == slug) or record.path == path:
                return record
        record = _Record(path, slug)
        self._records.append(record)
        return record

    def _add(self, record: _Record, segment: Segment) -> None:
        """Add *segment* to *record* if there is room for it."""
        if segment.name in record.sizes or not self._make_room(
            record, segment.size
        ):
            return
        source = self._folder / segment.name
        target = record.path / segment.name
        for folder in (record.path.parent, record.path):
            folder.mkdir(_FOLDER_MODE, exist_ok=True)
        if not (source.exists() or target.exists()):
            return
        try:
            os.link(source, target)
        except FileExistsError:
            pass
        except OSError:
            # a file system without hard links: move it out of the ring
            source.rename(target)
            self._ring.remove(segment)
        record.sizes[segment.name] = segment.size
        record.newest = max(record.newest, segment.number)

    def _make_room(self, own: _Record, size: int) -> bool:
        """Drop closed records, the oldest first, until *size* fits."""
        while self.kept_bytes + size > self._config.kept_bytes:
            closed = [
                record
                for record in self._records
                if record is not own and record.until_us is None
            ]
            if not closed:
                if not own.is_full:
                    _LOG.warning("record_full", record=own.path.name)
                own.is_full = True
                return False
            oldest = min(closed, key=lambda record: record.newest)
            _LOG.warning(
                "record_dropped", record=oldest.path.name, bytes=oldest.size
            )
            for name in list(oldest.sizes):
                (oldest.path / name).unlink(missing_ok=True)
                del oldest.sizes[name]
            _remove_if_empty(oldest.path)
            self._records.remove(oldest)
        return True

    def _adopt(self) -> None:
        """Take over the files of an earlier run; once only."""
        self._folder.mkdir(_FOLDER_MODE, parents=True, exist_ok=True)
        if self._adopted:
            return
        ring = _segments(self._folder)
        records = []
        kept = self._folder / KEPT
        for path in sorted(kept.iterdir()) if kept.is_dir() else ():
            if not path.is_dir():
                continue
            own = _segments(path)
            if not own:
                _remove_if_empty(path)
                continue
            reason = path.name.partition("-")[2]
            sizes = {segment.name: segment.size for segment in own}
            records.append(_Record(path, reason, sizes, own[-1].number))
        self._ring, self._records = ring, records
        newest = [record.newest for record in records]
        newest += [segment.number for segment in ring]
        self._number = max(newest, default=-1) + 1
        self._adopted = True


def _segments(folder: Path) -> list[Segment]:
    """Return the segments in *folder*, in the order of writing.

    Files left unfinished by a power loss are removed.
    """
    found = []
    for path in folder.iterdir():
        if path.name.endswith(_ENDING + _PART):
            path.unlink(missing_ok=True)
            continue
        match = _NAME.fullmatch(path.name)
        start_us = None if match is None else _start_us(match)
        if match is None or start_us is None:
            continue
        size = path.stat().st_size
        if size:
            found.append(Segment(path.name, int(match[3]), start_us, size))
        else:
            path.unlink(missing_ok=True)
    return sorted(found, key=lambda segment: segment.number)


def _start_us(match: re.Match[str]) -> int | None:
    try:
        moment = time.strptime(match[1], _UTC)
    except ValueError:
        return None
    return timegm(moment) * _MICRO + int(match[2])


def _time_text(stamp_us: int) -> str:
    seconds, micros = divmod(max(stamp_us, 0), _MICRO)
    moment = time.gmtime(min(seconds, _LAST_STAMP_S))
    return f"{time.strftime(_UTC, moment)}-{micros:06d}Z"


def _write_whole(path: Path, data: bytes) -> None:
    part = path.with_name(path.name + _PART)
    try:
        handle = os.open(
            part, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, _FILE_MODE
        )
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        part.rename(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def _sync_folder(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _remove_if_empty(path: Path) -> None:
    """Remove the folder *path* unless it has other files."""
    if path.is_dir() and not any(path.iterdir()):
        path.rmdir()
