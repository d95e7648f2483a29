"""Vehicle observer: mass, bias, drag, pitch and friction from the motion.

The pure-Python form of ``native/heat/observer.c``; both do the same operations
in the same order. An accelerometer measures ``dv/dt + g sin(theta)`` and its
bias b, so that the balance of forces needs no grade::

    accel = mu u - sigma D(v) + b' + k dv/dt - braking
    u = T / (R m0) + F_ext / m0 - J / (R^2 m0) dv/dt,  b' = b - g f_r

with mu = m0 / m, m0 and D of the configuration. A Kalman filter estimates mu,
b', sigma and k from unbraked half seconds. A Schmidt-Kalman filter estimates
ln of the friction over Feed-Forward's, ``level + a ln(v/10) + c ln(p/10 bar) +
drift``, from braked ones: they do not change the states of the motion, but
consider their errors, and later updates of those states correct the friction.
A fault of an input (a wrong scale of the accelerometer, a wheel radius that
contradicts the speed over ground, a pressure that is never there, an external
force) is reported, and nothing is learned from it.
"""

from __future__ import annotations

from math import exp, isnan, log, sqrt
from typing import TYPE_CHECKING, Final

from bstm_daemon.model.heat.check_rules import STANDING_MS
from bstm_daemon.model.heat.learned import (
    BIAS,
    DRAG,
    DRIFT,
    FIRST_FRICTION,
    GAIN,
    MASS,
    NO_FRICTION,
    STATES,
    clipped,
    friction_row,
    product,
    quadratic,
)
from bstm_daemon.model.heat.memory import UNKNOWN, ObserverMemory
from bstm_daemon.model.heat.observer_faults import (
    compare_forces,
    compare_radius,
    count_drive,
    findings,
    implausible_gain,
    implausible_radius,
    is_outlier,
    motion_unmeasured,
)
from bstm_daemon.model.heat.observer_rules import (
    ACCEL_NOISE,
    ASSUMED_TORQUE_STD,
    CALM_S,
    COPY_S,
    CORRELATED_GAIN_WINDOWS,
    CORRELATED_WINDOWS,
    DEAD_MS2,
    DRAG_TORQUE_NOISE,
    DRIFT_S,
    EXTERNAL_HOLD_S,
    EXTERNAL_MS2,
    EXTERNAL_S,
    EXTERNAL_SHARE,
    GAIN_NOISE,
    GAIN_RATE_MS2,
    GAIN_SQUARE_MOST,
    GRADE_S,
    HEIGHT_NOISE_M,
    HEIGHT_PATH_M,
    IDLE_DRIVE_MS2,
    IDLE_OUTLIER,
    LEAST_BRAKE_N,
    LEAST_SPEED_MS,
    LOAD_STD,
    MODEL_NOISE,
    MOST_LATERAL_MS2,
    OBSERVER_RESET,
    OUTLIER,
    P0_STD,
    PRESSED_S,
    PROOF_S,
    RATE_S,
    RELEASED_S,
    RESTART_S,
    ROUGHNESS_MS2,
    ROUGHNESS_S,
    SLOW_RATE_S,
    STOOD_S,
    TORQUE_NOISE,
    WIND_SHARE,
    WINDOW_S,
)
from bstm_daemon.native.layout import zeros
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from bstm_daemon.model.heat.observer_faults import Step
    from bstm_daemon.model.heat.sample_plan import PlanNumbers

WINDOW_NONE: Final = 0.0
WINDOW_DRIVEN: Final = 1.0
WINDOW_BRAKED: Final = 2.0


