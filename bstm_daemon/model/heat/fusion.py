"""Brake power of each corner, fused from pressure and motion.

The pure-Python form of ``native/heat/fusion.c``; both do the same operations
in the same order. Feed-Forward gives the distribution over time and corners,
the friction that the observer has learned from the motion gives the magnitude.
If the motion shows braking without pressure, the power is from motion alone;
if the motion is not usable, it is from pressure and the learned friction.
Torque of engine and motor is subtracted first: it never heats a brake.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isnan, nan, sqrt
from typing import TYPE_CHECKING, Final

from bstm_daemon.channels import FLAGS
from bstm_daemon.model.heat.check_rules import PEDAL_REST, SLIP_FORWARD
from bstm_daemon.model.heat.inputs import SLOPE_ACCELEROMETER
from bstm_daemon.model.heat.learned import (
    BIAS,
    DRAG,
    MASS,
    STATES,
    published_variance,
)
from bstm_daemon.model.heat.motion_checks import wrong_scale
from bstm_daemon.model.heat.observer_faults import Step
from bstm_daemon.model.heat.observer_rules import (
    ASSUMED_TORQUE_STD,
    DRAG_TORQUE_NOISE,
    LEAST_BRAKE_N,
    P0_STD,
    REFERENCE_PRESSURE_PA,
    REFERENCE_SPEED_MS,
    TORQUE_NOISE,
)
from bstm_daemon.roles import GROUND_SPEED_ROLES, ROLE_INDEX
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.model.heat.inputs import Inputs
    from bstm_daemon.model.heat.readings import Readings

BRAKING_S: Final = 0.3
"""Time constant of the measured braking in the test for one unpressed."""

SILENT_BEFORE_S: Final = 0.5
SILENT_SPEED_MS: Final = 1.5
SILENT_STDS: Final = 3.0
ASSUMED_STDS: Final = 2.0
STEEPEST_MS2: Final = 2.0
"""Braking without pressure counts after ``SILENT_BEFORE_S`` above
``SILENT_SPEED_MS`` and beyond ``SILENT_STDS`` standard deviations
(``ASSUMED_STDS`` if the torque is only assumed and the bias never learned);
its energy from its start on is included. Beyond ``STEEPEST_MS2``, a slope of
20 %, between acceleration and rate of speed it does not count."""

MOST_FRICTION: Final = 1.75
"""Braking by motion over that by pressure and learned friction, beyond which
the pressure is not that of the brakes: linings have 0.7 to 1.3 of their
nominal friction, and 0.6 when they fade."""

SLIPPING: Final = 0.06
"""All wheels turn alike within this ratio."""

MODEL_SHARE: Final = 0.015
ABS_SHARE: Final = 0.12
ASSIST_SHARE: Final = 0.15
SINGLE_SHARE: Final = 0.6
"""Relative standard deviations: of the model with everything learned; while
ABS modulates; if the shares of the corners are assumed; if single wheels are
braked at unknown pressure, or the torque is assumed."""

ABS_LOW: Final = 0.2
ABS_HIGH: Final = 1.5
GRADE_NOISE: Final = 0.02

TARE_PA: Final = 3e4
TARE_S: Final = 5.0
TARE_DRIVE_MS2: Final = 0.3
"""A pressure read with the brake released is its sensor's offset, up to 0.3
bar; without a brake switch, drive of 0.3 m/s2 shows that it is released."""

FLAG_SHIFT: Final = 40
"""Position of the observer's bits in the flags of a step."""

_ACCELERATION: Final = ROLE_INDEX["acceleration_longitudinal"]
_TORQUE: Final = ROLE_INDEX["powertrain_torque"]
_TRAVEL: Final = ROLE_INDEX["brake_pedal_travel"]
_MOTOR: Final = ROLE_INDEX["motor_torque"]
_TARED: Final = (
    (ROLE_INDEX["primary_pressure"], "tare_primary"),
    (ROLE_INDEX["secondary_pressure"], "tare_secondary"),
)

SUSPECTS: Final = (
    FLAGS["speed_suspect"]
    | FLAGS["acceleration_suspect"]
    | FLAGS["torque_suspect"]
    | FLAGS["samples_refused"]
    | FLAGS["wheels_contradict"]
    | FLAGS["acceleration_contradicts"]
)

