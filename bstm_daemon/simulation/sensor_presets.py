"""Sensor presets ``n1`` (good) to ``n4`` (poor): the errors of every channel.

Thermocouples: white noise, drift with the junction's place, offset, lag.
Vehicle signals: accelerometer noise, bias and body pitch; pressure offset,
lag and quantum; wheel-speed quantum and the speed below which a wheel sensor
sees no teeth; noise of the torque signal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from bstm_daemon.errors import UsageError
from bstm_daemon.roles import CORNERS
from bstm_daemon.simulation.sensors import Channel, SensorSuite

if TYPE_CHECKING:
    from bstm_daemon.simulation.parameters import Effects


@dataclass(frozen=True, slots=True)
class SensorPreset:
    """Errors of all channels at one level, SI."""

    thermocouple: Channel
    acceleration_noise_ms2: float
    acceleration_bias_sd_ms2: float
    pitch_rad_per_g: float
    pressure_offset_pa: float
    wheel_speed_quantum_ms: float
    wheel_speed_dead_ms: float
    torque_noise: float

    def channels(self) -> dict[str, Channel]:
        """Return the channels by role, ``temp`` for all thermocouples."""
        pressure = Channel(
            offset=self.pressure_offset_pa, lag_s=0.02, quantum=1e4
        )
        speed = Channel(
            quantum=self.wheel_speed_quantum_ms,
            dead_below=self.wheel_speed_dead_ms,
        )
        corners = [corner.lower() for corner in CORNERS]
        return {
            "temp": self.thermocouple,
            "acceleration_longitudinal": Channel(
                bias_sd=self.acceleration_bias_sd_ms2,
                noise=self.acceleration_noise_ms2,
            ),
            "primary_pressure": pressure,
            "secondary_pressure": pressure,
            **{f"wheel_pressure_{corner}": pressure for corner in corners},
            # the stability system has its speed from the wheels
            "vehicle_speed": speed,
            **{f"wheel_speed_{corner}": speed for corner in corners},
            "powertrain_torque": Channel(relative_noise=self.torque_noise),
        }


SENSOR_PRESETS: Final[dict[str, SensorPreset | None]] = {
    "none": None,
    "n1": SensorPreset(
        Channel(noise=0.5), 0.02, 0.05, 0.0, 2e3, 0.01, 0.0, 0.01
    ),
    "n2": SensorPreset(
        Channel(noise=1.0, drift=1.0), 0.05, 0.10, 0.03, 5e3, 0.03, 0.4, 0.02
    ),
    "n3": SensorPreset(
        Channel(noise=2.0, drift=3.0, bias_sd=3.0, lag_s=5.0),
        *(0.08, 0.15, 0.03, 1e4, 0.06, 0.4, 0.04),
    ),
    "n4": SensorPreset(
        Channel(noise=5.0, drift=8.0), 0.12, 0.20, 0.03, 2e4, 0.06, 0.4, 0.06
    ),
}
"""Name to errors; ``none`` reads the truth."""


def sensor_suite(name: str, effects: Effects, seed: int) -> SensorSuite:
    """Return the sensors of the preset *name* with *effects* and *seed*.

    Raises :class:`~bstm_daemon.errors.UsageError` for an unknown name.
    """
    try:
        preset = SENSOR_PRESETS[name]
    except KeyError:
        msg = f"no sensors {name!r}: one of {', '.join(SENSOR_PRESETS)}"
        raise UsageError(msg) from None
    if preset is None:
        return SensorSuite(effects, seed)
    return SensorSuite(
        effects, seed, preset.channels(), preset.pitch_rad_per_g
    )
