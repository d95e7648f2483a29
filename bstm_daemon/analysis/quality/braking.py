"""Checks of pressure against deceleration, brake switch and brake force."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.channels import PRESSURES, Channels
from bstm_daemon.analysis.quality.comparison import Fit, fit_channels
from bstm_daemon.analysis.quality.grid import window_mean
from bstm_daemon.analysis.quality.pressures import released_reading
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.model.heat.feed_forward import PressureTorque

if TYPE_CHECKING:
    from bstm_daemon.analysis.quality.finding import Fault, Notes
    from bstm_daemon.analysis.statistics.series import Column, Mask

_ACCELEROMETER: Final = "acceleration_longitudinal"
_SWITCH: Final = "brake_switch"
_SWITCH_S: Final = 1.0
_FITS: Final = 0.8


def compare_braking(channels: Channels, notes: Notes) -> dict[str, bool]:
    """Compare each pressure with deceleration and Feed-Back brake force.

    Returns, for the pressures where it could be judged, whether the car's
    braking fits them.
    """
    roles = channels.alive(PRESSURES)
    if not roles:
        return {}
    if channels.on_stand or not channels.speed_roles:
        notes.skip("pressures against deceleration: no motion of the car")
        return {}
    says: dict[str, bool] = {}
    for role in roles:
        pressed = channels.value(role) > limits.PRESSED_PA
        pressed &= channels.speed > limits.MOVING_MS
        braked_s = np.count_nonzero(pressed) * limits.GRID_S
        if braked_s < limits.ENOUGH_S:
            notes.skip(
                f"{role} against deceleration: {braked_s:.1f} s of braking "
                "while moving in this log"
            )
            continue
        _deceleration(channels, notes, role, pressed)
        fits = _force(channels, notes, role, pressed)
        if fits is not None:
            says[role] = fits
    return says


def _deceleration(
    channels: Channels, notes: Notes, role: str, pressed: Mask
) -> None:
    pressure = window_mean(channels.value(role))
    slowing = -channels.speed_rate()
    fit = fit_channels(pressure, slowing, 3 * limits.PRESSURE_SPAN_PA, pressed)
    here = pressed & np.isfinite(pressure)
    span = np.ptp(pressure[here]) if here.any() else 0.0
    agrees: bool | None = None
    if fit is None or span < limits.PRESSURE_SPAN_PA:
        verdict = "not judged: pressed at one and the same pressure"
    elif abs(fit.correlation) < limits.UNRELATED:
        verdict = (
            f"not judged: r = {fit.correlation:.2f}, grade or drive line "
            "hide it"
        )
    else:
        agrees = fit.scale > 0.0
        verdict = f"agrees, {fit.scale * 1e5:.3f} m/s2 a bar"
        if not agrees:
            verdict = "wrong sign: harder pressing, less deceleration"
            notes.fault("sign", role, f"{verdict}, against dv/dt")
    if agrees is None:
        notes.skip(f"{role} against deceleration: {verdict[12:]}")
    notes.compare(
        f"deceleration against {role}",
        (role, "deceleration"),
        (channels.time_s, pressure, slowing),
        (verdict, agrees, fit),
        "m/s2",
        reference_unit="bar",
        reference_si=1e5,
    )


def feed_forward_n(channels: Channels, role: str) -> Column:
    """Return the brake force [N] if every corner had the pressure *role*."""
    config = channels.config
    pressure = window_mean(channels.value(role))
    heat = config.heat
    total = np.zeros(len(pressure))
    for corner in config.corner:
        torque = PressureTorque.of_corner(corner)
        here = pressure
        if corner.name[0] == "R" and heat.front_pressure_pa:
            here = np.interp(
                pressure, heat.front_pressure_pa, heat.rear_pressure_pa
            )
        pushing = np.maximum(here - torque.pushout_pressure_pa, 0.0)
        total += torque.torque_per_pressure_nm_pa * pushing
    return total / config.vehicle.wheel_radius_m


def resistance_n(car: Vehicle, speed_ms: Column) -> Column:
    """Return Eq 4.2 at *speed_ms* (n,), 0 at rest, NaN where unknown."""
    rolling = (car.quadratic * speed_ms + car.linear) * speed_ms + car.constant
    return np.where(speed_ms <= 0.0, 0.0, rolling)


def brake_force_n(
    car: Vehicle,
    speed_ms: Column,
    rate_ms2: Column,
    accel_measured_ms2: Column | None,
    traction_n: Column,
) -> Column:
    """Return Eq 4.11 with the external force of Eq 4.7, (n,) [N].

    Args:
        car: its masses and resistances.
        speed_ms: of the car, (n,).
        rate_ms2: its change, (n,).
        accel_measured_ms2: the accelerometer, which includes the slope, (n,);
            None for a flat road.
        traction_n: force of powertrain and outside that drives the car, (n,).
    """
    accel_ms2 = rate_ms2 if accel_measured_ms2 is None else accel_measured_ms2
    inertia = car.mass_kg * accel_ms2 + car.rotating_mass_kg * rate_ms2
    return np.asarray(traction_n - resistance_n(car, speed_ms) - inertia)


def feed_back_n(channels: Channels) -> Column:
    """Return the brake force [N] of Eq 4.11 from the car's motion."""
    config = channels.config
    vehicle = Vehicle.of_config(config.vehicle)
    speed = channels.speed
    torque = np.zeros(len(speed))
    if channels.alive(["powertrain_torque"]):
        torque = window_mean(channels.value("powertrain_torque"))
    elif config.heat.assume_powertrain_torque_nm is not None:
        torque += config.heat.assume_powertrain_torque_nm
    push = np.zeros(len(speed))
    if channels.alive(["external_force"]):
        push = window_mean(channels.value("external_force"))
    return brake_force_n(
        vehicle,
        speed,
        channels.speed_rate(),
        channels.acceleration() if _has_slope(channels) else None,
        torque / vehicle.wheel_radius_m + push,
    )


