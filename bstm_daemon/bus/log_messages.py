"""ASC, BLF, TRC and CSV logs through python-can's readers.

Interfaces are named after python-can's channel numbers: ``can0`` is the
first channel, numbered 1 in an ASC, BLF or TRC file. A log without channels
(CSV, TRC before 1.3) has ``can0`` alone. Stamps are as python-can gives
them: those of an ASC file begin near zero, all others are absolute where the
file says when it began.
"""

from __future__ import annotations

import gzip
import logging
import zlib
from collections import deque
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, Protocol, cast

from can.io.asc import ASCReader
from can.io.blf import BLFReader
from can.io.csv import CSVReader
from can.io.trc import TRCReader

from bstm_daemon.bus.candump_line import LINE_LIMIT
from bstm_daemon.bus.log_blf import BlfFeed
from bstm_daemon.bus.log_reader import FrameLedger, frame_chunk
from bstm_daemon.bus.log_text_guards import (
    AscGuard,
    CsvGuard,
    TrcGuard,
    Verdict,
)
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.errors import FileAccessError, LogError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path
    from typing import BinaryIO

    from can import Message

    from bstm_daemon.bus.candump import Wanted
    from bstm_daemon.bus.frame_chunk import FrameChunk

CHUNK_FRAMES: Final = 20_000

_TEXT: Final[dict[str, tuple[type[Any], type[Guard], int]]] = {
    ".asc": (ASCReader, AscGuard, 0),
    ".csv": (CSVReader, CsvGuard, 0),
    ".trc": (TRCReader, TrcGuard, 1),
}
"""By ending: python-can's reader, our guard, python-can's first channel."""


class Guard(Protocol):
    """Judges lines; ``header_end`` goes behind the header if not ""."""

    header_end: str

    def judge(self, line: str) -> Verdict:
        """Return what is in *line*."""

    def handed_over(self, line: str) -> str:
        """Return a *line* with a frame, judged last, for python-can."""


class MessageReader(FrameLedger):
    """A :class:`~bstm_daemon.bus.log_reader.FrameReader`, by its ending.

    The endings are ``.asc``, ``.blf``, ``.csv`` and ``.trc``, each also with
    ``.gz`` behind it.
    """

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
        self._packed = path.suffix.lower() == ".gz"
        ending = path.suffixes[-2] if self._packed else path.suffix
        self._ending = ending.lower()

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames in file order.

        Raises :class:`FileAccessError` and, for a damaged log,
        :class:`LogError`.
        """
        try:
            size = max(self.path.stat().st_size, 1)
            with self.path.open("rb") as file, self._opened(file) as source:
                for chunk in self._chunks(source):
                    self.share = min(file.tell() / size, 1.0)
                    yield chunk
        except (gzip.BadGzipFile, zlib.error) as error:
            raise self._damaged(error) from error
        except OSError as error:
            msg = f"{self.path}: cannot be read: {error.strerror or error}"
            raise FileAccessError(msg) from error

    @contextmanager
    def _opened(
        self, file: BinaryIO
    ) -> Iterator[tuple[Iterable[Message], deque[int], int]]:
        """Open python-can's reader, the line numbers, its first channel."""
        stream = (
            cast("BinaryIO", gzip.GzipFile(fileobj=file))
            if self._packed
            else file
        )
        source = _Tolerant(stream, self)
        # what it remarks on single lines, the guards have counted
        logging.getLogger("can.io").setLevel(logging.ERROR)
        if self._ending == ".blf":
            feed = BlfFeed(source, self)
            yield BLFReader(cast("BinaryIO", feed)), feed.lines, 0
            return
        reader, guard, first = _TEXT[self._ending]
        lines = _GuardedLines(source, guard(), self)
        yield reader(lines), lines.lines, first

    def _chunks(
        self, source: tuple[Iterable[Message], deque[int], int]
    ) -> Iterator[FrameChunk]:
        reader, lines, first = source
        columns = _Columns()
        messages = iter(reader)
        while (message := self._next(messages)) is not None:
            line = lines.popleft()
            reason = _refusal(message)
            if reason is not None:
                self.refuse(reason, line)
                continue
            columns.add(message, line, self._channel_of(message, first))
            if len(columns.line) >= self._chunk_frames:
                yield self.settle(columns.chunk())
                columns = _Columns()
        yield self.settle(columns.chunk())

    def _next(self, messages: Iterator[Message]) -> Message | None:
        try:
            return next(messages, None)
        except (ValueError, LookupError, TypeError, OverflowError) as error:
            raise self._damaged(error) from error

    def _channel_of(self, message: Message, first: int) -> int:
        channel = message.channel
        if isinstance(channel, int):
            return self.channel(f"can{channel - first}")
        return self.channel("can0" if channel is None else str(channel))

    def _damaged(self, error: Exception) -> LogError:
        what = "object" if self._ending == ".blf" else "line"
        return LogError(
            f"{self.path}: damaged after {what} {self.lines}: {error}"
        )


