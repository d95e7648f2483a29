"""Which lines of an ASC, TRC or python-can CSV log hold a data frame.

python-can's readers take what looks roughly right, or end with a traceback.
A guard judges each line first, so that only lines with exactly one sound
data frame reach them; every other line gets a named reason. What they would
take for something else, a guard rewrites.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.candump_line import EXTENDED_MAX, STANDARD_MAX
from bstm_daemon.bus.extraction import FD_LENGTHS
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Sequence

Verdict = Refusal | bool
"""``True`` for a data frame, ``False`` for a line of the header that
python-can has to see, else why there is no frame in the line."""

_CLASSIC_BYTES: Final = 8
_DLC_MAX: Final = 15
_CODES: Final = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Payload bytes of each CAN FD length code (ISO 11898-1)."""

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
    r"\d{1,12}(?:\.\d{1,20})?(?:e-\d\d)?,(?P<id>0x[0-9a-fA-F]{1,8}),(?P<extended>[01]),"
    r"(?P<remote>[01]),(?P<error>[01]),(?P<dlc>\d{1,2}),"
    r"(?P<data>(?:[A-Za-z0-9+/]{4})*"
    r"(?:[A-Za-z0-9+/]{2}==|[A-Za-z0-9+/]{3}=)?)",
    re.ASCII,
)


class AscGuard:
    """Judges the lines of a Vector ASC log.

    A transmission request (``TxRq``) is no frame on the bus: the frame
    itself follows as ``Tx``.
    """

    header_end = "\n"
    """Handed to python-can behind the header: it takes the line that ends a
    header for part of it."""

    def __init__(self) -> None:
        """Expect a header; hexadecimal and absolute stamps without one."""
        self._base = 16
        self._is_relative = False
        self._elapsed_ps = 0

    def judge(self, line: str) -> Verdict:
        """Return what is in *line*."""
        tokens = line.split()
        if not tokens or not _STAMP.fullmatch(tokens[0]):
            return self._header(line.strip())
        if self._is_relative and not self._advance(tokens[0]):
            return Refusal.MALFORMED
        if len(tokens) < 3:
            return Refusal.MALFORMED
        if _DIGITS.fullmatch(tokens[1]):
            return self._classic(tokens)
        if tokens[1] == "CANFD":
            return self._fd(tokens)
        is_xl = tokens[1] == "CANXL"
        return Refusal.XL_FRAME if is_xl else Refusal.NOT_A_FRAME

    def handed_over(self, line: str) -> str:
        """Return *line* with an absolute stamp: python-can sums none up."""
        if not self._is_relative:
            return line
        seconds, rest_ps = divmod(self._elapsed_ps, _PS_A_S)
        event = line.split(maxsplit=1)[1]
        return f"{seconds}.{rest_ps:012d} {event}"

    def _advance(self, stamp: str) -> bool:
        """Add a relative *stamp*, of any event; False beyond all time."""
        seconds, _, decimals = stamp.partition(".")
        step_ps = int(seconds) * _PS_A_S + int(decimals.ljust(12, "0"))
        if self._elapsed_ps + step_ps >= _LONGEST_PS:
            return False
        self._elapsed_ps += step_ps
        return True

    def _header(self, line: str) -> Verdict:
        if base := _ASC_BASE.match(line):
            self._is_relative = (base[3] or "").lower() == "relative"
            self._base = 16 if base[1].lower() == "hex" else 10
            return False
        known = _ASC_HEADER.match(line)
        return Refusal.NOT_A_FRAME if known else Refusal.MALFORMED

    def _classic(self, tokens: Sequence[str]) -> Verdict:
        if tokens[2].lower().startswith("errorframe"):
            return Refusal.ERROR_FRAME
        if len(tokens) < 4 or tokens[3] not in ("Rx", "Tx"):
            return Refusal.NOT_A_FRAME
        if not self._is_id(tokens[2]):
            return Refusal.MALFORMED
        kind = tokens[4].lower() if len(tokens) > 4 else ""
        if kind == "r":
            return Refusal.REMOTE_FRAME
        sound = kind == "d" and self._data_fit(tokens[5:])
        return True if sound else Refusal.MALFORMED

    def _data_fit(self, tokens: Sequence[str]) -> bool:
        """Whether the length code in front has its bytes behind it."""
        code = self._value(tokens[0]) if tokens else None
        if code is None or code > _DLC_MAX:
            return False
        count = min(code, _CLASSIC_BYTES)
        data, rest = tokens[1 : 1 + count], tokens[1 + count : 2 + count]
        surplus = bool(rest) and bool(_HEX_PAIR.fullmatch(rest[0]))
        return len(data) == count and self._are_bytes(data) and not surplus

    def _fd(self, tokens: Sequence[str]) -> Verdict:
        if len(tokens) < 5:
            return Refusal.MALFORMED
        if tokens[4].lower().startswith("errorframe"):
            return Refusal.ERROR_FRAME
        if tokens[3] not in ("Rx", "Tx"):
            return Refusal.NOT_A_FRAME
        if not (_DIGITS.fullmatch(tokens[2]) and self._is_id(tokens[4])):
            return Refusal.MALFORMED
        # a symbolic name may stand before the two flags
        first = 5 if len(tokens) > 5 and tokens[5].isdigit() else 6
        return self._fd_data(tokens[first : first + 2], tokens[first + 2 :])

    def _fd_data(self, flags: Sequence[str], rest: Sequence[str]) -> Verdict:
        # python-can wants a token behind the length
        if len(rest) < 3 or not {*flags} <= {"0", "1"}:
            return Refusal.MALFORMED
        code = self._value(rest[0])
        if code is None or code > _DLC_MAX or not _DIGITS.fullmatch(rest[1]):
            return Refusal.MALFORMED
        count = int(rest[1])
        if count == 0 < code:
            return Refusal.REMOTE_FRAME
        data = rest[2 : 2 + count]
        whole = count == _CODES[code] == len(data)
        return True if whole and self._are_bytes(data) else Refusal.MALFORMED

    def _is_id(self, text: str) -> bool:
        extended = text[-1:] in ("x", "X")
        value = self._value(text[:-1] if extended else text)
        limit = EXTENDED_MAX if extended else STANDARD_MAX
        return value is not None and value <= limit

    def _are_bytes(self, texts: Sequence[str]) -> bool:
        values = [self._value(text) for text in texts]
        return all(value is not None and value <= 255 for value in values)

    def _value(self, text: str) -> int | None:
        digits = text.isascii() and text.isalnum() and len(text) <= 10
        try:
            return int(text, self._base) if digits else None
        except ValueError:
            return None


