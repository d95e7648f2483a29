"""The configuration flattened into the arrays of the per-sample pass.

``ints`` and ``floats`` are read in the order written here by
:mod:`bstm_daemon.heat.sample_pass` and by ``_samples.c``.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from bstm_daemon.heat.feed_back import Vehicle
from bstm_daemon.heat.feed_forward import PressureTorque
from bstm_daemon.heat.friction_law import FrictionLaw
from bstm_daemon.heat.limits import LIMITS
from bstm_daemon.roles import CORNERS, MEASURED_NODES, ROLE_INDEX, ROLES
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.config import Config, CornerConfig

PLAN_LAYOUT: Final = 5
MODES: Final = {"ff": 0, "fb": 1, "measured": 2, "fused": 3}
SLOPES: Final = {"accelerometer": 0, "flat": 1}

CHANNELS: Final = (
    "speed_ms",
    "pressure_pa",
    "brake_on",
    "wetness",
    "ambient_k",
    "brake_power_w",
    "brake_energy_ff_j",
    "brake_energy_fb_j",
    "brake_power_std_w",
    *(f"measured_{node}_k" for node in MEASURED_NODES),
)
"""A corner's columns of a step row: means over the step, but for the running
energies since the start and ``measured_*`` (held, nan where not present)."""

MEASURED_FROM: Final = len(CHANNELS) - len(MEASURED_NODES)

VEHICLE_CHANNELS: Final = (
    "speed_ms",
    "distance_m",
    "brake_force_n",
    "input_age_s",
    "grade",
    "grade_std",
    "mass_kg",
    "mass_std_kg",
    "accel_bias_ms2",
    "accel_bias_std_ms2",
    "friction_scale",
    "friction_scale_std",
    "drag_scale",
    "drag_scale_std",
    "flags",
)
"""The vehicle's columns of a step row; distance counts from the start, the
age is that of the mandatory input that is silent longest."""

FLAGS: Final = {
    "speed_missing": 1,
    "pressure_missing": 2,
    "acceleration_missing": 4,
    "torque_missing": 8,
    "ambient_missing": 16,
    "clock_jump": 32,
    "settled": 64,
    "speed_suspect": 1 << 11,
    "pressure_suspect": 1 << 12,
    "acceleration_suspect": 1 << 13,
    "torque_suspect": 1 << 14,
    "temperature_suspect": 1 << 15,
    "samples_refused": 1 << 16,
    "stuck": 1 << 17,
    "switch_contradicts": 1 << 18,
    "wheels_contradict": 1 << 19,
    "acceleration_contradicts": 1 << 20,
    "heat_substituted": 1 << 21,
    "heat_unknown": 1 << 22,
    "silent": 1 << 23,
    "external_force_suspected": 1 << 40,
    "observer_reset": 1 << 41,
    "acceleration_scale": 1 << 42,
    "wheel_radius": 1 << 43,
    "pressure_dead": 1 << 44,
    "braking_unpressed": 1 << 45,
}
"""Bits of a step's ``flags``; those of pressure and heat are for any corner.
``docs/validity.md`` says when each is set."""

CORNER_PRESSURE: Final = 128
"""Shifted by the corner's place: the pressure of that corner is missing."""

WHEEL_SUSPECT: Final = 1 << 24
CORNER_PRESSURE_SUSPECT: Final = 1 << 28
HEAT_LOST: Final = 1 << 32
HEAT_DOUBT: Final = 1 << 36
"""Likewise: the wheel's speed is suspect; the pressure that the corner goes
by is; its heat is unknown, and has been for too long; it was of late."""

VEHICLE_ROLES: Final = (
    "vehicle_speed",
    "primary_pressure",
    "secondary_pressure",
    "acceleration_longitudinal",
    "powertrain_torque",
    "external_force",
    "ambient_temperature",
    "rain",
    "brake_switch",
    "esc_active",
    "motor_torque",
    "acceleration_lateral",
    "yaw_rate",
    "gear",
    "clutch_open",
    "abs_active",
    "tc_active",
    "altitude",
    "gnss_speed",
)
"""Roles of the vehicle that the pass reads, in plan order."""