def _has_slope(channels: Channels) -> bool:
    return (
        bool(channels.alive([_ACCELEROMETER]))
        and channels.config.heat.slope == "accelerometer"
    )


def _force(
    channels: Channels, notes: Notes, role: str, pressed: Mask
) -> bool | None:
    """Compare the energies of Feed-Forward and Feed-Back; None: not known."""
    forward, back = feed_forward_n(channels, role), feed_back_n(channels)
    here = pressed & np.isfinite(forward) & np.isfinite(back)
    mass_kg = channels.config.vehicle.mass_kg
    mean_back = float(back[here].mean()) if here.any() else 0.0
    mean_forward = float(forward[here].mean()) if here.any() else 0.0
    fit = fit_channels(back, forward, mass_kg, here)
    verdict, agrees, fault = _judge_force(
        channels, role, mean_forward, mean_back, fit
    )
    subject = f"Feed-Forward by {role} against Feed-Back"
    if agrees is None:
        notes.skip(f"{subject}: {verdict.removeprefix('not judged: ')}")
    if fault is not None:
        notes.fault(fault, role, f"{verdict}, against Feed-Back")
    notes.compare(
        subject,
        ("Feed-Back", f"Feed-Forward by {role}"),
        (
            channels.time_s,
            np.where(channels.speed > limits.MOVING_MS, back, np.nan),
            np.where(channels.speed > limits.MOVING_MS, forward, np.nan),
        ),
        (verdict, agrees, fit),
        "kN",
        unit_si=1e3,
    )
    return agrees


def _judge_force(
    channels: Channels,
    role: str,
    mean_forward: float,
    mean_back: float,
    fit: Fit | None,
) -> tuple[str, bool | None, Fault | None]:
    mass_kg = channels.config.vehicle.mass_kg
    known = bool(channels.alive(["powertrain_torque"]))
    ratio = mean_forward / max(mean_back, 1e-3 * mass_kg)
    text = f"{ratio:.2f} times the force of Feed-Back"
    fits = 1 / limits.FORCE_RATIO <= ratio <= limits.FORCE_RATIO
    why = ""
    if max(abs(mean_back), mean_forward) < limits.FORCE_MS2 * mass_kg:
        why = "only light braking"
    elif mean_back < -limits.FORCE_MS2 * mass_kg and not known:
        why = "powertrain torque unknown"
    elif not fits and not known and not _has_slope(channels):
        why = f"{text}, torque and grade unknown"
    if why:
        return f"not judged: {why}", None, None
    if mean_back < -limits.FORCE_MS2 * mass_kg:
        text = "the car drives on while this pressure indicates braking"
        return text, False, "unrelated"
    if fits:
        return f"agrees, {text}", True, None
    unit = channels.unit_for_scale(role, ratio, limits.FORCE_UNIT_TOLERANCE)
    follows = fit is not None and fit.correlation > _FITS
    if unit is not None and (follows or known):
        configured, _ = channels.unit(role)
        text += f", configured as {configured}, the values are {unit}"
        return f"wrong unit: {text}", False, "unit"
    return f"wrong scale, of pressure or brake data: {text}", False, "scale"


def compare_switch(channels: Channels, notes: Notes) -> None:
    """Compare the brake switch with the pressure or a substitute for it."""
    if not channels.alive([_SWITCH]):
        return
    roles = channels.alive(PRESSURES)
    if not roles:
        notes.skip(f"{_SWITCH}: no pressure to compare it with")
        return
    pressure, switch = channels.value(roles[0]), channels.value(_SWITCH)
    known = np.isfinite(switch)
    pressed = (pressure > limits.PRESSED_PA) & known
    rest, above = released_reading(
        pressure, channels.speed, channels.speed_rate()
    )
    released = (pressure - rest < above) & known
    counts = [
        np.count_nonzero(mask) * limits.GRID_S for mask in (pressed, released)
    ]
    if min(counts) < _SWITCH_S:
        notes.skip(f"{_SWITCH}: the pedal is not both pressed and released")
        return
    on_pressed = float(np.mean(switch[pressed] > 0.5))
    on_released = float(np.mean(switch[released] > 0.5))
    fault: Fault | None = None
    verdict = "agrees"
    if on_pressed < 0.2 and on_released > 0.8:
        fault, verdict = "sign", "inverted: on when released"
    elif on_pressed < 0.2:
        fault, verdict = "dead", "dead: stays off under pressure"
    elif on_released > 0.8:
        fault, verdict = "dead", "dead: stays on without pressure"
    elif on_pressed < 0.8 or on_released > 0.2:
        verdict = (
            f"agrees in part: on {100 * on_pressed:.0f} % of the time "
            f"pressed, {100 * on_released:.0f} % released"
        )
    if fault is not None:
        notes.fault(fault, _SWITCH, f"{verdict} ({roles[0]})", wrong=False)
    notes.compare(
        f"{_SWITCH} against {roles[0]}",
        (roles[0], _SWITCH),
        (channels.time_s, pressure, switch),
        (verdict, fault is None, None),
        "on",
        reference_unit="bar",
        reference_si=1e5,
    )
