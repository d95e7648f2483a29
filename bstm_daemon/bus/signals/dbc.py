"""DBC files, read with cantools, with every problem worded for the user.

A strict load refuses a file with any defect; a lenient one leaves out what
cannot be read, names it and loads the rest. cantools decodes overlapping
signals wrongly, the extraction plan does not: it takes from here only where a
signal lies, and each signal is read by itself.

A sender without a measurement sends a reserved raw value, mostly the highest
ones, and the ``VAL_`` line names it: ``254 "Error" 255 "SNA"``. Taken for a
measurement it would be the highest speed or pressure there is.
"""

import itertools
import logging
import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cantools.database
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import UnsupportedDatabaseFormatError

from bstm_daemon.bus.signals import dbc_text
from bstm_daemon.bus.signals.dbc_survey import MessageOutline, Survey
from bstm_daemon.bus.signals.extraction import RawSignal
from bstm_daemon.config.limits import DBC_BYTES, read_limited
from bstm_daemon.errors import ConfigError

_WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W_a-zA-Z]+")
_ALONE: Final = frozenset(
    {
        *("sna", "unavailable", "invalid", "error", "fault"),
        *("notavailable", "notavail", "notvalid"),
    }
)
"""Words that mean "no value" alone."""
_DENIED: Final = re.compile(r"\bnot (available|avail|valid)\b")
"""Words that mean "no value" after ``not`` only."""
_BESIDE: Final = frozenset(
    {
        *("signal", "sig", "value", "val", "data", "sensor", "measurement"),
        *("indicator", "or", "and", "is"),
    }
)
"""Words that may stand beside them; any other changes the meaning."""
_STATES_OF_ONE_BIT: Final = 1


def unavailable_values(signal: Signal) -> frozenset[int]:
    """Return the raw values of *signal* that stand for no value, unsigned.

    A signal of one bit has none: there, ``fault`` is what it reports. Neither
    has a floating-point one, which has nan.
    """
    size = signal.length
    if size <= _STATES_OF_ONE_BIT or signal.conversion.is_float:
        return frozenset()
    return frozenset(
        int(raw) & ((1 << size) - 1)
        for raw, name in (signal.choices or {}).items()
        if -(1 << (size - 1)) <= int(raw) < 1 << size
        and names_no_value(str(name))
    )


def names_no_value(name: str) -> bool:
    """Whether *name* of a value table means that there is no value.

    It does where it has one of ``SNA``, ``not available``, ``unavailable``,
    ``invalid``, ``not valid``, ``error``, ``fault``, in any case and
    spelling of words together, and else only words such as ``signal``.
    ``No error`` and ``fault memory full`` do not.
    """
    if name.strip().lower() in {"n/a", "n.a."}:
        return True
    text = " ".join(_WORD.findall(name)).lower()
    words = {*_DENIED.sub("invalid", text).split()}
    return words <= _ALONE | _BESIDE and not words <= _BESIDE


_LENIENT_HINT: Final = "set strict = false in its [[bus]] to load it anyway"
_LONGEST_BITS: Final = 64
_FLOAT_BITS: Final = (16, 32, 64)
_MULTIPLEXER_BITS: Final = 52
_PAIRS_SHOWN: Final = 6
_EXTENDED: Final = 0x8000_0000


class UnusableSignalError(ValueError):
    """A signal that a DBC declares but that no value can be read from."""


@dataclass(frozen=True, slots=True)
class LoadedDbc:
    """A database and what had to be overlooked to load it."""

    database: Database
    warnings: tuple[dbc_text.DbcDefect, ...]


def load_dbc(path: Path, *, strict: bool, encoding: str) -> Database:
    """Return the database of :func:`read_dbc`, which see."""
    return read_dbc(path, strict=strict, encoding=encoding).database


def read_dbc(path: Path, *, strict: bool, encoding: str) -> LoadedDbc:
    """Read the DBC *path*.

    *strict*, every defect is a problem: statements that cannot be read,
    names and ids given twice, signals that overlap, that do not fit in
    their message or whose multiplexer is missing. Else what is loadable is
    loaded and the defects are warnings. Raises :class:`ConfigError` with all
    problems, and for a file that cannot be read or is no DBC.
    """
    try:
        content = read_limited(path, DBC_BYTES)
        text, defects = dbc_text.decode_dbc(content, encoding)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigError([f"{path}: cannot be read: {reason}"]) from error
    except LookupError as error:
        raise ConfigError(
            [f"{path}: encoding = {encoding!r} is not a known encoding"]
        ) from error
    except ValueError as error:
        raise ConfigError([f"{path}: {error}"]) from error
    try:
        database, survey = _load(text)
    except UnsupportedDatabaseFormatError as error:
        raise ConfigError([f"{path}: not a DBC: {error.e_dbc}"]) from error
    defects += survey.defects
    defects += layout_defects(database, survey.messages)
    defects.sort(key=lambda defect: defect.line)
    problems = [defect for defect in defects if not defect.harmless]
    if strict and problems:
        raise ConfigError(
            [f"{path}: {defect}; {_LENIENT_HINT}" for defect in problems]
        )
    return LoadedDbc(database, tuple(defects))


