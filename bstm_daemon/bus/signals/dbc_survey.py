"""Survey of a DBC: the declarations of its statements, and their defects.

cantools reads a file as a whole or not at all, and some defects it does not
see. A survey finds both kinds and what to leave out.
"""

import re
from dataclasses import dataclass, field
from typing import Final

from bstm_daemon.bus.signals.dbc_text import (
    FORMS,
    DbcDefect,
    Edit,
    Statement,
    edited,
    statements_of,
)
from bstm_daemon.config import limits

_FORM_SHOWN: Final = {
    "BO_": "BO_ id name: bytes sender",
    "SG_": 'SG_ name : start|bits@order+ (scale,offset) [min|max] "unit" '
    "receiver",
    "SG_MUL_VAL_": "SG_MUL_VAL_ id signal multiplexer from-to;",
    "SIG_VALTYPE_": "SIG_VALTYPE_ id signal : type;",
    "VAL_": 'VAL_ id signal value "text" ... ;',
    "CM_": 'CM_ SG_ id signal "text"; or CM_ BO_ id "text";',
}
_IMPLIED: Final = {"BO_": "the sender", "SG_": "the receiver"}
_EXTENDED: Final = 0x8000_0000
_UNASSIGNED: Final = "VECTOR__INDEPENDENT_SIG_MSG"
_SHOWN: Final = 48


@dataclass(slots=True)
class MessageOutline:
    """A message as its statements declare it: lines, not values."""

    dbc_id: int
    name: str
    line: int
    signals: dict[str, Statement] = field(default_factory=dict)
    markers: dict[str, str] = field(default_factory=dict)
    parents: dict[str, str] = field(default_factory=dict)