BLIND: Final = FLAGS["external_force_suspected"] | FLAGS["acceleration_scale"]
UNSURE: Final = (
    FLAGS["speed_suspect"]
    | FLAGS["acceleration_suspect"]
    | FLAGS["torque_suspect"]
)
"""With any of these the motion does not measure the braking: an external
force, a wrong scale, a suspect input."""


@dataclass(frozen=True, slots=True)
class Fused:
    """Power of a step and its standard deviation per corner [W].

    ``learned`` are the vehicle's channels from the grade on.
    """

    flags: int
    power: list[float]
    power_std: list[float]
    learned: list[float]


def accumulate_motion(run: Inputs, h: float) -> None:
    """Add *h* seconds of the held values to the sums of the motion."""
    plan, m, v = run.plan, run.observer.m, run.speed
    m.sum_drag += (plan.quadratic * v + plan.linear) * v / plan.mass_kg * h
    if (
        not run.valid(_ACCELERATION)
        or (run.mapped(_MOTOR) and not run.valid(_MOTOR))
        or not (run.valid(_TORQUE) or run.plan.torque_assumed)
        or not run.speed_known
        or run.plan.slope != SLOPE_ACCELEROMETER
    ):
        return
    torque = run.vehicle("powertrain_torque", run.plan.assumed_torque_nm)
    torque += run.vehicle("motor_torque", 0.0)
    external = run.vehicle("external_force", 0.0)
    drive = run.heading * (torque / run.plan.radius_m + external)
    accel = run.m.value[_ACCELERATION]
    m.sum_time += h
    m.sum_accel += run.heading * accel * h
    m.sum_drive += drive / run.plan.mass_kg * h


def fuse(run: Inputs, now: Readings, flags: int) -> Fused:
    """Learn from the step that ends and give each corner's power."""
    observer = run.observer
    s = _describe(run, now, flags)
    _tare_pressures(run, s)
    found = observer.observe(s) << FLAG_SHIFT
    learned = _learned_channels(run, s)
    known, m = observer.m.known, observer.m
    ratio = known.x[MASS]
    level, variance = known.friction(s.speed, s.pressure_pa)
    scale = exp(level)
    variance += (
        published_variance(
            known.cov[0] / (ratio * ratio), P0_STD[0] * P0_STD[0]
        )
        + MODEL_SHARE * MODEL_SHARE
    )
    if found & FLAGS["forces_contradict"]:
        # what was learned may hide heat
        scale = max(scale, 1.0)
        found |= FLAGS["acceleration_suspect"] | FLAGS["torque_suspect"]
    std = extra = 0.0
    blind = found & BLIND or flags & UNSURE
    if not isnan(s.accel) and s.forward and not blind:
        ff_decel = s.brake_n / run.plan.mass_kg * ratio * scale
        braking, std = observer.braking(s.accel, s.drive, s.drag, m.rate)
        torque = _torque_std(s, ratio)
        std = sqrt(std * std + torque * torque)
        share = 1.0 - exp(-s.dt_s / BRAKING_S)
        m.slow_braking += share * (braking - m.slow_braking)
        m.slow_brake += share * (ff_decel - m.slow_brake)
        modulated = run.vehicle("abs_active", 0.0) > 0.0
        if modulated and not s.wheel_pressures and m.slow_brake > 0.0:
            real = m.slow_braking / m.slow_brake
            scale *= min(max(real, ABS_LOW), ABS_HIGH)
            variance += ABS_SHARE * ABS_SHARE
        if not s.wheel_pressures:
            slow = m.slow_braking - m.slow_brake
            extra = _unpressed(run, s, braking - ff_decel, slow, std)
    else:
        m.slow_braking = m.slow_brake = 0.0
        m.silent_s = m.silent_energy = 0.0
    single = run.vehicle("tc_active", 0.0) > 0.0 or now.esc_active > 0.0
    guessed = single or not s.torque_known
    vague = SINGLE_SHARE if guessed else ASSIST_SHARE
    part = _divide(run, now, pressed=s.brake_n > 0.0 and not _too_little(run))
    power, power_std = [], []
    for c in range(run.corners):
        pressed = scale * (run.m.energy_ff[c] / s.dt_s)
        turning = run.wheel[c] / run.speed if run.speed > 0.0 else 1.0
        other = extra * part[c] * turning
        own = vague * other
        if other > 0.0:
            unsure = run.plan.mass_kg / ratio * std * s.speed * part[c]
            own = sqrt(own * own + unsure * unsure)
            found |= FLAGS["braking_unpressed"]
        power.append(pressed + other)
        power_std.append(sqrt(pressed * pressed * variance + own * own))
    return Fused(found, power, power_std, learned)


