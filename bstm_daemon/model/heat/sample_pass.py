"""The pass over samples in pure Python: fallback and oracle of the C form.

Samples (time, role, value) arrive in the order of the log or the bus. Between
two samples every value is held; energy and distance are integrated at sample
rate and handed to the estimator's step as means, because sampling the power
at the steps would cost 1 K on the disc. One row or a million give the same
bits: all memory of the pass is in :class:`SampleState`. The compiled form
is ``native/heat/sample_pass.c``; both do the same operations in the same
order.

Time. A sample up to 1 s behind the pass is late: its value counts from now.
A jump (more than 1 s back, more than an hour ahead) must be confirmed by a
second stamp near the first; the sample that announced it is dropped. Back:
the axis is set back, nothing is marched. Ahead up to 12 h: a silent bus,
marched. Up to 30 days: parked, everything settles to ambient. Beyond: the
clock was set; the axis is moved and nothing cools.

A silence of the bus ends the call twice, as it begins and at the first speed
after it, so that the estimator can judge whether the car drove meanwhile.
"""

from __future__ import annotations

from array import array
from math import exp, isfinite, nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.channels import FLAGS, LEARNED_CHANNELS
from bstm_daemon.model.heat import check_rules as rules
from bstm_daemon.model.heat.friction_law import friction_factor
from bstm_daemon.model.heat.fusion import accumulate_motion, fuse
from bstm_daemon.model.heat.inputs import (
    BRAKE_TORQUE_ROLE,
    MODE_FB,
    MODE_FUSED,
    OTHER,
    PEDAL_AT_REST,
    PEDAL_BRAKES,
    SLOPE_ACCELEROMETER,
    Inputs,
)
from bstm_daemon.model.heat.memory import (
    NEVER,
    UNKNOWN,
    SampleMemory,
    SampleState,
)
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

    from bstm_daemon.model.heat.sample_plan import SamplePlan

LATE_US: Final = 1_000_000
AHEAD_US: Final = 3_600_000_000
SETTLED_US: Final = 12 * 3_600_000_000
CLOCK_SET_US: Final = 30 * 24 * 3_600_000_000
CONFIRM_US: Final = 10_000_000
LIMIT_US: Final = 2**60

TAIL: Final = 4.0
"""Time for which Feed-Back continues after release, in time constants of the
speed filter."""

_UNLEARNED: Final = (nan,) * len(LEARNED_CHANNELS)
_ACCELERATION: Final = ROLE_INDEX["acceleration_longitudinal"]
_TORQUE: Final = ROLE_INDEX["powertrain_torque"]
_LOST: Final = FLAGS["silent"] | FLAGS["asleep"]
_AMBIENT: Final = ROLE_INDEX["ambient_temperature"]

TICK: Final = -1
"""Role number of a tick, which moves time and carries no sample."""

