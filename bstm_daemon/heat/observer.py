"""The car as its motion tells it: mass, bias, drag, pitch and friction.

The pure-Python form of ``_observer.c``; both do the same operations in the
same order. An accelerometer feels ``dv/dt + g sin(theta)`` and its bias b, so
that the balance of forces needs no grade::

    felt = mu u - sigma D(v) + b' + k dv/dt - braking
    u = T / (R m0) + F_ext / m0 - J / (R^2 m0) dv/dt,  b' = b - g f_r

with mu = m0 / m, m0 and D of the configuration. Unbraked half seconds teach
mu, b', sigma and k by a Kalman filter. Braked ones teach ln of the friction
over Feed-Forward's, ``level + a ln(v/10) + c ln(p/10 bar) + drift``, by a
Schmidt-Kalman filter: the motion's states are not changed by the brakes, but
their errors count, and what is learned of them later corrects the friction.
"""

from __future__ import annotations

from math import exp, isnan, log, sqrt
from typing import TYPE_CHECKING, Final

from bstm_daemon.heat import observer_rules as rules
from bstm_daemon.heat.check_layout import UNKNOWN
from bstm_daemon.heat.learned import (
    BIAS,
    DRAG,
    DRIFT,
    GAIN,
    MASS,
    NO_FRICTION,
    Learned,
    forms,
    product,
    quadratic,
)
from bstm_daemon.heat.observer_doubts import (
    compare_radius,
    doubts,
    strange_gain,
    strange_radius,
    unfelt,
    watch_pressure,
)
from bstm_daemon.heat.observer_layout import (
    LEARNED_NAMES,
    MOTION,
    OBSERVER_NUMBERS,
    STATES,
)
from bstm_daemon.heat.observer_road import follow_grade
from bstm_daemon.heat.plausibility import STANDING_MS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.heat.observer_layout import Step

_LEARNED: Final = len(LEARNED_NAMES)
_OWN: Final = OBSERVER_NUMBERS[4 * _LEARNED :]
_NONE, _DRIVEN, _BRAKED = 0.0, 1.0, 2.0


