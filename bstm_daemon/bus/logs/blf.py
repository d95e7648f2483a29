"""BLF logs through python-can, which gets the sound CAN objects only.

The interfaces are named ``can0`` and so on, from the first channel.

python-can's reader runs for ever on an object of size zero, reads to the end
of the file for a negative size and ends with a traceback where the file is
cut. It gets what :class:`BlfFeed` lets through: the file header and then
containers with whole CAN frame objects only.

The layout is that of Vector's format as published by the library Vector BLF
(T. Lorenz): a file header, then objects; an object of type 10 contains
compressed objects, which may run on into the next one.
"""

from __future__ import annotations

import logging
import struct
import zlib
from collections import deque
from typing import TYPE_CHECKING, Final, NoReturn, Protocol, cast

from can.io.blf import BLFReader

from bstm_daemon.bus.logs.reader import FrameColumns, FrameReader
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import BinaryIO

    from can import Message

    from bstm_daemon.bus.logs.reader import Wanted
    from bstm_daemon.bus.signals.frame_chunk import FrameChunk

CHUNK_FRAMES: Final = 20_000

_SIGNATURE: Final = b"LOBJ"
_FILE_HEADER: Final = struct.Struct("<4sL")
_OBJECT_HEADER: Final = struct.Struct("<4sHHLL")
_CONTAINER: Final = struct.Struct("<H6xL4x")
_CONTAINER_TYPE: Final = 10
_UNPACKED, _DEFLATED = 0, 2
_SIZE_LIMIT: Final = 64 << 20
"""Bytes of one object; loggers write containers of 128 kB."""
_HEADER_SIZES: Final = {1: 32, 2: 40}
"""Bytes of an object's header by its version."""
_FRAMES: Final = {1: 16, 86: 16, 100: 84, 101: 40}
"""Fewest bytes behind the header, by type: CAN frame, the same with more
fields, CAN FD frame and CAN FD frame of variable size."""
_FD_64: Final = 101
_FD_64_EXTENSION: Final = 35
_ERRORS: Final = (2, 73, 104)


class Source(Protocol):
    """Where bytes come from."""

    def read(self, size: int, /) -> bytes:
        """Return up to *size* bytes."""