class TrcGuard:
    """Judges the lines of a PEAK TRC log of version 1.0, 1.1, 1.3 or 2.x."""

    header_end = "\n"

    _KNOWN: Final = ("1.0", "1.1", "1.3", "2.0", "2.1")
    _COLUMNS: Final = {
        "1.0": "N,O,I,L,D",
        "1.1": "N,O,d,I,L,D",
        "1.3": "N,O,B,d,I,R,L,D",
    }
    _KINDS: Final = frozenset({"DT", "FD", "FB", "FE", "BI"})
    _TITLES: Final = re.compile(r";\$(FILEVERSION|STARTTIME|COLUMNS)\s*=(.*)")

    def __init__(self) -> None:
        """Expect a header; version 1.0 without one."""
        self._version = "1.0"
        self._columns = self._COLUMNS["1.0"].split(",")
        self._in_header = True

    def judge(self, line: str) -> Verdict:
        """Return what is in *line*.

        Raises :class:`LogError` for a version or columns that are not read.
        """
        text = line.strip()
        if not text:
            return Refusal.NOT_A_FRAME
        if text.startswith(";"):
            return (
                self._header(text) if self._in_header else Refusal.NOT_A_FRAME
            )
        if self._in_header:
            self._in_header = False
            self._require_columns()
        cells = text.split(maxsplit=len(self._columns) - 1)
        return self._judge(dict(zip(self._columns, cells, strict=False)))

    def handed_over(self, line: str) -> str:
        """Return *line* as it is."""
        return line

    def _header(self, text: str) -> Verdict:
        found = self._TITLES.match(text)
        if found is None:
            return Refusal.NOT_A_FRAME
        title, value = found[1], found[2].strip()
        if title == "STARTTIME":
            # days since 1899, as far as a date goes
            sound = re.fullmatch(r"\d{1,6}(\.\d{1,20})?", value, re.ASCII)
            return False if sound else Refusal.MALFORMED
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
        elif self._version >= "2":
            self._columns = value.split(",")
        return False

    def _require_columns(self) -> None:
        needed = {"O", "T", "I", "d", "D"} if self._version >= "2" else set()
        missing = needed.difference(self._columns)
        if needed and not {"l", "L"} & {*self._columns}:
            missing.add("L")
        if missing:
            msg = f"its ;$COLUMNS lack {', '.join(sorted(missing))}"
            raise LogError(msg)

    def _judge(self, cell: dict[str, str]) -> Verdict:
        kind = cell.get("T", "DT")
        if kind == "ER" or cell.get("d") in ("Error", "Warng"):
            return Refusal.ERROR_FRAME
        if self._version == "1.0" and cell.get("I") == "FFFFFFFF":
            return Refusal.ERROR_FRAME
        if kind == "RR" or cell.get("D", "").startswith("RTR"):
            return Refusal.REMOTE_FRAME
        if kind not in self._KINDS:
            return Refusal.NOT_A_FRAME
        if cell.get("d", "Rx") not in ("Rx", "Tx"):
            return Refusal.MALFORMED
        sound = (
            _NUMBER.fullmatch(cell.get("O", ""))
            and _DIGITS.fullmatch(cell.get("B", "1"))
            and self._is_id(cell.get("I", ""))
            and self._data_fit(cell, classic=kind == "DT")
        )
        return True if sound else Refusal.MALFORMED

    @staticmethod
    def _is_id(text: str) -> bool:
        # PEAK writes 4 or 8 digits, python-can 4 or 7
        if not re.fullmatch(r"[0-9A-Fa-f]{4,8}", text):
            return False
        limit = STANDARD_MAX if len(text) == 4 else EXTENDED_MAX
        return int(text, 16) <= limit

    def _data_fit(self, cell: dict[str, str], *, classic: bool) -> bool:
        given = cell.get("l", cell.get("L", ""))
        if not _DIGITS.fullmatch(given):
            return False
        count = int(given)
        if "l" not in cell and self._version >= "2":
            if count > _DLC_MAX:
                return False
            count = min(_CODES[count], 8) if classic else _CODES[count]
        pairs = cell.get("D", "").split()
        return (
            count in FD_LENGTHS
            and (count <= _CLASSIC_BYTES or not classic)
            and len(pairs) == count
            and all(_HEX_PAIR.fullmatch(pair) for pair in pairs)
        )


