"""Candump logs (``candump -l`` and ``-L``) as chunks of columns.

Two forms with the same result: the exact reading line by line
(:mod:`~bstm_daemon.bus.logs.candump_line`), and the compiled scan
(``candump.c``), which leaves to it what is not plain. It stops where Python
has to decide: at an interface that is new, at an id for which it is not yet
known whether it is wanted, and at the first CAN FD frame, which needs wider
payloads. Time per line and memory do not depend on the length of the log.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from io import BufferedReader
from pathlib import Path
from typing import Final

import numpy as np

from bstm_daemon.bus.logs.candump_line import LINE_LIMIT, parse_line
from bstm_daemon.bus.logs.reader import FrameReader, FrameRow, Wanted, chunk_of
from bstm_daemon.bus.signals.extraction import EXTENDED_MAX
from bstm_daemon.bus.signals.frame_chunk import (
    FrameChunk,
    columns_for,
    columns_of,
    join_in_file_order,
    rows_of,
)
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.native.loader import BusExtension, extension

_CHUNK_BYTES: Final = 2 << 20
_NAMES_LIMIT: Final = 64
_KEY_SLOTS: Final = 2048
_KEYS_LIMIT: Final = _KEY_SLOTS // 2
_BYTES_PER_LINE: Final = 32
"""Room for a chunk of lines this long; of shorter ones it takes more calls."""

# state of the scan, as in candump.c
_POSITION, _LINE, _FRAMES, _PENDING, _A, _B, _NAMES_FULL, _KEYS_FULL = range(8)
_DONE, _NEW_NAME, _NEW_KEY, _NO_ROOM, _NEED_WIDE = range(5)
_KEY, _WANTED, _COUNT = range(3)


class CandumpReader(FrameReader):
    """Reads a candump log, packed with gzip where it ends in ``.gz``.

    ``truncated`` is set by a gzip file without its end.
    """

    def __init__(
        self,
        path: Path,
        wanted: Wanted | None = None,
        *,
        chunk_bytes: int = _CHUNK_BYTES,
    ) -> None:
        """Prepare to read *path*, every id of every interface by default.

        Args:
            path: The log.
            wanted: What to read; None for all.
            chunk_bytes: Text that becomes one chunk [byte].
        """
        super().__init__(path, wanted)
        self._chunk_bytes = chunk_bytes
        self._channel_of: dict[bytes, int] = {}
        self._compiled = extension()
        if self._compiled is not None:
            room = chunk_bytes // _BYTES_PER_LINE + 1
            self._names = b""
            self._keys = np.zeros((_KEY_SLOTS, 3), np.int64)
            self._key_of_slot: dict[int, tuple[int, int, bool]] = {}
            self._state = np.zeros(8, np.int64)
            self._pending = np.empty((room, 3), np.int64)
            self._columns = columns_for(room)

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames, as :meth:`FrameReader.chunks`."""
        with self.opened() as stream:
            for store, end in self._whole_lines(stream):
                chunk = self._parse(store, end)
                self.note_share()
                yield chunk

    def _whole_lines(
        self, stream: BufferedReader
    ) -> Iterator[tuple[bytearray, int]]:
        """Yield runs of whole lines, each with its end.

        A newline ends them, added where the last line of a log lacks it.

        Of a line without end, its first ``LINE_LIMIT`` bytes are kept: they
        alone decide what a line is.
        """
        room = self._chunk_bytes + LINE_LIMIT + 1
        store = bytearray(room + 1)
        view = memoryview(store)
        kept = 0
        while count := _fill(stream, view[kept:room]):
            end = kept + count
            cut = store.rfind(b"\n", kept, end) + 1
            if cut:
                yield store, cut
            kept = min(end - cut, LINE_LIMIT + 1)
            store[:kept] = store[cut : cut + kept]
        if kept:
            store[kept] = ord("\n")
            yield store, kept + 1

    def _parse(self, store: bytearray, end: int) -> FrameChunk:
        if self._compiled is None:
            lines = bytes(memoryview(store)[:end]).split(b"\n")[:-1]
            first = self.lines + 1
            self.lines += len(lines)
            chunk = chunk_of(self._rows(enumerate(lines, first)))
        else:
            found, pending = self._scanned(self._compiled, store, end)
            left = chunk_of(
                self._rows(
                    (line, bytes(store[start:stop]))
                    for start, stop, line in pending
                )
            )
            parts = [part for part in (*found, left) if len(part)]
            chunk = join_in_file_order(parts or [left])
        self.frames += len(chunk)
        return chunk

    def _scanned(
        self, compiled: BusExtension, store: bytearray, end: int
    ) -> tuple[list[FrameChunk], list[tuple[int, ...]]]:
        """Scan the whole lines in *store* up to *end*, and count them.

        Returns the frames, and the lines left: start, end, line number.
        """
        state = self._state
        state[_POSITION] = 0
        state[_LINE] = self.lines + 1
        parts: list[FrameChunk] = []
        pending: list[tuple[int, ...]] = []
        stop = -1
        while stop != _DONE:
            stop = compiled.scan(
                *(store, end, self._names, self._keys, state),
                *(*columns_of(self._columns), self._pending),
            )
            if stop == _NEW_NAME:
                start = int(state[_A])
                name = bytes(store[start : start + int(state[_B])])
                full = self._number(name) + 1 >= _NAMES_LIMIT
                self._names += name + b"\n"
                state[_NAMES_FULL] = full
            elif stop == _NEW_KEY:
                self._decide(int(state[_A]))
            else:
                parts.append(self._copied(int(state[_FRAMES])))
                left = int(state[_PENDING])
                pending += map(tuple, self._pending[:left].tolist())
                state[_FRAMES] = state[_PENDING] = 0
                if stop == _NEED_WIDE:
                    self._columns = columns_for(len(self._pending), 64)
        self.lines = int(state[_LINE]) - 1
        counts = self._keys[:, _COUNT]
        for slot in np.flatnonzero(counts).tolist():
            key, count = self._key_of_slot[slot], int(counts[slot])
            self.seen[key] += count
            reason = self.why_unwanted(*key)
            if reason is not None:
                self.refused[reason] += count
        counts[:] = 0
        return parts, pending

    def _decide(self, slot: int) -> None:
        packed = int(self._keys[slot, _KEY])
        key = (packed >> 32) - 1, packed & EXTENDED_MAX, bool(packed >> 31 & 1)
        self._key_of_slot[slot] = key
        self._keys[slot, _WANTED] = self.why_unwanted(*key) is None
        self._state[_KEYS_FULL] = len(self._key_of_slot) >= _KEYS_LIMIT

    def _copied(self, count: int) -> FrameChunk:
        found = rows_of(self._columns, slice(count))
        width = 8 if found.length.max(initial=0) <= 8 else 64
        found = replace(found, data=found.data[:, :width])
        return FrameChunk(*(column.copy() for column in columns_of(found)))

    def _rows(
        self, numbered: Iterable[tuple[int, bytes]]
    ) -> Iterator[FrameRow]:
        for number, line in numbered:
            found = parse_line(line[:LINE_LIMIT], self._why_unwanted)
            if isinstance(found, RejectReason):
                self.refuse(found, number)
                continue
            time_us, interface, can_id, extended, data = found
            channel = self._channel_of[interface]
            yield time_us, number, channel, can_id, extended, data

    def _why_unwanted(
        self,
        interface: bytes,
        can_id: int,
        extended: bool,  # noqa: FBT001  (part of a frame's key)
    ) -> RejectReason | None:
        """Count a sound frame; return why it is not read, if so."""
        channel = self._number(interface)
        self.seen[channel, can_id, extended] += 1
        return self.why_unwanted(channel, can_id, extended)

    def _number(self, interface: bytes) -> int:
        number = self._channel_of.get(interface)
        if number is None:
            name = interface.decode("utf-8", "backslashreplace")
            number = self._channel_of[interface] = self.add_interface(name)
        return number


def _fill(stream: BufferedReader, room: memoryview) -> int:
    """Read until *room* is full or the log ends; return the bytes read.

    Part by part: within one ``readinto`` no signal would be answered.
    """
    filled = 0
    while filled < len(room) and (count := stream.readinto1(room[filled:])):
        filled += count
    return filled
