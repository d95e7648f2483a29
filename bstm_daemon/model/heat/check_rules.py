"""Thresholds of the input checks: range, rate of change, plausibility.

A sample outside its range is rejected. So is one that differs from the last
one by more than ``step + rate * time between the two``, unless the next
sample confirms it. The limits are far beyond what a driver or a control
system does, so that nothing they reject is a measurement.

A check that is made once a step counts seconds: the count rises while the
check fails, and from ``comes_s`` on the input is suspect; then the check must
pass for ``goes_s`` before the input counts as sound again. While a check can
not be made, the count stays. ``docs/validity.md`` lists all with reasons.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Final

from bstm_daemon.roles import ROLES


@dataclass(frozen=True, slots=True)
class Limits:
    """Range and rate of change of a quantity, SI."""

    low: float = -inf
    high: float = inf
    step: float = inf
    rate_per_s: float = 0.0


_WHEEL_SPEED: Final = Limits(-150.0, 150.0, 3.0, 200.0)
"""A wheel that the brake locks on ice loses 20 g; no car does 540 km/h."""

_VEHICLE_SPEED: Final = Limits(-150.0, 150.0, 3.0, 60.0)
"""Tyres and wings slow a car by 6 g at most."""

_PRESSURE: Final = Limits(-5e5, 400e5, 20e5, 2000e5)
"""Hydraulics burst near 400 bar; an electric booster builds 1000 bar/s."""

_ACCELERATION: Final = Limits(-100.0, 100.0, 15.0, 500.0)
"""10 g is a crash; kerbs and gear changes shake the body by some m/s2."""

_TORQUE: Final = Limits(-2e5, 2e5, 2e4, 5e5)
"""At all wheels together: a 60 t truck climbs with 140 kNm; an electric
motor turns its torque round in a tenth of a second."""

_FORCE: Final = Limits(-1e6, 1e6)
"""A trailer of the heaviest vehicle, braked by it alone."""

_AMBIENT: Final = Limits(200.0, 360.0, 10.0, 5.0)
"""From the coldest weather to a sensor above a hot road."""

_TEMPERATURE: Final = Limits(200.0, 2300.0, 100.0, 500.0)
"""Carbon discs glow at 1300 K; a rubbing thermocouple gains 500 K/s."""

_BY_NAME: Final = {
    "vehicle_speed": _VEHICLE_SPEED,
    "primary_pressure": _PRESSURE,
    "secondary_pressure": _PRESSURE,
    "acceleration_longitudinal": _ACCELERATION,
    "powertrain_torque": _TORQUE,
    "external_force": _FORCE,
    "ambient_temperature": _AMBIENT,
}
_BY_PREFIX: Final = {
    "wheel_speed_": _WHEEL_SPEED,
    "wheel_pressure_": _PRESSURE,
    "temp_": _TEMPERATURE,
}


def limits_of(role: str) -> Limits:
    """Return the limits of *role*; without any where none is known."""
    for prefix, limits in _BY_PREFIX.items():
        if role.startswith(prefix):
            return limits
    return _BY_NAME.get(role, Limits())


LIMITS: Final = tuple(limits_of(role.name) for role in ROLES)
"""Limits by role number."""


HOLD_US: Final = 2_000_000
"""How long a role is suspect after a rejected sample."""

SILENT_US: Final = 1_000_000
"""Without any sample for longer, the bus sleeps and the car is parked."""


@dataclass(frozen=True, slots=True)
class Hysteresis:
    """Time a check must fail to set a fault, and pass to clear it [s]."""

    comes_s: float
    goes_s: float

    def advance(
        self, fault_s: float, dt_s: float, *, failed: bool | None
    ) -> float:
        """Return the count [s] a step later; *failed* is None if unknown."""
        if failed is None:
            return fault_s
        latched = fault_s >= self.comes_s
        if failed:
            fault_s = fault_s + dt_s
            if latched or fault_s >= self.comes_s:
                return self.comes_s + self.goes_s
            return fault_s
        fault_s = fault_s - dt_s
        if fault_s <= (self.comes_s if latched else 0.0):
            return 0.0
        return fault_s


DEVIATION: Final = Hysteresis(2.0, 10.0)
STUCK: Final = Hysteresis(1.0, 10.0)
SWITCH: Final = Hysteresis(1.0, 10.0)
INERTIA: Final = Hysteresis(5.0, 20.0)
REVERSED: Final = Hysteresis(1.0, 20.0)

DEVIATION_MS: Final = 2.0
DEVIATION_SHARE: Final = 0.2
DEVIATION_BRAKING: Final = 0.35
MOVING_MS: Final = 3.0
"""A speed deviates from the others' median by more than 2 m/s and 20 % of it,
35 % while braking: the tightest turn gives 15 to 20 %, ABS slip some more."""

SCALE_MS: Final = 8.0
SCALE_S: Final = 20.0
SCALE_LIMIT: Final = 0.07
"""A speed over the median of all, filtered over 20 s while one is above 8 m/s:
bends and slip stay within 3 %, a worn or a spare tyre within 5 %, and so does
the speed that a speedometer shows."""

FROZEN_SPEED_S: Final = 5.0
FROZEN_SPEED_MS: Final = 3.0
FROZEN_PRESSURE_S: Final = 30.0
FROZEN_PRESSURE_MS: Final = 5.0
FROZEN_PRESSURE_PA: Final = 3e5
MOVES_S: Final = 1.0
"""A value is frozen if it is bit-identical for ``FROZEN_*_S`` while the car's
speed changed by ``FROZEN_*_MS``, a pressure only above ``FROZEN_PRESSURE_PA``.
One that changed within ``MOVES_S`` is moving."""

ZERO_PA: Final = -0.8e5
ZERO: Final = Hysteresis(1.0, 300.0)
"""No brake is below the air's pressure, so a lower reading is an error of the
sensor's zero, which is there as well while the brake is pressed."""

