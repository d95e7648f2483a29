"""The pass over samples in pure Python: fallback and oracle of ``_samples.c``.

Samples (time, role, value) arrive in the order of the log or the bus. Between
two samples every value is held; energy and distance are integrated at sample
rate and handed to the estimator's step as means, because sampling the power
at the steps would cost 1 K on the disc. One row or a million give the same
bits: the whole memory of the pass is :class:`SampleState`.

Time. A sample up to 1 s behind the pass is late: its value counts from now.
A jump (more than 1 s back, more than an hour ahead) must be confirmed by a
second stamp near the first; the sample that announced it is dropped. Back:
the axis is set back, nothing is marched. Ahead up to 12 h: a silent bus,
marched. Up to 30 days: parked, everything settles to ambient. Beyond: the
clock was set; the axis is moved and nothing cools.
"""

from __future__ import annotations

from array import array
from math import exp, isfinite, nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.heat.check_layout import NEVER, UNKNOWN, Readings
from bstm_daemon.heat.friction_law import friction_factor
from bstm_daemon.heat.fusion import feel, fuse
from bstm_daemon.heat.sample_plan import (
    CHANNELS,
    FLAGS,
    MEASURED_FROM,
    MODES,
    VEHICLE_CHANNELS,
    SamplePlan,
)
from bstm_daemon.heat.sample_state import (
    NONE,
    OTHER,
    SampleMemory,
    SampleState,
)

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

LATE_US: Final = 1_000_000
AHEAD_US: Final = 3_600_000_000
SETTLED_US: Final = 12 * 3_600_000_000
CLOCK_SET_US: Final = 30 * 24 * 3_600_000_000
CONFIRM_US: Final = 10_000_000
LIMIT_US: Final = 2**60

TAIL: Final = 4.0
"""Time constants of the speed filter that Feed-Back runs on after release."""

LIGHT_PRESSURE_PA: Final = 2e4
"""Pressure counts from here on while the brake switch is on (mode fused)."""

FUSED: Final = MODES["fused"]
_UNLEARNED: Final = (nan,) * (len(VEHICLE_CHANNELS) - 5)

TICK: Final = -1
"""The role number of a tick: time passes, nothing is sampled."""

DONE: Final = 0
FULL: Final = 1
SETTLE: Final = 2
JUMP: Final = 3
_DROP: Final = 4


def sample_pass(  # noqa: PLR0913, PLR0917  (the signature of the compiled pass)
    plan: SamplePlan,
    state: SampleState,
    times_us: Sequence[int],
    roles: Sequence[int],
    values: Sequence[float],
    first: int,
    rows: MutableSequence[float],
    vehicle_rows: MutableSequence[float],
    row_times_us: MutableSequence[int],
) -> tuple[int, int, int]:
    """Consume samples from *first* on until they or the row space end.

    Args:
        plan: what to compute.
        state: changed in place.
        times_us: stamps [us], int64.
        roles: role numbers, int32; :data:`TICK` only moves time.
        values: SI values.
        first: index of the first sample to consume.
        rows: room for [steps, corners, len(CHANNELS)] numbers.
        vehicle_rows: room for [steps, len(VEHICLE_CHANNELS)].
        row_times_us: room for the closing time of each step.

    Returns:
        (index of the next sample, steps written, code): ``DONE``; ``FULL``,
        call again with empty rows; ``SETTLE``, the car stood for longer than
        12 h: set the nodes to ambient, then call again; ``JUMP``, the time
        axis was moved, call again. The steps of one call are contiguous.
    """
    run = _Pass(plan, state, rows, vehicle_rows, row_times_us)
    index = first
    while index < len(times_us):
        # most samples come with others of their frame
        if times_us[index] == run.now != NEVER:
            run.pending, code = NEVER, DONE
        else:
            code = run.move_to(times_us[index])
        if code == FULL:
            run.store()
            return index, run.steps, FULL
        if code != _DROP and 0 <= roles[index] < len(run.value):
            run.take(times_us[index], roles[index], values[index])
        # values age at every sample, wherever the stream is cut into calls
        run.stale = True
        index += 1
        if code in (SETTLE, JUMP):
            run.store()
            return index, run.steps, code
    run.store()
    return index, run.steps, DONE


