"""What the car's sensors say of the truth.

A :class:`SensorSuite` holds the errors of every channel: bias, lag, white
noise and quantum, with one seeded random stream a channel, so that adding a
channel leaves the others' noise as it was. Without errors the signals are the
truth and only the DBC's resolution limits them.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.roles import CORNERS, MEASURED_NODES
from bstm_daemon.simulation.profile import SAMPLE_S
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.simulation.car import Motion
    from bstm_daemon.simulation.materials import Array
    from bstm_daemon.simulation.parameters import Effects
    from bstm_daemon.simulation.profile import Course

INSTRUMENTED: Final = ("FL", "FR")
"""Corners with thermocouples."""

_THERMOCOUPLE_OFFSET_K = 15.0
_THERMOCOUPLE_LAG_S = 15.0
_ACCELEROMETER_BIAS_MS2 = 0.1
_TORQUE_ERROR = -0.08
_AMBIENT_SOAK_K = 8.0
_AMBIENT_LAG_S = 400.0
_BRAKE_TORQUE_SHARE = 0.6
_PEDAL_TRAVEL_PER_PA = 1.0 / 12e6


@dataclass(frozen=True, slots=True)
class Channel:
    """Errors of one channel, in the channel's SI unit."""

    bias: float = 0.0
    gain: float = 1.0
    lag_s: float = 0.0
    noise: float = 0.0
    quantum: float = 0.0


class SensorSuite:
    """The errors of all channels and their random streams."""

    def __init__(
        self,
        effects: Effects,
        seed: int,
        channels: Mapping[str, Channel] | None = None,
    ) -> None:
        """Take *channels* by role, clean where absent, plus *effects*."""
        self.effects = effects
        self._seed = seed
        self._channels = dict(channels or {})

    def read(self, role: str, truth: Array, sample_s: float) -> Array:
        """Return what *role* reads where the truth is *truth*, (n,)."""
        channel = self._channel(role)
        reading = truth * channel.gain + channel.bias
        if channel.lag_s > 0:
            reading = lagged(reading, channel.lag_s, sample_s)
        if channel.noise > 0:
            stream = np.random.default_rng(
                [self._seed, zlib.crc32(role.encode())]
            )
            reading = reading + stream.normal(0, channel.noise, len(truth))
        if channel.quantum > 0:
            reading = np.round(reading / channel.quantum) * channel.quantum
        return reading

    def _channel(self, role: str) -> Channel:
        channel = self._channels.get(role, Channel())
        e = self.effects
        bias, gain, lag_s = channel.bias, channel.gain, channel.lag_s
        if role.startswith("temp_"):
            bias += _THERMOCOUPLE_OFFSET_K * e.thermocouple_offset
            lag_s += _THERMOCOUPLE_LAG_S * e.thermocouple_lag
        elif role == "acceleration_longitudinal":
            bias += _ACCELEROMETER_BIAS_MS2 * e.accelerometer_bias
        elif role == "powertrain_torque":
            gain *= 1.0 + _TORQUE_ERROR * e.powertrain_torque_error
        return Channel(bias, gain, lag_s, channel.noise, channel.quantum)


def lagged(values: Array, lag_s: float, sample_s: float) -> Array:
    """Return *values* behind a first-order lag, starting settled."""
    decay = np.exp(-sample_s / lag_s)
    out = np.empty_like(values)
    last = float(values[0])
    for index, value in enumerate(values.tolist()):
        last = value + (last - value) * decay
        out[index] = last
    return out


def measured_roles(
    course: Course,
    motion: Motion,
    line_pa: Array,
    ambient_k: Array,
    suite: SensorSuite,
) -> dict[str, Array]:
    """Return the vehicle roles as the sensors read them, (n,) each, SI."""
    v = course.speed_ms
    segments = course.segments
    radius = course.level([s.bend_radius_m for s in segments])
    yaw = np.divide(v, radius, out=np.zeros_like(v), where=radius != 0)
    assist = course.level([float(s.assist) for s in segments]) > 0
    primary = np.where(assist, 0.0, line_pa)
    parked = course.level([float(s.parked) for s in segments])
    truth = {
        **{f"wheel_speed_{c.lower()}": v for c in CORNERS},
        "vehicle_speed": v,
        "primary_pressure": primary,
        "secondary_pressure": line_pa,
        "acceleration_longitudinal": course.acceleration_ms2
        + GRAVITY_MS2 * np.sin(course.slope_rad),
        "acceleration_lateral": v * yaw,
        "yaw_rate": yaw,
        "powertrain_torque": motion.powertrain_torque_nm,
        "motor_torque": motion.motor_torque_nm,
        # the car's own signal strongly underestimates (thesis 4.2)
        "brake_torque": _BRAKE_TORQUE_SHARE * motion.brake_torque_nm,
        "external_force": motion.external_force_n,
        "engine_speed": motion.engine_speed_rad_s,
        "gear": motion.gear,
        "clutch_open": (motion.gear == 0).astype(np.float64),
        "ambient_temperature": _ambient(ambient_k, v, suite),
        "rain": course.level([s.rain for s in segments]),
        "brake_switch": (primary > 0).astype(np.float64),
        "brake_pedal_travel": np.minimum(primary * _PEDAL_TRAVEL_PER_PA, 1.0),
        "park_brake": parked,
        "ignition": course.level([float(s.ignition) for s in segments]),
        **{
            f"{name}_active": course.level(
                [float(name in s.active) for s in segments]
            )
            for name in ("abs", "esc", "tc")
        },
    }
    return {
        role: suite.read(role, values, SAMPLE_S)
        for role, values in truth.items()
    }


def _ambient(ambient_k: Array, v: Array, suite: SensorSuite) -> Array:
    """Ambient at the bumper: warm from the parked car's engine bay."""
    strength = suite.effects.ambient_heat_soak
    if strength == 0:
        return ambient_k
    soak = strength * _AMBIENT_SOAK_K * np.exp(-v / 6.0)
    return ambient_k + lagged(soak, _AMBIENT_LAG_S, SAMPLE_S)


def measured_temperatures(
    truth: Mapping[str, Array], suite: SensorSuite
) -> dict[str, Array]:
    """Return the thermocouples' roles [K] from the truth at 1 Hz."""
    return {
        role: suite.read(role, truth[f"{corner}.{node}"], 1.0)
        for corner in INSTRUMENTED
        for node in MEASURED_NODES
        for role in (f"temp_{corner.lower()}_{node}",)
    }
