"""Brake power of each corner out of pressure and motion.

The pure-Python form of ``_fusion.c``; both do the same operations in the same
order. Feed-Forward gives the shape in time and over the corners, the friction
that the observer has learned from the motion its magnitude. Where no pressure
tells of the braking that is felt, the motion alone gives it; where the motion
tells nothing, the pressure with what was learned. Torque of engine and motor
is taken off before: it never heats a brake.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isnan, nan, sqrt
from typing import TYPE_CHECKING, Final

from bstm_daemon.heat.learned import BIAS, DRAG, MASS, published_variance
from bstm_daemon.heat.observer_layout import STATES, Step
from bstm_daemon.heat.observer_rules import (
    ASSUMED_DOUBT,
    DRAG_TORQUE_NOISE,
    REFERENCE_PRESSURE_PA,
    REFERENCE_SPEED_MS,
    SD,
    TORQUE_NOISE,
)
from bstm_daemon.heat.plausibility import STANDING_MS
from bstm_daemon.heat.sample_plan import FLAGS
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.heat.check_layout import Readings
    from bstm_daemon.heat.sample_state import SampleMemory

BRAKING_S: Final = 0.3
"""Filter of the felt braking before it counts as one without pressure."""

SILENT_BEFORE_S: Final = 0.5
SILENT_SPEED_MS: Final = 1.5
SILENT_SPREADS: Final = 3.0
ASSUMED_SPREADS: Final = 2.0
STEEPEST_MS2: Final = 2.0
"""Braking without pressure must be felt for so long, at such a speed, and
beyond so many standard deviations (fewer where the torque is only assumed and
the bias never learned); its energy since it began is not lost. What
is felt beyond the change of speed is a slope of 20 % at most."""

SLIP_FORWARD: Final = 0.08
SLIPPING: Final = 0.06
STAND_TURNS_MS: Final = 3.0
"""A wheel spins beyond the first share; all turn alike within the second; on
a stand some turn faster while others stand."""

MODEL_SHARE: Final = 0.015
ABS_SHARE: Final = 0.12
ASSIST_SHARE: Final = 0.15
SINGLE_SHARE: Final = 0.6
"""Standard deviations as shares: of the model with everything learned; where
anti-lock modulates; where the share of the corners is assumed; where single
wheels are braked and no pressure tells how, or the torque is assumed."""

ABS_LOW: Final = 0.2
ABS_HIGH: Final = 1.5
GRADE_NOISE: Final = 0.02

TARE_PA: Final = 3e4
TARE_S: Final = 5.0
TARE_PUSH: Final = 0.3
"""A pressure read while nobody brakes is its sensor's offset, up to 0.3 bar;
where no switch tells, nobody brakes who drives on with 0.3 m/s2."""

FLAG_SHIFT: Final = 40
"""The observer's bits in those of a step."""

_SUSPECTS: Final = (
    FLAGS["speed_suspect"]
    | FLAGS["acceleration_suspect"]
    | FLAGS["torque_suspect"]
    | FLAGS["samples_refused"]
    | FLAGS["wheels_contradict"]
    | FLAGS["acceleration_contradicts"]
)

_BLIND: Final = FLAGS["external_force_suspected"] | FLAGS["acceleration_scale"]
_UNSURE: Final = (
    FLAGS["speed_suspect"]
    | FLAGS["acceleration_suspect"]
    | FLAGS["torque_suspect"]
)
"""The motion tells nothing of the brakes: a push, a scale, an input."""


@dataclass(frozen=True, slots=True)
class Fused:
    """A step's power and standard deviation per corner [W].

    ``learned`` are the vehicle's channels from the grade on.
    """

    flags: int
    power: list[float]
    spread: list[float]
    learned: list[float]


def feel(run: SampleMemory, h: float, v: float) -> None:
    """Add what the values held for *h* seconds say of the motion."""
    m = run.observer.m
    roles = run.vehicle_role
    m["sum_drag"] += (run.quadratic * v + run.linear) * v / run.mass * h
    motor = roles["motor_torque"]
    if (
        not run.valid(roles["acceleration_longitudinal"])
        or (motor >= 0 and not run.valid(motor))
        or not (run.valid(roles["powertrain_torque"]) or run.assumed)
        or not run.speed_known
        or run.slope != 0
    ):
        return
    torque = run.vehicle("powertrain_torque", run.assumed_torque)
    torque += run.vehicle("motor_torque", 0.0)
    external = run.vehicle("external_force", 0.0)
    push = run.heading * (torque / run.radius + external)
    felt = run.value[roles["acceleration_longitudinal"]]
    m["sum_time"] += h
    m["sum_felt"] += run.heading * felt * h
    m["sum_push"] += push / run.mass * h