class _Pass(SampleMemory):
    """The pass itself."""

    def move_to(self, time_us: int) -> int:  # noqa: PLR0911
        """Integrate and close steps up to *time_us*.

        Returns:
            DONE, FULL (nothing taken from this sample yet), SETTLE, JUMP or
            _DROP.
        """
        if abs(time_us) > LIMIT_US:
            self.dropped += 1
            return _DROP
        if self.now == NEVER:
            self._start_axis(time_us)
            return DONE
        ahead = time_us - self.now
        if -LATE_US <= ahead <= AHEAD_US:
            if ahead < 0:
                self.late += 1
                return DONE
            return self._march_to(time_us)
        if self.pending == NEVER or not (
            time_us != self.pending
            and abs(time_us - self.pending) <= CONFIRM_US
        ):
            if time_us != self.pending:
                self.pending = time_us
            self.dropped += 1
            return _DROP
        if 0 < ahead <= SETTLED_US:
            return self._march_to(time_us)
        return self._move_axis(time_us, ahead)

    def _move_axis(self, time_us: int, ahead: int) -> int:
        self.pending = NEVER
        self.jumps += 1
        settled = 0 < ahead <= CLOCK_SET_US
        self.flags |= FLAGS["settled" if settled else "clock_jump"]
        if settled:
            self.checks.settle()
        else:
            self.checks.shift(ahead)
            for role, stamp in enumerate(self.stamp):
                if stamp != NEVER:
                    self.stamp[role] = stamp + ahead
        self._start_axis(time_us)
        return SETTLE if settled else JUMP

    def _start_axis(self, time_us: int) -> None:
        """Let the open step start anew at *time_us*."""
        self.now = time_us
        self.grid = (time_us // self.step_us + 1) * self.step_us
        self.clear()
        self.stale = True

    def _march_to(self, time_us: int) -> int:
        while self.grid <= time_us:
            if self.steps == self.room:
                return FULL
            self._integrate(self.grid)
            self._close()
        if time_us > self.now:
            self._integrate(time_us)
        self.pending = NEVER
        return DONE

    def take(self, time_us: int, role: int, value: float) -> None:
        """Let *role* have *value* from now on, if it is a sample.

        Only a number is one, and only one that the checks admit; of a late
        one nobody knows how fast it came from the one before.
        """
        if not isfinite(value):
            return
        at_us = max(time_us, self.now)
        since = NEVER
        if at_us == time_us and self.valid(role):
            since = self.stamp[role]
        if self.checks.admit(at_us, role, value, self.value[role], since):
            self.value[role] = value
            self.stamp[role] = at_us

    def _refresh(self) -> None:
        """Form speeds and pressures from the values that count now."""
        value, valid = self.value, self.valid
        vehicle = valid(self.vehicle_role["vehicle_speed"])
        counts = [valid(ints[0]) for ints in self.corner_ints]
        heard = vehicle
        if any(self.checks.left_out):
            counts, heard = self._sound_voices(counts, vehicle=vehicle)
        total, signed, count = 0.0, 0.0, 0
        for own, ints in zip(counts, self.corner_ints, strict=True):
            if own:
                speed = value[ints[0]]
                total += abs(speed)
                signed += speed
                count += 1
        if heard:
            signed = value[self.vehicle_role["vehicle_speed"]]
            self.speed = abs(signed)
        else:
            self.speed = total / count if count else 0.0
        # in reverse what points forward pushes against the motion
        self.heading = -1.0 if signed < 0.0 else 1.0
        self.speed_known = count > 0 or vehicle
        self.wheel = [
            abs(value[ints[0]]) if own else self.speed
            for own, ints in zip(counts, self.corner_ints, strict=True)
        ]
        self._refresh_pressures()
        # the foot is on the pedal: fusion counts the lightest pressure
        self.pressing_pa = self.on_pressure
        if self.mode == FUSED and self.vehicle("brake_switch", 0.0) > 0.0:
            self.pressing_pa = min(self.on_pressure, LIGHT_PRESSURE_PA)
        self.stale = False

    def _sound_voices(
        self, present: list[bool], *, vehicle: bool
    ) -> tuple[list[bool], bool]:
        """Which wheels, and whether the vehicle's speed, are believed.

        Those that the others contradict are not, unless none is left.
        """
        doubted = [left_out != 0.0 for left_out in self.checks.left_out]
        wheels = [one and not doubted[c] for c, one in enumerate(present)]
        heard = vehicle and not doubted[self.corners]
        return (wheels, heard) if heard or any(wheels) else (present, vehicle)

    def _refresh_pressures(self) -> None:
        """Form each corner's pressure: its own, its circuit's or axle's."""
        value, valid = self.value, self.valid
        learned, roles = self.observer.m, self.vehicle_role
        primary = roles["primary_pressure"]
        secondary = roles["secondary_pressure"]
        tare = learned["tare_primary"]
        by_primary, by_secondary = valid(primary), valid(secondary)
        axle = (value[primary] if by_primary else tare) - tare
        other = value[secondary] - learned["tare_secondary"]
        self.pressure_present = False
        for c, ints in enumerate(self.corner_ints):
            own, second = valid(ints[1]), ints[2] and by_secondary
            if own or second or by_primary:
                self.pressure_present = True
            pressure = other if second else axle
            if own:
                pressure = value[ints[1]]
            elif ints[3] and self.points:
                pressure = self.rear_pressure(pressure)
            self.target[c] = max(0.0, pressure)

    def _integrate(self, time_us: int) -> None:
        """Hold all values from now to *time_us* and add up."""
        if time_us <= self.now:
            return
        if self.stale:
            self._refresh()
        h = (time_us - self.now) * 1e-6
        v = self.speed
        highest = self._integrate_corners(h)
        gained, middle = self._filter_speed(h, v)
        impulse, inertia_kg = self._outer_impulse(h, v)
        force_s = impulse - inertia_kg * gained
        if self.pressure_present:
            pressed = highest > self.pressing_pa
        else:
            pressed = force_s > self.on_force * h
        if pressed:
            # the filtered speed still falls when the brake has let go
            whole = inertia_kg > self.rotating_mass
            self.tail_s = TAIL * self.filter_s if whole else 0.0
        braked = impulse * v - inertia_kg * (gained * middle)
        if pressed or self.tail_s > 0.0:
            self.force_sum += force_s
            self.energy_fb += braked
        elif (
            self.unpressed_share > 0.0
            and self.feed_back_known()
            and force_s > self.on_force * h
        ):
            self.force_sum += self.unpressed_share * force_s
            self.unpressed_j += self.unpressed_share * braked
            for c in range(self.corners):
                self.on_time[c] += h
        if not pressed:
            self.tail_s = max(self.tail_s - h, 0.0)
        if self.mode == FUSED:
            feel(self, h, v)
        self.speed_sum += v * h
        self.distance += v * h
        self.now = time_us

    def _integrate_corners(self, h: float) -> float:
        """Add up each corner's Feed-Forward; the highest mean pressure."""
        highest = 0.0
        for c, (per_pa, pushout, lag_s, _) in enumerate(self.corner_floats):
            target = self.target[c]
            # a pressure measured at the wheel has the lag in it
            if lag_s > 0.0 and not self.valid(self.corner_ints[c][1]):
                decay = exp(-h / lag_s)
                apart = self.lagged[c] - target
                p = target + apart * (lag_s * (1.0 - decay) / h)
                self.lagged[c] = target + apart * decay
            else:
                p = target
                self.lagged[c] = target
            pushing = p - pushout
            pressed = p > self.pressing_pa
            if pressed and pushing > 0.0:
                grip = per_pa
                if self.laws:
                    grip *= friction_factor(
                        self.laws[c], self.interface_k[c], p, self.wheel[c]
                    )
                power = grip * pushing * (self.wheel[c] / self.radius)
                self.energy_ff[c] += power * h
                self.observer.brake_sum[c] += grip * pushing / self.radius * h
            self.pressure_sum[c] += p * h
            if pressed:
                self.on_time[c] += h
            highest = max(highest, p)
        return highest

    def _filter_speed(self, h: float, v: float) -> tuple[float, float]:
        """Change and mean of the filtered speed over *h* seconds."""
        if not self.speed_known:
            self.filtered = UNKNOWN
            return 0.0, v
        if self.filtered < 0.0:
            # a speed that appears is not an acceleration
            self.filtered = v
            return 0.0, v
        before = self.filtered
        self.filtered = v + (before - v) * exp(-h / self.filter_s)
        return self.filtered - before, 0.5 * (before + self.filtered)

    def _outer_impulse(self, h: float, v: float) -> tuple[float, float]:
        """All of Eq 4.11 but the change of speed, times *h* [N s].

        The accelerometer feels the change of the car's own speed and the
        slope; then only the wheels' inertia is left to the filtered speed.

        Returns:
            (impulse, mass that the filtered speed's change acts on [kg]).
        """
        drag = (
            (self.quadratic * v + self.linear) * v + self.constant
            if v > 0.0
            else 0.0
        )
        torque = self.vehicle("powertrain_torque", self.assumed_torque)
        external = self.vehicle("external_force", 0.0)
        driving = self.heading * (torque / self.radius + external)
        impulse = (driving - drag) * h
        acceleration = self.vehicle_role["acceleration_longitudinal"]
        if self.slope == 0 and self.valid(acceleration):
            felt = self.mass * (self.heading * self.value[acceleration]) * h
            return impulse - felt, self.rotating_mass
        return impulse, self.mass + self.rotating_mass

    def _close(self) -> None:
        """Write the row of the step that ends now and start the next."""
        dt_s = self.step_us * 1e-6
        # the air of a silent car is nearer the last one than the default
        air = self.vehicle_role["ambient_temperature"]
        known = air >= 0 and self.stamp[air] != NEVER
        ambient = self.value[air] if known else self.ambient_k
        wetness = min(max(self.vehicle("rain", 0.0), 0.0), 1.0)
        unpressed = max(self.unpressed_j, 0.0)
        energy = max(self.energy_fb, 0.0) + unpressed
        power_fb = energy / dt_s
        speed = self.speed_sum / dt_s
        self.total_fb += energy
        answers, at_risk = self.heat_answers()
        flags = self.flags | self.missing()
        now = self._readings(dt_s, answers, at_risk)
        flags |= self.checks.close(now)
        fused = None
        if self.mode == FUSED:
            fused = fuse(self, now, flags)
            flags |= fused.flags
        at = self.steps * self.corners * len(CHANNELS)
        for c, ints in enumerate(self.corner_ints):
            power_ff = self.energy_ff[c] / dt_s
            share = self.corner_floats[c][3]
            chosen = power_ff + share * (unpressed / dt_s)
            if fused is not None:
                chosen = fused.power[c]
            elif (self.mode == MODES["fb"]) is (answers[c] != OTHER):
                chosen = share * power_fb
            if answers[c] == OTHER and at_risk[c]:
                flags |= FLAGS["heat_substituted"]
            self.total_ff[c] += self.energy_ff[c]
            self.rows[at : at + MEASURED_FROM] = array(
                "d",
                [
                    speed,
                    self.pressure_sum[c] / dt_s,
                    self.on_time[c] / dt_s,
                    wetness,
                    ambient,
                    chosen,
                    self.total_ff[c],
                    share * self.total_fb,
                    nan if fused is None else fused.spread[c],
                ],
            )
            for i, role in enumerate(ints[4:]):
                self.rows[at + MEASURED_FROM + i] = (
                    self.value[role] if self.valid(role) else float("nan")
                )
            at += len(CHANNELS)
        at = self.steps * len(VEHICLE_CHANNELS)
        self.vehicle_rows[at] = speed
        self.vehicle_rows[at + 1] = self.distance
        self.vehicle_rows[at + 2] = max(self.force_sum, 0.0) / dt_s
        self.vehicle_rows[at + 3] = self.input_age_s()
        learned = _UNLEARNED if fused is None else fused.learned
        self.vehicle_rows[at + 4 : at + len(VEHICLE_CHANNELS)] = array(
            "d", [*learned, float(flags)]
        )
        self.row_times[self.steps] = self.grid
        self.steps += 1
        self.flags = 0
        self.grid += self.step_us
        self.clear()
        self.interface_k[:] = self.told_k
        # a value may have aged out: speeds and pressures are formed anew
        self.stale = True

    def _readings(
        self, dt_s: float, answers: Sequence[int], at_risk: Sequence[bool]
    ) -> Readings:
        """What the checks need of the step that ends now."""
        roles = self.vehicle_role
        acceleration = self.vehicle("acceleration_longitudinal", nan)
        brake_switch = self.vehicle("brake_switch", nan)
        return Readings(
            now=self.now,
            dt_s=dt_s,
            speed=self.speed,
            speed_known=self.speed_known,
            braking=brake_switch > 0.0
            or max(self.target, default=0.0) > self.on_pressure,
            brake_switch=brake_switch,
            esc_active=self.vehicle("esc_active", 0.0),
            acceleration=self.heading * acceleration,
            voices=[
                *(abs(self._reading(ints[0])) for ints in self.corner_ints),
                abs(self._reading(roles["vehicle_speed"])),
            ],
            pressures=[
                self._reading(roles["primary_pressure"]),
                self._reading(roles["secondary_pressure"]),
                *(self._reading(ints[1]) for ints in self.corner_ints),
            ],
            sources=[self._source(c) for c in range(self.corners)],
            heat_known=[answer != NONE for answer in answers],
            at_risk=at_risk,
        )

    def _reading(self, role: int) -> float:
        return self.value[role] if self.valid(role) else nan

    def _source(self, corner: int) -> int:
        """Place among the pressures of the one that the corner goes by."""
        ints = self.corner_ints[corner]
        if self.valid(ints[1]):
            return 2 + corner
        if ints[2] and self.valid(self.vehicle_role["secondary_pressure"]):
            return 1
        return 0
