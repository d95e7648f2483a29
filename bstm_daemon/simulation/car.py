"""The car on its drive: forces, brake pressure and powertrain torque.

Inverse longitudinal dynamics along the given speed, all samples at once::

    m_eff dv/dt = T_pt / R + F_ext - F_brake - F_res,   m_eff = m + J / R^2
    F_res = m g (sin + f_r cos) + 1/2 rho CdA v^2 + C v

The driver brakes with what is left after engine drag, the engine or the
pusher supplies what is missing. Brake torque of a corner is
``2 (p - p0) A n eta mu r_eff``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.simulation.parameters import (
    FRONT,
    REAR,
    CornerParameters,
    Effects,
)
from bstm_daemon.units import AIR_DENSITY_KG_M3, GRAVITY_MS2

if TYPE_CHECKING:
    import numpy.typing as npt

    from bstm_daemon.simulation.materials import Array
    from bstm_daemon.simulation.profile import Course

    Gears = npt.NDArray[np.intp]

# engine speed over wheel speed, neutral first: gearbox times final drive
_TOTAL_RATIO = np.array([0.0, 13.0, 7.6, 5.0, 3.8, 3.0, 2.5])
_ENGINE_DRAG_NM = 16.0
_ENGINE_DRAG_NM_S = 0.06
_IDLE_RAD_S = 75.0

# a driver does not touch the pedal for less
_LEAST_BRAKE_N = 20.0

# typical size of the effects that act on the car
_MASS_ERROR = 0.06
_SHARE_SHIFT = 0.10
_PUSHOUT_PA = 1.0e5
_LAG_S = 0.15


@dataclass(frozen=True, slots=True, kw_only=True)
class CarParameters:
    """The car, SI; defaults are the thesis's vehicle 1."""

    mass_kg: float = 2194.0
    wheel_inertia_kg_m2: float = 3.0809
    wheel_radius_m: float = 0.3418
    rolling_resistance: float = 0.014
    friction_ns_m: float = 4.0
    drag_area_m2: float = 0.70
    front: CornerParameters = FRONT
    rear: CornerParameters = REAR

    @property
    def corners(self) -> tuple[CornerParameters, ...]:
        """The four corners: FL, FR, RL, RR."""
        return (self.front, self.front, self.rear, self.rear)

    @property
    def effective_mass_kg(self) -> float:
        """Mass with the wheels' rotational inertia."""
        rotating = self.wheel_inertia_kg_m2 / self.wheel_radius_m**2
        return self.mass_kg + rotating

    @property
    def gains(self) -> Array:
        """Brake force at the road over pressure [N/Pa] of the corners."""
        return np.array(
            [
                2
                * corner.piston_area_m2
                * corner.piston_count
                * corner.efficiency
                * corner.friction_coefficient
                * corner.effective_radius_m
                / self.wheel_radius_m
                for corner in self.corners
            ]
        )

    def with_mass(self, mass_kg: float) -> CarParameters:
        """Return the car at another mass."""
        return replace(self, mass_kg=mass_kg)

    def brake_force(self, pressure_pa: float) -> float:
        """Return the brake force of all wheels [N] at nominal mu."""
        return float(self.gains.sum()) * pressure_pa

    def resistance(self, speed_ms: Array, slope_rad: Array) -> Array:
        """Return rolling, air and friction resistance plus grade [N]."""
        weight = self.mass_kg * GRAVITY_MS2
        air = 0.5 * AIR_DENSITY_KG_M3 * self.drag_area_m2
        total: Array = (
            weight * np.sin(slope_rad)
            + weight * self.rolling_resistance * np.cos(slope_rad)
            + (air * speed_ms + self.friction_ns_m) * speed_ms
        )
        return total

    def engine_speed(self, speed_ms: Array, gear: Gears) -> Array:
        """Return the engine speed [rad/s]; it idles with an open clutch."""
        turned = speed_ms / self.wheel_radius_m * _TOTAL_RATIO[gear]
        clutched: Array = np.maximum(turned, _IDLE_RAD_S)
        return clutched

    def engine_drag(self, speed_ms: Array, gear: Gears) -> Array:
        """Return the dragging engine's torque at the wheels [Nm], <= 0."""
        ratio = _TOTAL_RATIO[gear]
        turned = speed_ms / self.wheel_radius_m * ratio
        drag = ratio * (_ENGINE_DRAG_NM + _ENGINE_DRAG_NM_S * turned)
        # the clutch opens below idle
        return np.where(turned > _IDLE_RAD_S, -drag, 0.0)


NOMINAL: Final = CarParameters()
"""The nominal car."""


def real_car(car: CarParameters, effects: Effects) -> CarParameters:
    """Return the car that really drives: what *effects* change in *car*.

    The mass is above its nominal value, brake force shifts to the front axle.
    """
    shift = _SHARE_SHIFT * effects.brake_share
    front, _, rear, _ = car.gains
    rear_scale = 1.0 - shift * front / rear
    return replace(
        car,
        mass_kg=car.mass_kg * (1.0 + _MASS_ERROR * effects.mass_error),
        front=_scaled(car.front, 1.0 + shift),
        rear=_scaled(car.rear, rear_scale),
    )


def _scaled(corner: CornerParameters, factor: float) -> CornerParameters:
    mu = corner.friction_coefficient * factor
    return replace(corner, friction_coefficient=mu)


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
