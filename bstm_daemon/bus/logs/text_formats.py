"""ASC, TRC and python-can CSV logs: lines that are data frames, or why not.

Interfaces are named after python-can's channel numbers: ``can0`` is the first
channel, numbered 1 in an ASC or TRC file. A log without channels (CSV, TRC
before 1.3) has ``can0`` alone. Stamps of an ASC file begin near zero, all
others are absolute where the file has its start time.

python-can's readers take what looks roughly right, skip other lines without
a word or end with a traceback. Here every line is either one sound data frame
or has a named reason. Stamps are computed as python-can does.
"""

import re
from binascii import a2b_base64
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from io import BufferedReader
from pathlib import Path
from typing import Final, NamedTuple

from bstm_daemon.bus.logs.candump_line import LINE_LIMIT
from bstm_daemon.bus.logs.reader import FrameReader, FrameRow, Wanted
from bstm_daemon.bus.signals.extraction import (
    EXTENDED_MAX,
    FD_LENGTHS,
    STANDARD_MAX,
)
from bstm_daemon.bus.signals.frame_chunk import FrameChunk
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.errors import LogError


class TextFrame(NamedTuple):
    """A data frame; the first *channel* is 0."""

    time_us: int
    channel: int
    can_id: int
    extended: bool
    data: bytes


Verdict = TextFrame | RejectReason

_CLASSIC_BYTES: Final = 8
_DLC_MAX: Final = 15
_CODES: Final = FD_LENGTHS
"""Payload bytes by the length code (ISO 11898-1)."""

_PS_A_S: Final = 10**12
"""Stamps have at most twelve decimals; their sum is exact in integers."""

_LONGEST_PS: Final = 10**12 * _PS_A_S
"""An absolute stamp has no more digits either."""

_STAMP: Final = re.compile(r"\d{1,12}\.\d{1,12}", re.ASCII)
_NUMBER: Final = re.compile(r"\d{1,12}(\.\d{1,12})?", re.ASCII)
_DIGITS: Final = re.compile(r"\d{1,6}", re.ASCII)
_HEX_PAIR: Final = re.compile(r"[0-9A-Fa-f]{2}", re.ASCII)
_ASC_HEADER: Final = re.compile(
    r"(date|begin|end|(no\s+)?internal|version|base)\b|//|$", re.IGNORECASE
)
_ASC_BASE: Final = re.compile(
    r"base\s+(hex|dec)\b(\s+timestamps\s+(absolute|relative))?", re.IGNORECASE
)
_CSV_HEADER: Final = "timestamp,arbitration_id,extended,remote,error,dlc,data"
_CSV_FRAME: Final = re.compile(
    r"(?P<time>\d{1,12}(?:\.\d{1,20})?(?:e-\d\d)?),(?P<id>0x[0-9a-fA-F]{1,8}),(?P<extended>[01]),"
    r"(?P<remote>[01]),(?P<error>[01]),(?P<dlc>\d{1,2}),"
    r"(?P<data>(?:[A-Za-z0-9+/]{4})*"
    r"(?:[A-Za-z0-9+/]{2}==|[A-Za-z0-9+/]{3}=)?)",
    re.ASCII,
)


