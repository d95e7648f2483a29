"""The car on its drive: forces, brake pressure and powertrain torque.

Inverse longitudinal dynamics along the given speed, all samples at once::

    m_eff dv/dt = T_pt / R + F_ext - F_brake - F_res,   m_eff = m + J / R^2
    F_res = m g (sin + f_r cos) + 1/2 rho CdA v^2 + C v

The driver brakes with what is left after engine drag, the engine or the
pusher supplies what is missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bstm_daemon.simulation.materials import Array
    from bstm_daemon.simulation.parameters import Effects
    from bstm_daemon.simulation.profile import Course
    from bstm_daemon.simulation.vehicle import CarParameters

# a driver does not touch the pedal for less
_LEAST_BRAKE_N = 20.0

# typical size of the effects that act on the car
_PUSHOUT_PA = 1.0e5
_LAG_S = 0.15


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Forces along a course, arrays (n,) at 100 Hz, SI.

    ``brake_force_n`` and ``brake_torque_nm`` are friction braking of all
    wheels, ``motor_torque_nm`` regeneration at the wheels; ``pressure_pa``
    presses the pads at nominal mu, ``contact`` is 1 with pressed pads.
    """

    brake_force_n: Array
    brake_torque_nm: Array
    powertrain_torque_nm: Array
    motor_torque_nm: Array
    external_force_n: Array
    pressure_pa: Array
    contact: Array
    engine_speed_rad_s: Array
    gear: Array

    @property
    def size(self) -> int:
        """Number of samples."""
        return len(self.brake_force_n)


def move(course: Course, car: CarParameters, *, pushed: bool) -> Motion:
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
        moving, car.resistance(v, course.slope_rad), 0.0
    )
    surplus = external + drag / radius - needed
    # free segments: what smoothing leaves over is nobody's brake force
    driven = course.level([float(s.until_speed_kmh is None) for s in segments])
    braking = np.where(surplus > _LEAST_BRAKE_N, surplus, 0.0) * driven
    pressed = _pressed(course, car)
    braking = np.where(np.isnan(pressed), braking, pressed)
    braking = np.where(moving, braking, 0.0)
    missing = np.where(moving, braking - surplus, 0.0)
    if pushed:
        external = external + missing
        torque = drag
    else:
        torque = drag + missing * radius
    recovered = course.level([s.regeneration for s in segments]) * braking
    friction = braking - recovered
    pressure = friction / car.gains.sum()
    held = course.level([(s.brake_pressure_bar or 0.0) for s in segments])
    pressure = np.where(moving, pressure, held * 1e5)
    return Motion(
        brake_force_n=friction,
        brake_torque_nm=friction * radius,
        powertrain_torque_nm=torque,
        motor_torque_nm=-recovered * radius,
        external_force_n=external,
        pressure_pa=pressure,
        contact=(pressure > 0).astype(np.float64),
        engine_speed_rad_s=car.engine_speed(v, gear),
        gear=gear.astype(np.float64),
    )


def _pressed(course: Course, car: CarParameters) -> Array:
    """Brake force that a segment prescribes [N], NaN where it does not."""
    total = float(car.gains.sum())
    return course.level(
        [
            s.brake_force_n
            if s.brake_force_n is not None
            else s.brake_pressure_bar * 1e5 * total
            if s.brake_pressure_bar is not None
            else float("nan")
            for s in course.segments
        ]
    )


def line_pressure(clamp_pa: Array, effects: Effects, sample_s: float) -> Array:
    """Return the primary pressure [Pa] behind the clamping pressure.

    Push-out has to be overcome before pads are pressed; with hydraulic lag
    the pads follow the line, so the line leads.
    """
    pushout = _PUSHOUT_PA * effects.pushout_pressure * (clamp_pa > 0)
    lead = _LAG_S * effects.hydraulic_lag * np.gradient(clamp_pa, sample_s)
    return np.maximum(clamp_pa + pushout + lead, 0.0)
