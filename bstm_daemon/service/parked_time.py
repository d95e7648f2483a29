"""Parked time of the car, as far as the clocks prove it.

The brakes may cool for no longer than the car stood: time that is not proven
keeps them hot. Within one boot of the computer the time since boot proves it,
which nobody sets. Over a power cut there are two proofs: the uptime since, and
the wall clock if it was synchronised at both ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, slots=True)
class Moment:
    """An instant by every clock of the computer.

    ``wall_error_us`` is how far the wall clock may be from the true time;
    None if it is not synchronised. ``boot_id`` is None where the system
    does not name its boots.
    """

    boot_id: str | None
    boot_us: int
    wall_us: int
    wall_error_us: int | None

    @classmethod
    def saved(cls, document: Mapping[str, Any]) -> Moment | None:
        """Return the moment in a state file's *document*, None without."""
        boot_us, wall_us = document.get("boot_us"), document.get("wall_us")
        if not (isinstance(boot_us, int) and isinstance(wall_us, int)):
            return None
        boot_id = document.get("boot_id")
        error_us = document.get("wall_error_us")
        return cls(
            boot_id if isinstance(boot_id, str) else None,
            boot_us,
            wall_us,
            error_us if isinstance(error_us, int) and error_us >= 0 else None,
        )


class ParkedTime(NamedTuple):
    """The shortest time [us] that the clocks allow; whether it is exact."""

    us: int
    exact: bool


def parked_time(saved: Moment | None, start: Moment) -> ParkedTime:
    """Return how long the car stood at least from *saved* to *start*."""
    if saved is None:
        return ParkedTime(0, exact=False)
    if saved.boot_id is None or start.boot_id is None:
        up_us = 0
    elif saved.boot_id == start.boot_id:
        return ParkedTime(max(start.boot_us - saved.boot_us, 0), exact=True)
    else:
        up_us = max(start.boot_us, 0)
    if saved.wall_error_us is None or start.wall_error_us is None:
        return ParkedTime(up_us, exact=False)
    error_us = saved.wall_error_us + start.wall_error_us
    wall_us = start.wall_us - saved.wall_us - error_us
    return ParkedTime(max(up_us, wall_us), exact=True)
