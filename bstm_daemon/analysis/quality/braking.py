"""Checks of pressures by each other, the car's motion, switch and torque."""

from collections.abc import Callable
from functools import cache
from typing import Final

import numpy as np

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.channels import Channels, window_mean
from bstm_daemon.analysis.quality.comparison import Fit, fit_channels
from bstm_daemon.analysis.quality.finding import Checks, Fault
from bstm_daemon.analysis.quality.naming import (
    Naming,
    Tolerance,
    components,
    name_faults,
    write_faults,
)
from bstm_daemon.analysis.statistics.series import Column, Mask
from bstm_daemon.config.heat import HeatConfig
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.model.heat.feed_forward import PressureTorque
from bstm_daemon.roles import LONGITUDINAL, PRESSURES

_REAR: Final = ("secondary_pressure", "wheel_pressure_rl", "wheel_pressure_rr")


def compare_pressures(channels: Checks, motion_says: dict[str, bool]) -> None:
    """Compare every pressure, name the wrong ones and leave them out.

    *motion_says* is, for each pressure, whether the car's braking fits it,
    where that could be judged: it decides between two that disagree.
    """
    roles = channels.alive(PRESSURES)
    if len(roles) < 2:
        if roles:
            channels.skip(f"{roles[0]}: the only pressure, see deceleration")
        return
    naming = cache(lambda one, other: _naming(channels, one, other))
    groups = components(roles, lambda a, b: naming(a, b).agrees)
    for other in roles[1:]:
        found = naming(roles[0], other)
        channels.compare(
            f"{other} against {roles[0]}",
            (roles[0], other),
            (channels.value(roles[0]), channels.value(other)),
            found.named,
            "bar",
        )
        if found.agrees is None:
            channels.skip(
                f"{other} against {roles[0]}: {found.why_not_judged}"
            )
    _attribute(channels, groups, naming, motion_says)


def _attribute(
    channels: Checks,
    groups: list[tuple[str, ...]],
    naming: Callable[[str, str], Naming],
    motion_says: dict[str, bool],
) -> None:
    first = groups[0]
    for group in groups[1:]:
        for role in group:
            against = [naming(other, role) for other in first]
            judged = [n for n in against if n.agrees is False]
            if not judged:
                continue
            believed = _believed(first, group, motion_says)
            if believed is first:
                write_faults(channels, role, judged[0], first[0])
            elif believed is group:
                for other in first:
                    turned = naming(role, other)
                    write_faults(channels, other, turned, role)
                    channels.dead.add(other)
            else:
                channels.fault(
                    "ambiguous",
                    (first[0], role),
                    f"{first[0]} and {role} disagree "
                    f"({judged[0].verdict}): one is wrong and this log "
                    "does not show which",
                )
    for role in first:
        late = [
            text
            for other in first
            if other != role
            for fault, text in naming(other, role).faults
            if fault == "lag" and text.endswith("late")
        ]
        if late:
            channels.fault("lag", role, late[0], wrong=False)


def _believed(
    one: tuple[str, ...], other: tuple[str, ...], motion_says: dict[str, bool]
) -> tuple[str, ...] | None:
    fits_one = [motion_says[r] for r in one if r in motion_says]
    fits_other = [motion_says[r] for r in other if r in motion_says]
    if any(fits_one) != any(fits_other):
        return one if any(fits_one) else other
    if len(one) != len(other):
        return one if len(one) > len(other) else other
    return None


def _naming(channels: Channels, one: str, other: str) -> Naming:
    """Judge the pressure *other* against *one*."""
    x, y = channels.value(one), channels.value(other)
    fit = fit_channels(x, y, limits.PRESSURE_FLOOR_PA)
    both = np.isfinite(x) & np.isfinite(y)
    span = max(np.ptp(x[both]), np.ptp(y[both])) if both.any() else 0.0
    why = ""
    if span < limits.PRESSURE_SPAN_PA:
        why = f"the pressures range over {span / 1e5:.1f} bar only"
    rear = one in _REAR or other in _REAR
    tolerance = Tolerance(
        limits.REAR_PRESSURE_SCALE if rear else limits.PRESSURE_SCALE,
        limits.PRESSURE_OFFSET_PA,
    )
    return name_faults(channels, other, fit, tolerance, why)


def released_reading(
    pressure: Column, speed_ms: Column, rate_ms2: Column
) -> tuple[float, float]:
    """Return what a *pressure* reads with the brake certainly released.

    The car gains speed, or rolls at the lowest pressures of the log.

    Args:
        pressure: of one circuit [Pa], (n,) on the grid, NaN where absent.
        speed_ms: of the car, (n,).
        rate_ms2: its change, (n,).

    Returns:
        The reading, and how far above it the brake is still released [Pa];
        the reading is 0 where there is none or one that can not be that of a
        released brake.
    """
    above_pa = limits.RELEASED_PA
    rolling = (speed_ms > limits.MOVING_MS) & np.isfinite(pressure)
    gaining = rolling & (rate_ms2 > limits.DRIVING_MS2)
    chosen = pressure[gaining if gaining.any() else rolling]
    if not len(chosen):
        return 0.0, above_pa
    rest = float(np.median(chosen) if gaining.any() else np.min(chosen))
    if abs(rest) > limits.RESIDUAL_PA:
        return 0.0, above_pa
    if gaining.any():
        spread = float(np.percentile(chosen, 95)) - rest
        above_pa = max(0.5 * above_pa, limits.RELEASED_SPREADS * spread)
    return rest, above_pa