class CsvGuard:
    """Judges the lines of python-can's CSV log; it has no channels."""

    header_end = ""

    def __init__(self) -> None:
        """Expect the header line."""
        self._in_header = True

    def judge(self, line: str) -> Verdict:
        """Return what is in *line*."""
        text = line.strip()
        if self._in_header:
            self._in_header = False
            return False
        frame = _CSV_FRAME.fullmatch(text)
        if frame is None:
            return Refusal.MALFORMED if text else Refusal.NOT_A_FRAME
        if frame["error"] == "1":
            return Refusal.ERROR_FRAME
        if frame["remote"] == "1":
            return Refusal.REMOTE_FRAME
        limit = EXTENDED_MAX if frame["extended"] == "1" else STANDARD_MAX
        data = frame["data"]
        size = len(data) // 4 * 3 - data.count("=")
        sound = (
            int(frame["id"], 16) <= limit
            and size == int(frame["dlc"])
            and size in FD_LENGTHS
        )
        return True if sound else Refusal.MALFORMED

    def handed_over(self, line: str) -> str:
        """Return *line* as it is."""
        return line


def is_frame_csv(first_line: str) -> bool:
    """Whether *first_line* is that of python-can's CSV log of frames."""
    return first_line.strip().lstrip("\ufeff") == _CSV_HEADER