DONE: Final = 0
FULL: Final = 1
SETTLE: Final = 2
JUMP: Final = 3
DROP: Final = 4
LOST: Final = 5
BACK: Final = 6


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
        axis was moved, call again; ``LOST``, the bus fell silent, call again;
        ``BACK``, this is the first speed after a silence, call again. The
        steps of one call are contiguous.
    """
    run = _Pass(plan, state)
    run.rows, run.vehicle_rows = rows, vehicle_rows
    run.row_times = row_times_us
    index = first
    while index < len(times_us):
        # most samples come with others of their frame
        if times_us[index] == run.m.now != NEVER:
            run.m.pending, code = NEVER, DONE
        else:
            code = run.move_to(times_us[index])
        if code in (FULL, LOST):
            run.store()
            return index, run.steps, code
        if code != DROP and 0 <= roles[index] < len(run.m.value):
            run.take(times_us[index], roles[index], values[index])
        # values age at every sample, wherever the stream is cut into calls
        run.stale = True
        index += 1
        if code not in (SETTLE, JUMP) and run.is_back():
            code = BACK
        if code in (SETTLE, JUMP, BACK):
            run.store()
            return index, run.steps, code
    run.store()
    return index, run.steps, DONE


class _Pass(Inputs):
    """The pass itself."""

    rows: MutableSequence[float]
    vehicle_rows: MutableSequence[float]
    row_times: MutableSequence[int]

    def __init__(self, plan: SamplePlan, state: SampleState) -> None:
        """Take *plan* and *state*; the caller gives the rows to write."""
        super().__init__(plan, state.memory())
        self.state = state
        self.steps = 0
        self.flags = state.flags[0]

    def store(self) -> None:
        """Write the state back."""
        self.state.store(SampleMemory(self.m, self.checks.m, self.observer.m))
        self.state.flags[0] = self.flags

    def move_to(self, time_us: int) -> int:  # noqa: PLR0911
        """Integrate and close steps up to *time_us*.

        Returns:
            DONE, FULL or LOST (nothing taken from this sample yet), SETTLE,
            JUMP or DROP.
        """
        if abs(time_us) > LIMIT_US:
            self.m.dropped += 1
            return DROP
        if self.m.now == NEVER:
            self._start_axis(time_us)
            return DONE
        ahead = time_us - self.m.now
        if -LATE_US <= ahead <= AHEAD_US:
            if ahead < 0:
                self.m.late += 1
                return DONE
            return self._march_to(time_us)
        if self.m.pending == NEVER or not (
            time_us != self.m.pending
            and abs(time_us - self.m.pending) <= CONFIRM_US
        ):
            if time_us != self.m.pending:
                self.m.pending = time_us
            self.m.dropped += 1
            return DROP
        if 0 < ahead <= SETTLED_US:
            return self._march_to(time_us)
        if 0 < ahead <= CLOCK_SET_US and self.m.unseen == 0.0:
            self.m.unseen = 1.0
            return LOST
        return self._move_axis(time_us, ahead)

    def _move_axis(self, time_us: int, ahead: int) -> int:
        self.m.pending = NEVER
        self.m.jumps += 1
        settled = 0 < ahead <= CLOCK_SET_US
        self.flags |= FLAGS["settled" if settled else "clock_jump"]
        if settled:
            self.checks.settle()
        else:
            self.checks.shift(ahead)
            for role, stamp in enumerate(self.m.stamp):
                if stamp != NEVER:
                    self.m.stamp[role] = stamp + ahead
        self._start_axis(time_us)
        return SETTLE if settled else JUMP

    def _start_axis(self, time_us: int) -> None:
        """Restart the open step at *time_us*."""
        self.m.now = time_us
        self.m.grid = (time_us // self.plan.step_us + 1) * self.plan.step_us
        self._clear()
        self.stale = True

    def _march_to(self, time_us: int) -> int:
        while self.m.grid <= time_us:
            if self.steps == len(self.row_times):
                return FULL
            self._integrate(self.m.grid)
            if self._close():
                return LOST
        if time_us > self.m.now:
            self._integrate(time_us)
        self.m.pending = NEVER
        return DONE

    def take(self, time_us: int, role: int, value: float) -> None:
        """Set *role* to *value* from now on, if the checks admit it.

        NaN is rejected. The rate of change of a late sample is unknown and
        not checked.
        """
        if not isfinite(value):
            return
        at_us = max(time_us, self.m.now)
        in_order = at_us == time_us and self.valid(role)
        since = self.m.stamp[role] if in_order else NEVER
        if self.checks.admit(at_us, role, value, self.m.value[role], since):
            self.m.value[role] = value
            self.m.stamp[role] = at_us

    def is_back(self) -> bool:
        """Whether the first speed after a silence has come just now."""
        if self.m.unseen == 0.0:
            return False
        self.refresh()
        self.stale = True
        if not self.speed_known:
            return False
        self.m.unseen = 0.0
        self.m.speed_after = self.speed
        return True

    def _integrate(self, time_us: int) -> None:
        """Integrate the held values from now to *time_us*."""
        if time_us <= self.m.now:
            return
        if self.stale:
            self.refresh()
        h = (time_us - self.m.now) * 1e-6
        v = self.ground_speed
        highest = self._integrate_corners(h)
        gained, middle = self._filter_speed(h, v)
        impulse, inertia_kg = self._outer_impulse(h, v)
        force_s = impulse - inertia_kg * gained
        if self.pressure_present:
            pressed = highest > self.pressing_pa
        else:
            pressed = self._brakes(h, force_s)
        if pressed:
            # the filtered speed still falls after the brake is released
            whole = inertia_kg > self.plan.rotating_kg
            self.m.tail_s = TAIL * self.plan.filter_s if whole else 0.0
        braked = impulse * v - inertia_kg * (gained * middle)
        if pressed or self.m.tail_s > 0.0:
            self.m.force_sum += force_s
            self.m.energy_fb += braked
        elif (
            self.plan.unpressed_share > 0.0
            and self.feed_back_known()
            and force_s > self.plan.on_force_n * h
        ):
            self.m.force_sum += self.plan.unpressed_share * force_s
            self.m.unpressed_j += self.plan.unpressed_share * braked
            for c in range(self.corners):
                self.m.on_time[c] += h
        if not pressed:
            self.m.tail_s = max(self.m.tail_s - h, 0.0)
        if self.plan.mode == MODE_FUSED:
            accumulate_motion(self, h)
        self.m.speed_sum += self.speed * h
        self.m.distance += self.speed * h
        self.m.now = time_us

    def _integrate_corners(self, h: float) -> float:
        """Integrate Feed-Forward; return the highest mean pressure."""
        highest = 0.0
        plan, m = self.plan, self.m
        for c, target in enumerate(self.target):
            lag_s = plan.lag_s[c]
            # a pressure measured at the wheel includes the lag
            if lag_s > 0.0 and not self.valid(self.pressure_role[c]):
                decay = exp(-h / lag_s)
                behind = m.lagged_pa[c] - target
                p = target + behind * (lag_s * (1.0 - decay) / h)
                m.lagged_pa[c] = target + behind * decay
            else:
                p = target
                m.lagged_pa[c] = target
            pushing = p - plan.pushout_pa[c]
            pressed = p > self.pressing_pa
            if pressed and pushing > 0.0:
                grip = plan.torque_per_pa[c]
                if self.laws:
                    grip *= friction_factor(
                        self.laws[c], m.interface_k[c], p, self.wheel[c]
                    )
                power = grip * pushing * (self.wheel[c] / plan.radius_m)
                m.energy_ff[c] += power * h
                force_n = grip * pushing / plan.radius_m
                self.observer.m.brake_sum[c] += force_n * h
            m.pressure_sum[c] += p * h
            if pressed:
                m.on_time[c] += h
            highest = max(highest, p)
        return highest

    def _filter_speed(self, h: float, v: float) -> tuple[float, float]:
        """Change and mean of the filtered speed over *h* seconds."""
        if not self.speed_known:
            self.m.filtered_speed = UNKNOWN
            return 0.0, v
        if self.m.filtered_speed < 0.0 or self.spinning:
            # neither the first speed after a gap nor slip is an acceleration
            self.m.filtered_speed, self.m.tail_s = v, 0.0
            return 0.0, v
        before = self.m.filtered_speed
        self.m.filtered_speed = v + (before - v) * exp(-h / self.plan.filter_s)
        return self.m.filtered_speed - before, 0.5 * (
            before + self.m.filtered_speed
        )

    def _brakes(self, h: float, force_s: float) -> bool:
        """Whether the motion brakes by *force_s* [N s], without a pressure.

        With the pedal at rest only what needs no drive counts, where it is
        more than errors of torque and drag; all of that until the pedal has
        shown braking for once, and after too much of it at rest.
        """
        plan, m = self.plan, self.m
        torque_nm = self.vehicle("powertrain_torque", plan.assumed_torque_nm)
        motor_nm = self.heading * self.vehicle("motor_torque", 0.0)
        # Eq 4.11 takes what the motor recovers for braking
        drive_nm = max(self.heading * torque_nm, 0.0) - min(motor_nm, 0.0)
        drive = drive_nm / plan.radius_m
        shown = (force_s / h - drive) / plan.mass_kg
        share = 1.0 - exp(-h / rules.PEDAL_S)
        m.decel_shown += share * (shown - m.decel_shown)
        if self.pedal == PEDAL_BRAKES:
            m.pedal_seen, m.pedal_lost = 1.0, 0.0
            return force_s > plan.on_force_n * h
        error = 1.0 if self.spinning else rules.DRIVE_ERROR
        enough = force_s > (plan.on_force_n + error * drive) * h
        if self.pedal != PEDAL_AT_REST:
            return enough
        felt = plan.slope == SLOPE_ACCELEROMETER and self.valid(_ACCELERATION)
        low = rules.PEDAL_LOW_MS2 + (0.0 if felt else rules.SLOPE_MS2)
        engine = 0.0 if self.valid(_TORQUE) else rules.ENGINE_MS2
        high = low + rules.PEDAL_MORE_MS2 + engine
        least = low + engine if m.pedal_seen != 0.0 else high
        if m.decel_shown > least and self.speed > rules.SWITCH_MS:
            m.pedal_lost += m.decel_shown * h
        if m.pedal_lost > rules.PEDAL_LOST_MS:
            m.pedal_seen = 0.0
        if m.pedal_seen == 0.0:
            return force_s > (plan.on_force_n + drive) * h
        # assistants brake without the pedal; the torque shows them
        least = high if self.valid(BRAKE_TORQUE_ROLE) else low
        return enough and m.decel_shown > least

    def _outer_impulse(self, h: float, v: float) -> tuple[float, float]:
        """Eq 4.11 without the change of speed, times *h* [N s].

        The accelerometer measures the change of the car's own speed and the
        slope; then only the wheels' inertia is left to the filtered speed.

        Returns:
            (impulse, mass that the filtered speed's change acts on [kg]).
        """
        plan = self.plan
        drag = 0.0
        if v > 0.0:
            drag = (plan.quadratic * v + plan.linear) * v + plan.constant
        torque = self.vehicle("powertrain_torque", plan.assumed_torque_nm)
        external = self.vehicle("external_force", 0.0)
        driving = self.heading * (torque / plan.radius_m + external)
        impulse = (driving - drag) * h
        if plan.slope == SLOPE_ACCELEROMETER and self.valid(_ACCELERATION):
            accel = self.heading * self.m.value[_ACCELERATION]
            return impulse - plan.mass_kg * accel * h, plan.rotating_kg
        return impulse, plan.mass_kg + plan.rotating_kg

    def _close(self) -> bool:
        """Write the row of the step that ends now and start the next.

        Returns:
            Whether the bus fell silent in it.
        """
        plan, m = self.plan, self.m
        dt_s = plan.step_us * 1e-6
        # on a silent bus the last air temperature is better than the default
        known = self.mapped(_AMBIENT) and m.stamp[_AMBIENT] != NEVER
        ambient_k = m.value[_AMBIENT] if known else plan.ambient_k
        wetness = min(max(self.vehicle("rain", 0.0), 0.0), 1.0)
        unpressed = max(m.unpressed_j, 0.0)
        energy = max(m.energy_fb, 0.0) + unpressed
        power_fb = energy / dt_s
        speed = m.speed_sum / dt_s
        sources, at_risk = self.heat_sources()
        flags = self.flags | self.input_flags()
        m.total_fb += energy
        now = self.readings(dt_s, sources, at_risk)
        flags |= self.checks.close(now)
        if flags & FLAGS["ambient_suspect"]:
            ambient_k = max(ambient_k, plan.ambient_k, self.checks.m.air_k)
        fused = None
        if plan.mode == MODE_FUSED:
            fused = fuse(self, now, flags)
            flags |= fused.flags
        row = array("d")
        for c, measured in enumerate(self.measured_roles):
            power_ff = m.energy_ff[c] / dt_s
            share = plan.force_share[c]
            # a disc at rest turns no motion into heat
            rests = self.on_stand and self.wheel[c] < rules.STANDING_MS
            moved = 0.0 if rests else share
            chosen = power_ff + moved * (unpressed / dt_s)
            if fused is not None:
                chosen = fused.power[c]
            elif (plan.mode == MODE_FB) is (sources[c] != OTHER):
                chosen = moved * power_fb
            if sources[c] == OTHER and at_risk[c]:
                flags |= FLAGS["heat_substituted"]
            m.total_ff[c] += m.energy_ff[c]
            # in the order of CHANNELS
            row.extend(
                [
                    speed,
                    m.pressure_sum[c] / dt_s,
                    m.on_time[c] / dt_s,
                    wetness,
                    ambient_k,
                    chosen,
                    m.total_ff[c],
                    share * m.total_fb,
                    nan if fused is None else fused.power_std[c],
                    *(self.reading(role) for role in measured),
                ]
            )
        at = self.steps * len(row)
        self.rows[at : at + len(row)] = row
        # in the order of VEHICLE_CHANNELS
        row = array(
            "d",
            [
                speed,
                m.distance,
                max(m.force_sum, 0.0) / dt_s,
                self.input_age_s(),
                *(_UNLEARNED if fused is None else fused.learned),
                float(flags),
            ],
        )
        at = self.steps * len(row)
        self.vehicle_rows[at : at + len(row)] = row
        self.row_times[self.steps] = m.grid
        self.steps += 1
        self.flags = 0
        m.grid += plan.step_us
        self._clear()
        m.interface_k[:] = m.next_interface_k
        # a value may have timed out: compute speeds and pressures again
        self.stale = True
        if m.unseen != 0.0 or not flags & _LOST:
            return False
        m.unseen = 1.0
        return True

    def _clear(self) -> None:
        """Reset the sums of a step."""
        m, observed = self.m, self.observer.m
        m.unpressed_j = m.speed_sum = m.force_sum = m.energy_fb = 0.0
        for c in range(self.corners):
            m.energy_ff[c] = m.pressure_sum[c] = m.on_time[c] = 0.0
            observed.brake_sum[c] = 0.0
        observed.sum_time = observed.sum_accel = 0.0
        observed.sum_drive = observed.sum_drag = 0.0
