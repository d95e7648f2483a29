"""Candump logs (``candump -l`` and ``-L``) as chunks of columns.

Time per line and memory do not depend on the length of the log. Plain lines
are read by the compiled scan (:mod:`~bstm_daemon.bus.candump_scan`) where it
is there, lines that look like most others as columns
(:mod:`~bstm_daemon.bus.candump_layout`), all others one by one
(:mod:`~bstm_daemon.bus.candump_line`).
"""

import gzip
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from io import BufferedIOBase
from pathlib import Path
from typing import Final, cast

import numpy as np

from bstm_daemon.bus.candump_layout import (
    PADDING,
    Channel,
    Integers,
    Layout,
    LayoutKey,
    Text,
    layout_key,
)
from bstm_daemon.bus.candump_line import (
    LINE_LIMIT,
    Frame,
    parse_line,
    read_header,
)
from bstm_daemon.bus.candump_scan import CandumpScan, Key
from bstm_daemon.bus.compiled import extension
from bstm_daemon.bus.frame_chunk import (
    FrameChunk,
    empty_chunk,
    join_in_file_order,
)
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.errors import FileAccessError, LogError

Wanted = Callable[[str], Collection[tuple[int, bool]] | None]
"""Gives the (id, extended) to read from an interface, by its name.

``None`` for an interface that is not to be read at all.
"""

_CHUNK_BYTES: Final = 2 << 20
_CHUNK_BYTES_NUMPY: Final = 4 << 20
"""Longer: a message costs some calls of NumPy in each chunk."""
_LAYOUT_LIMIT: Final = 64
_LINES_KEPT: Final = 5
_NOT_KEPT: Final = (Refusal.UNKNOWN_ID, Refusal.UNKNOWN_INTERFACE)
_NEWLINE: Final = ord("\n")