def fuse(run: SampleMemory, now: Readings, flags: int) -> Fused:
    """Learn from the step that ends and give each corner's power."""
    observer = run.observer
    s = _describe(run, now, flags)
    _tare_pressures(run, s)
    found = observer.observe(s) << FLAG_SHIFT
    learned = _tell(run, s)
    known, m = observer.known, observer.m
    ratio = known.x[MASS]
    level, variance = known.friction(s.speed, s.pressure_pa)
    scale = exp(level)
    variance += (
        published_variance(known.cov[0] / (ratio * ratio), SD[0] * SD[0])
        + MODEL_SHARE * MODEL_SHARE
    )
    doubt = extra = 0.0
    blind = found & _BLIND or flags & _UNSURE
    if not isnan(s.felt) and s.forward and not blind:
        given = s.brake_n / run.mass * ratio * scale
        braking, doubt = known.braking(s.felt, s.push, s.drag, m["rate"])
        torque = _torque_doubt(s, ratio)
        doubt = sqrt(doubt * doubt + torque * torque)
        share = 1.0 - exp(-s.dt_s / BRAKING_S)
        m["slow_braking"] += share * (braking - m["slow_braking"])
        m["slow_brake"] += share * (given - m["slow_brake"])
        modulated = run.vehicle("abs_active", 0.0) > 0.0
        if modulated and not s.wheel_pressures and m["slow_brake"] > 0.0:
            real = m["slow_braking"] / m["slow_brake"]
            scale *= min(max(real, ABS_LOW), ABS_HIGH)
            variance += ABS_SHARE * ABS_SHARE
        if not s.wheel_pressures:
            slow = m["slow_braking"] - m["slow_brake"]
            extra = _unpressed(run, s, braking - given, slow, doubt)
    else:
        m["slow_braking"] = m["slow_brake"] = 0.0
        m["silent_s"] = m["silent_energy"] = 0.0
    single = run.vehicle("tc_active", 0.0) > 0.0 or now.esc_active > 0.0
    guessed = single or not s.torque_known
    vague = SINGLE_SHARE if guessed else ASSIST_SHARE
    part = _divide(run, now, pressed=s.brake_n > 0.0)
    power, spread = [], []
    for c in range(run.corners):
        pressed = scale * (run.energy_ff[c] / s.dt_s)
        turning = run.wheel[c] / run.speed if run.speed > 0.0 else 1.0
        other = extra * part[c] * turning
        own = vague * other
        if other > 0.0:
            unsure = run.mass / ratio * doubt * s.speed * part[c]
            own = sqrt(own * own + unsure * unsure)
            found |= FLAGS["braking_unpressed"]
        power.append(pressed + other)
        spread.append(sqrt(pressed * pressed * variance + own * own))
    return Fused(found, power, spread, learned)


def _torque_doubt(s: Step, ratio: float) -> float:
    """Standard deviation of what drives the car [m/s2].

    Of the driveline's torque the retarding one is known worst.
    """
    if not s.torque_known:
        return ASSUMED_DOUBT
    share = DRAG_TORQUE_NOISE if s.push < 0.0 else TORQUE_NOISE
    return share * ratio * s.push


def _describe(run: SampleMemory, now: Readings, flags: int) -> Step:
    m, dt_s = run.observer.m, now.dt_s
    whole = m["sum_time"] > dt_s - 1e-9
    yaw = abs(run.vehicle("yaw_rate", 0.0)) * run.speed
    side = abs(run.vehicle("acceleration_lateral", 0.0))
    brake_n = highest = 0.0
    pressure_known = wheel_pressures = True
    some = none = False
    for c, ints in enumerate(run.corner_ints):
        brake_n += run.observer.brake_sum[c] / dt_s
        highest = max(highest, run.pressure_sum[c] / dt_s)
        if run.on_time[c] > 0.0:
            some = True
        else:
            none = True
        pressure_known = pressure_known and run.corner_known(ints)
        wheel_pressures = wheel_pressures and run.valid(ints[1])
    pressed = now.brake_switch > 0.0 or some
    acts = (
        run.vehicle("abs_active", 0.0) > 0.0
        or now.esc_active > 0.0
        or run.vehicle("tc_active", 0.0) > 0.0
    )
    partial = some and none and not wheel_pressures
    return Step(
        dt_s=dt_s,
        speed=run.speed_sum / dt_s,
        end_speed=run.speed,
        felt=m["sum_felt"] / dt_s if whole else nan,
        push=m["sum_push"] / dt_s if whole else nan,
        drag=m["sum_drag"] / dt_s,
        brake_n=brake_n,
        pressure_pa=highest,
        brake_switch=now.brake_switch,
        lateral=max(yaw, side),
        gear=run.vehicle("gear", 0.0),
        clutch=run.vehicle("clutch_open", 0.0),
        height=run.vehicle("altitude", nan),
        gnss_speed=run.vehicle("gnss_speed", nan),
        steady=not acts
        and _rolls(run)
        and flags & _SUSPECTS == 0
        and not partial,
        forward=run.heading > 0.0,
        pressed=pressed,
        pressure_known=pressure_known,
        wheel_pressures=wheel_pressures,
        torque_known=run.valid(run.vehicle_role["powertrain_torque"]),
        on_stand=not pressed and _on_stand(run),
    )


