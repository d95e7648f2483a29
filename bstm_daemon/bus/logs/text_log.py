"""ASC, TRC and CSV logs.

Interfaces are named after python-can's channel numbers: ``can0`` is the first
channel, numbered 1 in an ASC or TRC file. A log without channels (CSV, TRC
before 1.3) has ``can0`` alone. Stamps of an ASC file begin near zero, all
others are absolute where the file has its start time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.logs.candump_line import LINE_LIMIT
from bstm_daemon.bus.logs.reader import FrameColumns, FrameReader
from bstm_daemon.bus.logs.text_formats import AscParser, CsvParser, TrcParser
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from io import BufferedReader
    from pathlib import Path

    from bstm_daemon.bus.logs.reader import Wanted
    from bstm_daemon.bus.signals.frame_chunk import FrameChunk

CHUNK_FRAMES: Final = 20_000

_PARSERS: Final[dict[str, type[AscParser | CsvParser | TrcParser]]] = {
    ".asc": AscParser,
    ".csv": CsvParser,
    ".trc": TrcParser,
}
"""By the ending of the file, in front of ``.gz`` where it is packed."""


class TextLogReader(FrameReader):
    """Reads a text log by its ending: ``.asc``, ``.csv`` or ``.trc``."""

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
        ending = path.suffixes[-2] if self.is_packed else path.suffix
        self._parser = _PARSERS[ending.lower()]()

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames in file order.

        Raises:
            FileAccessError: The file cannot be read.
            LogError: The gzip file is damaged, or the version or the columns
                of a TRC log are not read.
        """
        columns = FrameColumns()
        with self.opened() as stream:
            for line in self._lines(stream):
                try:
                    found = self._parser.parse(line)
                except LogError as error:
                    msg = f"{self.path}: line {self.lines}: {error}"
                    raise LogError(msg) from error
                if isinstance(found, RejectReason):
                    self.refuse(found, self.lines)
                    continue
                columns.add(
                    found.time_us,
                    self.lines,
                    self.channel(f"can{found.channel}"),
                    found.can_id,
                    found.extended,
                    found.data,
                )
                if len(columns) >= self._chunk_frames:
                    yield self.wanted_frames(columns.chunk())
                    columns = FrameColumns()
            yield self.wanted_frames(columns.chunk())

    def _lines(self, stream: BufferedReader) -> Iterator[str]:
        """Yield and count the lines, of each up to ``LINE_LIMIT`` bytes."""
        while raw := stream.readline(LINE_LIMIT):
            line = raw.decode("utf-8", "replace")
            while len(raw) == LINE_LIMIT and not raw.endswith(b"\n"):
                raw = stream.readline(LINE_LIMIT)
            self.lines += 1
            yield line
