"""The car on its drive: forces, brake pressures and powertrain torque.

Inverse longitudinal dynamics along the given speed, all samples at once::

    m_eff dv/dt = T_pt / R + F_ext - F_brake - F_res,   m_eff = m + J / R^2
    F_res = m g (sin + f_r cos) + 1/2 rho CdA v^2 + C v

The driver brakes with the force beyond engine drag; the engine or the
pusher supplies a missing one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.simulation import hydraulics
from bstm_daemon.simulation.profile import prescribed_force, rounded

if TYPE_CHECKING:
    from bstm_daemon.simulation.materials import Array
    from bstm_daemon.simulation.parameters import Effects
    from bstm_daemon.simulation.profile import Course
    from bstm_daemon.simulation.vehicle import CarParameters

# a driver does not press the pedal for less
_LEAST_BRAKE_N = 20.0


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Forces along a course, arrays (n,) or (n, 4) at 100 Hz, SI.

    ``brake_force_n`` and ``brake_torque_nm`` are friction braking of all
    wheels, ``corner_force_n`` (n, 4) of each, ``slip`` (n, 4) the share by
    which a wheel turns too slowly. ``motor_torque_nm`` is regeneration at the
    wheels. ``pressure_pa`` is the driver's demand at nominal mu,
    ``corner_pressure_pa`` (n, 4) what presses the pads for it.
    """

    brake_force_n: Array
    brake_torque_nm: Array
    corner_force_n: Array
    slip: Array
    powertrain_torque_nm: Array
    motor_torque_nm: Array
    external_force_n: Array
    pressure_pa: Array
    corner_pressure_pa: Array
    engine_speed_rad_s: Array
    gear: Array

    @property
    def size(self) -> int:
        """Number of samples."""
        return len(self.brake_force_n)


def move(
    course: Course, car: CarParameters, effects: Effects, *, pushed: bool
) -> Motion:
    """Return the forces that make *car* follow *course*.

    *pushed*: the missing force comes from outside, not from the engine.
    """
    v, radius = course.speed_ms, car.wheel_radius_m
    segments = course.segments
    moving = v > 0
    external = course.level([s.external_force_n for s in segments])
    gear = course.level([float(s.gear) for s in segments]).astype(np.intp)
    gear[~moving] = 0
    drag = car.engine_drag(v, gear)
    needed = car.effective_mass_kg * course.acceleration_ms2 + np.where(
        moving, car.resistance(v, course.slope_rad, course.headwind_ms), 0.0
    )
    surplus = external + drag / radius - needed
    extra_pa = 1e5 * _corners(
        course, [s.corner_pressure_bar for s in segments]
    )
    extra_n = np.where(moving, extra_pa @ car.gains, 0.0)
    demand = _demand(course, car, surplus, extra_n)
    braking = demand + extra_n
    missing = np.where(moving, braking - surplus, 0.0)
    if pushed:
        external = external + missing
        torque = drag
    else:
        torque = drag + missing * radius
    recovered = course.level([s.regeneration for s in segments]) * demand
    pressure = (demand - recovered) / car.gains.sum()
    held = course.level([(s.brake_pressure_bar or 0.0) for s in segments])
    pressure = np.where(moving, pressure, held * 1e5)
    corner_pa = hydraulics.wheel_pressures(
        pressure,
        car.gains,
        effects,
        modulation=course.level([s.modulation for s in segments]),
    )
    corner_pa += np.where(moving[:, None], extra_pa, 0.0)
    corner_force = np.where(moving[:, None], corner_pa * car.gains, 0.0)
    friction = demand - recovered + extra_n
    return Motion(
        brake_force_n=friction,
        brake_torque_nm=friction * radius,
        corner_force_n=corner_force,
        slip=_corners(course, [s.slip for s in segments]),
        powertrain_torque_nm=torque,
        motor_torque_nm=-recovered * radius,
        external_force_n=external,
        pressure_pa=pressure,
        corner_pressure_pa=corner_pa,
        engine_speed_rad_s=car.engine_speed(v, gear),
        gear=gear.astype(np.float64),
    )


def _corners(course: Course, values: list[list[float]]) -> Array:
    """Return four values a segment as samples (n, 4)."""
    return np.array(values, dtype=np.float64)[course.segment]


def _demand(
    course: Course, car: CarParameters, surplus: Array, extra_n: Array
) -> Array:
    """Return the brake force [N] that the driver demands, (n,).

    On a driven segment what the speed needs beyond *extra_n*, unless the
    segment prescribes it; on a free one what the segment prescribes, over as
    long as the speed is rounded, so that both belong together.
    """
    segments = course.segments
    prescribed = np.zeros(len(surplus))
    bounds = np.searchsorted(
        course.segment, np.arange(len(segments) + 1), side="left"
    )
    for index, segment in enumerate(segments):
        here = slice(int(bounds[index]), int(bounds[index + 1]))
        elapsed_s = course.time_s[here] - course.starts_s[index]
        prescribed[here] = prescribed_force(segment, elapsed_s, car)
    presses = course.level(
        [
            float((s.brake_force_n, s.brake_pressure_bar) != (None, None))
            for s in segments
        ]
    )
    free = course.level(
        [float(s.until_speed_kmh is not None) for s in segments]
    )
    parked = course.level([float(s.parked) for s in segments])
    least = np.maximum(surplus - extra_n, 0.0)
    driven = np.where(surplus > _LEAST_BRAKE_N, least, 0.0)
    driven = np.where(presses > 0, prescribed, driven)
    # a held brake at rest is no part of the motion before it
    smooth = rounded(np.where(parked > 0, 0.0, prescribed))
    # where braking of the next segment begins within the rounding
    early = np.where(surplus - smooth > _LEAST_BRAKE_N, surplus - smooth, 0.0)
    demand = np.where(free > 0, smooth + early, driven)
    return np.where(course.speed_ms > 0, demand, 0.0)