class Survey:
    """What the statements of a DBC declare, and what is wrong with them.

    ``messages`` are those that are read. Not *thorough*, only what cantools
    lets pass unseen or is beyond a limit is looked for; thorough, every
    statement must also have its form and refer to what exists.
    """

    def __init__(self, text: str, *, thorough: bool) -> None:
        """Survey *text*."""
        self.messages: list[MessageOutline] = []
        self.defects: list[DbcDefect] = []
        self._thorough = thorough
        self._edits: list[Edit] = []
        self._by_name: dict[str, MessageOutline] = {}
        self._by_id: dict[int, list[MessageOutline]] = {}
        self._silent: set[int] = set()
        self._text = text
        statements = statements_of(text)
        self._messages(statements)
        for statement in statements:
            if statement.keyword == "SG_MUL_VAL_":
                self._reference(statement)
        for message in self.messages:
            self._orphans(message)
        for statement in statements:
            if statement.keyword not in ("BO_", "SG_", "SG_MUL_VAL_"):
                self._reference(statement)
        self.defects.sort(key=lambda defect: defect.line)

    def cleaned(self) -> str:
        """Return the text without what was dropped, with ends put in."""
        return edited(self._text, self._edits)

    def _messages(self, statements: list[Statement]) -> None:
        current: MessageOutline | None = None
        first = True
        for statement in statements:
            if statement.keyword == "BO_":
                current = self._message(statement)
                first = False
            elif statement.keyword == "SG_" and current is not None:
                self._signal(current, statement)
            elif statement.keyword == "SG_" and first:
                reason = "a signal before the first message: dropped"
                self._drop(statement, reason, "")
            elif statement.keyword == "SG_":
                # its message is dropped and named
                self._edits.append(statement.dropped())

    def _message(self, statement: Statement) -> MessageOutline | None:
        match = self._match(statement)
        if match is None:
            # of a form that only cantools knows: left to it
            unknown = MessageOutline(-1, "", statement.line)
            return None if self._thorough else unknown
        outline = MessageOutline(int(match[1]), match[2], statement.line)
        if outline.name == _UNASSIGNED:
            # signals of no message: cantools does not read them either
            self._edits.append(statement.dropped())
            return None
        twin = self._by_name.get(outline.name)
        if twin is not None:
            reason = (
                f"has the name of the message in line {twin.line}, which "
                "counts: dropped"
            )
        else:
            reason = _message_problem(outline.dbc_id, int(match[3]))
        if reason:
            if twin is None or twin.dbc_id != outline.dbc_id:
                self._silent.add(outline.dbc_id)
            self._drop(statement, reason, outline.name)
            return None
        same_id = self._by_id.setdefault(outline.dbc_id, [])
        if same_id:
            reason = (
                f"has the id 0x{outline.dbc_id & ~_EXTENDED:X} of message "
                f"{same_id[0].name!r} in line {same_id[0].line}: roles can be "
                "read from one of them"
            )
            defect = DbcDefect(
                *(statement.line, reason, outline.name),
                harmless=True,
                same_id=True,
            )
            self.defects.append(defect)
        same_id.append(outline)
        self._by_name[outline.name] = outline
        self.messages.append(outline)
        return outline

    def _signal(self, message: MessageOutline, statement: Statement) -> None:
        match = self._match(statement, message.name)
        if match is None:
            return
        name, marker = match[1], match[2] or ""
        start, bits = int(match[3]), int(match[4])
        if name in message.signals:
            reason = (
                f"signal {name!r} is declared in line "
                f"{message.signals[name].line} already, which counts: dropped"
            )
        elif bits == 0:
            reason = f"signal {name!r} has no bits: dropped"
        elif bits > limits.SIGNAL_BITS:
            reason = (
                f"signal {name!r} has {bits} bits, more than "
                f"{limits.SIGNAL_BITS}: dropped"
            )
        elif start >= 8 * limits.MESSAGE_BYTES:
            reason = (
                f"signal {name!r} begins at bit {start}, beyond "
                f"{limits.MESSAGE_BYTES} bytes: dropped"
            )
        else:
            if marker == "m":
                marker = self._marked_as_head(message, statement, match)
            message.signals[name] = statement
            message.markers[name] = marker
            return
        self._drop(statement, reason, message.name, name)

    def _marked_as_head(
        self,
        message: MessageOutline,
        statement: Statement,
        match: re.Match[str],
    ) -> str:
        """Read the mark ``m`` without a number as ``M``."""
        place = statement.start + match.start(2)
        self._edits.append((place, place + 1, "M"))
        reason = (
            f"signal {match[1]!r} has the mark 'm' without a number: read as "
            "the multiplexer, 'M'"
        )
        self.defects.append(
            DbcDefect(statement.line, reason, message.name, (match[1],))
        )
        return "M"

    def _reference(self, statement: Statement) -> None:
        """Look at a statement about a message or signal declared above."""
        if statement.keyword == "CM_":
            size = len(statement.text)
            if size > limits.COMMENT_CHARACTERS:
                reason = f"a comment of {size} characters: left out"
                self._edits.append(statement.dropped())
                self.defects.append(
                    DbcDefect(statement.line, reason, harmless=True)
                )
                return
        if self._thorough and statement.keyword not in FORMS:
            # nothing that a value is read with
            self._edits.append(statement.dropped())
            return
        match = self._match(statement)
        named = ("VAL_", "SIG_VALTYPE_", "SG_MUL_VAL_")
        if match is None or statement.keyword not in named or not match[1]:
            return
        dbc_id, name = int(match[1]), match[2]
        owners = self._by_id.get(dbc_id, [])
        owner = next((one for one in owners if name in one.signals), None)
        if owner is not None and statement.keyword == "SG_MUL_VAL_":
            if match[3] in owner.signals:
                owner.parents[name] = match[3]
                return
            reason = f"no signal is the multiplexer {match[3]!r}"
        elif owner is not None:
            return
        elif dbc_id in self._silent:
            self._edits.append(statement.dropped())
            return
        else:
            what = "such signal" if owners else f"message with id {dbc_id}"
            reason = f"there is no {what}"
        if self._thorough or statement.keyword == "SG_MUL_VAL_":
            self._drop(
                statement,
                f"{statement.keyword} of signal {name!r}: {reason}: dropped",
                owners[0].name if owners else "",
                name,
            )

    def _orphans(self, message: MessageOutline) -> None:
        """Drop signals whose multiplexer is not declared.

        cantools takes them for always present, which gives wrong values.
        """
        heads = [
            name for name, mark in message.markers.items() if mark[-1:] == "M"
        ]
        lack = (
            f"SG_MUL_VAL_ names which of {', '.join(heads)} selects it"
            if heads
            else "multiplexer is declared"
        )
        for name, marker in message.markers.items():
            known = len(heads) == 1 or name in message.parents
            if marker in ("", "M") or known:
                continue
            reason = (
                f"signal {name!r} is multiplexed ({_shown(marker)}), but no "
                f"{lack}: dropped"
            )
            statement = message.signals.pop(name)
            self._drop(statement, reason, message.name, name)

    def _match(
        self, statement: Statement, message: str = ""
    ) -> re.Match[str] | None:
        """Match *statement* with its form; note what is beside the form."""
        pattern = FORMS.get(statement.keyword)
        match = pattern.match(statement.text) if pattern else None
        if not self._thorough or pattern is None:
            return match
        if match is None:
            form = _FORM_SHOWN.get(statement.keyword)
            reason = f"cannot be read: {_shown(statement.text)}" + (
                f" (form: {form})" if form else ""
            )
            self._drop(statement, f"{reason}: dropped", message)
            return None
        place = statement.start + match.end()
        if match["end"] is None:
            implied = _IMPLIED.get(statement.keyword)
            end = " Vector__XXX" if implied else ";"
            self._edits.append((place, place, end))
            reason = (
                f"{implied or 'the semicolon'} is missing at the end of "
                f"{_shown(match[0])}: read all the same"
            )
            self.defects.append(DbcDefect(statement.line, reason, message))
        rest = statement.text[match.end() :]
        if rest.strip(" \t\n;,"):
            blank = len(rest) - len(rest.lstrip())
            line = statement.line + statement.text.count(
                "\n", 0, match.end() + blank
            )
            reason = f"cannot be read: {_shown(rest.strip())}: dropped"
            self.defects.append(DbcDefect(line, reason, message))
        if rest.strip():
            self._edits.append((place, statement.end, "\n" * rest.count("\n")))
        return match

    def _drop(
        self, statement: Statement, reason: str, message: str, signal: str = ""
    ) -> None:
        self._edits.append(statement.dropped())
        signals = (signal,) if signal else ()
        self.defects.append(
            DbcDefect(statement.line, reason, message, signals)
        )


def _message_problem(dbc_id: int, size: int) -> str:
    extended = dbc_id & _EXTENDED
    bits = 29 if extended else 11
    if (dbc_id ^ extended) >> bits:
        return f"its id {dbc_id} has more than {bits} bits: dropped"
    if size > limits.MESSAGE_BYTES:
        return f"has {size} bytes, more than {limits.MESSAGE_BYTES}: dropped"
    return ""


def _shown(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _SHOWN else f"{line[:_SHOWN]}..."
