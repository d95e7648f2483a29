"""What a quantity can physically be, and how fast it can physically change.

Only for the roles that the pass over samples computes with.
A sample outside a range is not taken. Neither is one that lies further from
the last one than ``step + rate * time between the two``, unless the next
sample confirms it. The limits are far beyond what a driver or a control
system does, so that what they stop is no measurement. ``docs/validity.md``
has the reasons in a table.
"""

from __future__ import annotations

from math import inf
from typing import Final, NamedTuple

from bstm_daemon.roles import ROLES


class Limits(NamedTuple):
    """Range and rate of change of a quantity, SI."""

    low: float = -inf
    high: float = inf
    step: float = inf
    rate_per_s: float = 0.0


WHEEL_SPEED: Final = Limits(-150.0, 150.0, 3.0, 200.0)
"""A wheel that the brake locks on ice loses 20 g; no car does 540 km/h."""

VEHICLE_SPEED: Final = Limits(-150.0, 150.0, 3.0, 60.0)
"""Tyres and wings slow a car by 6 g at most."""

PRESSURE: Final = Limits(-5e5, 400e5, 20e5, 2000e5)
"""Hydraulics burst near 400 bar; an electric booster builds 1000 bar/s."""

ACCELERATION: Final = Limits(-100.0, 100.0, 15.0, 500.0)
"""10 g is a crash; kerbs and gear changes shake the body by some m/s2."""

TORQUE: Final = Limits(-2e5, 2e5, 2e4, 5e5)
"""At all wheels together: a 60 t truck climbs with 140 kNm; an electric
motor turns its torque round in a tenth of a second."""

FORCE: Final = Limits(-1e6, 1e6)
"""A trailer of the heaviest vehicle, braked by it alone."""

AMBIENT: Final = Limits(200.0, 360.0, 10.0, 5.0)
"""From the coldest weather to a sensor above a hot road."""

TEMPERATURE: Final = Limits(200.0, 2300.0, 100.0, 500.0)
"""Carbon discs glow at 1300 K; a rubbing thermocouple gains 500 K/s."""

_BY_NAME: Final = {
    "vehicle_speed": VEHICLE_SPEED,
    "primary_pressure": PRESSURE,
    "secondary_pressure": PRESSURE,
    "acceleration_longitudinal": ACCELERATION,
    "powertrain_torque": TORQUE,
    "external_force": FORCE,
    "ambient_temperature": AMBIENT,
}
_BY_PREFIX: Final = {
    "wheel_speed_": WHEEL_SPEED,
    "wheel_pressure_": PRESSURE,
    "temp_": TEMPERATURE,
}


def limits_of(role: str) -> Limits:
    """Return the limits of *role*; without any where none is known."""
    for prefix, limits in _BY_PREFIX.items():
        if role.startswith(prefix):
            return limits
    return _BY_NAME.get(role, Limits())


LIMITS: Final = tuple(limits_of(role.name) for role in ROLES)
"""Limits by role number."""
