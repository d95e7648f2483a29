"""Flags of input faults in groups, and their texts for the user."""

from collections.abc import Sequence
from typing import Final

from bstm_daemon.channels import (
    CORNER_PRESSURE,
    CORNER_PRESSURE_SUSPECT,
    FLAGS,
    HEAT_LOST,
    HEAT_UNCERTAIN,
    WHEEL_SUSPECT,
)
from bstm_daemon.roles import CORNERS

_ANY_CORNER: Final = 0b1111

FAULTS: Final = {
    **{
        name: bit
        for name, bit in FLAGS.items()
        if name not in {"clock_jump", "settled"}
    },
    "wheel_speed_suspect": _ANY_CORNER * WHEEL_SUSPECT,
    "heat_lost": _ANY_CORNER * HEAT_LOST,
    "heat_doubt": _ANY_CORNER * HEAT_UNCERTAIN,
}
"""Bits of each fault of the inputs or the heat, of any corner."""

CONTRADICTIONS: Final = (
    FLAGS["switch_contradicts"]
    | FLAGS["wheels_contradict"]
    | FLAGS["acceleration_contradicts"]
    | FLAGS["pressure_contradicts"]
    | FLAGS["forces_contradict"]
)
"""Inputs do not agree with each other."""

CAUSES: Final = FLAGS["samples_refused"] | FLAGS["stuck"] | CONTRADICTIONS
"""Faults that make an input suspect. They are the only bits of a vehicle speed
that is left out while a wheel speed is sound."""

SUSPECT: Final = (
    CAUSES
    | FLAGS["speed_suspect"]
    | FLAGS["pressure_suspect"]
    | FLAGS["acceleration_suspect"]
    | FLAGS["torque_suspect"]
    | FLAGS["temperature_suspect"]
    | FLAGS["ambient_suspect"]
    | FAULTS["wheel_speed_suspect"]
    | _ANY_CORNER * CORNER_PRESSURE_SUSPECT
)
"""An input is suspect, whether the heat mode uses it or not."""

SUBSTITUTED: Final = FLAGS["heat_substituted"] | FLAGS["heat_unknown"]
"""The heat of a corner is from the other source, or from none."""

WORDS: Final = {
    "speed_missing": "speed missing",
    "pressure_missing": "pressure missing",
    "acceleration_missing": "acceleration missing",
    "torque_missing": "torque missing",
    "ambient_missing": "ambient temperature missing",
    "clock_jump": "clock was set",
    "settled": "parked, settled to ambient",
    "speed_suspect": "speed suspect",
    "pressure_suspect": "pressure suspect",
    "acceleration_suspect": "acceleration suspect",
    "torque_suspect": "torque suspect",
    "temperature_suspect": "temperature suspect",
    "samples_refused": "impossible values or jumps refused",
    "stuck": "a signal is stuck",
    "switch_contradicts": "braking without brake switch",
    "wheels_contradict": "wheel speeds contradict each other",
    "acceleration_contradicts": "acceleration contradicts the speed",
    "heat_substituted": "heat from the other source",
    "heat_unknown": "heat unknown",
    "silent": "bus silent",
    "external_force_suspected": "external force suspected, nothing learned",
    "observer_reset": "learned vehicle data reset",
    "acceleration_scale": "acceleration wrongly scaled or not measured",
    "wheel_radius": "wheel speed disagrees with satellite speed",
    "pressure_dead": "repeated braking without any pressure",
    "braking_unpressed": "braking without measured pressure",
    "pressure_contradicts": "pressure below zero, or left against right",
    "forces_contradict": "torque, brakes and acceleration contradict",
    "ambient_suspect": "ambient temperature suspect",
    "driven_unseen": "driven while nothing was received",
    "asleep": "bus asleep, car parked",
    "speed_unproven": "no change of speed compared yet",
    "forces_unproven": "pressure unproven after an external force",
    "wheel_speed_suspect": "wheel speed suspect",
    "heat_lost": "heat unknown for too long",
    "heat_doubt": "unknown heat still has an effect",
}
"""Each of :data:`FLAGS` and :data:`FAULTS` in plain words."""


def reasons(flags: int, corners: Sequence[str] = CORNERS) -> list[str]:
    """Return *flags* in plain words, in the order of the bits.

    *corners*: names of the corners in the order of the configuration.
    """
    words = [WORDS[name] for name, bit in FLAGS.items() if flags & bit]
    for first, text in (
        (CORNER_PRESSURE, WORDS["pressure_missing"]),
        (WHEEL_SUSPECT, WORDS["wheel_speed_suspect"]),
        (CORNER_PRESSURE_SUSPECT, WORDS["pressure_suspect"]),
        (HEAT_LOST, WORDS["heat_lost"]),
        (HEAT_UNCERTAIN, WORDS["heat_doubt"]),
    ):
        names = [n for c, n in enumerate(corners) if flags & first << c]
        if names:
            words.append(f"{text}: {', '.join(names)}")
    return words


def fault_names(flags: int) -> tuple[str, ...]:
    """Return which of :data:`FAULTS` are in *flags*."""
    return tuple(name for name, bits in FAULTS.items() if flags & bits)
