"""What the car's sensors say of the truth.

A :class:`SensorSuite` holds the errors of every channel, with one seeded
random stream a channel, so that adding a channel leaves the others' noise as
it was. Without errors the signals are the truth and only the DBC's resolution
limits them.

The presets ``n1`` (good) to ``n4`` (poor) set the errors of every channel.
Thermocouples: white noise, drift with the junction's place, offset, lag.
Vehicle signals: accelerometer noise, bias and body pitch; pressure offset,
lag and quantum; wheel-speed quantum and the speed below which a wheel sensor
sees no teeth; noise of the torque signal; lag and noise of satellite speed.
"""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.errors import UsageError
from bstm_daemon.roles import CORNERS, MEASURED_NODES
from bstm_daemon.simulation.car import SECONDARY, Motion
from bstm_daemon.simulation.materials import Array
from bstm_daemon.simulation.parameters import Effects
from bstm_daemon.simulation.profile import SAMPLE_S, Course
from bstm_daemon.units import GRAVITY_MS2, KELVIN_OFFSET

INSTRUMENTED: Final = ("FL", "FR")
"""Corners with thermocouples."""

DRIFT_S: Final = 300.0
"""Correlation time of a drifting channel (AR(1))."""

# typical size of the effects that act in sensors
_THERMOCOUPLE_OFFSET_K = 9.0
_THERMOCOUPLE_GAIN = 0.02
_THERMOCOUPLE_LAG_S = 7.5
_ACCELEROMETER_BIAS_MS2 = 0.1
_BIAS_WARM_S = 600.0
_TORQUE_ERROR = -0.08
_TORQUE_OFFSET_NM = 12.0
_AMBIENT_SOAK_K = 8.0
_AMBIENT_LAG_S = 400.0
_BRAKE_TORQUE_SHARE = 0.6
_PEDAL_TRAVEL_PER_PA = 1.0 / 12e6
_BLOCK = 64


@dataclass(frozen=True, slots=True)
class Channel:
    """Errors of one channel, in the channel's SI unit.

    ``bias_sd`` is the spread of a constant drawn for each drive, ``offset``
    the size of one of either sign, ``drift`` the spread of an AR(1) process
    of :data:`DRIFT_S`, ``relative_noise`` white noise as a share of the
    reading; below ``dead_below`` the channel reads 0.
    """

    bias_sd: float = 0.0
    offset: float = 0.0
    lag_s: float = 0.0
    drift: float = 0.0
    noise: float = 0.0
    relative_noise: float = 0.0
    dead_below: float = 0.0
    quantum: float = 0.0


class SensorSuite:
    """The errors of all channels and their random streams."""

    def __init__(
        self,
        effects: Effects,
        seed: int,
        channels: Mapping[str, Channel] | None = None,
        pitch_rad_per_g: float = 0.0,
    ) -> None:
        """Take *channels* by role, clean where absent, plus *effects*.

        A key ``temp`` holds for all thermocouples. *pitch_rad_per_g* is how
        far the body pitches under the car's own acceleration.
        """
        self.effects = effects
        self.pitch_rad_per_g = pitch_rad_per_g
        self._seed = seed
        self._channels = dict(channels or {})

    def read(self, role: str, truth: Array, sample_s: float) -> Array:
        """Return what *role* reads where the truth is *truth*, (n,)."""
        temperature = role.startswith("temp_")
        kind = "temp" if temperature else role
        channel = self._channels.get(role, self._channels.get(kind))
        reading = self._with_effects(role, truth, sample_s)
        if channel is None:
            return reading
        stream = np.random.default_rng([self._seed, zlib.crc32(role.encode())])
        return _erring(reading, channel, stream, sample_s)

    def _with_effects(self, role: str, truth: Array, sample_s: float) -> Array:
        """Return *truth* with the effects that sit in this channel."""
        e = self.effects
        reading: Array = truth
        if role.startswith("temp_"):
            if e.thermocouple_offset > 0:
                excess = truth - (KELVIN_OFFSET + 20.0)
                reading = truth + e.thermocouple_offset * (
                    _THERMOCOUPLE_OFFSET_K + _THERMOCOUPLE_GAIN * excess
                )
            if e.thermocouple_lag > 0:
                # junction and cement, one behind the other
                lag_s = _THERMOCOUPLE_LAG_S * e.thermocouple_lag
                reading = lagged(reading, lag_s, sample_s)
                reading = lagged(reading, lag_s, sample_s)
        elif role == "acceleration_longitudinal" and e.accelerometer_bias > 0:
            at_s = sample_s * np.arange(len(truth))
            warm = 1.0 - 0.3 * np.exp(-at_s / _BIAS_WARM_S)
            bias = _ACCELEROMETER_BIAS_MS2 * e.accelerometer_bias
            reading = truth + bias * warm
        elif role == "powertrain_torque" and e.powertrain_torque_error > 0:
            gain = 1.0 + _TORQUE_ERROR * e.powertrain_torque_error
            offset = _TORQUE_OFFSET_NM * e.powertrain_torque_error
            reading = truth * gain + offset * (truth != 0)
        return reading