def raw_signal(message: Message, name: str) -> RawSignal:
    """Return where the signal *name* of *message* lies and its conversion.

    Raises :class:`UnusableSignalError` for what only a leniently loaded DBC
    can hold (a signal beyond the end of its message) and for a length or a
    conversion that gives no usable value.
    """
    signal = message.get_signal_by_name(name)
    _check(message, signal)
    conversion = signal.conversion
    scale, offset = conversion.scale, conversion.offset
    # cantools computes whole-number conversions of integers exactly
    exact = float(scale).is_integer() and float(offset).is_integer()
    if exact and not conversion.is_float:
        scale, offset = int(scale), int(offset)
    return RawSignal(
        name=signal.name,
        start=_start(signal),
        length=signal.length,
        big_endian=signal.byte_order == "big_endian",
        signed=signal.is_signed,
        floating=conversion.is_float,
        scale=scale,
        offset=offset,
        unavailable=unavailable_values(signal),
    )


def multiplexers(
    message: Message, name: str
) -> list[tuple[str, frozenset[int]]]:
    """Return what must hold for the signal *name* to be in a frame.

    Pairs of multiplexer and its values, from the nearest to the root of the
    message (extended multiplexing). Raises :class:`UnusableSignalError`.
    """
    found: list[tuple[str, frozenset[int]]] = []
    signal = message.get_signal_by_name(name)
    while signal.multiplexer_signal is not None:
        if len(found) >= len(message.signals):
            msg = f"signal {name!r} hangs on a circle of multiplexers"
            raise UnusableSignalError(msg)
        parent = _multiplexer(message, signal)
        values = frozenset(signal.multiplexer_ids or ())
        if not values or parent.length > _MULTIPLEXER_BITS:
            msg = (
                f"signal {name!r} hangs on multiplexer {parent.name!r}, which "
                f"needs values for it and at most {_MULTIPLEXER_BITS} bits"
            )
            raise UnusableSignalError(msg)
        found.append((parent.name, values))
        signal = parent
    return found


def layout_defects(
    database: Database, outlines: list[MessageOutline]
) -> list[dbc_text.DbcDefect]:
    """List signals beyond the end of their message and those that overlap.

    Signals that are never in the same frame do not overlap. One entry a
    message and kind; *outlines* give the lines.
    """
    lines = {(one.dbc_id, one.name): one for one in outlines}
    defects = []
    for message in database.messages:
        dbc_id = message.frame_id | _EXTENDED * message.is_extended_frame
        outline = lines.get((dbc_id, message.name))
        size = 8 * message.length
        spans = {one.name: _bits(one) for one in message.signals}
        held = {one.name: _held(message, one.name) for one in message.signals}
        beyond = [name for name, bits in spans.items() if bits >> size]
        if beyond:
            reason = (
                f"signals do not fit in its {message.length} bytes: "
                f"{_listed(beyond)}"
            )
            defects.append(_layout_defect(message, outline, beyond, reason))
        pairs = [
            (one.name, other.name)
            for one, other in itertools.combinations(message.signals, 2)
            if spans[one.name] & spans[other.name]
            and not _exclusive(held[one.name], held[other.name])
        ]
        if pairs:
            names = list(dict.fromkeys(itertools.chain(*pairs)))
            shown = [f"{one} and {other}" for one, other in pairs]
            reason = f"signals overlap: {_listed(shown)}"
            defects.append(_layout_defect(message, outline, names, reason))
    return defects


