"""The motion of a recorded car on one time grid, as identification needs it.

Speeds and accelerometer go through the checks of ``bstm check --log`` first:
a channel that contradicts the others is left out and reported, not fitted.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from bstm_daemon.analysis.quality.accelerations import compare_accelerations
from bstm_daemon.analysis.quality.braking import released_reading, resistance_n
from bstm_daemon.analysis.quality.channels import Channels, window_mean
from bstm_daemon.analysis.quality.finding import Checks
from bstm_daemon.analysis.quality.frozen import find_frozen_speeds
from bstm_daemon.analysis.quality.limits import GRID_S, MOVING_MS
from bstm_daemon.analysis.quality.recording import Recording, read_recording
from bstm_daemon.analysis.quality.speeds import compare_speeds
from bstm_daemon.analysis.statistics.series import Column, Mask, running_mean
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.roles import LONGITUDINAL, PRESSURES

CONTROL: Final = ("abs_active", "esc_active", "tc_active")
"""Flags that indicate wheel slip."""

PITCH_WINDOW_S: Final = 20.0
"""Grade changes slower than this, body pitch follows at once."""

PITCH_RATE_MS2: Final = 0.5
"""Changes of speed that pitch the body well beyond the road's own."""

HARDEST_MS2: Final = 3.5
"""Hardest change of speed used; beyond it tyres slip, which looks like pitch.
"""

PITCH_LEAST_S: Final = 10.0
PITCH_SIGMAS: Final = 3.0
LARGEST_PITCH: Final = 0.12
"""m/s2 of gravity a m/s2; 7 degrees at 1 g, softer than any road car."""


@dataclass(frozen=True, slots=True)
class Driving:
    """Signals of one log on a grid of 0.05 s, (n,) each, SI, NaN if absent.

    ``rate_ms2`` is dv/dt and ``accel_measured_ms2`` the accelerometer, both
    over the same half second around each point; the body's ``pitch`` times
    ``rate_ms2`` is taken off the latter. ``torque_nm`` is that of the
    powertrain at the wheels, 0 where the drive line is open; ``external_n``
    the external force. ``pressures`` holds the pressures by role.
    ``line_known`` names what shows whether the drive line is open.
    """

    name: str
    channels: Channels
    vehicle: Vehicle
    time_s: Column
    speed_ms: Column
    rate_ms2: Column
    accel_measured_ms2: Column
    torque_nm: Column
    external_n: Column
    pressures: dict[str, Column]
    line_known: str
    pitch: float
    pitch_error: float
    remarks: tuple[str, ...]

    @property
    def has_accelerometer(self) -> bool:
        """Whether the accelerometer is there and sound."""
        return bool(np.isfinite(self.accel_measured_ms2).any())

    @property
    def traction_n(self) -> Column:
        """Force of powertrain and outside that drives the car, (n,)."""
        return self.torque_nm / self.vehicle.wheel_radius_m + self.external_n

    @property
    def slope_ms2(self) -> Column:
        """Grade times g plus the accelerometer's bias, (n,)."""
        return self.accel_measured_ms2 - self.rate_ms2

    def value(self, role: str) -> Column:
        """Return *role* on the grid, NaN where it is not."""
        return self.channels.value(role)

    def highest_pressure_pa(self) -> Column:
        """Return the highest of the pressures, NaN where none is known."""
        top = np.full(len(self.time_s), np.nan)
        for pressure in self.pressures.values():
            top = np.fmax(top, pressure)
        return top

    @property
    def brake_known(self) -> bool:
        """Whether a pressure or the brake switch is in the log."""
        return bool(self.pressures or self.channels.alive(["brake_switch"]))

    def released(self) -> Mask:
        """Return where the brake is known to be released, (n,).

        A missing pressure does not count as a released brake; one that rests
        above 0 is released there.
        """
        released = np.full(len(self.time_s), self.brake_known)
        for pressure in self.pressures.values():
            rest, above = released_reading(
                pressure, self.speed_ms, self.rate_ms2
            )
            released &= pressure - rest < above
        if self.channels.alive(["brake_switch"]):
            released &= self.value("brake_switch") < 0.5
        return released


@dataclass(frozen=True, slots=True)
class Span:
    """Points ``first`` to ``last``, both included, of a time axis."""

    first: int
    last: int

    @property
    def points(self) -> slice:
        """The points as a slice."""
        return slice(self.first, self.last + 1)


@dataclass(frozen=True, slots=True)
class Balance:
    """Eq 4.5 in the right form: speeds at both ends and the works [J].

    1/2 m_eff (v0^2 - v1^2) = W_brake + W_drag + W_climb - W_drive
    """

    from_ms: float
    to_ms: float
    kinetic_j: float
    drag_j: float
    climb_j: float
    drive_j: float

    @property
    def brake_j(self) -> float:
        """W_brake, nan where the speed is not known."""
        return self.kinetic_j - self.drag_j - self.climb_j + self.drive_j


def balance_of(
    car: Vehicle, speed_ms: Column, slope_ms2: Column, traction_n: Column
) -> Balance:
    """Return Eq 4.5 over columns of the grid, (n,) each.

    *slope_ms2* is g sin(grade), *traction_n* the force that drives the car.
    """
    from_ms, to_ms = float(speed_ms[0]), float(speed_ms[-1])
    return Balance(
        from_ms,
        to_ms,
        car.kinetic_energy_j(from_ms) - car.kinetic_energy_j(to_ms),
        work_j(resistance_n(car, speed_ms), speed_ms),
        work_j(car.mass_kg * slope_ms2, speed_ms),
        work_j(traction_n, speed_ms),
    )


