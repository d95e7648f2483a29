"""What an estimate needs, corner by corner, to be valid.

An estimate is *valid*; *degraded* where an input that the heat mode goes by
is missing or suspect, its heat comes from the other source, or its start or
heat was unknown and is still felt; *invalid* where its heat has been unknown
for too long, or it is no temperature of a brake. ``docs/validity.md`` has
the answers in a table.
"""

from __future__ import annotations

from array import array
from math import isfinite, isnan
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.channels import (
    CORNER_PRESSURE,
    CORNER_PRESSURE_SUSPECT,
    FLAGS,
    HEAT_LOST,
    HEAT_UNCERTAIN,
    WHEEL_SUSPECT,
)
from bstm_daemon.estimate import Validity
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimator.blocks import Block


LOWEST_K: Final = 200.0
HIGHEST_K: Final = 1800.0
"""An estimate outside can not be true: below any ambient, above iron's
melting point."""


class Needs(NamedTuple):
    """What a corner needs.

    Bits of a step's flags that degrade an estimate or make it invalid;
    whether its disc must be measured.
    """

    degrading: int
    invalidating: int
    measured: bool


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
            _inputs(config, present, place) | HEAT_UNCERTAIN << place,
            HEAT_LOST << place,
            config.heat.mode == "measured",
        )
        for place, corner in enumerate(config.corner)
    }


def validities(
    block: Block, needs: Mapping[str, Needs]
) -> dict[str, array[int]]:
    """Return the validity of each corner of *block*, one a publication.

    Args:
        block: its own validities are not read.
        needs: what each corner needs, by its name.
    """
    found = {}
    for name, (number, place, stride, group) in block.layout.modelled.items():
        output = block.outputs[number]
        degrading, invalidating, measured = needs[name]
        codes = array("b")
        for i, flags in enumerate(block.flags):
            first = i * stride + place
            nodes = output[first : first + group.nodes]
            # nan fails every comparison, but min and max may pass it over
            if not (
                isfinite(sum(nodes))
                and min(nodes) > LOWEST_K
                and max(nodes) < HIGHEST_K
                and not flags & invalidating
            ):
                codes.append(Validity.INVALID)
            elif (
                flags & degrading
                or i < block.known_from
                or (
                    measured
                    and isnan(block.at(i).channel(name, "measured_disc_k"))
                )
            ):
                codes.append(Validity.DEGRADED)
            else:
                codes.append(Validity.VALID)
        found[name] = codes
    return found


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