def _load(text: str) -> tuple[Database, Survey]:
    """Load *text* whole if it can be, else without what cannot be read.

    Raises ``UnsupportedDatabaseFormatError`` when no message remains.
    """
    survey = Survey(text, thorough=False)
    try:
        return _parse(survey.cleaned()), survey
    except UnsupportedDatabaseFormatError:
        survey = Survey(text, thorough=True)
        if not survey.messages:
            raise
    cleaned = survey.cleaned()
    try:
        return _parse(cleaned), survey
    except UnsupportedDatabaseFormatError as error:
        attributes = [
            statement
            for statement in dbc_text.statements_of(cleaned)
            if statement.keyword.startswith("BA_")
        ]
        if not attributes:
            raise
        reason = (
            "the attributes (BA_...) cannot be read and are dropped, cycle "
            f"times, long names and CAN FD marks with them: {error.e_dbc}"
        )
        survey.defects.append(dbc_text.DbcDefect(attributes[0].line, reason))
        edits = [attribute.dropped() for attribute in attributes]
        return _parse(dbc_text.edited(cleaned, edits)), survey


def _parse(text: str) -> Database:
    # of two messages with one id, which the survey names
    logging.getLogger("cantools").setLevel(logging.ERROR)
    database = cantools.database.load_string(text, "dbc", strict=False)
    assert isinstance(database, Database)  # noqa: S101
    return database


def _layout_defect(
    message: Message,
    outline: MessageOutline | None,
    names: list[str],
    reason: str,
) -> dbc_text.DbcDefect:
    line = outline.line if outline else 0
    if outline and names[0] in outline.signals:
        line = outline.signals[names[0]].line
    return dbc_text.DbcDefect(line, reason, message.name, tuple(names))


def _multiplexer(message: Message, signal: Signal) -> Signal:
    """Return what *signal* hangs on.

    cantools gives signals their long names (SystemSignalLongSymbol) but
    leaves the short one, cut to 32 characters, in ``multiplexer_signal``.
    """
    name = signal.multiplexer_signal or ""
    for fits in (name.__eq__, lambda long: long.startswith(name[:27])):
        heads = [one for one in message.signals if fits(one.name)]
        if len(heads) == 1:
            return heads[0]
    msg = f"signal {signal.name!r} hangs on {name!r}, which does not exist"
    raise UnusableSignalError(msg)


def _listed(shown: list[str]) -> str:
    more = len(shown) - _PAIRS_SHOWN
    tail = f" and {more} more" if more > 0 else ""
    return "; ".join(shown[:_PAIRS_SHOWN]) + tail


def _bits(signal: Signal) -> int:
    """Return the bits of the payload as a mask, bit 0 of byte 0 first."""
    if signal.byte_order == "little_endian":
        return ((1 << signal.length) - 1) << signal.start
    span = range(_start(signal), _start(signal) + signal.length)
    return sum(1 << (8 * (bit // 8) + 7 - bit % 8) for bit in span)


def _held(message: Message, name: str) -> dict[str, frozenset[int]]:
    try:
        return dict(multiplexers(message, name))
    except UnusableSignalError:
        return {}


def _exclusive(
    one: dict[str, frozenset[int]], other: dict[str, frozenset[int]]
) -> bool:
    """Whether a multiplexer keeps two signals out of the same frame."""
    return any(
        one[parent].isdisjoint(other[parent])
        for parent in one.keys() & other.keys()
    )


def _check(message: Message, signal: Signal) -> None:
    end = _start(signal) + signal.length
    conversion = signal.conversion
    if signal.length < 1:
        problem = "has no bits"
    elif end > 8 * message.length:
        problem = (
            f"ends at bit {end} of message {message.name!r}, "
            f"which has {8 * message.length} bits"
        )
    elif signal.length > _LONGEST_BITS:
        problem = f"has {signal.length} bits, at most 64 are read"
    elif conversion.is_float and signal.length not in _FLOAT_BITS:
        problem = f"is a float of {signal.length} bits, not of 16, 32 or 64"
    elif conversion.scale == 0 or not _stays_finite(signal):
        problem = (
            f"has scale {conversion.scale:g} and offset "
            f"{conversion.offset:g} in the DBC, which give no usable value"
        )
    else:
        return
    msg = f"signal {signal.name!r} {problem}"
    raise UnusableSignalError(msg)


def _stays_finite(signal: Signal) -> bool:
    """Whether every integer raw value has a physical value."""
    scale, offset = signal.conversion.scale, signal.conversion.offset
    return math.isfinite(scale * 2.0**signal.length + offset)


def _start(signal: Signal) -> int:
    """Return the start bit as :class:`RawSignal` counts it."""
    if signal.byte_order == "big_endian":
        return 8 * (signal.start // 8) + 7 - signal.start % 8
    return signal.start