def work_j(force_n: Column, speed_ms: Column) -> float:
    """Return the integral of force times speed over the grid (Eq 4.3)."""
    power = np.nan_to_num(force_n * speed_ms)
    return float((power[1:] + power[:-1]).sum()) * 0.5 * GRID_S


def read_drivings(
    logs: Sequence[Path],
    config: Config,
    signal_map: SignalMap,
    overrides: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Driving]:
    """Return the motion in each of *logs*.

    Raises:
        LogError: a log holds no usable speed.
    """
    return [
        driving_of(
            log.name,
            read_recording([log], signal_map, overrides, progress),
            config,
            signal_map,
        )
        for log in logs
    ]


def driving_of(
    name: str, recording: Recording, config: Config, signal_map: SignalMap
) -> Driving:
    """Return the motion in *recording*, called *name*.

    Raises:
        LogError: it holds no usable speed.
    """
    channels = Checks(recording, config, signal_map.timeouts_us)
    with np.errstate(over="ignore", invalid="ignore"):
        find_frozen_speeds(channels)
        compare_speeds(channels)
        if not channels.on_stand:
            compare_accelerations(channels)
    if not channels.speed_roles or channels.on_stand:
        why = "; ".join(f.text for f in channels.findings if f.wrong)
        what = "the car stood on a stand" if channels.on_stand else "no speed"
        msg = f"{name}: {what} in this log" + (f": {why}" if why else "")
        raise LogError(msg)
    remarks = [
        f"{', '.join(f.roles)} left out: {f.text}"
        for f in channels.findings
        if f.wrong and set(f.roles) <= channels.dead
    ]
    rate = channels.speed_rate()
    accel_measured = np.full(len(rate), np.nan)
    if channels.alive([LONGITUDINAL]) and config.heat.slope != "flat":
        accel_measured = channels.acceleration()
    gripping = np.where(flagged(channels, CONTROL), np.nan, rate)
    pitch, error = pitch_of(gripping, accel_measured, channels.speed)
    torque, external, known = _drive_line(channels)
    return Driving(
        name,
        channels,
        Vehicle.of_config(config.vehicle),
        channels.time_s,
        channels.speed,
        rate,
        accel_measured - pitch * rate,
        torque,
        external,
        {role: channels.value(role) for role in channels.alive(PRESSURES)},
        known,
        pitch,
        error,
        tuple(remarks),
    )


def flagged(channels: Channels, roles: Iterable[str]) -> Mask:
    """Return where one of the flags *roles* is set, (n,)."""
    set_flags = np.zeros(len(channels.time_s), bool)
    for role in channels.alive(roles):
        set_flags |= channels.value(role) > 0.5
    return set_flags


def pitch_of(
    rate_ms2: Column, accel_measured_ms2: Column, speed_ms: Column
) -> tuple[float, float]:
    """Return the body's pitch and its standard error, m/s2 a m/s2.

    An accelerometer reads ``dv/dt + g sin(grade) + bias + pitch dv/dt``.
    Grade and bias change slowly, so the pitch is the slope of the fast part
    of its difference to ``rate`` over that of ``rate``. 0 if not significant.
    """
    excess_ms2 = accel_measured_ms2 - rate_ms2
    half = round(PITCH_WINDOW_S / GRID_S / 2)
    fast_excess, fast_rate = (
        _fast(one, half) for one in (excess_ms2, rate_ms2)
    )
    used = np.isfinite(fast_excess + fast_rate) & (speed_ms > MOVING_MS)
    used &= np.abs(fast_rate) > PITCH_RATE_MS2
    used &= np.abs(rate_ms2) < HARDEST_MS2
    if np.count_nonzero(used) * GRID_S < PITCH_LEAST_S:
        return 0.0, np.nan
    x, y = fast_rate[used], fast_excess[used]
    slope = float(x @ y / (x @ x))
    # points half a second apart are independent, those between are not
    independent = max(len(x) * GRID_S / 0.5, 3.0)
    error = float(
        np.std(y - slope * x) / np.sqrt(x @ x / len(x) * independent)
    )
    if slope < PITCH_SIGMAS * error or not 0.0 < slope < LARGEST_PITCH:
        return 0.0, error
    return slope, error


def _fast(value: Column, half: int) -> Column:
    """Return *value* less its mean over *half* points each side, else NaN."""
    mean, count = running_mean(value, half)
    return np.where(count == 2 * half + 1, value - mean, np.nan)


def _drive_line(channels: Channels) -> tuple[Column, Column, str]:
    """Return torque at the wheels, external force, and their source in words.

    An open line has no torque, whatever its signal's zero is.
    """
    count = len(channels.time_s)
    is_open = np.zeros(count, bool)
    sources = []
    if channels.alive(["gear"]):
        sources.append("gear")
        is_open |= np.abs(channels.value("gear")) < 0.5
    if channels.alive(["clutch_open"]):
        sources.append("clutch_open")
        is_open |= channels.value("clutch_open") > 0.5
    torque = np.full(count, np.nan)
    assumed = channels.config.heat.assume_powertrain_torque_nm
    if channels.alive(["powertrain_torque"]):
        sources.append("powertrain_torque")
        torque = window_mean(channels.value("powertrain_torque"))
    elif assumed is not None:
        sources.append(f"assumed torque of {assumed:g} Nm")
        torque = np.full(count, assumed)
    torque = np.where(is_open, 0.0, torque)
    external = np.zeros(count)
    if channels.alive(["external_force"]):
        external = np.nan_to_num(window_mean(channels.value("external_force")))
    return torque, external, ", ".join(sources)
