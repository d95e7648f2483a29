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
    from bstm_daemon.estimator.trust import Trust


LOWEST_K: Final = 200.0
HIGHEST_K: Final = 1800.0
"""An estimate outside can not be true: below any ambient, above iron's
melting point."""


_MOTION: Final = (
    ("acceleration_longitudinal", "acceleration"),
    ("powertrain_torque", "torque"),
)
_OBSERVED: Final = ("acceleration_scale", "wheel_radius", "pressure_dead")
"""What the observer of the car finds against an input."""


_SURE: Final = FLAGS["pressure_zero"] | FLAGS["ambient_suspect"]
"""Whatever the heat mode: pressure also says when the motion brakes, and all
temperatures are above the ambient's."""


class Needs(NamedTuple):
    """What a corner needs.

    Bits of a step's flags that degrade an estimate, those among them that
    speak against its heat, and those that make it invalid; whether its disc
    must be measured.
    """

    degrading: int
    suspecting: int
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
    found: dict[str, Needs] = {}
    for place, corner in enumerate(config.corner):
        suspecting = _suspecting(config, present, place)
        found[corner.name] = Needs(
            _missing(config, present, place)
            | _pressure(config, place)
            | suspecting
            | HEAT_UNCERTAIN << place,
            suspecting,
            HEAT_LOST << place,
            config.heat.mode == "measured",
        )
    return found


def validities(
    block: Block, needs: Mapping[str, Needs], trust: Trust, step_s: float
) -> dict[str, array[int]]:
    """Return the validity of each corner of *block*, one a publication.

    Args:
        block: its own validities are not read.
        needs: what each corner needs, by its name.
        trust: remembers what was found against the heat.
        step_s: time between two publications [s].
    """
    found = {}
    of_car = trust.findings(block, step_s)
    for name, (number, place, stride, group) in block.layout.modelled.items():
        output = block.outputs[number]
        degrading, suspecting, invalidating, measured = needs[name]
        codes = array("b")
        for i, flags in enumerate(block.flags):
            first = i * stride + place
            nodes = output[first : first + group.nodes]
            held = trust.holds(
                name, step_s, found=of_car[i] or bool(flags & suspecting)
            )
            # nan fails every comparison, but min and max may pass it over
            if not (
                isfinite(sum(nodes))
                and min(nodes) > LOWEST_K
                and max(nodes) < HIGHEST_K
                and not flags & invalidating
            ):
                codes.append(Validity.INVALID)
            elif (
                held
                or flags & degrading
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


def _missing(config: Config, present: Mapping[int, int], place: int) -> int:
    flags = FLAGS["speed_missing"]
    if config.heat.mode != "fb":
        return flags | CORNER_PRESSURE << place
    for role, name in _MOTION:
        if ROLE_INDEX[role] in present:
            flags |= FLAGS[f"{name}_missing"]
    return flags


def _pressure(config: Config, place: int) -> int:
    """Return the bit of a suspect pressure, where the heat comes from it."""
    return 0 if config.heat.mode == "fb" else CORNER_PRESSURE_SUSPECT << place


def _suspecting(config: Config, present: Mapping[int, int], place: int) -> int:
    flags, mode = FLAGS["speed_suspect"] | _SURE, config.heat.mode
    if mode in {"fb", "fused"}:
        for role, name in _MOTION:
            if ROLE_INDEX[role] in present:
                flags |= FLAGS[f"{name}_suspect"]
    if mode == "fb":
        return flags
    flags |= WHEEL_SUSPECT << place
    if mode == "measured":
        flags |= FLAGS["temperature_suspect"]
    if mode == "fused":
        # whether the pressure was wrong is known by the work it explains
        for name in _OBSERVED:
            flags |= FLAGS[name]
    else:
        flags |= _pressure(config, place)
    return flags
