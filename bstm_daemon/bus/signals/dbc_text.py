"""The text of a DBC before a parser sees it: encoding, statements, defects.

DBC files in the wild are written by hand and by many tools. cantools reads a
file as a whole or not at all; here it is split into statements, so that
one that cannot be read is named with its line and left out, and the rest of
the file keeps its line numbers.

Grammar: Vector, "DBC File Format Documentation" 1.0.5 (2010), in the form in
which cantools accepts it.
"""

from __future__ import annotations

import codecs
import re
from dataclasses import dataclass
from typing import Final

_NUMBER: Final = r"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?"
_NAME: Final = r"[A-Za-z_]\w*"
_TEXT: Final = r'"[^"\\]*(?:\\"?[^"\\]*)*"'
_SEMICOLON: Final = r"(?P<end>\s*;)?"

_FORMS: Final[dict[str, str]] = {
    "BO_": rf"BO_\s+(\d{{1,18}})\s+({_NAME})\s*:\s*(0|[1-9]\d{{0,17}})"
    rf"(?P<end>[ \t]+{_NAME})?",
    "SG_": rf"SG_\s+({_NAME})(?:\s+(M|m\d*M?))?\s*:\s*"
    r"(\d{1,18})\s*\|\s*(\d{1,18})\s*"
    rf"@\s*[01]\s*[-+]\s*\(\s*{_NUMBER}\s*,\s*{_NUMBER}\s*\)\s*"
    rf"\[\s*{_NUMBER}\s*\|\s*{_NUMBER}\s*\]\s*{_TEXT}"
    rf"(?P<end>[ \t]*{_NAME}(?:\s*,\s*{_NAME})*)?",
    "SG_MUL_VAL_": rf"SG_MUL_VAL_\s+(\d+)\s+({_NAME})\s+({_NAME})\s+"
    rf"\d+\s*-\d+(?:\s*,\s*\d+\s*-\d+)*{_SEMICOLON}",
    "SIG_VALTYPE_": rf"SIG_VALTYPE_\s+(\d+)\s+({_NAME})\s*:\s*[0-3]"
    rf"{_SEMICOLON}",
    "VAL_": rf"VAL_\s+(?:(\d+)\s+)?({_NAME})(?:\s+{_NUMBER}\s+{_TEXT})*"
    rf"{_SEMICOLON}",
    "CM_": rf"CM_(?:\s+SG_\s+\d+\s+{_NAME}|\s+BO_\s+\d+|"
    rf"\s+(?:EV_|BU_)\s+{_NAME})?\s*{_TEXT}{_SEMICOLON}",
    "BA_DEF_": rf"BA_DEF_\s+(?:(?:SG_|BO_|EV_|BU_)\s+)?{_TEXT}\s+"
    rf"(?:(?:INT|HEX|FLOAT)(?:\s+{_NUMBER}\s+{_NUMBER})?|STRING|"
    rf"ENUM\s+{_TEXT}(?:\s*,\s*{_TEXT})*){_SEMICOLON}",
    "BA_DEF_DEF_": rf"BA_DEF_DEF_\s+{_TEXT}\s+(?:{_NUMBER}|{_TEXT})"
    rf"{_SEMICOLON}",
    "BA_": rf"BA_\s+{_TEXT}\s+(?:BO_\s+\d+\s+|SG_\s+\d+\s+{_NAME}\s+|"
    rf"(?:BU_|EV_)\s+{_NAME}\s+)?(?:{_NUMBER}|{_TEXT}){_SEMICOLON}",
}
FORMS: Final = {
    keyword: re.compile(form, re.ASCII) for keyword, form in _FORMS.items()
}
"""How the statements that values and texts come from must look.

The group ``end`` is what many files lack: the semicolon, sender or receiver.
"""
_OTHERS: Final = (
    *("BA_DEF_DEF_REL_", "BA_DEF_REL_", "BA_DEF_SGTYPE_", "BA_REL_"),
    *("BA_SGTYPE_", "BO_TX_BU_", "BS_", "BU_", "BU_BO_REL_", "BU_EV_REL_"),
    *("BU_SG_REL_", "CAT_", "CAT_DEF_", "ENVVAR_DATA_", "EV_", "EV_DATA_"),
    *("FILTER", "NS_", "NS_DESC_", "SGTYPE_", "SGTYPE_VAL_", "SIG_GROUP_"),
    *("SIG_TYPE_REF_", "SIGTYPE_VALTYPE_", "VAL_TABLE_", "VERSION"),
)
# a keyword alone on its line is an entry of NS_
_START: Final = re.compile(
    rf"^[ \t]*({'|'.join([*_FORMS, *_OTHERS])})(?=[ \t]*:|[ \t]+\S|\")",
    re.MULTILINE,
)
_START_OR_TEXT: Final = re.compile(f"{_START.pattern}|{_TEXT}", re.MULTILINE)
_COMMENT: Final = re.compile(r"//[^\n]*")
_MARKS: Final = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