def _erring(
    reading: Array,
    channel: Channel,
    stream: np.random.Generator,
    sample_s: float,
) -> Array:
    # drawn in any case, so that each error keeps its numbers
    bias, sign = stream.normal(), stream.choice((-1.0, 1.0))
    if channel.lag_s > 0:
        reading = lagged(reading, channel.lag_s, sample_s)
    if channel.relative_noise > 0:
        share = stream.normal(0, channel.relative_noise, len(reading))
        reading = reading * (1.0 + share)
    reading = reading + channel.bias_sd * bias + channel.offset * sign
    if channel.drift > 0:
        reading = reading + channel.drift * drifting(
            stream, len(reading), sample_s
        )
    if channel.noise > 0:
        reading = reading + stream.normal(0, channel.noise, len(reading))
    if channel.quantum > 0:
        reading = np.round(reading / channel.quantum) * channel.quantum
    if channel.dead_below > 0:
        reading = np.where(reading < channel.dead_below, 0.0, reading)
    return reading


def drifting(
    stream: np.random.Generator, count: int, sample_s: float
) -> Array:
    """Return a stationary AR(1) series of unit spread, (count,)."""
    keep = float(np.exp(-sample_s / DRIFT_S))
    steps = stream.normal(0, np.sqrt(1.0 - keep * keep), count)
    out = np.empty(count)
    last = stream.normal()
    for index, step in enumerate(steps.tolist()):
        last = last * keep + step
        out[index] = last
    return out


def lagged(values: Array, lag_s: float, sample_s: float) -> Array:
    """Return *values* behind a first-order lag, starting settled."""
    decay = float(np.exp(-sample_s / lag_s))
    blocks = -(-len(values) // _BLOCK)
    padded = np.full(blocks * _BLOCK, values[-1], dtype=np.float64)
    padded[: len(values)] = values
    ages = np.subtract.outer(np.arange(_BLOCK), np.arange(_BLOCK))
    weights = np.where(ages >= 0, (1.0 - decay) * decay ** np.abs(ages), 0.0)
    # a block's answer to its own samples, then to what was before it
    out: Array = padded.reshape(blocks, _BLOCK) @ weights.T
    fading = decay ** np.arange(1, _BLOCK + 1)
    last = float(values[0])
    for index in range(blocks):
        out[index] += fading * last
        last = float(out[index, -1])
    return out.ravel()[: len(values)]


def measured_roles(
    course: Course,
    *,
    line_pa: Array,
    wheel_pa: Array,
    motion: Motion,
    ambient_k: Array,
    suite: SensorSuite,
) -> dict[str, Array]:
    """Return the vehicle roles as the sensors read them, (n,) each, SI.

    *line_pa* (n,) is the pressure in front of the wheels, *wheel_pa* (n, 4)
    at them.
    """
    v = course.speed_ms
    segments = course.segments
    radius = course.level([s.bend_radius_m for s in segments])
    yaw = np.divide(v, radius, out=np.zeros_like(v), where=radius != 0)
    assist = course.level([float(s.assist) for s in segments]) > 0
    primary = np.where(assist, 0.0, line_pa)
    # behind the valves, where the stability system may press without the pedal
    secondary = np.maximum(line_pa, wheel_pa[:, SECONDARY].mean(axis=1))
    parked = course.level([float(s.parked) for s in segments])
    pitch_rad = suite.pitch_rad_per_g * course.acceleration_ms2 / GRAVITY_MS2
    truth = {
        **{
            f"wheel_speed_{c.lower()}": v * (1.0 - motion.slip[:, lane])
            for lane, c in enumerate(CORNERS)
        },
        **{
            f"wheel_pressure_{c.lower()}": wheel_pa[:, lane]
            for lane, c in enumerate(CORNERS)
        },
        "vehicle_speed": v,
        "gnss_speed": v,
        "primary_pressure": primary,
        "secondary_pressure": secondary,
        "acceleration_longitudinal": course.acceleration_ms2
        + GRAVITY_MS2 * np.sin(course.slope_rad + pitch_rad),
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
    gnss_noise_ms: float

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
            # the receiver filters
            "gnss_speed": Channel(lag_s=0.6, noise=self.gnss_noise_ms),
        }


SENSOR_PRESETS: Final[dict[str, SensorPreset | None]] = {
    "none": None,
    "n1": SensorPreset(
        *(Channel(noise=0.5), 0.02, 0.05, 0.0, 2e3, 0.01, 0.0, 0.01, 0.03)
    ),
    "n2": SensorPreset(
        Channel(noise=1.0, drift=1.0),
        *(0.05, 0.10, 0.03, 5e3, 0.03, 0.4, 0.02, 0.05),
    ),
    "n3": SensorPreset(
        Channel(noise=2.0, drift=3.0, bias_sd=3.0, lag_s=5.0),
        *(0.08, 0.15, 0.03, 1e4, 0.06, 0.4, 0.04, 0.1),
    ),
    "n4": SensorPreset(
        Channel(noise=5.0, drift=8.0),
        *(0.12, 0.20, 0.03, 2e4, 0.06, 0.4, 0.06, 0.2),
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