class AscParser:
    """Reads the lines of a Vector ASC log.

    A transmission request (``TxRq``) is no frame on the bus: the frame
    itself follows as ``Tx``.
    """

    def __init__(self) -> None:
        """Expect a header; hexadecimal and absolute stamps without one."""
        self._base = 16
        self._is_relative = False
        self._elapsed_ps = 0

    def parse(self, line: str) -> Verdict:
        """Return what is in *line*."""
        tokens = line.split()
        if not tokens or not _STAMP.fullmatch(tokens[0]):
            return self._header(line.strip())
        if self._is_relative and not self._advance(tokens[0]):
            return RejectReason.MALFORMED
        if len(tokens) < 3:
            return RejectReason.MALFORMED
        if _DIGITS.fullmatch(tokens[1]):
            return self._classic(tokens)
        if tokens[1] == "CANFD":
            return self._fd(tokens)
        is_xl = tokens[1] == "CANXL"
        return RejectReason.XL_FRAME if is_xl else RejectReason.NOT_A_FRAME

    def _advance(self, stamp: str) -> bool:
        """Add a relative *stamp*, of any event; False beyond all time."""
        seconds, _, decimals = stamp.partition(".")
        step_ps = int(seconds) * _PS_A_S + int(decimals.ljust(12, "0"))
        if self._elapsed_ps + step_ps >= _LONGEST_PS:
            return False
        self._elapsed_ps += step_ps
        return True

    def _header(self, line: str) -> RejectReason:
        if base := _ASC_BASE.match(line):
            self._is_relative = (base[3] or "").lower() == "relative"
            self._base = 16 if base[1].lower() == "hex" else 10
            return RejectReason.NOT_A_FRAME
        known = _ASC_HEADER.match(line)
        return RejectReason.NOT_A_FRAME if known else RejectReason.MALFORMED

    def _classic(self, tokens: Sequence[str]) -> Verdict:
        if tokens[2].lower().startswith("errorframe"):
            return RejectReason.ERROR_FRAME
        if len(tokens) < 4 or tokens[3] not in ("Rx", "Tx"):
            return RejectReason.NOT_A_FRAME
        kind = tokens[4].lower() if len(tokens) > 4 else ""
        if kind == "r" and self._id(tokens[2]):
            return RejectReason.REMOTE_FRAME
        code = self._value(tokens[5]) if len(tokens) > 5 else None
        if kind != "d" or code is None or code > _DLC_MAX:
            return RejectReason.MALFORMED
        # the length code in front has its bytes behind it, and no more
        count = min(code, _CLASSIC_BYTES)
        rest = tokens[6 + count : 7 + count]
        if rest and _HEX_PAIR.fullmatch(rest[0]):
            return RejectReason.MALFORMED
        texts = tokens[6 : 6 + count]
        return self._frame(tokens[0], tokens[1], tokens[2], texts, count)

    def _fd(self, tokens: Sequence[str]) -> Verdict:
        if len(tokens) < 5:
            return RejectReason.MALFORMED
        if tokens[4].lower().startswith("errorframe"):
            return RejectReason.ERROR_FRAME
        if tokens[3] not in ("Rx", "Tx"):
            return RejectReason.NOT_A_FRAME
        # a symbolic name may stand before the two flags
        first = 5 if len(tokens) > 5 and tokens[5].isdigit() else 6
        return self._fd_data(tokens, first)

    def _fd_data(self, tokens: Sequence[str], first: int) -> Verdict:
        """Return the frame whose two flags begin at token *first*."""
        flags, rest = tokens[first : first + 2], tokens[first + 2 :]
        if (
            len(rest) < 3
            or not {*flags} <= {"0", "1"}
            or not _DIGITS.fullmatch(tokens[2])
            or not _DIGITS.fullmatch(rest[1])
        ):
            return RejectReason.MALFORMED
        code, count = self._value(rest[0]), int(rest[1])
        if code is None or code > _DLC_MAX:
            return RejectReason.MALFORMED
        if count == 0 < code and self._id(tokens[4]):
            return RejectReason.REMOTE_FRAME
        if count != _CODES[code]:
            return RejectReason.MALFORMED
        texts = rest[2 : 2 + count]
        return self._frame(tokens[0], tokens[2], tokens[4], texts, count)

    def _frame(
        self,
        stamp: str,
        channel: str,
        id_text: str,
        texts: Sequence[str],
        count: int,
    ) -> Verdict:
        key = self._id(id_text)
        values = [self._value(text) for text in texts]
        data = bytes(v for v in values if v is not None and v <= 255)
        if key is None or not len(data) == len(texts) == count:
            return RejectReason.MALFORMED
        if self._is_relative:
            seconds, rest_ps = divmod(self._elapsed_ps, _PS_A_S)
            stamp = f"{seconds}.{rest_ps:012d}"
        return TextFrame(_micros(float(stamp)), int(channel) - 1, *key, data)

    def _id(self, text: str) -> tuple[int, bool] | None:
        extended = text[-1:] in ("x", "X")
        value = self._value(text[:-1] if extended else text)
        limit = EXTENDED_MAX if extended else STANDARD_MAX
        if value is None or value > limit:
            return None
        return value, extended

    def _value(self, text: str) -> int | None:
        digits = text.isascii() and text.isalnum() and len(text) <= 10
        try:
            return int(text, self._base) if digits else None
        except ValueError:
            return None