TWIN_PA: Final = 3e5
TWIN_SETTLED_S: Final = 0.5
TWIN_ZERO_PA: Final = 0.5e5
TWIN_S: Final = 10.0
TWIN_LIMIT: Final = 0.1
TWIN_MOST: Final = 0.6
TWIN_MOST_PA: Final = 10e5
TWIN: Final = Hysteresis(2.0, 5.0)
"""The brakes of an axle have one pressure, whatever circuits and sensors they
are on, and so have the circuits of a master cylinder: where the mean of the
two has been above TWIN_PA for TWIN_SETTLED_S, without intervention, what they
differ by beyond their zeros, as a share of it, both filtered over TWIN_S of
such braking. Sound circuits stay below 0.03, one that reads 0.85 is at 0.15.
At most TWIN_MOST of TWIN_MOST_PA counts, so that noise is forgotten soon.
"""

LOWEST_CODE_K: Final = 233.15
LOWEST_CODE_WITHIN_K: Final = 0.1
LOWEST_CODE: Final = Hysteresis(60.0, 10.0)
"""-40 degC is the code 0 of the usual air temperature: a sensor that is not
there, or the coldest winter."""

AIR_FALL_K_S: Final = 0.25
AIR_NIGHT_K_S: Final = 3.0 / 3600.0
AIR_FELL_K: Final = 10.0
AIR_FELL: Final = Hysteresis(10.0, 10.0)
"""The air's history falls to a lower reading by the first, faster than a
sensor that sat above a hot engine or in a garage; by the second while nothing
is read, as on a clear evening. A reading that is lower by AIR_FELL_K is the
sensor's error."""

SWITCH_PRESSURE_PA: Final = 5e5
SWITCH_MS: Final = 1.0

INERTIA_FILTER_S: Final = 2.0
INERTIA_MS2: Final = 4.0
"""3 m/s2, and 1 m/s2 for a slope of 10 %, which the accelerometer measures."""

BAND_QUICK_S: Final = 0.3
BAND_SLOW_S: Final = 1.5
BAND_RESTART_S: Final = 8.0
BAND_RATE_MS2: Final = 40.0
BAND_SPEED_MS: Final = 2.0
BAND_LEAST_MS2: Final = 0.2
"""Accelerometer and derivative of the speed are compared in this band, in
which a road changes its slope little; from BAND_LEAST_MS2 of one of them on,
above BAND_SPEED_MS, not for BAND_RESTART_S after a gap or a leap of the speed,
faster than any tyre's."""

SHARE_LEAST: Final = 1.6
SHARE_MOST: Final = 8.0
SHARE_LIMIT: Final = 1.45
SHARE_BEYOND: Final = 0.3
SHARE_CORRELATION: Final = 0.6
"""One is more than SHARE_LIMIT times the other: noise and slopes that come
with the changes of speed make up to 1.37. Least and most geometric mean of
both sums of squares [m2/s3]: 1.6 are three changes by 1 m/s2. Before there are
as many, the sum of the products beyond the limit, and the square of the
correlation."""