def _torque_std(s: Step, ratio: float) -> float:
    """Standard deviation of the driving acceleration [m/s2].

    The retarding torque of the driveline is the least accurate.
    """
    if not s.torque_known:
        return ASSUMED_TORQUE_STD
    share = DRAG_TORQUE_NOISE if s.drive < 0.0 else TORQUE_NOISE
    return share * ratio * s.drive


def _describe(run: Inputs, now: Readings, flags: int) -> Step:
    m, dt_s = run.observer.m, now.dt_s
    whole = m.sum_time > dt_s - 1e-9
    yaw = abs(run.vehicle("yaw_rate", 0.0)) * run.speed
    side = abs(run.vehicle("acceleration_lateral", 0.0))
    brake_n = light_n = highest = 0.0
    for c in range(run.corners):
        pressure = run.m.pressure_sum[c] / dt_s
        pushing = max(pressure - run.plan.pushout_pa[c], 0.0)
        light_n += run.plan.torque_per_pa[c] * pushing / run.plan.radius_m
        brake_n += m.brake_sum[c] / dt_s
        highest = max(highest, pressure)
    braked = [time_s > 0.0 for time_s in run.m.on_time[: run.corners]]
    wheel_pressures = all(run.valid(role) for role in run.pressure_role)
    # a foot that only rests on the pedal brakes by a pressure that is too low
    # to count as heat; without a switch it may do so whenever the pressure is
    # not up
    travel_m = run.reading(_TRAVEL)
    brakes = now.brake_switch > 0.0 or any(braked)
    rests = travel_m <= PEDAL_REST and brake_n < LEAST_BRAKE_N
    pressed = brakes and not rests
    light = rests if brakes else isnan(now.brake_switch)
    partial = pressed and not all(braked) and any(braked)
    return Step(
        dt_s=dt_s,
        speed=run.m.speed_sum / dt_s,
        end_speed=run.speed,
        accel=m.sum_accel / dt_s if whole else nan,
        drive=m.sum_drive / dt_s if whole else nan,
        drag=m.sum_drag / dt_s,
        brake_n=brake_n,
        light_n=light_n if light else 0.0,
        pressure_pa=highest,
        brake_switch=now.brake_switch,
        lateral=max(yaw, side),
        gear=run.vehicle("gear", 0.0),
        clutch=run.vehicle("clutch_open", 0.0),
        height=run.vehicle("altitude", nan),
        ground_speeds=[run.reading(role) for role in GROUND_SPEED_ROLES],
        steady=not now.intervenes
        and _rolls(run)
        and flags & SUSPECTS == 0
        and (wheel_pressures or not partial),
        forward=run.heading > 0.0,
        pressed=pressed,
        pressure_known=all(run.corner_known(c) for c in range(run.corners)),
        wheel_pressures=wheel_pressures,
        torque_known=run.valid(_TORQUE),
        on_stand=not pressed and run.apart,
        wrong_scale=wrong_scale(run.checks.m),
    )


def _tare_pressures(run: Inputs, s: Step) -> None:
    """Filter the offsets of the pressure sensors, brake released."""
    switch, drives = s.brake_switch, s.drive > TARE_DRIVE_MS2
    if not (drives if isnan(switch) else switch <= 0.0):
        return
    m = run.observer.m
    share = 1.0 - exp(-s.dt_s / TARE_S)
    for role, name in _TARED:
        measured_pa = run.m.value[role]
        if run.valid(role) and abs(measured_pa) <= TARE_PA:
            tare = getattr(m, name)
            setattr(m, name, tare + share * (measured_pa - tare))


