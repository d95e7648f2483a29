"""Samples of brake force from motion with the pressure, stop by stop.

A press and the next one less than two seconds later are one application: the
thesis's pulsed stops (Fig 4.6) are stops. The force is Eq 4.11 less its
value with the brake released just before and after: accelerometer bias and
errors of the resistances cancel.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.identify.driving import (
    CONTROL,
    Driving,
    Span,
    flagged,
)
from bstm_daemon.analysis.quality.braking import (
    behind_table,
    brake_force_n,
    released_reading,
)
from bstm_daemon.analysis.quality.channels import HALF, window_mean
from bstm_daemon.analysis.quality.limits import GRID_S
from bstm_daemon.analysis.statistics.series import Column, Indices, Mask, runs
from bstm_daemon.config.sections import Config
from bstm_daemon.model.heat.feed_forward import PressureTorque
from bstm_daemon.roles import CORNERS, pressure_roles
from bstm_daemon.units import KELVIN_OFFSET

JOINED_S: Final = 2.0
"""Presses closer than this belong to one application."""

SHORTEST_S: Final = 0.4
"""A shorter press is a touch of the pedal."""

STANDING_MS: Final = 0.5
"""At or below this speed nothing slides; sensors with a dead band read 0."""

LOWEST_MS: Final = 2.5
"""Lowest speed of a sample; below it the accelerometer includes the jerk of
the stop."""

LEAST_PRESSURE_PA: Final = 2e5
"""Lowest pressure of a window; below it seals and springs dominate."""

STEADY_PA_S: Final = 15e5
"""Fastest change of pressure in a sample; a faster one leads the pads."""

JUMPING_PA_S: Final = 60e5
"""Fastest change of pressure if every stop is shown, hard ones too."""

AROUND_S: Final = 12.0
QUIET_S: Final = 1.0
LEAST_QUIET_S: Final = 1.5
"""Time before and after a stop in which the released brake is measured, gap to
the stop, and least time measured."""

DRIVEN_MS2: Final = 0.4
"""Largest drive at which a zero is taken; strong torque adds its own error."""

CORNERING_MS2: Final = 1.5

EVERY: Final = 2 * HALF
"""Grid points from sample to sample: windows that do not overlap."""


def applications(
    time_s: Column, speed_ms: Column, pressed: Mask
) -> list[Span]:
    """Return the applications, by rising time.

    Args:
        time_s: evenly spaced but for pauses, (n,).
        speed_ms: of the car, (n,).
        pressed: whether the brake is on, (n,).
    """
    on = pressed & (speed_ms > STANDING_MS)
    found: list[Span] = []
    for first, last in runs(on):
        if found and time_s[first] - time_s[found[-1].last] < JOINED_S:
            found[-1] = Span(found[-1].first, last)
        else:
            found.append(Span(first, last))
    return [
        span
        for span in found
        if time_s[span.last] - time_s[span.first] >= SHORTEST_S
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class Samples:
    """Brake force from motion and pressures, (n,) each, SI.

    ``front_pa`` and ``rear_pa`` are mean pressures of the axles,
    ``front_gain`` and ``rear_gain`` brake force over pressure by the
    configured geometry [N/Pa]; 0 where no brake of the axle has a pressure.
    """

    speed_ms: Column
    force_n: Column
    front_pa: Column
    rear_pa: Column
    front_gain: float
    rear_gain: float

    @property
    def gain(self) -> float:
        """Brake force over pressure of the whole car [N/Pa]."""
        return self.front_gain + self.rear_gain

    @property
    def pressure_pa(self) -> Column:
        """Pressure that gives the nominal force at both axles, (n,)."""
        weighted = (
            self.front_gain * self.front_pa + self.rear_gain * self.rear_pa
        )
        return np.asarray(weighted / self.gain)


@dataclass(frozen=True, slots=True, kw_only=True)
class BrakeStop(Samples):
    """The samples of one application of the brake.

    ``since_s`` (n,) counts from the press, ``zero_n`` is the force measured
    with the brake released, ``own_zero`` whether around this stop.
    ``initial_c`` has the measured discs' temperatures at the press, by corner.
    """

    log: str
    start_s: float
    duration_s: float
    from_ms: float
    to_ms: float
    zero_n: float
    own_zero: bool
    since_s: Column
    initial_c: dict[str, float]


def brake_samples(
    driving: Driving,
    config: Config,
    lag_s: float = 0.0,
    *,
    every_stop: bool = False,
) -> tuple[list[BrakeStop], float, str]:
    """Return the brake samples of *driving* with the brakes of *config*.

    The stops with samples, the reading of the released pressure [Pa], and
    what was searched in words.

    *lag_s* is the time constant by which the pads follow a circuit's
    pressure; one measured at the wheel includes it. *every_stop* takes
    those too in which anti-lock control acts, or of which no zero is known:
    their zero is 0.
    """
    measured = _corner_pressures(driving, config)
    pressures = {
        name: pressure
        if f"wheel_pressure_{name.lower()}" in driving.pressures
        else lagged(pressure, lag_s)
        for name, pressure in measured.items()
    }
    gains: dict[str, float] = {
        corner.name: PressureTorque.of_corner(corner).torque_per_pressure_nm_pa
        / config.vehicle.wheel_radius_m
        for corner in config.corner
        if corner.name in pressures
    }
    top = driving.highest_pressure_pa()
    rest, quiet_pa = released_reading(top, driving.speed_ms, driving.rate_ms2)
    pressed = top - rest > config.heat.brake_on_pressure_pa
    spans = applications(driving.time_s, driving.speed_ms, pressed)
    force = force_n(driving)
    released = _released(driving, top - rest < quiet_pa)
    zeros = [_zero(force, released, span) for span in spans]
    known = [zero for zero in zeros if zero is not None]
    # the grade differs from place to place: a zero of elsewhere holds only
    # where the accelerometer has the grade
    common = 0.0 if every_stop else None
    if known and driving.has_accelerometer:
        common = float(np.median(known))
    usable = _usable(driving, measured, every_stop=every_stop)
    front_pa, front_gain = _axle("F", pressures, gains)
    rear_pa, rear_gain = _axle("R", pressures, gains)
    time_s, speed_ms = driving.time_s, driving.speed_ms
    stops, without_zero = [], 0
    for span, zero in zip(spans, zeros, strict=True):
        offset = common if zero is None else zero
        if offset is None:
            without_zero += 1
            continue
        rows = _spaced(span.first + np.flatnonzero(usable[span.points]))
        if not len(rows):
            continue
        stops.append(
            BrakeStop(
                log=driving.name,
                start_s=float(time_s[span.first]),
                duration_s=float(time_s[span.last] - time_s[span.first]),
                from_ms=float(speed_ms[span.first]),
                to_ms=float(speed_ms[span.last]),
                zero_n=offset,
                own_zero=zero is not None,
                since_s=time_s[rows] - time_s[span.first],
                speed_ms=speed_ms[rows],
                force_n=force[rows] - offset,
                front_pa=front_pa[rows],
                rear_pa=rear_pa[rows],
                front_gain=front_gain,
                rear_gain=rear_gain,
                initial_c=_initial_c(driving, span.first),
            )
        )
    count = sum(len(stop.since_s) for stop in stops)
    words = (
        f"{len(spans)} applications of the brake, {len(stops)} with "
        f"{count} samples at steady pressure above "
        f"{LEAST_PRESSURE_PA / 1e5:.0f} bar and {LOWEST_MS * 3.6:.0f} km/h"
    )
    if without_zero:
        words += (
            f", {without_zero} without {LEAST_QUIET_S:g} s around them of "
            f"released brake (below {(rest + quiet_pa) / 1e5:.2f} bar), above "
            f"{LOWEST_MS * 3.6:.0f} km/h and driven with at most "
            f"{DRIVEN_MS2:g} m/s2"
        )
    return stops, rest, words


def force_n(driving: Driving) -> Column:
    """Return Eq 4.11 on the grid [N], nan where an input is missing."""
    accel_ms2 = driving.accel_measured_ms2
    return brake_force_n(
        driving.vehicle,
        driving.speed_ms,
        driving.rate_ms2,
        accel_ms2 if driving.has_accelerometer else None,
        driving.traction_n,
    )


def lagged(value: Column, lag_s: float) -> Column:
    """Return *value*, (n,), behind a first-order lag; NaN restarts it."""
    if lag_s <= 0.0:
        return value
    gain = 1.0 - float(np.exp(-GRID_S / lag_s))
    result = np.empty(len(value))
    last = np.nan
    for i, now in enumerate(value.tolist()):
        last = now if last != last else last + gain * (now - last)  # noqa: PLR0124
        result[i] = last
    return result


def _released(driving: Driving, off: Mask) -> Mask:
    """Return where the brake is *off* and the force should be zero."""
    car = driving.vehicle
    limit_n = DRIVEN_MS2 * car.mass_kg
    released = off & (driving.speed_ms > LOWEST_MS)
    released &= np.abs(driving.torque_nm) / car.wheel_radius_m < limit_n
    released &= np.isfinite(driving.rate_ms2)
    return released


def _zero(force: Column, released: Mask, span: Span) -> float | None:
    """Return the force of the released brake around *span*, None if unseen."""
    around, quiet = round(AROUND_S / GRID_S), round(QUIET_S / GRID_S)
    rows = np.concatenate(
        (
            np.arange(max(span.first - around, 0), max(span.first - quiet, 0)),
            np.arange(span.last + quiet, span.last + around),
        )
    )
    rows = rows[rows < len(force)]
    rows = rows[released[rows] & np.isfinite(force[rows])]
    if len(rows) * GRID_S < LEAST_QUIET_S:
        return None
    return float(np.median(force[rows]))


def _usable(
    driving: Driving, pressures: dict[str, Column], *, every_stop: bool
) -> Mask:
    """Return where force and pressure correspond."""
    usable = driving.speed_ms > LOWEST_MS
    for pressure in pressures.values():
        lowest = _lowest_around(pressure)
        usable &= lowest > LEAST_PRESSURE_PA
        rate = np.abs(np.gradient(window_mean(pressure), GRID_S))
        usable &= rate < (JUMPING_PA_S if every_stop else STEADY_PA_S)
    control = set(CONTROL)
    if every_stop:
        control.remove("abs_active")
    usable &= ~flagged(driving.channels, control)
    if driving.channels.alive(["yaw_rate"]):
        bend = np.abs(driving.value("yaw_rate") * driving.speed_ms)
        usable &= ~(bend > CORNERING_MS2)
    usable &= np.isfinite(force_n(driving))
    return np.asarray(usable)


def _lowest_around(value: Column) -> Column:
    """Return the lowest value in the half second around each point."""
    lowest = np.full(len(value), np.nan)
    if len(value) > 2 * HALF:
        windows = np.lib.stride_tricks.sliding_window_view(value, 2 * HALF + 1)
        lowest[HALF:-HALF] = windows.min(axis=1)
    return lowest


def _axle(
    axle: str, pressures: dict[str, Column], gains: dict[str, float]
) -> tuple[Column, float]:
    """Return the axle's mean pressure by gain, and the sum of its gains."""
    total = np.zeros(len(next(iter(pressures.values()), ())))
    of_axle = {n: gain for n, gain in gains.items() if n[0] == axle}
    for name, gain in of_axle.items():
        total = total + gain * window_mean(pressures[name])
    gain = sum(of_axle.values())
    return (total / gain if gain else total), gain


