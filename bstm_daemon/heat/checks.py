"""Checks of the inputs against physics, each other and their own past.

The pure-Python form of ``_plausibility.c``; both do the same operations in
the same order. :meth:`Checks.admit` judges one sample, :meth:`Checks.close`
what holds at the end of a step; thresholds are those of
:mod:`bstm_daemon.heat.plausibility`. The memory lives in the arrays of
:class:`~bstm_daemon.heat.sample_state.SampleState`, after that of the pass.
"""

from __future__ import annotations

from math import exp, isnan
from typing import TYPE_CHECKING

from bstm_daemon.heat.check_layout import (
    CHECK_NUMBERS,
    CHECK_TIMES,
    CORNER_CHECKS,
    NEVER,
    PRESSURE_CHECKS,
    UNKNOWN,
    VOICE_CHECKS,
)
from bstm_daemon.heat.plausibility import (
    APART_BRAKING,
    APART_MS,
    APART_SHARE,
    CONTRADICTION,
    FROZEN_PRESSURE_MS,
    FROZEN_PRESSURE_PA,
    FROZEN_PRESSURE_S,
    FROZEN_SPEED_MS,
    FROZEN_SPEED_S,
    HOLD_US,
    INERTIA,
    INERTIA_FILTER_S,
    INERTIA_MS2,
    MOVES_S,
    MOVING_MS,
    OUTAGE_MEMORY,
    OUTAGE_S,
    REVERSED,
    REVERSED_MEMORY_S,
    REVERSED_MOTION,
    REVERSED_MS2,
    REVERSED_SHARE,
    SILENT_US,
    STUCK,
    SWITCH,
    SWITCH_MS,
    SWITCH_PRESSURE_PA,
)
from bstm_daemon.heat.sample_plan import (
    CORNER_PRESSURE_SUSPECT,
    FLAGS,
    HEAT_DOUBT,
    HEAT_LOST,
    WHEEL_SUSPECT,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.heat.check_layout import Readings, Watched


class Checks:
    """The memory of all checks, unpacked; :meth:`packed` packs it again."""

    def __init__(
        self,
        limits: Sequence[Sequence[float]],
        settling_s: float,
        watched: Watched,
        times: Sequence[int],
        numbers: Sequence[float],
    ) -> None:
        """Unpack *times* and *numbers*.

        Args:
            limits: low, high, step and rate, each by role number.
            settling_s: the longest that an outage is felt [s].
            watched: the roles.
            times: as ``check_layout`` has them [us].
            numbers: likewise.
        """
        self.low, self.high, self.step, self.rate = limits
        self.settling_s = settling_s
        self.watched = watched
        roles, corners = len(self.low), len(watched.voices) - 1
        self.heard, self.suspect_until, self.out_of_range, self.refused = (
            times[: len(CHECK_TIMES)]
        )
        at = len(CHECK_TIMES)
        self.candidate_stamp = list(times[at : at + roles])
        self.until = list(times[at + roles : at + 2 * roles])
        at = len(CHECK_NUMBERS)
        (
            self.slow_speed,
            self.slow_acceleration,
            self.inertia_doubt,
            self.switch_doubt,
            self.pair_doubt,
            self.last_speed,
            self.agreement,
            self.motion,
            self.reversed_doubt,
        ) = numbers[:at]
        self.candidate = list(numbers[at : at + roles])
        at += roles
        blocks = []
        for names, size in (
            (CORNER_CHECKS, corners),
            (VOICE_CHECKS, corners + 1),
            (PRESSURE_CHECKS, corners + 2),
        ):
            for _ in names:
                blocks.append(list(numbers[at : at + size]))
                at += size
        self.blocks = blocks
        self.outage_s, self.doubt_s = blocks[:2]
        self.apart, self.held, self.held_s, self.mark = blocks[2:6]
        self.stuck, self.left_out = blocks[6:8]
        self.p_held, self.p_held_s, self.p_mark, self.p_stuck = blocks[8:]

    def packed(self) -> tuple[list[int], list[float]]:
        """Return the memory as it was given."""
        times = [self.heard, self.suspect_until]
        times += [self.out_of_range, self.refused]
        numbers = [
            *(self.slow_speed, self.slow_acceleration, self.inertia_doubt),
            *(self.switch_doubt, self.pair_doubt, self.last_speed),
            *(self.agreement, self.motion, self.reversed_doubt),
            *self.candidate,
        ]
        for block in self.blocks:
            numbers += block
        return (
            times + self.candidate_stamp + self.until,
            numbers,
        )

    def admit(
        self, at_us: int, role: int, value: float, last: float, since: int
    ) -> bool:
        """Whether *value* is a sample of *role*.

        *last* is the role's present value and *since* its stamp [us], NEVER
        where there is none or the order of the two is not known: then only
        the range counts.
        """
        self.heard = at_us
        if value < self.low[role] or value > self.high[role]:
            self.out_of_range += 1
            self._hold(at_us, role)
            return False
        if since != NEVER and self._apart(role, value - last, at_us - since):
            first = self.candidate_stamp[role]
            if (
                first == NEVER
                or at_us <= first
                or self._apart(
                    role, value - self.candidate[role], at_us - first
                )
            ):
                self.candidate_stamp[role] = at_us
                self.candidate[role] = value
                self.refused += 1
                self._hold(at_us, role)
                return False
        self.candidate_stamp[role] = NEVER
        return True

    def _apart(self, role: int, change: float, time_us: int) -> bool:
        return abs(change) > (
            self.step[role] + self.rate[role] * (time_us * 1e-6)
        )

    def _hold(self, at_us: int, role: int) -> None:
        self.until[role] = at_us + HOLD_US
        self.suspect_until = max(self.suspect_until, self.until[role])

    def shift(self, ahead_us: int) -> None:
        """Move the axis, as the clock was set."""
        for stamps in (self.candidate_stamp, self.until):
            for role, stamp in enumerate(stamps):
                if stamp != NEVER:
                    stamps[role] = stamp + ahead_us
        if self.heard != NEVER:
            self.heard += ahead_us
        if self.suspect_until != NEVER:
            self.suspect_until += ahead_us

    def settle(self) -> None:
        """Forget outages: everything is at ambient temperature."""
        for c in range(len(self.outage_s)):
            self.outage_s[c] = self.doubt_s[c] = 0.0

    def close(self, now: Readings) -> int:
        """Judge a step that ends; returns bits of FLAGS."""
        median, count = _median(now.voices)
        self._compare_speeds(now, median, count)
        self._hold_speeds(now, median, count)
        refused = 0
        if now.now <= self.suspect_until:
            refused = self._held_flags(now)
            refused |= self._speed_flags(now, refused)
        self._hold_pressures(now, refused)
        self._compare_switch(now)
        self._compare_inertia(now, refused)
        flags = self._contradictions(now, count) | refused
        flags |= self._speed_flags(now, flags)
        return flags | self._answers(now)

    def _compare_speeds(
        self, now: Readings, median: float, count: int
    ) -> None:
        share = APART_BRAKING if now.braking else APART_SHARE
        allowed = APART_MS + share * median
        agreeing = 0
        for voice in now.voices:
            if abs(voice - median) <= allowed:
                agreeing += 1
        for v, voice in enumerate(now.voices):
            failed = None
            if count >= 3 and not isnan(voice):
                if abs(voice - median) > allowed:
                    failed = True if agreeing >= 2 else None
                elif median > MOVING_MS:
                    failed = False
            self.apart[v] = CONTRADICTION.after(
                self.apart[v], now.dt_s, failed=failed
            )
        if count == 2:
            self._compare_pair(now, median, share)

    def _compare_pair(
        self, now: Readings, median: float, share: float
    ) -> None:
        # the median of two is their mean
        high = low = median
        for voice in now.voices:
            high = max(high, voice)
            low = min(low, voice)
        failed = None
        if high - low > APART_MS + share * high:
            failed = True
        elif median > MOVING_MS:
            failed = False
        self.pair_doubt = CONTRADICTION.after(
            self.pair_doubt, now.dt_s, failed=failed
        )

    def _hold_speeds(self, now: Readings, median: float, count: int) -> None:
        for v, voice in enumerate(now.voices):
            # of two, the other; of three and more a median stands still
            # only where most of them do
            other = 2.0 * median - voice if count == 2 else median
            if isnan(voice) or voice != self.held[v]:
                self.held[v] = 0.0 if isnan(voice) else voice
                self.held_s[v] = 0.0
                self.mark[v] = 0.0 if isnan(other) else other
            else:
                self.held_s[v] += now.dt_s
            failed = None
            if count >= 2 and not isnan(voice):
                if self.held_s[v] < MOVES_S:
                    failed = False
                elif (
                    self.held_s[v] >= FROZEN_SPEED_S
                    and abs(other - self.mark[v]) > FROZEN_SPEED_MS
                ):
                    failed = True
            self.stuck[v] = STUCK.after(self.stuck[v], now.dt_s, failed=failed)
            self.left_out[v] = float(
                self.apart[v] >= CONTRADICTION.comes_s
                or self.stuck[v] >= STUCK.comes_s
            )

    def _hold_pressures(self, now: Readings, refused: int) -> None:
        # what noise made of the speed is no driving
        unsure = bool(refused & FLAGS["speed_suspect"])
        for i, pressure in enumerate(now.pressures):
            if isnan(pressure) or pressure != self.p_held[i]:
                self.p_held[i] = 0.0 if isnan(pressure) else pressure
                self.p_held_s[i] = 0.0
                self.p_mark[i] = now.speed
            else:
                self.p_held_s[i] += now.dt_s
            if unsure:
                self.p_mark[i] = now.speed
            failed = None
            if not isnan(pressure) and now.speed_known:
                if (
                    pressure <= FROZEN_PRESSURE_PA
                    or self.p_held_s[i] < MOVES_S
                ):
                    failed = False
                elif (
                    self.p_held_s[i] >= FROZEN_PRESSURE_S
                    and abs(now.speed - self.p_mark[i]) > FROZEN_PRESSURE_MS
                ):
                    failed = True
            self.p_stuck[i] = STUCK.after(
                self.p_stuck[i], now.dt_s, failed=failed
            )

    def _compare_switch(self, now: Readings) -> None:
        # only the pedal's own pressure: assistance fills the other circuits
        failed = None
        primary = now.pressures[0]
        if (
            not isnan(primary)
            and now.speed > SWITCH_MS
            and not isnan(now.brake_switch)
            and now.esc_active == 0.0
        ):
            failed = primary > SWITCH_PRESSURE_PA and now.brake_switch == 0.0
        self.switch_doubt = SWITCH.after(
            self.switch_doubt, now.dt_s, failed=failed
        )

    def _compare_inertia(self, now: Readings, refused: int) -> None:
        noise = refused & (
            FLAGS["speed_suspect"] | FLAGS["acceleration_suspect"]
        )
        if isnan(now.acceleration) or not now.speed_known or noise:
            self.slow_speed = UNKNOWN
            return
        if self.slow_speed < 0.0:
            self.slow_speed = now.speed
            self.slow_acceleration = now.acceleration
        share = 1.0 - exp(-now.dt_s / INERTIA_FILTER_S)
        self.slow_speed += share * (now.speed - self.slow_speed)
        self.slow_acceleration += share * (
            now.acceleration - self.slow_acceleration
        )
        gained = (now.speed - self.slow_speed) / INERTIA_FILTER_S
        failed = abs(self.slow_acceleration - gained) > INERTIA_MS2
        self.inertia_doubt = INERTIA.after(
            self.inertia_doubt, now.dt_s, failed=failed
        )
        self._compare_direction(now.dt_s, gained)

    def _compare_direction(self, dt_s: float, gained: float) -> None:
        faded = dt_s / REVERSED_MEMORY_S
        self.agreement -= faded * self.agreement
        self.motion -= faded * self.motion
        if abs(gained) > REVERSED_MS2:
            self.agreement += self.slow_acceleration * gained * dt_s
            self.motion += gained * gained * dt_s
        failed = None
        if self.motion > REVERSED_MOTION:
            if self.agreement < -REVERSED_SHARE * self.motion:
                failed = True
            elif self.agreement > REVERSED_SHARE * self.motion:
                failed = False
        self.reversed_doubt = REVERSED.after(
            self.reversed_doubt, dt_s, failed=failed
        )

    def _contradictions(self, now: Readings, count: int) -> int:
        """Bits of the checks of whole steps; absent inputs have none."""
        flags = self._speed_contradictions(now, count)
        switch = self.switch_doubt >= SWITCH.comes_s and not isnan(
            now.brake_switch
        )
        for i, pressure in enumerate(now.pressures):
            if isnan(pressure):
                continue
            stuck = self.p_stuck[i] >= STUCK.comes_s
            alone = switch and i == 0
            if stuck:
                flags |= FLAGS["stuck"]
            if alone:
                flags |= FLAGS["switch_contradicts"]
            if stuck or alone:
                flags |= self._pressure_flags(now, i)
        contradicted = (
            self.inertia_doubt >= INERTIA.comes_s
            or self.reversed_doubt >= REVERSED.comes_s
        )
        if contradicted and not isnan(now.acceleration):
            flags |= FLAGS["acceleration_suspect"]
            flags |= FLAGS["acceleration_contradicts"]
        return flags

    def _speed_contradictions(self, now: Readings, count: int) -> int:
        flags = 0
        corners = len(now.voices) - 1
        pair = count == 2 and self.pair_doubt >= CONTRADICTION.comes_s
        for v, voice in enumerate(now.voices):
            if isnan(voice):
                continue
            suspect = pair or self.left_out[v] != 0.0
            if suspect and v < corners:
                flags |= WHEEL_SUSPECT << v
            if pair or self.apart[v] >= CONTRADICTION.comes_s:
                flags |= FLAGS["wheels_contradict"]
            if self.stuck[v] >= STUCK.comes_s:
                flags |= FLAGS["stuck"]
        if pair:
            flags |= FLAGS["speed_suspect"]
        return flags

    def _pressure_flags(self, now: Readings, which: int) -> int:
        flags = FLAGS["pressure_suspect"]
        for c, source in enumerate(now.sources):
            if source == which:
                flags |= CORNER_PRESSURE_SUSPECT << c
        return flags

    def _held_flags(self, now: Readings) -> int:
        """Bits of the roles that have refused samples of late."""
        flags = 0
        watched = self.watched
        for c, role in enumerate(watched.voices[:-1]):
            if self._suspect(now.now, role):
                flags |= WHEEL_SUSPECT << c
        if self._suspect(now.now, watched.voices[-1]):
            flags |= FLAGS["speed_suspect"]
        for i, role in enumerate(watched.pressures):
            if self._suspect(now.now, role):
                flags |= self._pressure_flags(now, i)
        if self._suspect(now.now, watched.acceleration):
            flags |= FLAGS["acceleration_suspect"]
        if self._suspect(now.now, watched.torque):
            flags |= FLAGS["torque_suspect"]
        for role in watched.temperatures:
            if self._suspect(now.now, role):
                flags |= FLAGS["temperature_suspect"]
        return flags | FLAGS["samples_refused"]

    def _suspect(self, now: int, role: int) -> bool:
        return role >= 0 and now <= self.until[role]

    def _speed_flags(self, now: Readings, flags: int) -> int:
        """The speed is suspect where no sound voice is left."""
        last = len(now.voices) - 1
        if not isnan(now.voices[last]) and self.left_out[last] == 0.0:
            return 0
        present = False
        for c in range(last):
            if not isnan(now.voices[c]):
                present = True
                if not flags & (WHEEL_SUSPECT << c):
                    return 0
        present = present or not isnan(now.voices[last])
        return FLAGS["speed_suspect"] if present else 0

    def _answers(self, now: Readings) -> int:
        """Bits of what is done where the heat of a corner is not known."""
        flags = 0
        silent = self.heard == NEVER or now.now - self.heard > SILENT_US
        if silent:
            flags |= FLAGS["silent"]
        if now.speed_known:
            self.last_speed = now.speed
        for c in range(len(now.heat_known)):
            if not silent and now.at_risk[c] and not now.heat_known[c]:
                self.outage_s[c] += now.dt_s
                flags |= FLAGS["heat_unknown"]
                if self.outage_s[c] > OUTAGE_S:
                    felt_s = OUTAGE_MEMORY * self.outage_s[c]
                    self.doubt_s[c] = min(self.settling_s, felt_s)
                    flags |= HEAT_LOST << c
                continue
            outage_s = self.outage_s[c] - now.dt_s / OUTAGE_MEMORY
            self.outage_s[c] = max(0.0, outage_s)
            if self.doubt_s[c] > 0.0:
                doubt_s = self.doubt_s[c] - now.dt_s
                self.doubt_s[c] = max(0.0, doubt_s)
                flags |= HEAT_DOUBT << c
        return flags


def _median(values: Sequence[float]) -> tuple[float, int]:
    """Median and count of the numbers among *values*; 0 of none."""
    known = sorted(value for value in values if not isnan(value))
    count = len(known)
    if count == 0:
        return 0.0, 0
    middle = count // 2
    if count % 2:
        return known[middle], count
    return 0.5 * (known[middle - 1] + known[middle]), count