@dataclass(frozen=True, slots=True)
class SamplePlan:
    """The arrays of the pass and what they were made for."""

    ints: array[int]
    floats: array[float]
    corners: tuple[str, ...]
    step_us: int


def plan_samples(
    config: Config,
    present: Mapping[int, int],
    step_us: int,
    settling_s: float = 86_400.0,
    laws: Mapping[str, FrictionLaw] | None = None,
    unpressed_share: float = 0.0,
) -> SamplePlan:
    """Flatten *config*.

    Args:
        config: the configuration.
        present: role number to timeout [us], for each role that is mapped.
        step_us: the estimator's step [us].
        settling_s: the longest that any past heat is felt [s].
        laws: friction of corners by name, where it is not nominal.
        unpressed_share: how much counts of a braking that is felt while no
            pressure tells of it.
    """
    vehicle = Vehicle.of_config(config.vehicle)
    heat = config.heat
    table = list(
        zip(heat.front_pressure_pa, heat.rear_pressure_pa, strict=True)
    )
    ints = [
        PLAN_LAYOUT,
        len(ROLES),
        len(config.corner),
        MODES[heat.mode],
        SLOPES[heat.slope],
        len(table),
        int(_has_pressure(present)),
        int(heat.assume_powertrain_torque_nm is not None),
        int(bool(laws)),
    ]
    ints += [_number(role, present) for role in VEHICLE_ROLES]
    floats = [
        float(step_us),
        vehicle.mass_kg,
        vehicle.rotating_mass_kg,
        vehicle.wheel_radius_m,
        vehicle.quadratic,
        vehicle.linear,
        vehicle.constant,
        config.vehicle.ambient_c + KELVIN_OFFSET,
        heat.assume_powertrain_torque_nm or 0.0,
        heat.brake_on_pressure_pa,
        heat.brake_on_force_n,
        heat.derivative_filter_s,
        settling_s,
        # the fused power finds such braking by itself
        0.0 if heat.mode == "fused" else unpressed_share,
    ]
    for corner in config.corner:
        ints += _corner_ints(corner, present)
        torque = PressureTorque.of_corner(corner)
        lag = (
            heat.primary_lag_s
            if corner.circuit == "primary"
            else heat.secondary_lag_s
        )
        floats += [
            torque.torque_per_pressure_nm_pa,
            torque.pushout_pressure_pa,
            lag,
            _force_share(config, corner),
        ]
    floats += [front for front, _ in table] + [rear for _, rear in table]
    floats += [float(present.get(i, 0)) for i in range(len(ROLES))]
    for bound in zip(*LIMITS, strict=True):
        floats += bound
    if laws:
        for corner in config.corner:
            floats += laws.get(corner.name, FrictionLaw()).numbers()
    return SamplePlan(
        array("i", ints),
        array("d", floats),
        tuple(corner.name for corner in config.corner),
        step_us,
    )


def _has_pressure(present: Mapping[int, int]) -> bool:
    names = (
        "primary_pressure",
        "secondary_pressure",
        *(f"wheel_pressure_{c.lower()}" for c in CORNERS),
    )
    return any(ROLE_INDEX[name] in present for name in names)


def _number(role: str, present: Mapping[int, int]) -> int:
    index = ROLE_INDEX[role]
    return index if index in present else -1


def _corner_ints(
    corner: CornerConfig, present: Mapping[int, int]
) -> list[int]:
    name = corner.name.lower()
    return [
        _number(f"wheel_speed_{name}", present),
        _number(f"wheel_pressure_{name}", present),
        int(corner.circuit == "secondary"),
        int(corner.name[0] == "R"),
        *(_number(f"temp_{name}_{node}", present) for node in MEASURED_NODES),
    ]


def _force_share(config: Config, corner: CornerConfig) -> float:
    """Share of the vehicle's brake force: the axle's, halved (Eq 4.10)."""
    front = corner.name[0] == "F"
    share = config.vehicle.front_share
    return 0.5 * (share if front else 1.0 - share)
