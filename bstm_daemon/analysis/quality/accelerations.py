"""Checks of the accelerometers against the wheels (thesis figure 4.3)."""

from typing import Final

import numpy as np

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.bends import fit_in_bends
from bstm_daemon.analysis.quality.channels import HALF, Channels, unit_ratio
from bstm_daemon.analysis.quality.comparison import Fit, fit_channels
from bstm_daemon.analysis.quality.finding import Checks
from bstm_daemon.analysis.quality.naming import (
    Naming,
    Tolerance,
    name_faults,
    write_faults,
)
from bstm_daemon.analysis.statistics.series import Mask
from bstm_daemon.roles import LONGITUDINAL
from bstm_daemon.units import GRAVITY_MS2

_AROUND: Final = 4 * HALF
_DRIFT_WINDOW_S: Final = 30.0
_TOLERANCE: Final = Tolerance(
    limits.ACCELERATION_SCALE, limits.ACCELERATION_OFFSET_MS2, unit=0.2
)
"""Units of acceleration differ by a factor of 9.8: 20 % separates them."""

_SPEED_UNIT: Final = 0.1
_SPEED_UNIT_LEAST: Final = 2.0
"""Ratios of 3.6 and 2.24 (km/h, mph and m/s) are attributed to the speeds, 1.6
to the accelerometer, whose scale may be anything."""


def fit_acceleration(channels: Channels) -> Fit | None:
    """Fit the accelerometer on dv/dt of the car's speed."""
    return fit_channels(
        channels.speed_rate(),
        channels.acceleration(),
        limits.ACCELERATION_FLOOR_MS2,
        _active(channels),
    )


def _active(channels: Channels) -> Mask:
    """Return where speed changes, a second around it included.

    Hours of cruising would otherwise outweigh the few stops.
    """
    rate = channels.speed_rate()
    busy = np.abs(rate) > limits.ACCELERATION_SPREAD_MS2
    near = np.convolve(busy, np.ones(2 * _AROUND + 1), "same") > 0.5
    active: Mask = near & np.isfinite(rate)
    return active


def compare_accelerations(channels: Checks) -> None:
    """Compare both accelerometers with the speeds and report the faults."""
    if channels.alive([LONGITUDINAL]):
        if channels.on_stand:
            channels.skip(
                f"{LONGITUDINAL}: the car stood, wheels show nothing"
            )
        elif channels.speed_roles:
            _longitudinal(channels)
        else:
            channels.skip(f"{LONGITUDINAL}: no speed to compare it with")
    if channels.alive(["acceleration_lateral"]):
        _lateral(channels)


def _longitudinal(channels: Checks) -> None:
    rate, accel_measured = channels.speed_rate(), channels.acceleration()
    active = _active(channels)
    fit = fit_acceleration(channels)
    moving = rate[active]
    why = ""
    if (
        len(moving) * limits.GRID_S < limits.ENOUGH_S
        or np.nanstd(moving) < limits.ACCELERATION_SPREAD_MS2
    ):
        why = "the speed hardly changes"
    naming = name_faults(channels, LONGITUDINAL, fit, _TOLERANCE, why)
    pair = None
    if (
        fit is not None
        and _only(naming) == ("scale", 1)
        and fit.beyond(_SPEED_UNIT_LEAST)
    ):
        pair = unit_ratio("speed", 1.0 / fit.scale, _SPEED_UNIT)
    if fit is not None and pair is not None:
        # no accelerometer is wrong by a unit of speed
        channels.fault(
            "unit",
            channels.speed_roles,
            f"wrong unit: all speeds read {1.0 / fit.scale:.3g} times what "
            f"the accelerometer says, which is {pair[0]} to {pair[1]}",
        )
        what = "the speeds are in the wrong unit"
        naming = Naming((("unit", what),), fit=fit)
    else:
        write_faults(channels, LONGITUDINAL, naming, "dv/dt of the speed")
    channels.compare(
        "accelerometer against dv/dt",
        ("dv/dt", LONGITUDINAL),
        (rate, accel_measured),
        naming.named,
        "m/s2",
    )
    if naming.agrees is None:
        channels.skip(f"{LONGITUDINAL}: {naming.why_not_judged}")
    if naming.agrees is not False:
        _drift(channels, agrees=naming.agrees)
    if pair is not None:
        channels.dead.update(channels.speed_roles)
        channels.set_speed(())


def _only(naming: Naming) -> tuple[str, int]:
    """Return the first fault and how many there are, a lag left out."""
    faults = [fault for fault, _ in naming.faults if fault != "lag"]
    return (faults[0] if faults else ""), len(faults)


def _drift(channels: Checks, *, agrees: bool | None) -> None:
    """Compare speed with the accelerometer integrated over windows."""
    accel_measured = channels.value(LONGITUDINAL)
    speed = channels.speed
    steps = round(_DRIFT_WINDOW_S / limits.GRID_S)
    both = np.isfinite(accel_measured) & np.isfinite(speed)
    integrated = np.full(len(speed), np.nan)
    drifts = []
    for start in range(0, len(speed) - 1, steps):
        part = slice(start, start + steps)
        known = both[part]
        if known.mean() < 0.9 or not known[0]:
            continue
        a = np.where(known, accel_measured[part], 0.0)
        v = speed[part]
        gained = np.concatenate(([0.0], np.cumsum(0.5 * (a[1:] + a[:-1]))))
        integrated[part] = v[0] + gained * limits.GRID_S
        if np.nanmax(v) >= limits.MOVING_MS:
            end = int(np.flatnonzero(known)[-1])
            rate = (integrated[start + end] - v[end]) / (end * limits.GRID_S)
            integrated[part] -= rate * limits.GRID_S * np.arange(len(v))
            drifts.append(rate)
    if not drifts:
        return
    drift = float(np.median(drifts))
    verdict = (
        f"drifts {drift:+.2f} m/s a second: bias, or a grade of "
        f"{100 * drift / GRAVITY_MS2:+.1f} %"
    )
    channels.compare(
        f"accelerometer integrated over {_DRIFT_WINDOW_S:g} s, less its "
        "drift, against speed",
        ("speed", f"integrated {LONGITUDINAL}"),
        (speed, integrated),
        (verdict, agrees, fit_channels(speed, integrated, 1.0)),
        "km/h",
    )


def _lateral(channels: Checks) -> None:
    if not channels.alive(["yaw_rate"]) or not channels.speed_roles:
        channels.skip("acceleration_lateral: no yaw rate to compare it with")
        return
    yaw = channels.value("yaw_rate")
    centripetal = yaw * channels.speed
    turning = np.abs(yaw) > limits.YAW_SPREAD_RAD_S
    turning &= channels.speed > limits.BEND_MS
    why = ""
    if np.count_nonzero(turning) * limits.GRID_S < limits.ENOUGH_S:
        why = "hardly a bend in this log"
    role = "acceleration_lateral"
    fit = fit_in_bends(
        *(centripetal, channels.speed, channels.value(role)),
        limits.ACCELERATION_FLOOR_MS2,
    )
    tolerance = Tolerance(1.5, limits.ACCELERATION_OFFSET_MS2, unit=0.3)
    naming = name_faults(channels, role, fit, tolerance, why)
    for fault, text in naming.faults:
        channels.fault(
            fault, role, f"{text}, against v x yaw rate", wrong=False
        )
    if naming.agrees is None:
        channels.skip(f"{role} against yaw rate: {why}")
    channels.compare(
        "lateral accelerometer against v x yaw rate",
        ("v x yaw rate", role),
        (centripetal, channels.value(role)),
        naming.named,
        "m/s2",
    )