class CandumpReader:
    """Reads one log, once.

    ``lines`` counts the lines read, ``frames`` the data frames handed out
    and ``refused`` the other lines by reason, so that they add up.
    ``first_refused`` keeps the first line numbers of each reason (not of
    frames that are merely not wanted),
    ``seen`` counts frames by (channel, id, extended) whether wanted or not,
    ``interfaces`` lists the interface names in order of appearance.
    ``truncated`` tells of a gzip file without its end.
    """

    def __init__(
        self,
        path: Path,
        wanted: Wanted | None = None,
        *,
        chunk_bytes: int | None = None,
        columns: bool = True,
    ) -> None:
        """Prepare to read *path*, every id of every interface by default.

        The compiled scan is taken where it is there. Without *columns* every
        line is parsed on its own: the same result, slowly, for tests.
        """
        self.path = path
        self.interfaces: list[str] = []
        self.lines = 0
        self.frames = 0
        self.refused: Counter[Refusal] = Counter()
        self.first_refused: dict[Refusal, list[int]] = {}
        self.seen: Counter[tuple[int, int, bool]] = Counter()
        self.truncated = False
        self._wanted = wanted
        self._columns = columns
        self._channels: dict[bytes, Channel] = {}
        self._layouts: dict[LayoutKey, Layout] = {}
        compiled = extension() if columns else None
        if chunk_bytes is None:
            chunk_bytes = _CHUNK_BYTES if compiled else _CHUNK_BYTES_NUMPY
        self._chunk_bytes = chunk_bytes
        self._compiled = (
            None
            if compiled is None
            else CandumpScan(
                compiled, self._channels, self._channel, chunk_bytes
            )
        )

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames in file order.

        A chunk may be empty. Raises :class:`FileAccessError` and, for a
        damaged gzip file, :class:`LogError`.
        """
        try:
            with self._open() as stream:
                for store, end in self._texts(stream):
                    yield self._parse(store, end)
        except (gzip.BadGzipFile, zlib.error) as error:
            msg = f"{self.path}: damaged after line {self.lines}: {error}"
            raise LogError(msg) from error
        except OSError as error:
            msg = f"{self.path}: cannot be read: {error.strerror or error}"
            raise FileAccessError(msg) from error

    def _open(self) -> BufferedIOBase:
        if self.path.suffix == ".gz":
            return cast("BufferedIOBase", gzip.open(self.path))
        return self.path.open("rb")

    def _texts(
        self, stream: BufferedIOBase
    ) -> Iterator[tuple[bytearray, int]]:
        """Yield runs of whole lines, each with its end.

        A newline ends them, added where the last line of a log lacks it.

        Of a line without end, its first ``LINE_LIMIT`` bytes are kept: the
        verdict on any line rests on those.
        """
        room = self._chunk_bytes + LINE_LIMIT + 1
        store = bytearray(room + 1 + PADDING)
        view = memoryview(store)
        kept = 0
        while count := self._fill(stream, view[kept:room]):
            end = kept + count
            cut = store.rfind(b"\n", kept, end) + 1
            if cut:
                yield store, cut
            kept = min(end - cut, LINE_LIMIT + 1)
            store[:kept] = store[cut : cut + kept]
        if kept:
            store[kept] = _NEWLINE
            yield store, kept + 1

    def _fill(self, stream: BufferedIOBase, room: memoryview) -> int:
        filled = 0
        try:
            while filled < len(room):
                # not readinto(): it loses what precedes a missing end
                count = stream.readinto1(room[filled:])
                if not count:
                    break
                filled += count
        except EOFError:
            self.truncated = True
        return filled

    def _text(self, store: bytearray, end: int) -> Text:
        buffer = np.frombuffer(store, np.uint8)
        newlines = np.flatnonzero(buffer[:end] == _NEWLINE)
        starts = np.empty_like(newlines)
        starts[0] = 0
        np.add(newlines[:-1], 1, out=starts[1:])
        ends = newlines
        if (newlines - starts).max() > LINE_LIMIT:
            ends = np.minimum(newlines, starts + LINE_LIMIT)
        numbers = np.arange(self.lines + 1, self.lines + len(newlines) + 1)
        return Text(buffer, starts, ends, numbers)

    def _parse(self, store: bytearray, end: int) -> FrameChunk:
        parts: list[FrameChunk] = []
        if self._compiled is None:
            text = self._text(store, end)
            self.lines += len(text.ends)
        else:
            scanned = self._compiled.read(store, end, self.lines + 1)
            text, parts = scanned.pending, scanned.parts
            self.lines += scanned.lines
            for key, count in scanned.settled:
                self._tally(key, count)
        self._parse_text(text, parts)
        chunk = join_in_file_order(parts) if parts else empty_chunk()
        self.frames += len(chunk)
        return chunk

    def _tally(self, key: Key, count: int) -> None:
        self.seen[key.channel.number, key.can_id, key.extended] += count
        if not key.wanted:
            self.refused[_unwanted(key.channel)] += count

    def _parse_text(self, text: Text, parts: list[FrameChunk]) -> None:
        """Add the frames of all lines of *text* to *parts*."""
        pending: Integers = np.arange(len(text.ends))
        for layout in list(self._layouts.values()):
            if not pending.size:
                break
            pending = self._scan(layout, text, pending, parts)
        singles = []
        while pending.size:
            index = int(pending[0])
            layout_found = self._new_layout(text.line(index))
            if layout_found is None:
                singles.append(index)
                pending = pending[1:]
            else:
                pending = self._scan(layout_found, text, pending, parts)
        if singles:
            parts.append(self._parse_singles(text, singles))

    def _scan(
        self,
        layout: Layout,
        text: Text,
        pending: Integers,
        parts: list[FrameChunk],
    ) -> Integers:
        scan = layout.scan(text, pending)
        channel = layout.channel
        if scan.refused:
            self.refused[_unwanted(channel)] += scan.refused
        for can_id, count in zip(
            scan.ids.tolist(), scan.counts.tolist(), strict=True
        ):
            self.seen[channel.number, can_id, layout.extended] += count
        parts += scan.parts
        return scan.pending

    def _new_layout(self, line: bytes) -> Layout | None:
        """Return the layout of *line* unless there is none or it is known."""
        header = read_header(line)
        if header is None:
            return None
        channel = self._channel(header.interface)
        key = layout_key(line, header)
        if (
            not self._columns
            or key is None
            or key in self._layouts
            or len(self._layouts) >= _LAYOUT_LIMIT
        ):
            return None
        self._layouts[key] = Layout(key, channel)
        return self._layouts[key]

    def _channel(self, interface: bytes) -> Channel:
        channel = self._channels.get(interface)
        if channel is None:
            name = interface.decode("utf-8", "backslashreplace")
            self.interfaces.append(name)
            channel = Channel(
                len(self._channels),
                self._wanted(name) if self._wanted else None,
                everything=self._wanted is None,
            )
            self._channels[interface] = channel
        return channel

    def _parse_singles(self, text: Text, indices: list[int]) -> FrameChunk:
        frames: list[Frame] = []
        lines = []
        for index in indices:
            line = int(text.numbers[index])
            found = parse_line(text.line(index), self._judge)
            if isinstance(found, Refusal):
                self._refuse(found, line)
            else:
                frames.append(found)
                lines.append(line)
        channels = [self._channel(frame.interface).number for frame in frames]
        longest = max((len(frame.data) for frame in frames), default=0)
        width = 8 if longest <= 8 else 64
        data = b"".join(frame.data.ljust(width, b"\0") for frame in frames)
        return FrameChunk(
            time_us=np.array([frame.time_us for frame in frames], np.int64),
            line=np.array(lines, np.int64),
            channel=np.array(channels, np.int16),
            can_id=np.array([frame.can_id for frame in frames], np.uint32),
            extended=np.array([frame.extended for frame in frames], np.bool_),
            length=np.array([len(frame.data) for frame in frames], np.uint8),
            data=np.frombuffer(data, np.uint8).reshape(len(frames), width),
        )

    def _judge(
        self,
        interface: bytes,
        can_id: int,
        extended: bool,  # noqa: FBT001
    ) -> Refusal | None:
        channel = self._channel(interface)
        self.seen[channel.number, can_id, extended] += 1
        wanted = channel.known and channel.wants(can_id, extended)
        return None if wanted else _unwanted(channel)

    def _refuse(self, reason: Refusal, line: int) -> None:
        self.refused[reason] += 1
        if reason in _NOT_KEPT:
            return
        first = self.first_refused.setdefault(reason, [])
        if len(first) < _LINES_KEPT:
            first.append(line)


def _unwanted(channel: Channel) -> Refusal:
    """Why a frame of *channel* is not read."""
    return Refusal.UNKNOWN_ID if channel.known else Refusal.UNKNOWN_INTERFACE
