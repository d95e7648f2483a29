"""BLF logs: the CAN objects that are whole, and all others counted.

The interfaces are named ``can0`` and so on, from the first channel.

The layout is that of Vector's format as published by the library Vector BLF
(T. Lorenz): a file header, then objects; an object of type 10 contains
compressed objects, which may run on into the next one. Stamps are computed as
python-can does, whose reader runs for ever on an object of size zero and ends
with a traceback where the file is cut.
"""

import struct
import zlib
from collections.abc import Generator, Iterator
from datetime import UTC, datetime
from io import BufferedReader
from typing import Final, NoReturn

from bstm_daemon.bus.logs.reader import FrameReader, FrameRow
from bstm_daemon.bus.signals.extraction import EXTENDED_MAX, FD_LENGTHS
from bstm_daemon.bus.signals.frame_chunk import FrameChunk
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.errors import LogError

_SIGNATURE: Final = b"LOBJ"
_FILE_HEADER: Final = struct.Struct("<4sL")
_START: Final = struct.Struct("<40x8H")
"""Year, month, weekday, day, hour, minute, second, millisecond."""
_OBJECT_HEADER: Final = struct.Struct("<4sHHLL")
_STAMP: Final = struct.Struct("<16xL4xQ")
"""Unit and stamp, in both versions of an object's header."""
_PER_SECOND: Final = {1: 100_000}
"""Ticks of a stamp by its unit; of all others nanoseconds."""
_CONTAINER: Final = struct.Struct("<H6xL4x")
_CONTAINER_TYPE: Final = 10
_UNPACKED, _DEFLATED = 0, 2
_SIZE_LIMIT: Final = 64 << 20
"""Bytes of one object; loggers write containers of 128 kB."""
_HEADER_SIZES: Final = {1: 32, 2: 40}
"""Bytes of an object's header by its version."""
_CLASSIC: Final = struct.Struct("<HBBL8s")
_FD: Final = struct.Struct("<HBBL5xBB5x64s")
_FD_64: Final = struct.Struct("<BBBxL4xL19xB4x")
_FRAMES: Final = {1: _CLASSIC, 86: _CLASSIC, 100: _FD, 101: _FD_64}
"""Layout behind the header, by type: CAN frame, the same with more fields,
CAN FD frame and CAN FD frame of variable size, whose bytes follow."""
_ERRORS: Final = (2, 73, 104)
_EXTENDED: Final = 1 << 31


