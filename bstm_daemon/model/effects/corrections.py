"""Correction of samples for the sensor errors of effects."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from bstm_daemon.model.effects.model import Correction


def corrections_by_role(
    corrections: Iterable[Correction],
) -> dict[int, tuple[float, float]]:
    """Return gain and offset by role number; of one role, one after another.

    Raises:
        KeyError: a role that does not exist.
    """
    found: dict[int, tuple[float, float]] = {}
    for one in corrections:
        role = ROLE_INDEX[one.role]
        gain, offset = found.get(role, (1.0, 0.0))
        found[role] = one.gain * gain, one.gain * offset + one.offset
    return found


def corrected(
    corrections: Mapping[int, tuple[float, float]],
    roles: Sequence[int] | Any,
    values: Sequence[float] | Any,
) -> array[float]:
    """Return *values* [n] of *roles* [n], corrected; neither is changed."""
    found = array("d", values)
    for index, role in enumerate(roles):
        if role in corrections:
            gain, offset = corrections[role]
            found[index] = gain * found[index] + offset
    return found