class BlfReader(FrameReader):
    """Reads the data frames of a BLF log; ``lines`` counts objects."""

    counted = "object"

    def __init__(
        self,
        path: Path,
        wanted: Wanted | None = None,
        *,
        chunk_frames: int = CHUNK_FRAMES,
    ) -> None:
        """Prepare to read *path*, every id of every interface by default."""
        super().__init__(path, wanted)
        self._chunk_frames = chunk_frames

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames in file order.

        Raises:
            FileAccessError: The file cannot be read.
            LogError: The log is damaged.
        """
        # what it logs about single objects is counted here
        logging.getLogger("can.io").setLevel(logging.ERROR)
        columns = FrameColumns()
        with self.opened() as stream:
            feed = BlfFeed(stream, self)
            messages = iter(BLFReader(cast("BinaryIO", feed)))
            while (message := self._next(messages)) is not None:
                line = feed.lines.popleft()
                reason = _why_refused(message)
                if reason is not None:
                    self.refuse(reason, line)
                    continue
                columns.add(
                    round(message.timestamp * 1e6),
                    line,
                    self.channel(f"can{message.channel}"),
                    message.arbitration_id,
                    message.is_extended_id,
                    bytes(message.data),
                )
                if len(columns) >= self._chunk_frames:
                    yield self.wanted_frames(columns.chunk())
                    columns = FrameColumns()
            yield self.wanted_frames(columns.chunk())

    def _next(self, messages: Iterator[Message]) -> Message | None:
        try:
            return next(messages, None)
        except (ValueError, LookupError, TypeError, OverflowError) as error:
            raise self.damaged(error) from error


def _why_refused(message: Message) -> RejectReason | None:
    """Return why *message* is no data frame with all of its bytes."""
    if message.is_error_frame:
        return RejectReason.ERROR_FRAME
    # there is no remote frame in CAN FD (ISO 11898-1): python-can makes one
    # of every FD frame without data
    if message.is_remote_frame and not message.is_fd:
        return RejectReason.REMOTE_FRAME
    size = len(message.data)
    if message.is_remote_frame or message.is_fd:
        return None if size <= 64 else RejectReason.MALFORMED
    # a classic frame may carry a raw DLC of 9 to 15 for its 8 bytes
    whole = size == min(message.dlc, 8) or size == message.dlc
    return None if whole else RejectReason.MALFORMED


class BlfFeed:
    """A file for python-can's BLF reader.

    ``lines`` has the numbers of the objects handed over whose frames have
    not been taken yet; all other objects are counted in the reader.
    """

    def __init__(self, source: Source, reader: FrameReader) -> None:
        """Take the file header from *source*.

        Raises :class:`LogError` where there is none.
        """
        self.lines: deque[int] = deque()
        self._source = source
        self._reader = reader
        self._tail = b""
        start = source.read(_FILE_HEADER.size)
        if len(start) < _FILE_HEADER.size or not start.startswith(b"LOGG"):
            msg = f"{reader.path}: has no BLF header"
            raise LogError(msg)
        size = _FILE_HEADER.unpack(start)[1]
        if not 72 <= size <= 4096:
            msg = f"{reader.path}: damaged BLF header, {size} bytes long"
            raise LogError(msg)
        rest = source.read(size - len(start))
        if len(rest) < size - len(start):
            msg = f"{reader.path}: cut short inside the BLF header"
            raise LogError(msg)
        self._store = start + rest
        self._containers = self._clean()

    def read(self, size: int) -> bytes:
        """Return the next *size* bytes, fewer at the end only."""
        while len(self._store) < size:
            container = next(self._containers, None)
            if container is None:
                break
            self._store += container
        found, self._store = self._store[:size], self._store[size:]
        return found

    def close(self) -> None:
        """Do nothing: the source is closed where it was opened."""

    def _clean(self) -> Iterator[bytes]:
        while True:
            header = self._source.read(_OBJECT_HEADER.size)
            if len(header) < _OBJECT_HEADER.size:
                self._reader.truncated |= bool(header) or bool(
                    self._tail.strip(b"\0")
                )
                return
            signature, _, _, size, kind = _OBJECT_HEADER.unpack(header)
            if signature != _SIGNATURE or not (
                _OBJECT_HEADER.size <= size <= _SIZE_LIMIT
            ):
                self._fail("no object begins here")
            body = self._source.read(size - len(header))
            self._source.read(size % 4)
            if len(body) < size - len(header):
                self._reader.truncated = True
            if kind == _CONTAINER_TYPE:
                kept = self._sound_objects(self._unpacked(body))
                if kept:
                    yield _container(kept)
            else:
                self._refuse(RejectReason.NOT_A_FRAME)
            if self._reader.truncated:
                return

    def _unpacked(self, body: bytes) -> bytes:
        if len(body) < _CONTAINER.size:
            return b""
        method, _ = _CONTAINER.unpack_from(body)
        packed = body[_CONTAINER.size :]
        if method == _UNPACKED:
            return packed
        if method != _DEFLATED:
            self._fail(f"compression method {method} is not known")
        engine = zlib.decompressobj()
        try:
            data = engine.decompress(packed, _SIZE_LIMIT)
        except zlib.error as error:
            self._fail(str(error))
        if engine.unconsumed_tail:
            self._fail("a container is too large")
        return data

    def _sound_objects(self, data: bytes) -> bytes:
        data = self._tail + data
        kept = []
        place = 0
        while True:
            start = data.find(_SIGNATURE, place, place + 8)
            if start < 0:
                if len(data) - place >= 8:
                    self._fail("no object begins here")
                break
            if len(data) - start < _OBJECT_HEADER.size:
                break
            _, header, version, size, kind = _OBJECT_HEADER.unpack_from(
                data, start
            )
            if not _OBJECT_HEADER.size <= size <= _SIZE_LIMIT:
                self._fail(f"an object of {size} bytes")
            if start + size > len(data):
                break
            place = start + size
            if kind in _ERRORS:
                self._refuse(RejectReason.ERROR_FRAME)
            elif kind not in _FRAMES:
                self._refuse(RejectReason.NOT_A_FRAME)
            elif _is_sound(data[start:place], header, version, kind):
                self._reader.lines += 1
                self.lines.append(self._reader.lines)
                kept.append(data[start:place] + bytes(-size % 4))
            else:
                self._refuse(RejectReason.MALFORMED)
        self._tail = data[place:]
        return b"".join(kept)

    def _refuse(self, reason: RejectReason) -> None:
        self._reader.lines += 1
        self._reader.refuse(reason, self._reader.lines)

    def _fail(self, reason: str) -> NoReturn:
        raise self._reader.damaged(reason)


def _is_sound(one: bytes, header: int, version: int, kind: int) -> bool:
    """Whether the object *one* has all bytes of its frame."""
    if _HEADER_SIZES.get(version) != header:
        return False
    if len(one) < header + _FRAMES[kind]:
        return False
    if kind == _FD_64:
        extension = one[header + _FD_64_EXTENSION]
        return extension == 0 or extension >= header + _FRAMES[kind]
    return True


def _container(objects: bytes) -> bytes:
    size = _OBJECT_HEADER.size + _CONTAINER.size + len(objects)
    return (
        _OBJECT_HEADER.pack(
            _SIGNATURE, _OBJECT_HEADER.size, 1, size, _CONTAINER_TYPE
        )
        + _CONTAINER.pack(_UNPACKED, len(objects))
        + objects
    )
