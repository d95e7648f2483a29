"""The rows, flags and inputs of the pass over samples: one table of them all.

The C form reads the same table: its header is generated from it when the
package is built. It imports nothing but the roles.
"""

from __future__ import annotations

from typing import Final

from bstm_daemon.roles import MEASURED_NODES

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
"""A corner's columns of a step row: means over the step, except the running
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
age is that of the oldest mandatory input."""

LEARNED_CHANNELS: Final = VEHICLE_CHANNELS[
    VEHICLE_CHANNELS.index("grade") : VEHICLE_CHANNELS.index("flags")
]
"""Channels that the vehicle observer fills."""

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
    "pressure_contradicts": 1 << 46,
    "forces_contradict": 1 << 47,
    "ambient_suspect": 1 << 48,
    "driven_unseen": 1 << 49,
    "asleep": 1 << 50,
    "speed_unproven": 1 << 51,
    "forces_unproven": 1 << 52,
}
"""Bits of a step's ``flags``; those of pressure and heat are for any corner.
``docs/validity.md`` says when each is set."""

CORNER_PRESSURE: Final = 128
"""Bit of corner 0, shifted by the corner's index: its pressure is missing."""

WHEEL_SUSPECT: Final = 1 << 24
CORNER_PRESSURE_SUSPECT: Final = 1 << 28
HEAT_LOST: Final = 1 << 32
HEAT_UNCERTAIN: Final = 1 << 36
"""Bits of corner 0, shifted likewise: its wheel speed is suspect; the pressure
it uses is suspect; its heat has been unknown for too long; it recently was."""