def _spaced(rows: Indices) -> Indices:
    """Return those of *rows* that are at least a window apart."""
    kept: list[int] = []
    for row in rows.tolist():
        if not kept or row - kept[-1] >= EVERY:
            kept.append(row)
    return np.array(kept, np.intp)


def _initial_c(driving: Driving, first: int) -> dict[str, float]:
    """Return the temperatures [degC] of the measured discs at *first*."""
    corners = {f"temp_{name.lower()}_disc": name for name in CORNERS}
    found = {
        corners[role]: float(driving.value(role)[first]) - KELVIN_OFFSET
        for role in driving.channels.alive(corners)
    }
    return {name: disc for name, disc in found.items() if np.isfinite(disc)}


def _corner_pressures(driving: Driving, config: Config) -> dict[str, Column]:
    """Return the pressure of each corner [Pa], (n,) each.

    Its wheel's own, else that of its circuit, behind the rear table: the
    rules of the estimator. A corner without any is left out.
    """
    known = driving.pressures
    found: dict[str, Column] = {}
    for corner in config.corner:
        own, *shared = pressure_roles(corner.name, corner.circuit)
        role = next((one for one in shared if one in known), None)
        if own in known:
            found[corner.name] = known[own]
        elif role is not None:
            found[corner.name] = behind_table(
                known[role], corner.name, config.heat
            )
    return found
