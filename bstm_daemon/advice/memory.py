"""What a restart within a drive carries over of the advice."""

from __future__ import annotations

from enum import Enum
from math import isfinite
from typing import TYPE_CHECKING, Any, ClassVar

if TYPE_CHECKING:
    from collections.abc import Mapping


class Machine:
    """A state machine whose memory is the attributes in ``MEMORY``.

    They are numbers, members of an enumeration, None, or tuples of numbers
    and None.
    """

    MEMORY: ClassVar[tuple[str, ...]] = ()

    def export(self) -> dict[str, Any]:
        """Return the memory as plain values that JSON knows."""
        return {name: _plain(getattr(self, name)) for name in self.MEMORY}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Take over what :meth:`export` gave.

        Raises:
            KeyError, TypeError, ValueError: it is nothing of that kind; the
                machine may be half restored.
        """
        for name in self.MEMORY:
            now = getattr(self, name)
            value = saved[name]
            if isinstance(now, Enum):
                setattr(self, name, type(now)(value))
            else:
                setattr(self, name, _number(value))


def _plain(value: Any) -> Any:
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not isfinite(value):
        return str(value)
    return value


def _number(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_number(part) for part in value)
    if isinstance(value, str):
        return float(value)
    if value is None or isinstance(value, bool | int | float):
        return value
    msg = f"{value!r}: not a number"
    raise TypeError(msg)
