"""What the checks of inputs remember, in which order, and what they read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from bstm_daemon.roles import ROLES

if TYPE_CHECKING:
    from collections.abc import Sequence

NEVER: Final = -(2**63)
UNKNOWN: Final = -1.0

CHECK_TIMES: Final = (
    "heard",
    "suspect_until",
    "out_of_range",
    "jumps_refused",
)
"""Newest sample of any role; end of the last hold [us]; samples not taken.
Then per role the stamp of a jump that waits to be confirmed, and the end of
its hold [us]."""

CHECK_NUMBERS: Final = (
    "slow_speed",
    "slow_acceleration",
    "inertia_doubt",
    "switch_doubt",
    "pair_doubt",
    "last_speed",
    "agreement",
    "motion",
    "reversed_doubt",
)
"""Low-passed speed and acceleration; seconds of doubt; the last known speed;
sums over the last minutes of acceleration times gain of speed, and of the
gain's square [m2/s3].
Then per role the value of a jump that waits, and the blocks below."""

CORNER_CHECKS: Final = ("outage_s", "doubt_s")
"""How long a corner's heat was unknown, and how long that is still felt."""

VOICE_CHECKS: Final = (
    "apart_doubt",
    "held_value",
    "held_s",
    "held_mark",
    "stuck_doubt",
    "left_out",
)
"""Per voice: the corners' wheel speeds, then the vehicle speed."""

PRESSURE_CHECKS: Final = ("held_value", "held_s", "held_mark", "stuck_doubt")
"""Per pressure: primary, secondary, then those of the wheels."""


@dataclass(slots=True)
class Readings:
    """What the pass knows at the end of a step; nan for what is missing.

    ``voices``: absolute speeds, wheels in corner order, then the vehicle;
    ``pressures``: primary, secondary, then wheels; ``acceleration`` along
    the motion; ``sources``: per corner the place in ``pressures`` that its
    pressure comes from, or -1; ``heat_known`` and ``at_risk`` per corner:
    whether its power is known, and whether there may be some.
    """

    now: int
    dt_s: float
    speed: float
    speed_known: bool
    braking: bool
    brake_switch: float
    esc_active: float
    acceleration: float
    voices: Sequence[float]
    pressures: Sequence[float]
    sources: Sequence[int]
    heat_known: Sequence[bool]
    at_risk: Sequence[bool]


@dataclass(frozen=True, slots=True)
class Watched:
    """Role numbers by what they are, -1 where not mapped."""

    voices: Sequence[int]
    pressures: Sequence[int]
    acceleration: int
    torque: int
    temperatures: Sequence[int]


def new_checks(corners: int, roles: int) -> tuple[list[int], list[float]]:
    """Return times [us] and numbers before the first sample."""
    times = [NEVER, NEVER, 0, 0] + 2 * roles * [NEVER]
    size = (
        len(CHECK_NUMBERS)
        + roles
        + len(CORNER_CHECKS) * corners
        + len(VOICE_CHECKS) * (corners + 1)
        + len(PRESSURE_CHECKS) * (corners + 2)
    )
    return times, [UNKNOWN] + (size - 1) * [0.0]


def check_time_names() -> list[str]:
    """Return the name of each of the times."""
    return [
        *CHECK_TIMES,
        *(f"jump_stamp.{role.name}" for role in ROLES),
        *(f"suspect_until.{role.name}" for role in ROLES),
    ]


def check_number_names(corners: Sequence[str]) -> list[str]:
    """Return the name of each of the numbers of a car with *corners*."""
    voices = [*(f"wheel_{c}" for c in corners), "vehicle"]
    pressures = ["primary", "secondary", *(f"wheel_{c}" for c in corners)]
    return [
        *CHECK_NUMBERS,
        *(f"jump_value.{role.name}" for role in ROLES),
        *(f"{name}.{c}" for name in CORNER_CHECKS for c in corners),
        *(f"speed_{name}.{v}" for name in VOICE_CHECKS for v in voices),
        *(
            f"pressure_{name}.{p}"
            for name in PRESSURE_CHECKS
            for p in pressures
        ),
    ]
