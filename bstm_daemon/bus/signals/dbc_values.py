"""Raw values that a DBC's value table names as no value at all.

A sender without a measurement sends a reserved raw value, mostly the
highest ones, and the DBC's ``VAL_`` line names it: ``254 "Error" 255 "SNA"``.
Taken for a measurement it would be the highest speed or pressure there is.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from cantools.database.can import Signal

_WORD: Final = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|[^\W_a-zA-Z]+")
_ALONE: Final = frozenset(
    {
        *("sna", "unavailable", "invalid", "error", "fault"),
        *("notavailable", "notavail", "notvalid"),
    }
)
"""Words that mean "no value" alone."""
_DENIED: Final = frozenset({"available", "avail", "valid"})
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
    words = [word.lower() for word in _WORD.findall(name)]
    found = False
    position = 0
    while position < len(words):
        word = words[position]
        following = words[position + 1 : position + 2]
        if word == "not" and _DENIED.issuperset(following) and following:
            found = True
            position += 1
        elif word in _ALONE:
            found = True
        elif word not in _BESIDE:
            return False
        position += 1
    return found