class BlfReader(FrameReader):
    """Reads the data frames of a BLF log; ``lines`` counts objects."""

    counted = "object"

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames, as :meth:`FrameReader.chunks`."""
        with self.opened() as stream:
            start_s = self._start_s(stream)
            yield from self.in_chunks(self._frames(stream, start_s))

    def _start_s(self, stream: BufferedReader) -> float:
        """Return when the recording began, from the file header."""
        start = stream.read(_FILE_HEADER.size)
        if len(start) < _FILE_HEADER.size or not start.startswith(b"LOGG"):
            msg = f"{self.path}: has no BLF header"
            raise LogError(msg)
        size = _FILE_HEADER.unpack(start)[1]
        if not 72 <= size <= 4096:
            msg = f"{self.path}: damaged BLF header, {size} bytes long"
            raise LogError(msg)
        start += stream.read(size - len(start))
        if len(start) < size:
            msg = f"{self.path}: cut short inside the BLF header"
            raise LogError(msg)
        year, month, _, day, *clock, milli = _START.unpack_from(start)
        try:
            midnight = datetime(year, month, day, tzinfo=UTC)
            hour, minute, second = clock
            began = midnight.replace(
                hour=hour,
                minute=minute,
                second=second,
                microsecond=milli * 1000,
            )
        except ValueError:
            return 0.0
        return began.timestamp()

    def _frames(
        self, stream: BufferedReader, start_s: float
    ) -> Iterator[FrameRow]:
        tail = b""
        while not self.truncated:
            header = stream.read(_OBJECT_HEADER.size)
            if len(header) < _OBJECT_HEADER.size:
                self.truncated |= bool(header or tail.strip(b"\0"))
                return
            signature, _, _, size, kind = _OBJECT_HEADER.unpack(header)
            if signature != _SIGNATURE or not (
                _OBJECT_HEADER.size <= size <= _SIZE_LIMIT
            ):
                self._fail("no object begins here")
            body = stream.read(size - len(header))
            stream.read(size % 4)
            self.truncated |= len(body) < size - len(header)
            if kind == _CONTAINER_TYPE:
                tail += self._unpacked(body)
                tail = yield from self._contained(tail, start_s)
            else:
                self._refuse(RejectReason.NOT_A_FRAME)

    def _unpacked(self, body: bytes) -> bytes:
        if len(body) < _CONTAINER.size:
            return b""
        method, _ = _CONTAINER.unpack_from(body)
        packed = body[_CONTAINER.size :]
        if method == _UNPACKED:
            return packed
        if method != _DEFLATED:
            reason = f"compression method {method} is not known"
            self._fail(reason)
        engine = zlib.decompressobj()
        data = engine.decompress(packed, _SIZE_LIMIT)
        if engine.unconsumed_tail:
            self._fail("a container is too large")
        return data

    def _contained(
        self, data: bytes, start_s: float
    ) -> Generator[FrameRow, None, bytes]:
        """Yield the frames in *data*; return the object that is not whole."""
        place = 0
        while True:
            start = data.find(_SIGNATURE, place, place + 8)
            if start < 0 and len(data) - place >= 8:
                self._fail("no object begins here")
            if start < 0 or len(data) - start < _OBJECT_HEADER.size:
                return data[place:]
            size, kind = _OBJECT_HEADER.unpack_from(data, start)[3:]
            if not _OBJECT_HEADER.size <= size <= _SIZE_LIMIT:
                self._fail(f"an object of {size} bytes")
            if start + size > len(data):
                return data[place:]
            place = start + size
            if kind in _ERRORS:
                self._refuse(RejectReason.ERROR_FRAME)
            elif kind not in _FRAMES:
                self._refuse(RejectReason.NOT_A_FRAME)
            else:
                found = _frame(data[start:place])
                if isinstance(found, RejectReason):
                    self._refuse(found)
                    continue
                self.lines += 1
                stamp_s, channel, word, payload = found
                yield (
                    *(round((stamp_s + start_s) * 1e6), self.lines),
                    self.channel(f"can{channel - 1}"),
                    *(word & EXTENDED_MAX, word & _EXTENDED != 0, payload),
                )

    def _fail(self, reason: str) -> NoReturn:
        raise self.damaged(reason)

    def _refuse(self, reason: RejectReason) -> None:
        self.lines += 1
        self.refuse(reason, self.lines)


def _frame(one: bytes) -> tuple[float, int, int, bytes] | RejectReason:
    """Return stamp [s], channel, id with its flag and bytes of an object."""
    _, header, version, _, kind = _OBJECT_HEADER.unpack_from(one)
    layout = _FRAMES[kind]
    if _HEADER_SIZES.get(version) != header or len(one) < header + layout.size:
        return RejectReason.MALFORMED
    is_fd = False
    if layout is _CLASSIC:
        channel, flags, size, word, data = layout.unpack_from(one, header)
        is_remote = flags & 0x80 != 0
        data = data[:size]
    elif layout is _FD:
        channel, flags, code, word, fd_flags, valid, data = layout.unpack_from(
            one, header
        )
        is_remote, is_fd = flags & 0x80 != 0, fd_flags & 1 != 0
        size, data = _bytes_of(code), data[:valid]
    else:
        channel, code, valid, word, flags, extension = layout.unpack_from(
            one, header
        )
        is_remote, is_fd = flags & 0x10 != 0, flags & 0x1000 != 0
        begin, end = header + layout.size, extension or len(one)
        if end < begin:
            return RejectReason.MALFORMED
        # more bytes may be stated than there are: the others are zero
        data = one[begin : min(begin + valid, end)].ljust(valid, b"\0")
        size = _bytes_of(code)
    if is_remote and not is_fd:
        return RejectReason.REMOTE_FRAME
    if is_remote:
        # there is no remote frame in CAN FD (ISO 11898-1): one without data
        data = b""
    # a classic frame may carry a raw DLC of 9 to 15 for its 8 bytes
    sizes = range(65) if is_fd else (min(size, 8), size)
    if len(data) not in sizes:
        return RejectReason.MALFORMED
    unit, stamp = _STAMP.unpack_from(one)
    stamp_s = stamp / _PER_SECOND.get(unit, 1_000_000_000)
    return stamp_s, channel, word, data


def _bytes_of(code: int) -> int:
    """Return the bytes of a length code of CAN FD (ISO 11898-1)."""
    return FD_LENGTHS[min(code, 15)]