class TrcParser:
    """Reads the lines of a PEAK TRC log of version 1.0, 1.1, 1.3 or 2.x."""

    _KNOWN: Final = ("1.0", "1.1", "1.3", "2.0", "2.1")
    _COLUMNS: Final = {
        "1.0": "N,O,I,L,D",
        "1.1": "N,O,d,I,L,D",
        "1.3": "N,O,B,d,I,R,L,D",
    }
    _KINDS: Final = frozenset({"DT", "FD", "FB", "FE", "BI"})
    _DAY_0: Final = datetime(1899, 12, 30, tzinfo=UTC)
    _TITLES: Final = re.compile(r";\$(FILEVERSION|STARTTIME|COLUMNS)\s*=(.*)")

    def __init__(self) -> None:
        """Expect a header; version 1.0 without one."""
        self._version = "1.0"
        self._columns = self._COLUMNS["1.0"].split(",")
        self._start_s = 0.0
        self._in_header = True

    def parse(self, line: str) -> Verdict:
        """Return what is in *line*.

        Raises:
            LogError: The version or the columns are not read.
        """
        text = line.strip()
        if not text:
            return RejectReason.NOT_A_FRAME
        if text.startswith(";"):
            in_header = self._in_header
            return self._title(text) if in_header else RejectReason.NOT_A_FRAME
        if self._in_header:
            self._in_header = False
            self._require_columns()
        cells = text.split(maxsplit=len(self._columns) - 1)
        return self._frame(dict(zip(self._columns, cells, strict=False)))

    def _title(self, text: str) -> RejectReason:
        """Apply *text*, a line of the header."""
        found = self._TITLES.match(text)
        if found is None:
            return RejectReason.NOT_A_FRAME
        title, value = found[1], found[2].strip()
        if title == "STARTTIME":
            # days since 1899, as far as a date goes
            if not re.fullmatch(r"\d{1,6}(\.\d{1,20})?", value, re.ASCII):
                return RejectReason.MALFORMED
            began = self._DAY_0 + timedelta(days=float(value))
            self._start_s = began.timestamp()
        if title == "FILEVERSION":
            if value not in self._KNOWN:
                msg = (
                    f"TRC version {value} is not read, these are: "
                    f"{', '.join(self._KNOWN)}"
                )
                raise LogError(msg)
            self._version = value
            columns = self._COLUMNS.get(value, "")
            self._columns = columns.split(",") if columns else []
        elif title == "COLUMNS" and self._version >= "2":
            self._columns = value.split(",")
        return RejectReason.NOT_A_FRAME

    def _require_columns(self) -> None:
        needed = {"O", "T", "I", "d", "D"} if self._version >= "2" else set()
        missing = needed.difference(self._columns)
        if needed and not {"l", "L"} & {*self._columns}:
            missing.add("L")
        if missing:
            msg = f"its ;$COLUMNS lack {', '.join(sorted(missing))}"
            raise LogError(msg)

    def _why_none(self, cell: dict[str, str]) -> RejectReason | None:
        """Return why a line has no data frame, judged by its kind."""
        kind = cell.get("T", "DT")
        if kind == "ER" or cell.get("d") in ("Error", "Warng"):
            return RejectReason.ERROR_FRAME
        if self._version == "1.0" and cell.get("I") == "FFFFFFFF":
            return RejectReason.ERROR_FRAME
        if kind == "RR" or cell.get("D", "").startswith("RTR"):
            return RejectReason.REMOTE_FRAME
        return None if kind in self._KINDS else RejectReason.NOT_A_FRAME

    def _frame(self, cell: dict[str, str]) -> Verdict:
        reason = self._why_none(cell)
        if reason is not None:
            return reason
        offset, channel = cell.get("O", ""), cell.get("B", "1")
        id_text = cell.get("I", "")
        data = self._data(cell, classic=cell.get("T", "DT") == "DT")
        if (
            data is None
            or cell.get("d", "Rx") not in ("Rx", "Tx")
            or not _NUMBER.fullmatch(offset)
            or not _DIGITS.fullmatch(channel)
            # PEAK writes 4 or 8 digits, python-can 4 or 7
            or not re.fullmatch(r"[0-9A-Fa-f]{4,8}", id_text)
        ):
            return RejectReason.MALFORMED
        can_id, extended = int(id_text, 16), len(id_text) > 4
        if can_id > (EXTENDED_MAX if extended else STANDARD_MAX):
            return RejectReason.MALFORMED
        start_s = 0.0 if self._version == "1.0" else self._start_s
        time_us = _micros(float(offset) / 1000 + start_s)
        return TextFrame(time_us, int(channel) - 1, can_id, extended, data)

    def _data(self, cell: dict[str, str], *, classic: bool) -> bytes | None:
        """Return the payload; None where its length is not the stated one."""
        size = cell.get("l", cell.get("L", ""))
        if not _DIGITS.fullmatch(size):
            return None
        count = int(size)
        if "l" not in cell and self._version >= "2":
            if count > _DLC_MAX:
                return None
            count = min(_CODES[count], 8) if classic else _CODES[count]
        pairs = cell.get("D", "").split()
        sound = (
            count in FD_LENGTHS
            and (count <= _CLASSIC_BYTES or not classic)
            and len(pairs) == count
            and all(_HEX_PAIR.fullmatch(pair) for pair in pairs)
        )
        return bytes.fromhex("".join(pairs)) if sound else None


