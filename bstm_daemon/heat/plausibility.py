"""Thresholds of the checks of inputs, and their findings in plain words.

A check is a number of seconds: it rises while the check fails, and from
``comes_s`` on the input is suspect; then it must pass for ``goes_s`` before
the input counts as sound again. Where a check can not be made, the number
stays. ``_plausibility.h`` has the same thresholds; ``docs/validity.md`` has
them in tables, with reasons.
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
from bstm_daemon.roles import CORNERS

if TYPE_CHECKING:
    from collections.abc import Sequence

HOLD_US: Final = 2_000_000
"""How long a role is suspect after a sample that was not taken."""

SILENT_US: Final = 1_000_000
"""No sample of any role for longer: the bus sleeps, the car is parked."""


class Hysteresis(NamedTuple):
    """After how long a failing check comes, and a passing one goes [s]."""

    comes_s: float
    goes_s: float

    def after(
        self, doubt_s: float, dt_s: float, *, failed: bool | None
    ) -> float:
        """Return the doubt a step later; *failed* is None if not known."""
        if failed is None:
            return doubt_s
        latched = doubt_s >= self.comes_s
        if failed:
            doubt_s = doubt_s + dt_s
            if latched or doubt_s >= self.comes_s:
                return self.comes_s + self.goes_s
            return doubt_s
        doubt_s = doubt_s - dt_s
        if doubt_s <= (self.comes_s if latched else 0.0):
            return 0.0
        return doubt_s


CONTRADICTION: Final = Hysteresis(2.0, 10.0)
STUCK: Final = Hysteresis(1.0, 10.0)
SWITCH: Final = Hysteresis(1.0, 10.0)
INERTIA: Final = Hysteresis(5.0, 20.0)
REVERSED: Final = Hysteresis(1.0, 20.0)

APART_MS: Final = 2.0
APART_SHARE: Final = 0.2
APART_BRAKING: Final = 0.35
MOVING_MS: Final = 3.0
"""A speed is apart from the others' median by more than 2 m/s and 20 % of it,
35 % while braking: the tightest turn gives 15 to 20 %, ABS slip some more."""

FROZEN_SPEED_S: Final = 5.0
FROZEN_SPEED_MS: Final = 3.0
FROZEN_PRESSURE_S: Final = 30.0
FROZEN_PRESSURE_MS: Final = 5.0
FROZEN_PRESSURE_PA: Final = 3e5
MOVES_S: Final = 1.0
"""Bit-identical for so long while the car's speed changed by so much."""

SWITCH_PRESSURE_PA: Final = 5e5
SWITCH_MS: Final = 1.0

INERTIA_FILTER_S: Final = 2.0
INERTIA_MS2: Final = 4.0
"""3 m/s2 and 1 m/s2 for a slope of 10 %, which the accelerometer feels."""

REVERSED_MEMORY_S: Final = 120.0
REVERSED_MS2: Final = 2.0
REVERSED_MOTION: Final = 40.0
REVERSED_SHARE: Final = 0.2
"""Where the speed gains more than 2 m/s2, which 20 % of slope can not undo,
acceleration times gain is summed: negative means the wrong way round. 40
m2/s3 are 10 s of 2 m/s2, or 2.5 s of 4."""

STANDING_MS: Final = 0.5
PARKING_MS: Final = 5.0
"""A car whose speed is lost above this has not just been parked."""

OUTAGE_S: Final = 10.0
OUTAGE_MEMORY: Final = 30.0
"""Unknown heat for longer makes an estimate invalid; it is felt for so many
times as long."""

_ANY_CORNER: Final = 0b1111

FAULTS: Final = {
    **{
        name: bit
        for name, bit in FLAGS.items()
        if name not in {"clock_jump", "settled"}
    },
    "wheel_speed_suspect": _ANY_CORNER * WHEEL_SUSPECT,
    "heat_lost": _ANY_CORNER * HEAT_LOST,
    "heat_doubt": _ANY_CORNER * HEAT_DOUBT,
}
"""Bits by what is wrong with the inputs or the heat, of any corner."""

CAUSES: Final = (
    FLAGS["samples_refused"]
    | FLAGS["stuck"]
    | FLAGS["switch_contradicts"]
    | FLAGS["wheels_contradict"]
    | FLAGS["acceleration_contradicts"]
)
"""What speaks against an input. A vehicle speed that is left out, while a
wheel is sound, has no other bit."""

SUSPECT: Final = (
    CAUSES
    | FLAGS["speed_suspect"]
    | FLAGS["pressure_suspect"]
    | FLAGS["acceleration_suspect"]
    | FLAGS["torque_suspect"]
    | FLAGS["temperature_suspect"]
    | FAULTS["wheel_speed_suspect"]
    | _ANY_CORNER * CORNER_PRESSURE_SUSPECT
)
"""An input is suspect, whether the heat mode goes by it or not."""

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
    "switch_contradicts": "pressure without brake switch",
    "wheels_contradict": "wheel speeds contradict each other",
    "acceleration_contradicts": "acceleration contradicts the speed",
    "heat_substituted": "heat from the other source",
    "heat_unknown": "heat unknown",
    "silent": "bus silent",
    "external_force_suspected": "external force suspected, nothing learned",
    "observer_reset": "learned vehicle data reset",
    "acceleration_scale": "acceleration wrongly scaled or not felt",
    "wheel_radius": "wheel speed disagrees with satellite speed",
    "pressure_dead": "braking without pressure again and again",
    "braking_unpressed": "braking that no pressure tells of",
    "wheel_speed_suspect": "wheel speed suspect",
    "heat_lost": "heat unknown for too long",
    "heat_doubt": "unknown heat still felt",
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
        (HEAT_DOUBT, WORDS["heat_doubt"]),
    ):
        names = [n for c, n in enumerate(corners) if flags & first << c]
        if names:
            words.append(f"{text}: {', '.join(names)}")
    return words


def fault_names(flags: int) -> tuple[str, ...]:
    """Return which of :data:`FAULTS` are in *flags*."""
    return tuple(name for name, bits in FAULTS.items() if flags & bits)


def input_status(flags: int) -> dict[str, str]:
    """Return valid, suspect or missing for each group of inputs."""
    found = {}
    for name in ("speed", "pressure", "acceleration", "torque"):
        if flags & FLAGS[f"{name}_missing"]:
            found[name] = "missing"
        elif flags & FLAGS[f"{name}_suspect"]:
            found[name] = "suspect"
        else:
            found[name] = "valid"
    return found