class Observer:
    """The observer of a car; its memory is ``m``."""

    def __init__(self, plan: PlanNumbers, memory: ObserverMemory) -> None:
        """Take the car of *plan* and *memory*."""
        self.mass_kg = plan.mass_kg
        self.rotating = plan.rotating_kg / plan.mass_kg
        self.rolling = plan.constant / plan.mass_kg
        self.m = memory

    def braking(
        self, accel: float, drive: float, drag: float, rate: float
    ) -> tuple[float, float]:
        """Deceleration by the brakes [m/s2] and its standard deviation.

        Times the mass it is the force; the error of the mass is not included.
        """
        h = [drive - self.rotating * rate, 1.0, -drag, rate, *NO_FRICTION]
        std = sqrt(quadratic(self.m.known.cov, h))
        return product(self.m.known.x, h) - accel, std

    def begin(self) -> None:
        """Start again from the configured values."""
        m = zeros(ObserverMemory)
        m.resets, m.brake_sum = self.m.resets, self.m.brake_sum
        m.known.begin(self.rolling)
        m.recent, m.earlier, m.first = (m.known.copy() for _ in range(3))
        m.started = 1.0
        m.radius_ratio = [1.0] * len(m.radius_ratio)
        m.last_speed = UNKNOWN
        self.m = m

    def observe(self, s: Step) -> int:
        """Update the filters with a finished step; return bits of findings."""
        m = self.m
        if m.started == 0.0:
            self.begin()
            m = self.m
        self._widen_mass(s)
        self._decay_drift(s.dt_s)
        if isnan(s.accel) or isnan(s.drive):
            m.last_speed = UNKNOWN
            m.calm_s = m.height_path = 0.0
            self._accumulate_window(s, WINDOW_NONE, 0.0)
        else:
            first_speed = m.last_speed
            if first_speed < 0.0:
                first_speed = s.end_speed
            self._filter_motion(s)
            self._keep_times(s)
            if s.on_stand:
                self._suspect_external(s.dt_s)
            compare_radius(m, s)
            if s.wrong_scale or implausible_radius(self.m):
                self._forget_drive()
            self._watch_pressure(s)
            calm = m.calm_s >= CALM_S
            self._learn_gain(s, learns=calm and m.external_held_s <= 0.0)
            if self._accumulate_window(s, self._window_kind(s), first_speed):
                self._learn_window(s)
            self._follow_grade(s)
            self._keep_copies(s.dt_s)
        if not self.m.known.plausible():
            m.resets += 1.0
            self.begin()
            return findings(self.m, s) | OBSERVER_RESET
        return findings(self.m, s)

    def _keep_copies(self, dt_s: float) -> None:
        m = self.m
        m.copy_age_s += dt_s
        if m.copy_age_s < COPY_S:
            return
        m.earlier, m.recent = m.recent, m.known.copy()
        m.copy_age_s = 0.0

    def _roll_back(self) -> None:
        """Forget what was learned within the last minutes."""
        m = self.m
        m.known, m.recent = m.earlier.copy(), m.earlier.copy()
        m.copy_age_s = 0.0

    def _forget_drive(self) -> None:
        """Forget this drive: its data have a wrong scale."""
        self.m.earlier = self.m.first.copy()
        self._roll_back()

    def _suspect_external(self, seconds: float) -> None:
        m = self.m
        m.external_s += seconds
        if m.external_s < EXTERNAL_S:
            return
        if m.external_held_s <= 0.0:
            self._roll_back()
        m.external_held_s = EXTERNAL_HOLD_S
        m.external_s = EXTERNAL_S
        m.proof_s = PROOF_S

    def _release_external(self, seconds: float) -> None:
        m = self.m
        m.external_s = max(m.external_s - 0.5 * seconds, 0.0)
        m.external_held_s = max(m.external_held_s - seconds, 0.0)

    def _learn_motion(
        self, accel: float, drive: float, drag: float, rate: float
    ) -> None:
        h = [drive - self.rotating * rate, 1.0, -drag, rate, *NO_FRICTION]
        relative = DRAG_TORQUE_NOISE if drive < 0.0 else TORQUE_NOISE
        torque = relative * self.m.known.x[MASS] * drive
        noise = CORRELATED_WINDOWS * (
            ACCEL_NOISE * ACCEL_NOISE + torque * torque
        )
        innovation = accel - product(self.m.known.x, h)
        std = sqrt(
            quadratic(self.m.known.cov, h)
            + ACCEL_NOISE * ACCEL_NOISE
            + torque * torque
        )
        most = IDLE_OUTLIER if drive < IDLE_DRIVE_MS2 else OUTLIER
        pushed = innovation > max(most * std, EXTERNAL_MS2)
        if pushed:
            self._suspect_external(WINDOW_S)
        count_drive(self.m, innovation, std, self.m.known.x[MASS] * drive)
        if pushed or abs(innovation) > OUTLIER * std:
            return
        self._release_external(WINDOW_S)
        if self.m.external_held_s > 0.0:
            return
        self.m.known.add_process_noise(0, FIRST_FRICTION, WINDOW_S)
        self.m.known.update(0, h, innovation, noise)

    def _learn_friction(
        self, accel: float, drive: float, drag: float, rate: float, s: Step
    ) -> None:
        m = self.m
        t = m.window_s
        braking, braking_std = self.braking(accel, drive, drag, rate)
        ff_decel = m.window_brake / t / self.mass_kg * self.m.known.x[MASS]
        h = friction_row(m.window_speed / t, m.window_pressure / t)
        level = product(self.m.known.x, h)
        assumed = 0.0 if s.torque_known else ASSUMED_TORQUE_STD
        std = sqrt(
            ACCEL_NOISE * ACCEL_NOISE
            + braking_std * braking_std
            + assumed * assumed
        )
        least = EXTERNAL_SHARE * (ff_decel * exp(level))
        if braking + 2.5 * std < least:
            self._suspect_external(WINDOW_S)
            return
        self._release_external(WINDOW_S)
        if braking - 2.5 * std > least:
            m.proof_s = max(m.proof_s - WINDOW_S, 0.0)
        # an assumed torque is no measurement
        if not s.torque_known:
            return
        compare_forces(m, ff_decel, braking, braking_std)
        if m.external_held_s > 0.0 or braking < 0.3 * ff_decel:
            return
        white = ACCEL_NOISE / braking
        wind = WIND_SHARE * (self.m.known.x[DRAG] * drag) / braking
        # an error of the motion's states stays in the friction
        h[MASS] = -(drive - self.rotating * rate) / braking
        h[BIAS] = -1.0 / braking
        h[DRAG] = drag / braking
        h[GAIN] = -rate / braking
        noise = (
            4.0 * (white * white)
            + CORRELATED_WINDOWS * (wind * wind)
            + MODEL_NOISE * MODEL_NOISE
        )
        innovation = log(braking / ff_decel) - level
        innovation_var = (
            quadratic(self.m.known.cov, h)
            + white * white
            + wind * wind
            + MODEL_NOISE * MODEL_NOISE
        )
        if is_outlier(m, innovation, sqrt(innovation_var)):
            return
        self.m.known.update(FIRST_FRICTION, h, innovation, noise)

    def _decay_drift(self, dt_s: float) -> None:
        """Let the drift of the friction decay; add noise to all else."""
        keep = exp(-dt_s / DRIFT_S)
        cov = self.m.known.cov
        self.m.known.add_process_noise(FIRST_FRICTION, STATES, dt_s)
        self.m.known.x[DRIFT] *= keep
        for i in range(STATES):
            cov[i * STATES + DRIFT] *= keep
            cov[DRIFT * STATES + i] *= keep
        cov[DRIFT * STATES + DRIFT] += (1.0 - keep * keep) * (
            P0_STD[DRIFT] * P0_STD[DRIFT]
        )

    def _learn_gain(self, s: Step, *, learns: bool) -> None:
        """Compare changes of accel with those of dv/dt: pitch and scale."""
        m = self.m
        rate = m.rate - m.slow_rate
        more = m.accel_measured - m.rate - (m.slow_accel - m.slow_rate)
        m.gain_time_s += s.dt_s
        if m.gain_time_s < WINDOW_S:
            return
        m.gain_time_s = 0.0
        if (
            not s.steady
            or s.speed < LEAST_SPEED_MS
            or abs(rate) < GAIN_RATE_MS2
            or m.roughness > ROUGHNESS_MS2 * ROUGHNESS_MS2
        ):
            return
        m.gain_product += more * rate
        m.gain_square += rate * rate
        if m.gain_square > GAIN_SQUARE_MOST:
            faded = GAIN_SQUARE_MOST / m.gain_square
            m.gain_product *= faded
            m.gain_square *= faded
        if motion_unmeasured(self.m):
            self._suspect_external(WINDOW_S)
        if implausible_gain(self.m):
            self._forget_drive()
        if not learns or implausible_gain(self.m):
            return
        innovation = more - self.m.known.x[GAIN] * rate
        if abs(innovation) > 3.0 * GAIN_NOISE:
            return
        h = [0.0, 0.0, 0.0, rate, *NO_FRICTION]
        noise = CORRELATED_GAIN_WINDOWS * GAIN_NOISE * GAIN_NOISE
        m.known.update(0, h, innovation, noise)

    def _filter_motion(self, s: Step) -> None:
        m = self.m
        if m.last_speed < 0.0:
            m.last_speed = s.end_speed
            m.accel_measured = m.slow_accel = s.accel
            m.rate = m.slow_rate = 0.0
            m.gain_time_s = -RESTART_S
        rate = (s.end_speed - m.last_speed) / s.dt_s
        share = 1.0 - exp(-s.dt_s / RATE_S)
        slow = 1.0 - exp(-s.dt_s / SLOW_RATE_S)
        jump = rate - m.rate
        m.roughness += (1.0 - exp(-s.dt_s / ROUGHNESS_S)) * (
            jump * jump - m.roughness
        )
        m.last_speed = s.end_speed
        m.rate += share * (rate - m.rate)
        m.accel_measured += share * (s.accel - m.accel_measured)
        m.slow_rate += slow * (m.rate - m.slow_rate)
        m.slow_accel += slow * (m.accel_measured - m.slow_accel)

    def _accumulate_window(
        self, s: Step, kind: float, first_speed: float
    ) -> bool:
        """Sum half a second of one kind; return whether it is complete."""
        m = self.m
        if kind != m.window_kind or kind == WINDOW_NONE:
            m.window_kind = kind
            m.window_s = m.window_accel = m.window_drive = 0.0
            m.window_drag = m.window_brake = 0.0
            m.window_pressure = m.window_speed = 0.0
            m.window_first_speed = first_speed
            if kind == WINDOW_NONE:
                return False
        m.window_s += s.dt_s
        m.window_accel += s.accel * s.dt_s
        m.window_drive += s.drive * s.dt_s
        m.window_drag += s.drag * s.dt_s
        m.window_brake += (s.brake_n if s.pressed else s.light_n) * s.dt_s
        m.window_pressure += s.pressure_pa * s.dt_s
        m.window_speed += s.speed * s.dt_s
        return m.window_s > WINDOW_S - 1e-6

    def _learn_window(self, s: Step) -> None:
        m = self.m
        t = m.window_s
        rate = (s.end_speed - m.window_first_speed) / t
        accel, drive = m.window_accel / t, m.window_drive / t
        drag = m.window_drag / t
        if m.window_kind == WINDOW_DRIVEN:
            speed, pressure = m.window_speed / t, m.window_pressure / t
            level, _ = m.known.friction(speed, pressure)
            light = m.window_brake / t / self.mass_kg * m.known.x[MASS]
            self._learn_motion(accel + light * exp(level), drive, drag, rate)
        else:
            self._learn_friction(accel, drive, drag, rate, s)
        m.window_kind = WINDOW_NONE

    def _window_kind(self, s: Step) -> float:
        m = self.m
        if m.calm_s < CALM_S:
            return WINDOW_NONE
        if m.released_s >= RELEASED_S:
            return WINDOW_DRIVEN if s.torque_known else WINDOW_NONE
        if m.pressed_s >= PRESSED_S and s.brake_n > LEAST_BRAKE_N:
            return WINDOW_BRAKED
        return WINDOW_NONE

    def _keep_times(self, s: Step) -> None:
        """Update the times since a disturbance, of brake on and brake off."""
        m = self.m
        shifted = s.gear != m.last_gear or s.clutch != m.last_clutch
        m.last_gear, m.last_clutch = s.gear, s.clutch
        calm = (
            s.steady
            and s.forward
            and not shifted
            and s.speed > LEAST_SPEED_MS
            and s.lateral < MOST_LATERAL_MS2
            and not implausible_gain(self.m)
            and not implausible_radius(self.m)
        )
        free = s.pressure_known and not s.pressed
        m.calm_s = m.calm_s + s.dt_s if calm else 0.0
        m.released_s = m.released_s + s.dt_s if free else 0.0
        m.pressed_s = m.pressed_s + s.dt_s if s.pressed else 0.0

    def _widen_mass(self, s: Step) -> None:
        """Raise the variance of the mass after a stop: its load may change."""
        m = self.m
        if s.speed <= STANDING_MS:
            m.stood_s += s.dt_s
            return
        if m.stood_s > STOOD_S:
            self.m.known.cov[0] += LOAD_STD * LOAD_STD
            self.m.known.cov[0] = min(
                self.m.known.cov[0], P0_STD[0] * P0_STD[0]
            )
        m.stood_s = 0.0

    def _watch_pressure(self, s: Step) -> None:
        """Sum the time of hard braking since the last pressure."""
        m = self.m
        if s.brake_n > 0.0:
            m.unpressed_s = 0.0
            return
        braking, std = self.braking(m.accel_measured, s.drive, s.drag, m.rate)
        if (
            s.brake_switch != 0.0
            and s.torque_known
            and s.pressure_known
            and s.steady
            and s.speed > LEAST_SPEED_MS
            and -m.rate > DEAD_MS2
            and braking - 2.5 * std > DEAD_MS2
        ):
            m.unpressed_s += s.dt_s

    def _follow_grade(self, s: Step) -> None:
        """Filter the sine of the grade; learn bias and g f_r from the height.

        The balance of forces gives the bias less g f_r; the height gained
        gives the bias alone.
        """
        m, known = self.m, self.m.known
        bias = known.x[BIAS] + self.rolling + known.rolling_error
        gain = 1.0 + known.x[GAIN]
        upward = m.accel_measured - gain * m.rate - bias
        sine = clipped(upward / GRAVITY_MS2, -0.5, 0.5)
        m.sine += (1.0 - exp(-s.dt_s / GRADE_S)) * (sine - m.sine)
        if (
            isnan(s.height)
            or m.external_held_s > 0.0
            or implausible_gain(self.m)
        ):
            m.height_path = 0.0
            return
        if m.height_path <= 0.0:
            m.height_last = s.height
            m.height_work = 0.0
        path = s.speed * s.dt_s
        m.height_work += (upward + known.rolling_error) * path
        m.height_path += path
        if m.height_path < HEIGHT_PATH_M:
            return
        climbed = GRAVITY_MS2 * (s.height - m.height_last)
        error = (m.height_work - climbed) / m.height_path
        std = 1.5 * GRAVITY_MS2 * HEIGHT_NOISE_M / m.height_path
        innovation = error - known.rolling_error
        rolling_var = known.rolling_var
        innovation_var = (
            known.cov[BIAS * STATES + BIAS] + rolling_var + std * std
        )
        m.height_path = 0.0
        if abs(innovation) > OUTLIER * sqrt(innovation_var):
            return
        # weight by variance; without torque the bias is free
        h = [0.0] * STATES
        h[BIAS] = 1.0
        known.update(0, h, innovation, rolling_var + std * std)
        share = rolling_var / innovation_var
        known.rolling_error += share * innovation
        known.rolling_var *= 1.0 - share
        known.rolling_var += 1e-6
