"""Candump logs (``candump -l`` and ``-L``) as chunks of columns.

Two forms with the same result: the exact reading line by line
(:mod:`~bstm_daemon.bus.logs.candump_line`), and the compiled scan
(:mod:`~bstm_daemon.bus.logs.candump_scan`), which leaves to it what is not
plain. Time per line and memory do not depend on the length of the log.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.logs.candump_line import LINE_LIMIT, parse_line
from bstm_daemon.bus.logs.candump_scan import CandumpScan
from bstm_daemon.bus.logs.reader import FrameColumns, FrameReader
from bstm_daemon.bus.signals.frame_chunk import FrameChunk, join_in_file_order
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.native.loader import extension

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from io import BufferedReader
    from pathlib import Path

    from bstm_daemon.bus.logs.reader import Wanted

_CHUNK_BYTES: Final = 2 << 20


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
        compiled = extension()
        self._scan = (
            None
            if compiled is None
            else CandumpScan(
                compiled, self._number, self.why_unwanted, chunk_bytes
            )
        )

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames in file order; a chunk may be empty.

        Raises:
            FileAccessError: The file cannot be read.
            LogError: The gzip file is damaged.
        """
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
        first = self.lines + 1
        if self._scan is None:
            lines = bytes(memoryview(store)[:end]).split(b"\n")[:-1]
            self.lines += len(lines)
            chunk = self._parse_lines(enumerate(lines, first))
        else:
            found = self._scan.read(store, end, first)
            self.lines += found.lines
            for key, reason, count in found.counts:
                self.seen[key] += count
                if reason is not None:
                    self.refused[reason] += count
            left = self._parse_lines(
                (line, bytes(store[start:stop]))
                for start, stop, line in found.pending
            )
            parts = [part for part in (*found.parts, left) if len(part)]
            chunk = join_in_file_order(parts or [left])
        self.frames += len(chunk)
        return chunk

    def _parse_lines(
        self, numbered: Iterable[tuple[int, bytes]]
    ) -> FrameChunk:
        columns = FrameColumns()
        for number, line in numbered:
            found = parse_line(line[:LINE_LIMIT], self._why_unwanted)
            if isinstance(found, RejectReason):
                self.refuse(found, number)
                continue
            time_us, interface, can_id, extended, data = found
            channel = self._channel_of[interface]
            columns.add(time_us, number, channel, can_id, extended, data)
        return columns.chunk()

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
