"""A6: emergency assist, in standby while boiling is possible.

Off while no fluid can boil, so that it can not be wrong then. In standby a
score from 0 to 1 says how much the brakes fail to answer; rules in the manner
of fuzzy logic, each as true as the least of its conditions:

1. pressure is large AND the brakes decelerate far less than it should give;
2. the pedal is far down AND the pressure small: vapour is compressed;
3. a pedal that moves fast, an anxious driver, makes either rule count more.

"Large", "far" and "fast" rise linearly between two bounds. What the brakes
decelerate is the accelerometer's specific force, in which the slope cancels;
without one, the change of speed less the slope of the pitch angle; without
that either, the change of speed alone, which counts less. A wheel that slips
explains missing deceleration otherwise: no score while ABS or ESC act.
"""

from __future__ import annotations

from math import exp, inf, isfinite, sin
from typing import TYPE_CHECKING, ClassVar, Final

from bstm_daemon.estimate import Assist, Intervention, RiskLevel
from bstm_daemon.estimator.memory import AnyNumber, Int64, Machine, Number
from bstm_daemon.model.heat.feed_forward import PressureTorque
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from bstm_daemon.advice.conditions import Conditions
    from bstm_daemon.config.sections import Config

MOVING_MS: Final = 1.0
"""A car at standstill does not decelerate any more."""

SMOOTHING_S: Final = 0.2
"""Time constant of pressure and deceleration: hydraulics and sensor."""

ANSWERED: Final = 0.6
UNANSWERED: Final = 0.2
"""Shares of the expected deceleration: the response is normal above the first
and missing below the second."""

FAR: Final = (0.5, 0.8)
"""Shares of the pedal travel between which "far down" rises from 0 to 1."""

UNSURE: Final = 0.7
"""Weight of a score whose slope is not known."""

ANXIOUS: Final = 0.25
"""Share that a fast pedal adds to a rule that holds."""

RELEASED_PA: Final = 2.0e5
"""Below this pressure the driver does not brake any more."""


