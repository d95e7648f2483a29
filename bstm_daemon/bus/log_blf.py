"""The sound CAN objects of a BLF file, as a smaller BLF stream.

python-can's reader runs for ever on an object of size zero, reads to the end
of the file for a negative size and ends with a traceback where the file is
cut. It gets what :class:`BlfFeed` lets through: the file header and then
containers with whole CAN frame objects only.

The layout is that of Vector's format as published by the library Vector BLF
(T. Lorenz): a file header, then objects; an object of type 10 contains
compressed objects, which may run on into the next one.
"""

from __future__ import annotations

import struct
import zlib
from collections import deque
from typing import TYPE_CHECKING, Final, NoReturn, Protocol

from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bstm_daemon.bus.log_reader import FrameLedger

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


class BlfFeed:
    """A file for python-can's BLF reader.

    ``lines`` has the numbers of the objects handed over whose frames have
    not been taken yet; all other objects are counted in the ledger.
    """

    def __init__(self, source: Source, ledger: FrameLedger) -> None:
        """Take the file header from *source*.

        Raises :class:`LogError` where there is none.
        """
        self.lines: deque[int] = deque()
        self._source = source
        self._ledger = ledger
        self._tail = b""
        start = source.read(_FILE_HEADER.size)
        if len(start) < _FILE_HEADER.size or not start.startswith(b"LOGG"):
            msg = f"{ledger.path}: has no BLF header"
            raise LogError(msg)
        size = _FILE_HEADER.unpack(start)[1]
        if not 72 <= size <= 4096:
            msg = f"{ledger.path}: damaged BLF header, {size} bytes long"
            raise LogError(msg)
        rest = source.read(size - len(start))
        if len(rest) < size - len(start):
            msg = f"{ledger.path}: cut short inside the BLF header"
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
        """Do nothing: whoever opened the source closes it."""

    def _clean(self) -> Iterator[bytes]:
        while True:
            header = self._source.read(_OBJECT_HEADER.size)
            if len(header) < _OBJECT_HEADER.size:
                self._ledger.truncated |= bool(header) or bool(
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
                self._ledger.truncated = True
            if kind == _CONTAINER_TYPE:
                kept = self._sound_objects(self._unpacked(body))
                if kept:
                    yield _container(kept)
            else:
                self._refuse(Refusal.NOT_A_FRAME)
            if self._ledger.truncated:
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
                self._refuse(Refusal.ERROR_FRAME)
            elif kind not in _FRAMES:
                self._refuse(Refusal.NOT_A_FRAME)
            elif _is_sound(data[start:place], header, version, kind):
                self._ledger.lines += 1
                self.lines.append(self._ledger.lines)
                kept.append(data[start:place] + bytes(-size % 4))
            else:
                self._refuse(Refusal.MALFORMED)
        self._tail = data[place:]
        return b"".join(kept)

    def _refuse(self, reason: Refusal) -> None:
        self._ledger.lines += 1
        self._ledger.refuse(reason, self._ledger.lines)

    def _fail(self, reason: str) -> NoReturn:
        msg = (
            f"{self._ledger.path}: damaged after object "
            f"{self._ledger.lines}: {reason}"
        )
        raise LogError(msg)


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
