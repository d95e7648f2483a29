"""Stretches in which a car coasts: nothing drives it, nothing brakes it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.quality.limits import GRID_S, RELEASED_PA
from bstm_daemon.analysis.statistics.series import Mask, runs

if TYPE_CHECKING:
    from bstm_daemon.analysis.identify.driving import Driving

LOWEST_MS: Final = 2.5
"""Below, wheel sensors with few teeth and a dead band are not trusted."""

SHORTEST_S: Final = 15.0
LEAST_FALL_MS: Final = 4.0
"""A stretch must last and slow the car so far, else noise outweighs it."""

SETTLING_S: Final = 1.5
"""Left out at both ends: drive line and body swing, filters settle."""

DRIVEN_MS2: Final = 0.05
"""Torque at the wheels over the mass that still counts as coasting where no
gear or clutch tells; it is known and taken into account."""

CORNERING_MS2: Final = 0.5
"""Tyres at an angle brake the car."""

_FLAGS: Final = ("abs_active", "esc_active", "tc_active", "park_brake")


@dataclass(frozen=True, slots=True)
class Stretch:
    """Grid points ``first`` to ``last`` (both included) of a coast-down."""

    driving: Driving
    first: int
    last: int

    @property
    def points(self) -> slice:
        """The points as a slice."""
        return slice(self.first, self.last + 1)

    @property
    def start_s(self) -> float:
        """Time of the first point since the start of the log."""
        return float(self.driving.time_s[self.first])

    @property
    def duration_s(self) -> float:
        """Time from the first to the last point."""
        return float(self.driving.time_s[self.last]) - self.start_s


def coasting(driving: Driving) -> tuple[list[Stretch], str]:
    """Return the coast-downs of *driving*, and what was searched in words.

    The text says how much of the log each condition leaves, so that a log
    without a coast-down says why.
    """
    steps = _conditions(driving)
    left = np.ones(len(driving.time_s), bool)
    words = []
    for name, mask in steps:
        left = left & mask
        words.append(f"{name} {np.count_nonzero(left) * GRID_S:.0f} s")
    found = []
    trim = round(SETTLING_S / GRID_S)
    for first, last in runs(left):
        begin, end = first + trim, last - trim
        if (end - begin) * GRID_S < SHORTEST_S:
            continue
        speed = driving.speed_ms[begin : end + 1]
        if float(speed[0] - speed[-1]) < LEAST_FALL_MS:
            continue
        found.append(Stretch(driving, begin, end))
    words.append(
        f"in {len(found)} pieces of {SHORTEST_S:g} s or more that lose "
        f"{LEAST_FALL_MS * 3.6:.0f} km/h or more"
    )
    return found, ", ".join(words)


def _conditions(driving: Driving) -> list[tuple[str, Mask]]:
    speed = driving.speed_ms
    moving = (speed > LOWEST_MS) & np.isfinite(driving.rate_ms2)
    steps = [(f"above {LOWEST_MS * 3.6:.0f} km/h", moving)]
    released = np.ones(len(speed), bool)
    for pressure in driving.pressures.values():
        # an unknown pressure is no released brake
        released &= pressure < RELEASED_PA
    channels = driving.channels
    if channels.alive(["brake_switch"]):
        released &= driving.value("brake_switch") < 0.5
    for role in channels.alive(_FLAGS):
        released &= ~(driving.value(role) > 0.5)
    name = "brakes released"
    if not driving.pressures and not channels.alive(["brake_switch"]):
        released[:] = False
        name = "brakes known to be released (no pressure, no brake_switch)"
    steps.append((name, released))
    steps.append(("drive line open or without torque", _undriven(driving)))
    if channels.alive(["yaw_rate"]):
        bend = np.abs(driving.value("yaw_rate") * speed) > CORNERING_MS2
        steps.append(("no bend", ~bend))
    if driving.has_accelerometer:
        steps.append(
            ("accelerometer there", np.isfinite(driving.accel_measured_ms2))
        )
    return steps


def _undriven(driving: Driving) -> Mask:
    mass_kg = driving.vehicle.mass_kg
    radius_m = driving.vehicle.wheel_radius_m
    limit_nm = DRIVEN_MS2 * mass_kg * radius_m
    undriven = np.abs(driving.torque_nm) < limit_nm
    if driving.channels.alive(["motor_torque"]):
        undriven &= ~(np.abs(driving.value("motor_torque")) > limit_nm)
    undriven &= np.abs(driving.external_n) < DRIVEN_MS2 * mass_kg
    return np.asarray(undriven)