@dataclass(frozen=True, slots=True)
class DbcDefect:
    """What is wrong in a DBC, where, and what becomes of it.

    ``line`` is 0 where none can be given. A ``harmless`` one changes no value
    and is no reason to refuse the file.
    """

    line: int
    reason: str
    message: str = ""
    signals: tuple[str, ...] = ()
    harmless: bool = False
    same_id: bool = False
    """Whether the message shares its id with another one."""

    def __str__(self) -> str:
        """Return ``line 12: message 'NAME': reason``."""
        line = f"line {self.line}: " if self.line else ""
        message = f"message {self.message!r}: " if self.message else ""
        return f"{line}{message}{self.reason}"


@dataclass(frozen=True, slots=True)
class Statement:
    """A statement of a DBC: where it stands, and its text."""

    keyword: str
    start: int
    end: int
    line: int
    text: str

    def dropped(self) -> Edit:
        """Return the edit that leaves this out; the lines stay."""
        return self.start, self.end, "\n" * self.text.count("\n")


Edit = tuple[int, int, str]
"""Start, end and what takes their place."""


def decode_dbc(data: bytes, encoding: str) -> tuple[str, list[DbcDefect]]:
    """Return the text of a DBC with Unix line ends, and what it lost.

    A byte order mark goes before *encoding*. Bytes without a character are
    replaced: names are ASCII, so only texts lose by it. Raises
    ``LookupError`` for an unknown encoding.
    """
    codec = codecs.lookup(encoding).name
    for mark, marked in _MARKS:
        if data.startswith(mark):
            encoding = codec = marked
            break
    text = data.decode(encoding, errors="replace")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    defects = []
    if "\ufffd" in text and "\ufffd".encode() not in data:
        place = text.index("\ufffd")
        reason = (
            f"{text.count(chr(0xFFFD))} characters, the first here, are not "
            f"in the encoding {encoding!r}: set encoding in its [[bus]]"
        )
        defects.append(_harmless(text, place, reason))
    elif not codec.startswith("utf") and guess_encoding(data) == "utf-8":
        first = re.search(r"[^\x00-\x7f]", text)
        if first:
            reason = (
                f"looks like UTF-8 but is read as {encoding!r}: set "
                'encoding = "utf-8" in its [[bus]]'
            )
            defects.append(_harmless(text, first.start(), reason))
    return text, defects


def guess_encoding(data: bytes) -> str:
    """Return "utf-8" for bytes that are UTF-8, else "cp1252"."""
    try:
        data.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"


def statements_of(text: str) -> list[Statement]:
    """Split *text* into its statements, in file order.

    A keyword begins a statement at the start of a line and outside of a
    string. Where a statement cannot be read that way (a quote is missing),
    the next keyword at the start of a line ends it.
    """
    text = _without_comments(text)
    found = []
    line, counted = 1, 0
    match = _START.search(text)
    while match is not None:
        start = match.start(1)
        following = _next_start(text, match.end())
        end = following.start() if following else len(text)
        inner = _START.search(text, match.end(), end)
        if inner and not _is_whole(match[1], text[start:end]):
            following, end = inner, inner.start()
        body = text[start:end].rstrip()
        line += text.count("\n", counted, start)
        counted = start
        found.append(Statement(match[1], start, start + len(body), line, body))
        match = following
    return found


def edited(text: str, edits: list[Edit]) -> str:
    """Return *text* with *edits* made; of two that overlap, the first."""
    pieces: list[str] = []
    done = 0
    for start, end, new in sorted(edits):
        if start >= done:
            pieces += (text[done:start], new)
            done = end
    return "".join([*pieces, text[done:]])


def _is_whole(keyword: str, body: str) -> bool:
    pattern = FORMS.get(keyword)
    match = pattern.match(body) if pattern else None
    return match is not None and match["end"] is not None


def _harmless(text: str, place: int, reason: str) -> DbcDefect:
    line = text.count("\n", 0, place) + 1
    return DbcDefect(line, reason, harmless=True)


def _without_comments(text: str) -> str:
    """Blank ``//`` comments outside of strings; places stay the same."""
    if "//" not in text:
        return text
    either = re.compile(f"{_TEXT}|{_COMMENT.pattern}")
    return either.sub(
        lambda found: found[0] if found[0][0] == '"' else " " * len(found[0]),
        text,
    )


def _next_start(text: str, place: int) -> re.Match[str] | None:
    """Return the next keyword that is not inside of a string."""
    found = _START_OR_TEXT.finditer(text, place)
    return next((match for match in found if match[1]), None)