class _Columns:
    """Frames on their way into a chunk."""

    def __init__(self) -> None:
        self.time_us: list[int] = []
        self.line: list[int] = []
        self.channel: list[int] = []
        self.can_id: list[int] = []
        self.extended: list[bool] = []
        self.data: list[bytes] = []

    def add(self, message: Message, line: int, channel: int) -> None:
        self.time_us.append(round(message.timestamp * 1e6))
        self.line.append(line)
        self.channel.append(channel)
        self.can_id.append(message.arbitration_id)
        self.extended.append(message.is_extended_id)
        self.data.append(bytes(message.data))

    def chunk(self) -> FrameChunk:
        return frame_chunk(
            self.time_us,
            self.line,
            self.channel,
            self.can_id,
            self.extended,
            self.data,
        )


def _refusal(message: Message) -> Refusal | None:
    """Return why *message* is no data frame with all of its bytes."""
    if message.is_error_frame:
        return Refusal.ERROR_FRAME
    # there is no remote frame in CAN FD (ISO 11898-1): python-can makes one
    # of every FD frame without data
    if message.is_remote_frame and not message.is_fd:
        return Refusal.REMOTE_FRAME
    size = len(message.data)
    if message.is_remote_frame or message.is_fd:
        return None if size <= 64 else Refusal.MALFORMED
    # a classic frame may carry a raw DLC of 9 to 15 for its 8 bytes
    whole = size == min(message.dlc, 8) or size == message.dlc
    return None if whole else Refusal.MALFORMED


class _Tolerant:
    """A file that ends where a gzip file is cut off."""

    def __init__(self, stream: BinaryIO, ledger: FrameLedger) -> None:
        self._stream = stream
        self._ledger = ledger

    def read(self, size: int) -> bytes:
        """Return up to *size* bytes, fewer at the end only."""
        try:
            return self._stream.read(size)
        except EOFError:
            self._ledger.truncated = True
            return b""

    def readline(self, size: int) -> bytes:
        """Return up to *size* bytes, to the end of the line at most."""
        try:
            return self._stream.readline(size)
        except EOFError:
            self._ledger.truncated = True
            return b""


class _GuardedLines:
    """The lines with a data frame, and those of the header.

    ``lines`` has the number of the line handed over last, until its frame
    is taken.
    """

    def __init__(
        self, source: _Tolerant, guard: Guard, ledger: FrameLedger
    ) -> None:
        self.lines: deque[int] = deque()
        self._source = source
        self._guard = guard
        self._ledger = ledger
        self._held: list[str] = []
        self._in_header = True

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if self._held:
            return self._held.pop()
        if self.lines:
            # python-can gave no frame for it
            self._ledger.refuse(Refusal.MALFORMED, self.lines.popleft())
        return self._next()

    def close(self) -> None:
        """Do nothing: whoever opened the source closes it."""

    def _next(self) -> str:
        ledger = self._ledger
        while raw := self._source.readline(LINE_LIMIT):
            line = raw.decode("utf-8", "replace")
            self._skip_rest(raw)
            ledger.lines += 1
            try:
                verdict = self._guard.judge(line)
            except LogError as error:
                msg = f"{ledger.path}: line {ledger.lines}: {error}"
                raise LogError(msg) from error
            if verdict is True:
                self.lines.append(ledger.lines)
                line = self._guard.handed_over(line)
                if self._in_header and self._guard.header_end:
                    self._held.append(line)
                    line = self._guard.header_end
                self._in_header = False
                return line
            ledger.refuse(verdict or Refusal.NOT_A_FRAME, ledger.lines)
            if verdict is False:
                return line
        if self._in_header and self._guard.header_end:
            # python-can would read the last line of a header as a frame
            self._in_header = False
            return self._guard.header_end
        raise StopIteration

    def _skip_rest(self, raw: bytes) -> None:
        while len(raw) == LINE_LIMIT and not raw.endswith(b"\n"):
            raw = self._source.readline(LINE_LIMIT)