def _rolls(run: Inputs) -> bool:
    """Whether all wheels turn alike."""
    most = SLIPPING * run.speed
    return all(-most <= wheel - run.speed <= most for wheel in run.wheel)


def _without_pressure(run: Inputs, c: int, *, pressed: bool) -> bool:
    """Whether the corner has no pressure, though others may have."""
    if not run.corner_known(c):
        return True
    if run.valid(run.pressure_role[c]):
        return False
    return not pressed or run.observer.m.brake_sum[c] <= 0.0


def _too_little(run: Inputs) -> bool:
    """Whether no corner lacks pressure, but all of them have too little."""
    m = run.observer.m
    return m.slow_braking > MOST_FRICTION * m.slow_brake and all(
        m.brake_sum[c] > 0.0 for c in range(run.corners)
    )


def _divide(run: Inputs, now: Readings, *, pressed: bool) -> Sequence[float]:
    """How a force without pressure falls on the corners."""
    spins = run.vehicle("tc_active", 0.0) > 0.0
    single = spins or now.esc_active > 0.0
    total = slipping = 0.0
    slip = []
    for c in range(run.corners):
        v = run.speed
        slip_share = (v - run.wheel[c]) / v if v > 0.0 else 0.0
        own = -slip_share - SLIP_FORWARD if spins else slip_share
        if own < 0.0 or not single:
            own = 0.0
        slip.append(own if _without_pressure(run, c, pressed=pressed) else 0.0)
        slipping += slip[c]
    part = []
    for c in range(run.corners):
        without = _without_pressure(run, c, pressed=pressed)
        share = run.plan.force_share[c] if without else 0.0
        part.append(slip[c] if slipping > 0.01 else share)
        total += part[c]
    return [own / total if total > 0.0 else 0.0 for own in part]


def _unpressed(
    run: Inputs, s: Step, excess: float, slow: float, std: float
) -> float:
    """Power [W] of the braking without pressure.

    *excess* is that of the step [m/s2], *slow* the filtered one.
    """
    m = run.observer.m
    mass_kg = run.plan.mass_kg / run.observer.m.known.x[MASS]
    stds = SILENT_STDS if s.torque_known else ASSUMED_STDS
    least = max(run.plan.on_force_n / mass_kg, stds * std)
    held = 0.5 * least if m.silent_s >= SILENT_BEFORE_S else least
    if (
        s.speed < SILENT_SPEED_MS
        or not slow > held
        or abs(m.accel_measured - m.rate) > STEEPEST_MS2
    ):
        m.silent_s = m.silent_energy = 0.0
        return 0.0
    m.silent_s += s.dt_s
    m.silent_energy += mass_kg * excess * s.speed * s.dt_s
    if m.silent_s < SILENT_BEFORE_S:
        return 0.0
    power = m.silent_energy / s.dt_s
    m.silent_energy = 0.0
    return max(power, 0.0)


def _learned_channels(run: Inputs, s: Step) -> list[float]:
    """What is learned, as the vehicle's channels from the grade on."""
    observer = run.observer
    known = observer.m.known
    ratio, sine = known.x[MASS], observer.m.sine
    mass_kg = run.plan.mass_kg / ratio
    level, variance = known.friction(REFERENCE_SPEED_MS, REFERENCE_PRESSURE_PA)
    bias_var = known.cov[BIAS * STATES + BIAS] + known.rolling_var
    known_accel = nan if isnan(s.accel) else 0.0
    return [
        sine / sqrt(1.0 - sine * sine) + known_accel,
        sqrt(bias_var + GRADE_NOISE * GRADE_NOISE) / GRAVITY_MS2 + known_accel,
        mass_kg,
        mass_kg * (sqrt(known.cov[0]) / ratio),
        known.x[BIAS] + observer.rolling + known.rolling_error,
        sqrt(bias_var),
        exp(level),
        exp(level) * sqrt(variance + known.cov[0] / (ratio * ratio)),
        known.x[DRAG] / ratio,
        sqrt(known.cov[DRAG * STATES + DRAG]) / ratio,
    ]
