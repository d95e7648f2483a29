"""The car on its drive: forces, brake pressures and powertrain torque.

Inverse longitudinal dynamics along the given speed, all samples at once::

    m_eff dv/dt = T_pt / R + F_ext - F_brake - F_res,   m_eff = m + J / R^2
    F_res = m g (sin + f_r cos) + 1/2 rho CdA v^2 + C v

The driver brakes with the force beyond engine drag; the engine or the
pusher supplies a missing one. Two circuits cross the car: FL and RR are on
the primary piston, FR and RL on the secondary one, which the primary pushes
and which therefore lags.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.simulation.materials import Array
from bstm_daemon.simulation.parameters import Effects
from bstm_daemon.simulation.profile import (
    SAMPLE_S,
    Course,
    prescribed_force,
    rounded,
)
from bstm_daemon.simulation.vehicle import CarParameters

SECONDARY: Final = np.array([False, True, True, False])
"""Corners on the secondary circuit: FR and RL."""

MODULATION_HZ: Final = 4.0
"""Cycles of the anti-lock system; whole ones in a step of the reality."""

# typical size of the effects that act here
_PUSHOUT_PA = 1.0e5
_LAG_S = 0.15


def wheel_pressures(
    demand_pa: Array, gains: Array, effects: Effects, *, modulation: Array
) -> Array:
    """Return the pressures [Pa] that press the pads, (n, 4).

    Whatever the circuits and the anti-lock system do, the four together brake
    as *demand_pa* (n,) at every wheel would. *gains* [N/Pa] (4,).
    """
    pressures = np.repeat(demand_pa[:, None], len(gains), axis=1)
    if effects.hydraulic_lag > 0:
        late = _second_circuit(demand_pa, gains, effects.hydraulic_lag)
        force = demand_pa * gains.sum() - late * gains[SECONDARY].sum()
        early = force / gains[~SECONDARY].sum()
        pressures = np.where(SECONDARY, late[:, None], early[:, None])
    if modulation.any():
        phase = (
            2 * np.pi * MODULATION_HZ * SAMPLE_S * np.arange(len(demand_pa))
        )
        swing = modulation * np.sin(phase)
        sides = np.array([1.0, -1.0, 1.0, -1.0])
        pressures = pressures * (1.0 + swing[:, None] * sides)
        total = pressures @ gains
        wanted = demand_pa * gains.sum()
        pressures *= np.divide(
            wanted, total, out=np.ones_like(total), where=total > 0
        )[:, None]
    return pressures


def _second_circuit(demand_pa: Array, gains: Array, strength: float) -> Array:
    """Return the secondary circuit's pressure behind the primary's.

    It follows the primary with a lag while the force of both is given; on
    release both end together.
    """
    primary = gains[~SECONDARY].sum() / gains.sum()
    decay = np.exp(-SAMPLE_S / (_LAG_S * strength * primary))
    late = np.empty_like(demand_pa)
    last = float(demand_pa[0])
    most = 1.0 / (1.0 - primary)
    for index, demand in enumerate(demand_pa.tolist()):
        last = min(demand + (last - demand) * decay, demand * most)
        late[index] = last
    return late


def line_pressure(clamp_pa: Array, effects: Effects) -> Array:
    """Return the primary pressure [Pa] in front of the clamping pressure.

    Push-out has to be overcome before pads are pressed: the seals give way
    bit by bit. With hydraulic lag the pads follow the line, so it leads.
    """
    line = clamp_pa
    if effects.pushout_pressure > 0:
        most = _PUSHOUT_PA * effects.pushout_pressure
        line = line - most * np.expm1(-clamp_pa / (0.5 * most))
    if effects.hydraulic_lag > 0:
        lead = np.gradient(clamp_pa, SAMPLE_S)
        line = line + _LAG_S * effects.hydraulic_lag * lead
    return np.maximum(line, 0.0)


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
    corner_pa = wheel_pressures(
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
