"""Memories that survive a restart: state machines as plain values."""

from __future__ import annotations

from enum import Enum
from math import isfinite
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


class Machine:
    """A state machine whose memory is the attributes in ``MEMORY``.

    Each has what reads its plain form: an enumeration or a function of this
    module. A reader raises TypeError or ValueError at anything else, because
    a state file may hold anything.
    """

    MEMORY: ClassVar[Mapping[str, Callable[[Any], Any]]] = {}

    def export(self) -> dict[str, Any]:
        """Return the memory as plain values that JSON knows."""
        return {name: _plain(getattr(self, name)) for name in self.MEMORY}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Take over what :meth:`export` gave.

        Raises:
            KeyError, TypeError, ValueError: it is nothing of that kind; the
                machine is as it was.
        """
        read = {name: kind(saved[name]) for name, kind in self.MEMORY.items()}
        for name, value in read.items():
            setattr(self, name, value)


def flag(value: Any) -> bool:
    """Return *value*, true or false."""
    if not isinstance(value, bool):
        msg = f"{value!r}: neither true nor false"
        raise TypeError(msg)
    return value


def stamp(value: Any) -> int:
    """Return *value*, a time in microseconds."""
    if isinstance(value, bool) or not isinstance(value, int):
        msg = f"{value!r}: no time"
        raise TypeError(msg)
    return value


def number(value: Any) -> float:
    """Return *value*, a finite number."""
    read = any_number(value)
    if not isfinite(read):
        msg = f"{value!r}: not finite"
        raise ValueError(msg)
    return read


def share(value: Any) -> float:
    """Return *value*, from 0 to 1."""
    read = number(value)
    if not 0.0 <= read <= 1.0:
        msg = f"{value!r}: not from 0 to 1"
        raise ValueError(msg)
    return read


def any_number(value: Any) -> float:
    """Return *value*, a number, as text if it is not finite."""
    if isinstance(value, str):
        return float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        msg = f"{value!r}: not a number"
        raise TypeError(msg)
    return float(value)


def perhaps(kind: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return what reads None or a *kind*."""
    return lambda value: None if value is None else kind(value)


def row(*kinds: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return what reads a list of as many, each of its own kind."""

    def read(value: Any) -> tuple[Any, ...]:
        if not isinstance(value, list):
            msg = f"{value!r}: no list"
            raise TypeError(msg)
        return tuple(
            kind(part) for kind, part in zip(kinds, value, strict=True)
        )

    return read


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not isfinite(value):
        return str(value)
    return value
