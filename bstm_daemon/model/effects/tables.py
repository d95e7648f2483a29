"""Tables and limits that several effects share."""

from collections.abc import Callable

from bstm_daemon.model.thermal.network import Factor, value
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

ROOM_K = 20.0 + KELVIN_OFFSET
FASTEST_MS = 120.0
"""End of the tables over speed."""

NEGLIGIBLE = 1e-6
"""Least strength; below it a part would be singular and is as good as absent.
"""

RELEASED = Table(0.0, 1.0, (1.0, 0.0))
"""1 with the brake off, 0 with it on, over ``brake_on``."""


def over_speed(share: Callable[[float], float]) -> Factor:
    """Return a factor *share* of the speed [m/s], tabulated."""
    return value("speed_ms", Table.from_function(share, 0.0, FASTEST_MS, 481))


def rising_with_speed(still: float, rise: float) -> Factor:
    """Return a factor *still* at rest and *rise* more for each m/s."""
    ends = (still, still + FASTEST_MS * rise)
    return value("speed_ms", Table(0.0, FASTEST_MS, ends))