def check_resting(channels: Checks) -> None:
    """Name pressures that are negative, or not zero with no braking."""
    for role in channels.alive(PRESSURES):
        value = channels.value(role)
        value = value[np.isfinite(value)]
        if not len(value):
            continue
        low, high = value.min(), value.max()
        if low < -limits.PRESSURE_SPAN_PA and high < -0.5 * low:
            channels.rule_out(
                "sign",
                role,
                f"wrong sign: falls to {low / 1e5:.0f} bar, a brake pressure "
                "is not negative",
            )
    _resting(channels)


def _resting(channels: Checks) -> None:
    """Name what a pressure reads while the car gains speed."""
    if not channels.speed_roles or channels.on_stand:
        return
    driving = channels.speed_rate() > limits.DRIVING_MS2
    driving &= channels.speed > limits.MOVING_MS
    limit = channels.config.heat.brake_on_pressure_pa
    for role in channels.alive(PRESSURES):
        value = channels.value(role)
        resting = value[driving & np.isfinite(value)]
        if len(resting) * limits.GRID_S < limits.ENOUGH_S:
            continue
        low, middle = np.percentile(resting, (10, 50))
        if abs(middle) > limit and abs(low) > limit:
            unit, factor = channels.unit(role)
            channels.fault(
                "offset",
                role,
                f"offset {middle / factor:+.3g} {unit}: read while the car "
                f"gains speed, more than brake_on_pressure_pa",
            )


_SWITCH: Final = "brake_switch"
_SWITCH_S: Final = 1.0
_FITS: Final = 0.8


def compare_braking(channels: Checks) -> dict[str, bool]:
    """Compare each pressure with deceleration and Feed-Back brake force.

    Returns, for the pressures where it could be judged, whether the car's
    braking fits them.
    """
    roles = channels.alive(PRESSURES)
    if not roles:
        return {}
    if channels.on_stand or not channels.speed_roles:
        channels.skip("pressures against deceleration: no motion of the car")
        return {}
    says: dict[str, bool] = {}
    for role in roles:
        pressed = channels.value(role) > limits.PRESSED_PA
        pressed &= channels.speed > limits.MOVING_MS
        braked_s = np.count_nonzero(pressed) * limits.GRID_S
        if braked_s < limits.ENOUGH_S:
            channels.skip(
                f"{role} against deceleration: {braked_s:.1f} s of braking "
                "while moving in this log"
            )
            continue
        _deceleration(channels, role, pressed)
        fits = _force(channels, role, pressed)
        if fits is not None:
            says[role] = fits
    return says


def _deceleration(channels: Checks, role: str, pressed: Mask) -> None:
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
            channels.fault("sign", role, f"{verdict}, against dv/dt")
    if agrees is None:
        channels.skip(f"{role} against deceleration: {verdict[12:]}")
    channels.compare(
        f"deceleration against {role}",
        (role, "deceleration"),
        (pressure, slowing),
        (verdict, agrees, fit),
        "m/s2",
        reference_unit="bar",
    )


def feed_forward_n(channels: Channels, role: str) -> Column:
    """Return the brake force [N] if every corner had the pressure *role*."""
    config = channels.config
    pressure = window_mean(channels.value(role))
    heat = config.heat
    total = np.zeros(len(pressure))
    for corner in config.corner:
        torque = PressureTorque.of_corner(corner)
        here = behind_table(pressure, corner.name, heat)
        pushing = np.maximum(here - torque.pushout_pressure_pa, 0.0)
        total += torque.torque_per_pressure_nm_pa * pushing
    return total / config.vehicle.wheel_radius_m


def behind_table(pressure: Column, corner: str, heat: HeatConfig) -> Column:
    """Return a circuit's *pressure* (n,) as *corner* gets it by the table."""
    x, y = heat.front_pressure_pa, heat.rear_pressure_pa
    return np.interp(pressure, x, y) if corner[0] == "R" and x else pressure


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
        bool(channels.alive([LONGITUDINAL]))
        and channels.config.heat.slope == "accelerometer"
    )


def _force(channels: Checks, role: str, pressed: Mask) -> bool | None:
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
        channels.skip(f"{subject}: {verdict.removeprefix('not judged: ')}")
    if fault is not None:
        channels.fault(fault, role, f"{verdict}, against Feed-Back")
    channels.compare(
        subject,
        ("Feed-Back", f"Feed-Forward by {role}"),
        (
            np.where(channels.speed > limits.MOVING_MS, back, np.nan),
            np.where(channels.speed > limits.MOVING_MS, forward, np.nan),
        ),
        (verdict, agrees, fit),
        "kN",
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


def compare_switch(channels: Checks) -> None:
    """Compare the brake switch with the pressure or a substitute for it."""
    if not channels.alive([_SWITCH]):
        return
    roles = channels.alive(PRESSURES)
    if not roles:
        channels.skip(f"{_SWITCH}: no pressure to compare it with")
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
        channels.skip(f"{_SWITCH}: the pedal is not both pressed and released")
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
        channels.fault(fault, _SWITCH, f"{verdict} ({roles[0]})", wrong=False)
    channels.compare(
        f"{_SWITCH} against {roles[0]}",
        (roles[0], _SWITCH),
        (pressure, switch),
        (verdict, fault is None, None),
        "on",
        reference_unit="bar",
    )