class CsvParser:
    """Reads the lines of python-can's CSV log; it has no channels."""

    def __init__(self) -> None:
        """Expect the header line."""
        self._in_header = True

    def parse(self, line: str) -> Verdict:
        """Return what is in *line*."""
        text = line.strip()
        if self._in_header or not text:
            self._in_header = False
            return RejectReason.NOT_A_FRAME
        frame = _CSV_FRAME.fullmatch(text)
        if frame is None:
            return RejectReason.MALFORMED
        if frame["error"] == "1":
            return RejectReason.ERROR_FRAME
        if frame["remote"] == "1":
            return RejectReason.REMOTE_FRAME
        can_id, extended = int(frame["id"], 16), frame["extended"] == "1"
        data = a2b_base64(frame["data"])
        if (
            can_id > (EXTENDED_MAX if extended else STANDARD_MAX)
            or len(data) != int(frame["dlc"])
            or len(data) not in FD_LENGTHS
        ):
            return RejectReason.MALFORMED
        time_us = _micros(float(frame["time"]))
        return TextFrame(time_us, 0, can_id, extended, data)


def _micros(seconds: float) -> int:
    return round(seconds * 1e6)


def is_frame_csv(first_line: str) -> bool:
    """Whether *first_line* is that of python-can's CSV log of frames."""
    return first_line.strip().lstrip("\ufeff") == _CSV_HEADER


_PARSERS: Final[dict[str, type[AscParser | CsvParser | TrcParser]]] = {
    ".asc": AscParser,
    ".csv": CsvParser,
    ".trc": TrcParser,
}
"""By the ending of the file, in front of ``.gz`` where it is packed."""


class TextLogReader(FrameReader):
    """Reads a text log by its ending: ``.asc``, ``.csv`` or ``.trc``."""

    def __init__(self, path: Path, wanted: Wanted | None = None) -> None:
        """Prepare to read *path*, every id of every interface by default."""
        super().__init__(path, wanted)
        ending = path.suffixes[-2] if self.is_packed else path.suffix
        self._parser = _PARSERS[ending.lower()]()

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames, as :meth:`FrameReader.chunks`.

        :class:`LogError` also for version or columns of a TRC log not read.
        """
        with self.opened() as stream:
            yield from self.in_chunks(self._frames(stream))

    def _frames(self, stream: BufferedReader) -> Iterator[FrameRow]:
        for line in self._lines(stream):
            try:
                found = self._parser.parse(line)
            except LogError as error:
                msg = f"{self.path}: line {self.lines}: {error}"
                raise LogError(msg) from error
            if isinstance(found, RejectReason):
                self.refuse(found, self.lines)
                continue
            time_us, number, can_id, extended, data = found
            channel = self.channel(f"can{number}")
            yield time_us, self.lines, channel, can_id, extended, data

    def _lines(self, stream: BufferedReader) -> Iterator[str]:
        """Yield and count the lines, of each up to ``LINE_LIMIT`` bytes."""
        while raw := stream.readline(LINE_LIMIT):
            line = raw.decode("utf-8", "replace")
            while len(raw) == LINE_LIMIT and not raw.endswith(b"\n"):
                raw = stream.readline(LINE_LIMIT)
            self.lines += 1
            yield line
