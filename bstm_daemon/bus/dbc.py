"""DBC files, read with cantools, with every problem worded for the user."""

import math
from pathlib import Path
from typing import Final

import cantools.database
from cantools.database.can import Database, Message, Signal
from cantools.database.errors import Error, UnsupportedDatabaseFormatError

from bstm_daemon.bus.extraction import RawSignal
from bstm_daemon.errors import ConfigError

_LENIENT_HINT: Final = "set strict = false in its [[bus]] to load it anyway"
_LONGEST_BITS: Final = 64
_FLOAT_BITS: Final = (16, 32, 64)
_MULTIPLEXER_BITS: Final = 52


class UnusableSignalError(ValueError):
    """A signal that a DBC declares but that no value can be read from."""


def load_dbc(path: Path, *, strict: bool, encoding: str) -> Database:
    """Load the DBC *path*.

    With *strict*, signals that overlap or do not fit in their message are
    problems, all of them listed. Raises :class:`ConfigError` for those and
    for a file that cannot be read or is no DBC.
    """
    try:
        text = path.read_text(encoding=encoding, errors="replace")
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigError([f"{path}: cannot be read: {reason}"]) from error
    except LookupError as error:
        raise ConfigError(
            [f"{path}: encoding = {encoding!r} is not a known encoding"]
        ) from error
    try:
        return _parse(text, strict=strict)
    except UnsupportedDatabaseFormatError as error:
        raise ConfigError(_problems(path, text, error)) from error


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
    )


def multiplexers(
    message: Message, name: str
) -> list[tuple[str, frozenset[int]]]:
    """Return what must hold for the signal *name* to be in a frame.

    Pairs of multiplexer and its values, from the nearest to the root of the
    message (extended multiplexing). Raises :class:`UnusableSignalError`.
    """
    found = []
    signal = message.get_signal_by_name(name)
    while signal.multiplexer_signal is not None:
        parent = message.get_signal_by_name(signal.multiplexer_signal)
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


def _parse(text: str, *, strict: bool) -> Database:
    database = cantools.database.load_string(text, "dbc", strict=strict)
    assert isinstance(database, Database)  # noqa: S101
    return database


def _problems(
    path: Path, text: str, error: UnsupportedDatabaseFormatError
) -> list[str]:
    """Return one line a message that is not strict, else the syntax error.

    cantools stops at its first finding; a lenient pass shows them all.
    """
    try:
        database = _parse(text, strict=False)
    except UnsupportedDatabaseFormatError:
        return [f"{path}: not a DBC: {error.e_dbc}"]
    return [
        f"{path}: message {message.name!r}: {reason} {_LENIENT_HINT}"
        for message in database.messages
        if (reason := _strict_problem(message))
    ]


def _strict_problem(message: Message) -> str:
    try:
        message.refresh(strict=True)
    except Error as error:
        return str(error)
    return ""


def _check(message: Message, signal: Signal) -> None:
    end = _start(signal) + signal.length
    conversion = signal.conversion
    if end > 8 * message.length:
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
