"""Input checks: range, rate of change, plausibility against each other.

The pure-Python form of ``native/heat/checks.c``; both do the same operations
in the same order. :meth:`Checks.admit` judges one sample, :meth:`Checks.close`
what holds at the end of a step; limits and thresholds are those of
:mod:`bstm_daemon.model.heat.check_rules`.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from math import exp, isnan
from typing import Final

from bstm_daemon.channels import (
    CORNER_PRESSURE_SUSPECT,
    FLAGS,
    HEAT_LOST,
    HEAT_UNCERTAIN,
    WHEEL_SUSPECT,
)
from bstm_daemon.model.heat.air_checks import air_suspect, compare_air
from bstm_daemon.model.heat.check_rules import (
    DEVIATION,
    DEVIATION_BRAKING,
    DEVIATION_MS,
    DEVIATION_SHARE,
    FROZEN_SPEED_MS,
    FROZEN_SPEED_S,
    HOLD_US,
    LIMITS,
    MOVES_S,
    MOVING_MS,
    OUTAGE_MEMORY,
    OUTAGE_S,
    PARKED_S,
    SCALE_LIMIT,
    SCALE_MS,
    SCALE_S,
    SILENT_US,
    STANDING_MS,
    STUCK,
    SWITCH,
    TWIN,
    UNPROVEN_S,
    ZERO,
)
from bstm_daemon.model.heat.memory import NEVER, CheckMemory
from bstm_daemon.model.heat.motion_checks import (
    all_frozen,
    compare_motion,
    compare_turns,
    contradicted,
    leaps,
    too_slow_in_bends,
    watch_leap,
    wrong_scale,
)
from bstm_daemon.model.heat.pressure_checks import (
    compare_switch,
    compare_twins,
    compare_zero,
    hold_pressures,
)
from bstm_daemon.model.heat.readings import Readings
from bstm_daemon.model.heat.sample_plan import PlanNumbers
from bstm_daemon.roles import MEASURED_NODES, ROLE_INDEX

_FIRST_THERMOCOUPLE: Final = ROLE_INDEX[f"temp_fl_{MEASURED_NODES[0]}"]
_NO_MOTION: Final = FLAGS["speed_suspect"] | FLAGS["acceleration_suspect"]


@dataclass(frozen=True, slots=True)
class Watched:
    """Role numbers of the checked inputs by kind."""

    speeds: Sequence[int]
    pressures: Sequence[int]
    acceleration: int
    torque: int
    temperatures: Sequence[int]


class Checks:
    """All checks of a car; the memory ``m`` changes in place."""

    def __init__(
        self, watched: Watched, plan: PlanNumbers, memory: CheckMemory
    ) -> None:
        """Check the roles *watched* of *plan*."""
        self.watched, self.plan, self.m = watched, plan, memory

    def admit(
        self, at_us: int, role: int, value: float, last: float, since: int
    ) -> bool:
        """Return whether *value* is accepted as a sample of *role*.

        *last* is the role's present value and *since* its stamp [us], NEVER
        where there is none or the order of the two is not known: then only
        the range counts.
        """
        self.m.last_sample = at_us
        if role < _FIRST_THERMOCOUPLE:
            self.m.last_of_car = at_us
        if value < LIMITS[role].low or value > LIMITS[role].high:
            self.m.out_of_range += 1
            self._hold(at_us, role)
            return False
        if since != NEVER and self._jumped(role, value - last, at_us - since):
            first = self.m.jump_stamp[role]
            if (
                first == NEVER
                or at_us <= first
                or self._jumped(
                    role, value - self.m.jump_value[role], at_us - first
                )
            ):
                self.m.jump_stamp[role] = at_us
                self.m.jump_value[role] = value
                self.m.jumps_refused += 1
                self._hold(at_us, role)
                return False
        self.m.jump_stamp[role] = NEVER
        return True

    def _jumped(self, role: int, change: float, time_us: int) -> bool:
        limits = LIMITS[role]
        return abs(change) > (
            limits.step + limits.rate_per_s * (time_us * 1e-6)
        )

    def _hold(self, at_us: int, role: int) -> None:
        self.m.until[role] = at_us + HOLD_US
        self.m.suspect_until = max(self.m.suspect_until, self.m.until[role])

    def shift(self, ahead_us: int) -> None:
        """Shift all stamps after a clock jump."""
        for stamps in (self.m.jump_stamp, self.m.until):
            for role, stamp in enumerate(stamps):
                if stamp != NEVER:
                    stamps[role] = stamp + ahead_us
        if self.m.last_sample != NEVER:
            self.m.last_sample += ahead_us
        if self.m.last_of_car != NEVER:
            self.m.last_of_car += ahead_us
        if self.m.suspect_until != NEVER:
            self.m.suspect_until += ahead_us

    def settle(self) -> None:
        """Forget outages and the air: everything is at ambient temperature."""
        self.m.air_k = self.m.air_fault_s = 0.0
        for c in range(self.plan.corners):
            self.m.outage_s[c] = self.m.aftermath_s[c] = 0.0

    def close(self, now: Readings) -> int:
        """Check a finished step; return bits of FLAGS."""
        median, count = _median(now.speeds)
        self._compare_scales(now, median, count)
        self._compare_speeds(now, median, count)
        self._hold_speeds(now, median, count)
        refused = 0
        if now.now <= self.m.suspect_until:
            refused = self._held_flags(now)
            refused |= self._speed_flags(now, refused)
        # a change of a suspect speed does not count as driving
        unsure = bool(refused & FLAGS["speed_suspect"])
        hold_pressures(self.m, now, unsure=unsure)
        compare_switch(self.m, now)
        compare_zero(self.m, now)
        compare_twins(self.m, now)
        watch_leap(self.m, now, median, count)
        compare_motion(self.m, now, noise=bool(refused & _NO_MOTION))
        compare_turns(self.m, now)
        compare_air(self.m, now)
        flags = self._contradictions(now, count) | refused
        flags |= self._speed_flags(now, flags)
        return flags | self._outages(now) | self._sleeps(now)

    def _compare_scales(
        self, now: Readings, median: float, count: int
    ) -> None:
        # one that stands is dead, which is another check's; an intervention
        # slows single wheels for many seconds
        if (
            count < 3
            or min([median, *now.speeds]) <= STANDING_MS
            or max([0.0, *now.speeds]) < SCALE_MS
            or now.intervenes
        ):
            return
        share = 1.0 - exp(-now.dt_s / SCALE_S)
        scales = self.m.scale_error
        for v, speed in enumerate(now.speeds):
            if not isnan(speed):
                scales[v] += share * (speed / median - 1.0 - scales[v])

    def _compare_speeds(
        self, now: Readings, median: float, count: int
    ) -> None:
        share = DEVIATION_BRAKING if now.braking else DEVIATION_SHARE
        allowed = DEVIATION_MS + share * median
        agreeing = sum(abs(speed - median) <= allowed for speed in now.speeds)
        for v, speed in enumerate(now.speeds):
            failed = None
            if v == len(now.speeds) - 1 and self._wheels_dead(now):
                failed = False
            elif count >= 3 and not isnan(speed):
                if abs(self.m.scale_error[v]) > SCALE_LIMIT:
                    failed = True
                elif abs(speed - median) > allowed:
                    failed = True if agreeing >= 2 else None
                elif median > MOVING_MS:
                    failed = False
            self.m.deviation_fault_s[v] = DEVIATION.advance(
                self.m.deviation_fault_s[v], now.dt_s, failed=failed
            )
        if count == 2 or (count > 2 and agreeing < 2):
            self._compare_pair(now, median, share)
        elif count > 2:
            self.m.pair_fault_s = DEVIATION.advance(
                self.m.pair_fault_s,
                now.dt_s,
                failed=False if median > MOVING_MS else None,
            )

    def _compare_pair(
        self, now: Readings, median: float, share: float
    ) -> None:
        # the median of two is their mean; of more, two contradict two
        high, low = max([median, *now.speeds]), min([median, *now.speeds])
        failed = None
        if high - low > DEVIATION_MS + share * high:
            failed = True
        elif median > MOVING_MS:
            failed = False
        self.m.pair_fault_s = DEVIATION.advance(
            self.m.pair_fault_s, now.dt_s, failed=failed
        )

    def _hold_speeds(self, now: Readings, median: float, count: int) -> None:
        m = self.m
        # where some leap, the median changes for those that drive on
        unsure = count > 2 and leaps(m, median)
        # all wheels may freeze together: they are in one message
        *wheels, vehicle = now.speeds
        held = all(
            isnan(speed)
            or (speed == m.speed_held[v] and m.speed_held_s[v] > MOVES_S)
            for v, speed in enumerate(wheels)
        )
        if not held or isnan(vehicle):
            m.vehicle_mark = vehicle
        frozen = count > 2 and abs(vehicle - m.vehicle_mark) > FROZEN_SPEED_MS
        for v, speed in enumerate(now.speeds):
            # of two, the other; of three or more the median is constant
            # only where most of them do
            other = 2.0 * median - speed if count == 2 else median
            if isnan(speed) or speed != m.speed_held[v]:
                m.speed_held[v] = 0.0 if isnan(speed) else speed
                m.speed_held_s[v] = 0.0
                m.speed_mark[v] = 0.0 if isnan(other) else other
            else:
                m.speed_held_s[v] += now.dt_s
            if unsure:
                m.speed_mark[v] = 0.0 if isnan(other) else other
            failed = None
            if count >= 2 and not isnan(speed):
                if m.speed_held_s[v] < MOVES_S:
                    failed = False
                elif m.speed_held_s[v] >= FROZEN_SPEED_S and (
                    frozen or abs(other - m.speed_mark[v]) > FROZEN_SPEED_MS
                ):
                    failed = True
            m.speed_stuck_s[v] = STUCK.advance(
                m.speed_stuck_s[v], now.dt_s, failed=failed
            )
            m.left_out[v] = float(
                m.deviation_fault_s[v] >= DEVIATION.comes_s
                or m.speed_stuck_s[v] >= STUCK.comes_s
            )

    def _wheels_dead(self, now: Readings) -> bool:
        """Whether all wheels are stuck while the vehicle's speed changes."""
        *wheels, vehicle = now.speeds
        stuck = [
            self.m.speed_stuck_s[v] >= STUCK.comes_s
            for v, speed in enumerate(wheels)
            if not isnan(speed)
        ]
        moves = self.m.speed_stuck_s[len(wheels)] < STUCK.comes_s
        return len(stuck) > 1 and all(stuck) and moves and not isnan(vehicle)

    def _contradictions(self, now: Readings, count: int) -> int:
        """Bits of the checks of whole steps; absent inputs have none."""
        flags = self._speed_contradictions(now, count)
        switch = self.m.switch_fault_s >= SWITCH.comes_s and not isnan(
            now.brake_switch
        )
        for i, pressure in enumerate(now.pressures):
            if isnan(pressure):
                continue
            stuck = self.m.pressure_stuck_s[i] >= STUCK.comes_s
            alone = switch and i == 0
            off = self.m.zero_fault_s[i] >= ZERO.comes_s
            if stuck:
                flags |= FLAGS["stuck"]
            if alone:
                flags |= FLAGS["switch_contradicts"]
            if off:
                flags |= FLAGS["pressure_contradicts"]
            if stuck or alone or off:
                flags |= self._pressure_flags(now, i)
        *axles, circuits = (s >= TWIN.comes_s for s in self.m.twin_fault_s)
        for c, place in enumerate(self.plan.place[: self.plan.corners]):
            if axles[place // 2] or circuits:
                flags |= FLAGS["pressure_suspect"]
                flags |= FLAGS["pressure_contradicts"]
                flags |= CORNER_PRESSURE_SUSPECT << c
        if air_suspect(self.m):
            flags |= FLAGS["ambient_suspect"]
        return flags | self._motion_flags(now)

    def _motion_flags(self, now: Readings) -> int:
        flags = 0
        if now.speed_known and all_frozen(self.m):
            flags |= FLAGS["speed_suspect"] | FLAGS["stuck"]
        if now.speed_known and too_slow_in_bends(self.m):
            flags |= FLAGS["speed_suspect"] | FLAGS["acceleration_contradicts"]
        if isnan(now.acceleration):
            return flags
        if contradicted(self.m):
            flags |= FLAGS["acceleration_suspect"]
            flags |= FLAGS["acceleration_contradicts"]
        if now.speed_known and wrong_scale(self.m):
            # nobody knows which of the two it is
            flags |= _NO_MOTION | FLAGS["acceleration_contradicts"]
        return flags

    def _speed_contradictions(self, now: Readings, count: int) -> int:
        flags = 0
        corners = len(now.speeds) - 1
        apart = self.m.pair_fault_s >= DEVIATION.comes_s
        pair = count == 2 and apart
        # two against two, and none of them is stuck
        if count > 2 and apart and not any(self.m.left_out):
            flags |= FLAGS["wheels_contradict"] | FLAGS["speed_suspect"]
        for v, speed in enumerate(now.speeds):
            if isnan(speed):
                continue
            suspect = pair or self.m.left_out[v] != 0.0
            if suspect and v < corners:
                flags |= WHEEL_SUSPECT << v
            if pair or self.m.deviation_fault_s[v] >= DEVIATION.comes_s:
                flags |= FLAGS["wheels_contradict"]
            if self.m.speed_stuck_s[v] >= STUCK.comes_s:
                flags |= FLAGS["stuck"]
        # of the wheels and the vehicle's speed nobody knows which is right
        vehicle = (
            not isnan(now.speeds[corners])
            and abs(self.m.scale_error[corners]) > SCALE_LIMIT
        )
        if pair or vehicle or self._wheels_dead(now):
            flags |= FLAGS["speed_suspect"]
        return flags

    def _pressure_flags(self, now: Readings, which: int) -> int:
        flags = FLAGS["pressure_suspect"]
        for c, source in enumerate(now.pressure_of):
            if source == which:
                flags |= CORNER_PRESSURE_SUSPECT << c
        return flags

    def _held_flags(self, now: Readings) -> int:
        """Bits of the roles with recently rejected samples."""
        flags = 0
        watched = self.watched
        for c, role in enumerate(watched.speeds[:-1]):
            if self._suspect(now.now, role):
                flags |= WHEEL_SUSPECT << c
        if self._suspect(now.now, watched.speeds[-1]):
            flags |= FLAGS["speed_suspect"]
        for i, role in enumerate(watched.pressures):
            if self._suspect(now.now, role):
                flags |= self._pressure_flags(now, i)
        if self._suspect(now.now, watched.acceleration):
            flags |= FLAGS["acceleration_suspect"]
        if self._suspect(now.now, watched.torque):
            flags |= FLAGS["torque_suspect"]
        if any(self._suspect(now.now, role) for role in watched.temperatures):
            flags |= FLAGS["temperature_suspect"]
        return flags | FLAGS["samples_refused"]

    def _suspect(self, now: int, role: int) -> bool:
        return self.plan.timeout[role] >= 0.0 and now <= self.m.until[role]

    def _speed_flags(self, now: Readings, flags: int) -> int:
        """Return the bit of a suspect speed: no sound one is left."""
        last = len(now.speeds) - 1
        if not isnan(now.speeds[last]) and self.m.left_out[last] == 0.0:
            return 0
        present = False
        for c in range(last):
            if not isnan(now.speeds[c]):
                present = True
                if not flags & (WHEEL_SUSPECT << c):
                    return 0
        present = present or not isnan(now.speeds[last])
        return FLAGS["speed_suspect"] if present else 0

    def _outages(self, now: Readings) -> int:
        """Time the outages of each corner's heat; return their bits."""
        flags = 0
        last = self.m.last_sample
        silent = last == NEVER or now.now - last > SILENT_US
        if silent:
            flags |= FLAGS["silent"]
        if now.speed_known:
            self.m.last_speed = now.speed
        for c in range(len(now.heat_known)):
            if not silent and now.at_risk[c] and not now.heat_known[c]:
                self.m.outage_s[c] += now.dt_s
                flags |= FLAGS["heat_unknown"]
                if self.m.outage_s[c] > OUTAGE_S:
                    counts_s = OUTAGE_MEMORY * self.m.outage_s[c]
                    self.m.aftermath_s[c] = min(self.plan.settling_s, counts_s)
                    flags |= HEAT_LOST << c
                continue
            outage_s = self.m.outage_s[c] - now.dt_s / OUTAGE_MEMORY
            self.m.outage_s[c] = max(0.0, outage_s)
            if self.m.aftermath_s[c] > 0.0:
                aftermath_s = self.m.aftermath_s[c] - now.dt_s
                self.m.aftermath_s[c] = max(0.0, aftermath_s)
                flags |= HEAT_UNCERTAIN << c
        return flags

    def _sleeps(self, now: Readings) -> int:
        """Return the bit of a bus that sleeps because the car is parked."""
        m = self.m
        silent = m.last_of_car == NEVER or now.now - m.last_of_car > SILENT_US
        if now.speed_known and (now.speed > STANDING_MS or now.braking):
            m.parked_s = 0.0
        elif now.speed_known and not isnan(now.secured):
            m.parked_s = m.parked_s + now.dt_s if now.secured > 0.0 else 0.0
            m.unproven_s = 0.0
        elif not silent:
            m.unproven_s += now.dt_s
            if m.unproven_s > UNPROVEN_S:
                m.parked_s = 0.0
        return FLAGS["asleep"] if silent and m.parked_s >= PARKED_S else 0


def _median(values: Sequence[float]) -> tuple[float, int]:
    """Median and count of the values that are not nan; 0 if there are none."""
    known = [value for value in values if not isnan(value)]
    return (statistics.median(known), len(known)) if known else (0.0, 0)