def _tare_pressures(run: SampleMemory, s: Step) -> None:
    """Follow what the pressures read while nobody brakes."""
    if isnan(s.brake_switch):
        released = s.push > TARE_PUSH
    else:
        released = not s.brake_switch > 0.0
    if not released:
        return
    m = run.observer.m
    for circuit in ("primary", "secondary"):
        role = run.vehicle_role[f"{circuit}_pressure"]
        if not run.valid(role) or abs(run.value[role]) > TARE_PA:
            continue
        name = f"tare_{circuit}"
        share = 1.0 - exp(-s.dt_s / TARE_S)
        m[name] += share * (run.value[role] - m[name])


def _rolls(run: SampleMemory) -> bool:
    """Whether all wheels turn alike."""
    most = SLIPPING * run.speed
    return all(-most <= wheel - run.speed <= most for wheel in run.wheel)


def _on_stand(run: SampleMemory) -> bool:
    """Whether some wheels turn while others stand."""
    high, low = 0.0, STAND_TURNS_MS
    for ints in run.corner_ints:
        if run.valid(ints[0]):
            own = abs(run.value[ints[0]])
            high = max(high, own)
            low = min(low, own)
    return high > STAND_TURNS_MS and low < STANDING_MS


def _unheard(run: SampleMemory, c: int, *, pressed: bool) -> bool:
    """Whether no pressure speaks for the corner, though others may have."""
    ints = run.corner_ints[c]
    if not run.corner_known(ints):
        return True
    if run.valid(ints[1]):
        return False
    return not pressed or run.observer.brake_sum[c] <= 0.0


def _divide(
    run: SampleMemory, now: Readings, *, pressed: bool
) -> Sequence[float]:
    """How a force that no pressure tells of falls on the corners."""
    spins = run.vehicle("tc_active", 0.0) > 0.0
    single = spins or now.esc_active > 0.0
    total = slipping = 0.0
    slip = []
    for c in range(run.corners):
        apart = 0.0
        if run.speed > 0.0:
            apart = (run.speed - run.wheel[c]) / run.speed
        own = -apart - SLIP_FORWARD if spins else apart
        if own < 0.0 or not single:
            own = 0.0
        slip.append(own if _unheard(run, c, pressed=pressed) else 0.0)
        slipping += slip[c]
    part = []
    for c in range(run.corners):
        share = run.corner_floats[c][3]
        part.append(share if _unheard(run, c, pressed=pressed) else 0.0)
        if slipping > 0.01:
            part[c] = slip[c]
        total += part[c]
    return [own / total if total > 0.0 else 0.0 for own in part]


def _unpressed(
    run: SampleMemory, s: Step, excess: float, slow: float, doubt: float
) -> float:
    """Power [W] of the braking that no pressure tells of.

    *excess* is that of the step [m/s2], *slow* the filtered one.
    """
    m = run.observer.m
    mass_kg = run.mass / run.observer.known.x[MASS]
    spreads = SILENT_SPREADS if s.torque_known else ASSUMED_SPREADS
    least = max(run.on_force / mass_kg, spreads * doubt)
    held = 0.5 * least if m["silent_s"] >= SILENT_BEFORE_S else least
    if (
        s.speed < SILENT_SPEED_MS
        or not slow > held
        or abs(m["felt"] - m["rate"]) > STEEPEST_MS2
    ):
        m["silent_s"] = m["silent_energy"] = 0.0
        return 0.0
    m["silent_s"] += s.dt_s
    m["silent_energy"] += mass_kg * excess * s.speed * s.dt_s
    if m["silent_s"] < SILENT_BEFORE_S:
        return 0.0
    power = m["silent_energy"] / s.dt_s
    m["silent_energy"] = 0.0
    return max(power, 0.0)


def _tell(run: SampleMemory, s: Step) -> list[float]:
    """What is learned, as the vehicle's channels from the grade on."""
    observer = run.observer
    known = observer.known
    ratio, sine = known.x[MASS], observer.m["sine"]
    mass_kg = run.mass / ratio
    level, variance = known.friction(REFERENCE_SPEED_MS, REFERENCE_PRESSURE_PA)
    bias_var = known.cov[BIAS * STATES + BIAS] + known.rolling_var
    felt = nan if isnan(s.felt) else 0.0
    return [
        sine / sqrt(1.0 - sine * sine) + felt,
        sqrt(bias_var + GRADE_NOISE * GRADE_NOISE) / GRAVITY_MS2 + felt,
        mass_kg,
        mass_kg * (sqrt(known.cov[0]) / ratio),
        known.x[BIAS] + observer.rolling + known.rolling_error,
        sqrt(bias_var),
        exp(level),
        exp(level) * sqrt(variance + known.cov[0] / (ratio * ratio)),
        known.x[DRAG] / ratio,
        sqrt(known.cov[DRAG * STATES + DRAG]) / ratio,
    ]