TURN_SPEED_MS: Final = 5.0
TURN_LEAST_MS2: Final = 1.0
TURN_LEAST: Final = 15.0
TURN_MOST: Final = 30.0
TURN_LIMIT: Final = 1.13
TURN_CORRELATION: Final = 0.8
"""In a bend speed times yaw rate is the acceleration to the side. The body's
roll of 0.1 rad/g makes the accelerometer read a tenth more, the bank of a
bend less, so that a sound car has 0.9 to 1.1 of it; from TURN_LIMIT on the
speeds are too low. Above the first two, without intervention; least and most
sum of its squares [m2/s3], and the square of the correlation."""

PROOF_MS2: Final = 1.0
PROOF_J: Final = 4e5
"""Braking work up to which speeds and accelerometer need no proof: a disc is
60 K warmer then. They are proven from this geometric mean of both sums on
[m2/s3]: one brisk start."""

LEAP_MS: Final = 3.0
LEAP_S: Final = 2.0
"""The speeds leap: their median by more than the first within a step. Where
the accelerometer makes less of it in the second, what proved them is void."""

UNMOVED_SQUARE: Final = 1.0
UNMOVED_S: Final = 30.0
"""Sum of squares of the accelerometer in its band while all speeds are
constant to the bit [m2/s3], with a memory of 30 s, of a car that moves: a
slope of 12 % that begins within a second."""

TILT_MS2: Final = 0.4
TILT_S: Final = 5.0
"""A car that stands does not change its slope: by 4 % it is not loaded, and on
a lift or a ship its speed does not matter."""

REVERSED_MEMORY_S: Final = 120.0
REVERSED_MS2: Final = 2.0
REVERSED_MOTION: Final = 40.0
REVERSED_SHARE: Final = 0.2
"""While the speed rises by more than 2 m/s2, which a slope of 20 % can not
cancel, acceleration times rate of speed is summed: a negative sum means a
wrong sign. 40 m2/s3 are 10 s of 2 m/s2, or 2.5 s of 4."""

PEDAL_REST: Final = 0.005
TORQUE_REST: Final = 0.25
"""A pedal rests below 5 mm or 0.5 %; the bus's own brake torque below this
share of ``brake_on_force_n``, as it reads too little."""

PEDAL_S: Final = 0.3
PEDAL_LOW_MS2: Final = 0.5
PEDAL_MORE_MS2: Final = 1.5
ENGINE_MS2: Final = 0.7
SLOPE_MS2: Final = 1.0
PEDAL_LOST_MS: Final = 20.0
"""Braking by motion, filtered over PEDAL_S, while the pedal is at rest. Up to
the first it may be errors of drag and accelerometer, by the second more it is
the brakes; without a measured torque there is engine braking, without an
accelerometer a slope of 10 %. Once so much speed is lost at rest, the pedal
does not show all braking."""

DRIVE_ERROR: Final = 0.15
SLIP_FORWARD: Final = 0.08
"""What a drive torque may be wrong by [share]; a wheel slips forward above the
second ratio."""

STAND_TURNS_MS: Final = 1.0
STAND_MOTION: Final = 8.0
STAND_SHARE: Final = 0.25
"""A car is on a test stand where one axle turns faster than the first while
the other stands, and a live accelerometer shows less than STAND_SHARE of the
changes of its speed, in the sums of REVERSED_MS2: from 2 s of 2 m/s2 on."""

STANDING_MS: Final = 0.5
PARKING_MS: Final = 5.0
"""A car whose speed is lost above this has not just been parked."""

PARKED_S: Final = 60.0
"""A car that stood for that long, its brake released and its parking brake
applied or ignition off, is parked: few stops in traffic are as long, and none
is all of it."""

UNPROVEN_S: Final = 2.5
"""The bus of a parked car may be awake for that long without a speed or what
secures it: its messages end within 2 s, the speed times out 0.5 s after its
last one and the silence is known after 1 s."""

OUTAGE_S: Final = 10.0
OUTAGE_MEMORY: Final = 30.0
"""Unknown heat for longer than ``OUTAGE_S`` makes an estimate invalid; its
effect lasts ``OUTAGE_MEMORY`` times as long as the outage."""
