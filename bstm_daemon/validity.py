"""What an estimate needs, corner by corner, to be valid.

An estimate is *valid*; *degraded* where an input that the heat mode goes by
is missing or suspect, its heat comes from the other source, or its start or
heat was unknown and is still felt; *invalid* where its heat has been unknown
for too long, or it is no temperature of a brake. ``docs/validity.md`` has
the answers in a table.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.heat.sample_plan import (
    CORNER_PRESSURE,
    CORNER_PRESSURE_SUSPECT,
    FLAGS,
    HEAT_DOUBT,
    HEAT_LOST,
    WHEEL_SUSPECT,
)
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config import Config

VALID: Final = 0
DEGRADED: Final = 1
INVALID: Final = 2


class Needs(NamedTuple):
    """Bits of a step's flags that degrade an estimate or make it invalid."""

    degrading: int
    invalidating: int


def needs_of_corners(
    config: Config, present: Mapping[int, int]
) -> dict[str, Needs]:
    """Return what each corner of *config* needs, by its name.

    Args:
        config: the vehicle.
        present: role number to timeout [us] of each mapped role; an input
            that nothing is mapped to is not waited for.
    """
    return {
        corner.name: Needs(
            _inputs(config, present, place) | HEAT_DOUBT << place,
            HEAT_LOST << place,
        )
        for place, corner in enumerate(config.corner)
    }


def _inputs(config: Config, present: Mapping[int, int], place: int) -> int:
    flags = FLAGS["speed_missing"] | FLAGS["speed_suspect"]
    if config.heat.mode == "fb":
        for role, name in (
            ("acceleration_longitudinal", "acceleration"),
            ("powertrain_torque", "torque"),
        ):
            if ROLE_INDEX[role] in present:
                flags |= FLAGS[f"{name}_missing"] | FLAGS[f"{name}_suspect"]
        return flags
    flags |= CORNER_PRESSURE << place
    flags |= CORNER_PRESSURE_SUSPECT << place
    flags |= WHEEL_SUSPECT << place
    if config.heat.mode == "measured":
        flags |= FLAGS["temperature_suspect"]
    return flags