class Observer:
    """The memory, unpacked; :meth:`packed` packs it again."""

    def __init__(
        self,
        mass_kg: float,
        rotating: float,
        rolling: float,
        numbers: Sequence[float],
    ) -> None:
        """Unpack *numbers*, as ``observer_layout`` has them.

        *rotating* is J / R^2 over *mass_kg*, *rolling* g f_r [m/s2].
        """
        self.mass_kg, self.rotating, self.rolling = mass_kg, rotating, rolling
        self.known = Learned(rotating, numbers[:_LEARNED])
        self.recent = list(numbers[_LEARNED : 2 * _LEARNED])
        self.earlier = list(numbers[2 * _LEARNED : 3 * _LEARNED])
        self.first = list(numbers[3 * _LEARNED : 4 * _LEARNED])
        own = numbers[4 * _LEARNED : len(OBSERVER_NUMBERS)]
        self.m = dict(zip(_OWN, own, strict=True))
        self.brake_sum = list(numbers[len(OBSERVER_NUMBERS) :])

    def packed(self) -> list[float]:
        """Return the memory as it was given."""
        return [
            *self.known.packed(),
            *self.recent,
            *self.earlier,
            *self.first,
            *self.m.values(),
            *self.brake_sum,
        ]

    def begin(self) -> None:
        """Begin anew, from what the configuration says."""
        resets = self.m["resets"]
        self.m = dict.fromkeys(self.m, 0.0)
        self.m["resets"] = resets
        self.known.begin(self.rolling)
        self.m["radius_ratio"] = 1.0
        self.m["last_rolled"] = UNKNOWN
        self.recent = self.known.packed()
        self.earlier = self.known.packed()
        self.first = self.known.packed()
        self.m["started"] = 1.0

    def observe(self, s: Step) -> int:
        """Learn from a step that ends; returns what there is to tell."""
        m = self.m
        if m["started"] == 0.0:
            self.begin()
            m = self.m
        self._keep_load(s)
        self._let_friction_pass(s.dt_s)
        if isnan(s.felt) or isnan(s.push):
            m["last_rolled"] = UNKNOWN
            m["calm_s"] = m["height_path"] = 0.0
            self._gather(s, _NONE, 0.0)
        else:
            first_speed = m["last_rolled"]
            if first_speed < 0.0:
                first_speed = s.end_speed
            self._follow(s)
            self._keep_times(s)
            if s.on_stand:
                self._suspect_external(s.dt_s)
            compare_radius(m, s)
            if strange_radius(m):
                self._forget_drive()
            watch_pressure(m, self.known, s)
            calm = m["calm_s"] >= rules.CALM_S
            self._learn_gain(s, learns=calm and m["external_held_s"] <= 0.0)
            if self._gather(s, self._kind(s), first_speed):
                self._learn(s)
            follow_grade(m, self.known, self.rolling, s)
            self._keep_copies(s.dt_s)
        if not self.known.sound():
            m["resets"] += 1.0
            self.begin()
            return doubts(self.m) | rules.OBSERVER_RESET
        return doubts(m)

    def _keep_copies(self, dt_s: float) -> None:
        self.m["copy_age"] += dt_s
        if self.m["copy_age"] < rules.COPY_S:
            return
        self.earlier = self.recent
        self.recent = self.known.packed()
        self.m["copy_age"] = 0.0

    def _roll_back(self) -> None:
        """Forget what was learned within the last minutes."""
        self.known.unpack(self.earlier)
        self.recent = list(self.earlier)
        self.m["copy_age"] = 0.0

    def _forget_drive(self) -> None:
        """What this drive has taught rests on a wrong scale."""
        self.earlier = list(self.first)
        self._roll_back()

    def _suspect_external(self, seconds: float) -> None:
        m = self.m
        m["external_s"] += seconds
        if m["external_s"] < rules.EXTERNAL_S:
            return
        if m["external_held_s"] <= 0.0:
            self._roll_back()
        m["external_held_s"] = rules.EXTERNAL_HOLD_S
        m["external_s"] = rules.EXTERNAL_S

    def _trust(self, seconds: float) -> None:
        m = self.m
        m["external_s"] = max(m["external_s"] - 0.5 * seconds, 0.0)
        m["external_held_s"] = max(m["external_held_s"] - seconds, 0.0)

    def _learn_motion(
        self, felt: float, push: float, drag: float, rate: float
    ) -> None:
        h = [push - self.rotating * rate, 1.0, -drag, rate, *NO_FRICTION]
        relative = (
            rules.DRAG_TORQUE_NOISE if push < 0.0 else rules.TORQUE_NOISE
        )
        torque = relative * self.known.x[MASS] * push
        noise = rules.COMMON * (
            rules.FELT_NOISE * rules.FELT_NOISE + torque * torque
        )
        apart = felt - product(self.known.x, h)
        spread = (
            quadratic(self.known.cov, h)
            + rules.FELT_NOISE * rules.FELT_NOISE
            + torque * torque
        )
        most = rules.IDLE_OUTLIER if push < rules.IDLE_PUSH else rules.OUTLIER
        pushed = apart > most * sqrt(spread) and apart > rules.PUSHED_MS2
        if pushed:
            self._suspect_external(rules.WINDOW_S)
        if pushed or abs(apart) > rules.OUTLIER * sqrt(spread):
            return
        self._trust(rules.WINDOW_S)
        if self.m["external_held_s"] > 0.0:
            return
        self.known.walk(0, len(MOTION), rules.WINDOW_S)
        self.known.update(0, h, apart, noise)

    def _learn_friction(
        self, felt: float, push: float, drag: float, rate: float, s: Step
    ) -> None:
        m = self.m
        t = m["window_time"]
        braking, uncertain = self.known.braking(felt, push, drag, rate)
        given = m["window_brake"] / t / self.mass_kg * self.known.x[MASS]
        h = forms(m["window_speed"] / t, m["window_pressure"] / t)
        level = product(self.known.x, h)
        assumed = 0.0 if s.torque_known else rules.ASSUMED_DOUBT
        doubt = sqrt(
            rules.FELT_NOISE * rules.FELT_NOISE
            + uncertain * uncertain
            + assumed * assumed
        )
        if braking + 2.5 * doubt < rules.EXTERNAL_SHARE * (given * exp(level)):
            self._suspect_external(rules.WINDOW_S)
            return
        self._trust(rules.WINDOW_S)
        # an assumed torque is the driver's word, not a measurement
        if not s.torque_known:
            return
        if m["external_held_s"] > 0.0 or braking < 0.3 * given:
            return
        white = rules.FELT_NOISE / braking
        wind = rules.WIND_SHARE * (self.known.x[DRAG] * drag) / braking
        # an error of the motion's states is one of the friction for good
        h[MASS] = -(push - self.rotating * rate) / braking
        h[BIAS] = -1.0 / braking
        h[DRAG] = drag / braking
        h[GAIN] = -rate / braking
        noise = (
            4.0 * (white * white)
            + rules.COMMON * (wind * wind)
            + rules.FORM_NOISE * rules.FORM_NOISE
        )
        apart = log(braking / given) - level
        spread = (
            quadratic(self.known.cov, h)
            + white * white
            + wind * wind
            + rules.FORM_NOISE * rules.FORM_NOISE
        )
        if abs(apart) > rules.OUTLIER * sqrt(spread):
            return
        self.known.update(len(MOTION), h, apart, noise)

    def _let_friction_pass(self, dt_s: float) -> None:
        """The friction's passing part fades; all else walks slowly."""
        keep = exp(-dt_s / rules.DRIFT_S)
        cov = self.known.cov
        self.known.walk(len(MOTION), STATES, dt_s)
        self.known.x[DRIFT] *= keep
        for i in range(STATES):
            cov[i * STATES + DRIFT] *= keep
            cov[DRIFT * STATES + i] *= keep
        cov[DRIFT * STATES + DRIFT] += (1.0 - keep * keep) * (
            rules.SD[DRIFT] * rules.SD[DRIFT]
        )

    def _learn_gain(self, s: Step, *, learns: bool) -> None:
        """Pitch and scale: what is felt when the speed's rate changes."""
        m = self.m
        rate = m["rate"] - m["slow_rate"]
        more = m["felt"] - m["rate"] - (m["slow_felt"] - m["slow_rate"])
        m["gain_time"] += s.dt_s
        if m["gain_time"] < rules.WINDOW_S:
            return
        m["gain_time"] = 0.0
        if (
            not s.steady
            or s.speed < rules.LEAST_SPEED_MS
            or abs(rate) < rules.GAIN_RATE_MS2
            or m["rough"] > rules.ROUGH_MS2 * rules.ROUGH_MS2
        ):
            return
        m["alike"] += more * rate
        m["changed"] += rate * rate
        if m["changed"] > rules.CHANGED_MOST:
            faded = rules.CHANGED_MOST / m["changed"]
            m["alike"] *= faded
            m["changed"] *= faded
        if unfelt(self.m):
            self._suspect_external(rules.WINDOW_S)
        if strange_gain(self.m):
            self._forget_drive()
        if not learns or strange_gain(self.m):
            return
        apart = more - self.known.x[GAIN] * rate
        if abs(apart) > 3.0 * rules.GAIN_NOISE:
            return
        h = [0.0, 0.0, 0.0, rate, *NO_FRICTION]
        self.known.update(
            0,
            h,
            apart,
            rules.GAIN_COMMON * rules.GAIN_NOISE * rules.GAIN_NOISE,
        )

    def _follow(self, s: Step) -> None:
        m = self.m
        if m["last_rolled"] < 0.0:
            m["last_rolled"] = s.end_speed
            m["felt"] = m["slow_felt"] = s.felt
            m["rate"] = m["slow_rate"] = 0.0
            m["gain_time"] = -rules.RESTART_S
        rate = (s.end_speed - m["last_rolled"]) / s.dt_s
        share = 1.0 - exp(-s.dt_s / rules.RATE_S)
        slow = 1.0 - exp(-s.dt_s / rules.SLOW_RATE_S)
        jump = rate - m["rate"]
        m["rough"] += (1.0 - exp(-s.dt_s / rules.ROUGH_S)) * (
            jump * jump - m["rough"]
        )
        m["last_rolled"] = s.end_speed
        m["rate"] += share * (rate - m["rate"])
        m["felt"] += share * (s.felt - m["felt"])
        m["slow_rate"] += slow * (m["rate"] - m["slow_rate"])
        m["slow_felt"] += slow * (m["felt"] - m["slow_felt"])

    def _gather(self, s: Step, kind: float, first_speed: float) -> bool:
        """Sum half seconds of one kind; whether one is complete."""
        m = self.m
        if kind != m["window_kind"] or kind == _NONE:
            m["window_kind"] = kind
            m["window_time"] = m["window_felt"] = m["window_push"] = 0.0
            m["window_drag"] = m["window_brake"] = 0.0
            m["window_pressure"] = m["window_speed"] = 0.0
            m["window_first_speed"] = first_speed
            if kind == _NONE:
                return False
        m["window_time"] += s.dt_s
        m["window_felt"] += s.felt * s.dt_s
        m["window_push"] += s.push * s.dt_s
        m["window_drag"] += s.drag * s.dt_s
        m["window_brake"] += s.brake_n * s.dt_s
        m["window_pressure"] += s.pressure_pa * s.dt_s
        m["window_speed"] += s.speed * s.dt_s
        return m["window_time"] > rules.WINDOW_S - 1e-6

    def _learn(self, s: Step) -> None:
        m = self.m
        t = m["window_time"]
        rate = (s.end_speed - m["window_first_speed"]) / t
        felt, push = m["window_felt"] / t, m["window_push"] / t
        drag = m["window_drag"] / t
        if m["window_kind"] == _DRIVEN:
            self._learn_motion(felt, push, drag, rate)
        else:
            self._learn_friction(felt, push, drag, rate, s)
        m["window_kind"] = _NONE

    def _kind(self, s: Step) -> float:
        m = self.m
        if m["calm_s"] < rules.CALM_S:
            return _NONE
        if m["released_s"] >= rules.RELEASED_S:
            return _DRIVEN if s.torque_known else _NONE
        if (
            m["pressed_s"] >= rules.PRESSED_S
            and s.brake_n > rules.LEAST_BRAKE_N
        ):
            return _BRAKED
        return _NONE

    def _keep_times(self, s: Step) -> None:
        """How long nothing has disturbed, and the brake is on or off."""
        m = self.m
        shifted = s.gear != m["last_gear"] or s.clutch != m["last_clutch"]
        m["last_gear"], m["last_clutch"] = s.gear, s.clutch
        calm = (
            s.steady
            and s.forward
            and not shifted
            and s.speed > rules.LEAST_SPEED_MS
            and s.lateral < rules.MOST_LATERAL_MS2
            and not strange_gain(self.m)
            and not strange_radius(self.m)
        )
        free = s.pressure_known and not s.pressed
        m["calm_s"] = m["calm_s"] + s.dt_s if calm else 0.0
        m["released_s"] = m["released_s"] + s.dt_s if free else 0.0
        m["pressed_s"] = m["pressed_s"] + s.dt_s if s.pressed else 0.0

    def _keep_load(self, s: Step) -> None:
        """People and luggage get in and out while the car stands."""
        m = self.m
        if s.speed <= STANDING_MS:
            m["stood_s"] += s.dt_s
            return
        if m["stood_s"] > rules.STOOD_S:
            self.known.cov[0] += rules.LOAD_SD * rules.LOAD_SD
            self.known.cov[0] = min(
                self.known.cov[0], rules.SD[0] * rules.SD[0]
            )
        m["stood_s"] = 0.0