class EmergencyAssist(Machine):
    """Standby, detector, and the choice of one of three interventions."""

    MEMORY: ClassVar = {
        "state": Assist,
        "score": Number,
        "_expected": Number,
        "_measured": Number,
        "_pedal_rate": Number,
        "_since_us": Int64 | None,
        "_last": tuple[Int64, AnyNumber, AnyNumber | None] | None,
    }

    def __init__(self, config: Config) -> None:
        """Begin switched off."""
        self._config = config.advice
        self._torques: dict[str, PressureTorque] = {
            corner.name: PressureTorque.of_corner(corner)
            for corner in config.corner
        }
        lever = config.vehicle.mass_kg * config.vehicle.wheel_radius_m
        self._per_torque = 1.0 / lever
        self.state = Assist.OFF
        self.score = 0.0
        self._expected = self._measured = self._pedal_rate = 0.0
        self._since_us: int | None = None
        self._last: tuple[int, float, float | None] | None = None

    def update(self, now: Conditions) -> tuple[Assist, Intervention, float]:
        """Return state, request and score."""
        sure = self._observe(now)
        if not now.may_boil:
            self.state, self.score, self._since_us = Assist.OFF, 0.0, None
            return self.state, Intervention.NONE, 0.0
        if self.state is Assist.OFF:
            self.state = Assist.STANDBY
        self.score = self._score(now, sure)
        if self.score < self._config.detector_score:
            self._since_us = None
        elif self._since_us is None:
            self._since_us = now.time_us
        held_us = round(self._config.detector_hold_s * 1e6)
        if (
            self._since_us is not None
            and now.time_us - self._since_us >= held_us
        ):
            self.state = Assist.DETECTED
        if self.state is Assist.DETECTED and self._is_over(now):
            self.state = Assist.STANDBY
        if self.state is not Assist.DETECTED:
            return self.state, Intervention.NONE, self.score
        return self.state, self._intervention(now), self.score

    def _observe(self, now: Conditions) -> float:
        """Filter the measurements; return the weight of the deceleration."""
        travel = now.driver.get("brake_pedal_travel")
        last, self._last = self._last, (now.time_us, now.speed_ms, travel)
        if last is None or not 0 < now.time_us - last[0] <= 1_000_000:
            self._expected = self._measured = self._pedal_rate = 0.0
            return 0.0
        dt_s = (now.time_us - last[0]) * 1e-6
        sure, measured = 1.0, -now.driver.get("acceleration_longitudinal", 0.0)
        if "acceleration_longitudinal" not in now.driver:
            measured = (last[1] - now.speed_ms) / dt_s
            if "pitch" in now.driver:
                measured -= GRAVITY_MS2 * sin(now.driver["pitch"])
            else:
                sure = UNSURE
        if not isfinite(measured):
            return 0.0
        torque_nm = 0.0
        for name, pressure_pa in now.pressures_pa.items():
            if 0.0 < pressure_pa < inf:
                torque_nm += self._torques[name].torque_nm(pressure_pa)
        expected = self._per_torque * torque_nm
        share = 1.0 - exp(-dt_s / SMOOTHING_S)
        self._expected += share * (expected - self._expected)
        self._measured += share * (measured - self._measured)
        rate = 0.0
        if travel is not None and last[2] is not None:
            rate = (travel - last[2]) / dt_s
        # a kick of the pedal counts for as long as the brakes take to respond
        self._pedal_rate = max(rate, self._pedal_rate * exp(-dt_s))
        return sure

    def _score(self, now: Conditions, sure: float) -> float:
        moving = isfinite(now.speed_ms) and now.speed_ms > MOVING_MS
        if not moving or now.flag("abs_active") or now.flag("esc_active"):
            return 0.0
        limit_pa = self._config.detector_pressure_pa
        highest_pa = now.highest_pressure_pa
        if not isfinite(highest_pa):
            # an unknown value is neither large nor small
            return 0.0
        large = _rising(highest_pa, 0.5 * limit_pa, limit_pa)
        answer = (
            self._measured / self._expected if self._expected > 0.0 else 1.0
        )
        missing = 1.0 - _rising(answer, UNANSWERED, ANSWERED)
        travel = now.driver.get("brake_pedal_travel", 0.0)
        soft = min(
            _rising(travel, *FAR),
            1.0 - _rising(highest_pa, 0.25 * limit_pa, 0.5 * limit_pa),
        )
        rule = max(sure * min(large, missing), soft)
        fast_1_s = self._config.detector_pedal_rate_1_s
        anxious = _rising(self._pedal_rate, 0.5 * fast_1_s, fast_1_s)
        return min(rule * (1.0 + ANXIOUS * anxious), 1.0)

    def _is_over(self, now: Conditions) -> bool:
        """Whether the driver has released the pedal or the car has stopped."""
        braking = (
            now.highest_pressure_pa > RELEASED_PA
            or now.flag("brake_switch") is True
        )
        return not braking or now.speed_ms < 0.5 * MOVING_MS

    def _intervention(self, now: Conditions) -> Intervention:
        """Choose by the circuits that may be full of vapour (7.2.6)."""
        hot = {
            name
            for name, corner in now.corners.items()
            if corner.is_at_least(RiskLevel.HIGH)
        }
        circuits = (
            ({"FL", "FR"}, {"RL", "RR"})
            if self._config.brake_split == "front-rear"
            else ({"FL", "RR"}, {"FR", "RL"})
        )
        locked = [bool(circuit & hot) for circuit in circuits]
        if not all(locked):
            return Intervention.MAXIMUM_PRESSURE
        if not hot & {"RL", "RR"}:
            return Intervention.ISOLATE_FRONT
        if now.speed_ms <= self._config.park_brake_speed_ms:
            return Intervention.PARK_BRAKE
        return Intervention.MAXIMUM_PRESSURE


def _rising(value: float, low: float, high: float) -> float:
    """Degree to which *value* is above: 0 at *low*, 1 at *high*."""
    return min(max((value - low) / (high - low), 0.0), 1.0)
