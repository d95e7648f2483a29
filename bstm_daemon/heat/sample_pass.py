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
from dataclasses import dataclass, field
from math import exp, isfinite
from typing import TYPE_CHECKING, Final

from bstm_daemon.heat.sample_plan import (
    CHANNELS,
    FLAGS,
    VEHICLE_CHANNELS,
    VEHICLE_ROLES,
    SamplePlan,
)
from bstm_daemon.roles import MEASURED_NODES, ROLES

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

LATE_US: Final = 1_000_000
AHEAD_US: Final = 3_600_000_000
SETTLED_US: Final = 12 * 3_600_000_000
CLOCK_SET_US: Final = 30 * 24 * 3_600_000_000
CONFIRM_US: Final = 10_000_000
LIMIT_US: Final = 2**60
NEVER: Final = -(2**63)
UNKNOWN: Final = -1.0
"""The filtered speed while no speed is known."""

TICK: Final = -1
"""The role number of a tick: time passes, nothing is sampled."""

DONE: Final = 0
FULL: Final = 1
SETTLE: Final = 2
JUMP: Final = 3
_DROP: Final = 4

HEADER: Final = 7
PER_CORNER_INTS: Final = 4 + len(MEASURED_NODES)
VEHICLE_FLOATS: Final = 12
PER_CORNER_FLOATS: Final = 4
PER_CORNER_SUMS: Final = 5
# lagged pressure; of the step: energy, pressure, brake-on time; all energy

TIMES: Final = ("now", "grid", "pending", "late", "dropped", "jumps")
"""``times`` of the state, followed by the stamp of each role [us]."""

NUMBERS: Final = (
    "filtered_speed",
    "speed",
    "distance",
    "force",
    "energy_fb",
    "total_fb",
)
"""``numbers`` of the state, then corner sums, then a value per role."""


@dataclass(slots=True)
class SampleState:
    """All that the pass remembers; two flat arrays that both forms share.

    ``flags`` are pending bits for the next row (clock jump, settled).
    """

    times: array[int]
    numbers: array[float]
    flags: array[int] = field(default_factory=lambda: array("i", [0]))

    @classmethod
    def new(cls, plan: SamplePlan) -> SampleState:
        """Return the state before the first sample."""
        times = [NEVER] * (len(TIMES) + len(ROLES))
        for name in ("late", "dropped", "jumps"):
            times[TIMES.index(name)] = 0
        size = len(NUMBERS) + PER_CORNER_SUMS * len(plan.corners) + len(ROLES)
        numbers = array("d", [0.0] * size)
        numbers[NUMBERS.index("filtered_speed")] = UNKNOWN
        return cls(array("q", times), numbers)


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


class _Pass:
    """The pass with its arrays unpacked; :meth:`store` packs them again."""

    def __init__(
        self,
        plan: SamplePlan,
        state: SampleState,
        rows: MutableSequence[float],
        vehicle_rows: MutableSequence[float],
        row_times_us: MutableSequence[int],
    ) -> None:
        ints, floats = plan.ints, plan.floats
        self.state = state
        self.rows, self.vehicle_rows = rows, vehicle_rows
        self.row_times = row_times_us
        self.steps = 0
        self.room = len(row_times_us)
        self.corners = len(plan.corners)
        self.mode, self.slope, self.points = ints[3], ints[4], ints[5]
        self.pressure_mapped = ints[6] != 0
        self.vehicle_role = dict(
            zip(VEHICLE_ROLES, ints[HEADER:], strict=False)
        )
        first = HEADER + len(VEHICLE_ROLES)
        self.corner_ints = [
            ints[
                first + c * PER_CORNER_INTS : first + (c + 1) * PER_CORNER_INTS
            ]
            for c in range(self.corners)
        ]
        self.step_us = int(floats[0])
        (
            self.mass,
            self.rotating_mass,
            self.radius,
            self.quadratic,
            self.linear,
            self.constant,
            self.ambient_k,
            self.assumed_torque,
            self.on_pressure,
            self.on_force,
            self.filter_s,
        ) = floats[1:VEHICLE_FLOATS]
        at = VEHICLE_FLOATS
        self.corner_floats = [
            floats[
                at + c * PER_CORNER_FLOATS : at + (c + 1) * PER_CORNER_FLOATS
            ]
            for c in range(self.corners)
        ]
        at += self.corners * PER_CORNER_FLOATS
        self.table_front = floats[at : at + self.points]
        self.table_rear = floats[at + self.points : at + 2 * self.points]
        self.timeout = floats[at + 2 * self.points :]
        self.now, self.grid, self.pending = state.times[:3]
        self.late, self.dropped, self.jumps = state.times[3:6]
        self.stamp = state.times[len(TIMES) :]
        numbers = state.numbers
        self.filtered, self.speed_sum, self.distance = numbers[:3]
        self.force_sum, self.energy_fb, self.total_fb = numbers[3:6]
        at = len(NUMBERS)
        k = self.corners
        self.lagged = numbers[at : at + k]
        self.energy_ff = numbers[at + k : at + 2 * k]
        self.pressure_sum = numbers[at + 2 * k : at + 3 * k]
        self.on_time = numbers[at + 3 * k : at + 4 * k]
        self.total_ff = numbers[at + 4 * k : at + 5 * k]
        self.value = numbers[at + 5 * k :]
        self.flags = state.flags[0]
        self.stale = True
        self.speed = 0.0
        self.speed_known = False
        self.wheel = [0.0] * k
        self.target = [0.0] * k

    def store(self) -> None:
        """Write the state back."""
        self.state.times[:] = array(
            "q",
            [
                *(self.now, self.grid, self.pending),
                *(self.late, self.dropped, self.jumps),
                *self.stamp,
            ],
        )
        self.state.numbers[:] = array(
            "d",
            [
                *(self.filtered, self.speed_sum, self.distance),
                *(self.force_sum, self.energy_fb, self.total_fb),
                *(*self.lagged, *self.energy_ff, *self.pressure_sum),
                *(*self.on_time, *self.total_ff, *self.value),
            ],
        )
        self.state.flags[0] = self.flags

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
            self.now = time_us
            self.grid = (time_us // self.step_us + 1) * self.step_us
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
        self.pending = NEVER
        self.jumps += 1
        settled = 0 < ahead <= CLOCK_SET_US
        self.flags |= FLAGS["settled" if settled else "clock_jump"]
        for role, stamp in enumerate(self.stamp):
            if stamp != NEVER and not settled:
                self.stamp[role] = stamp + ahead
        # the open step starts anew on the new axis
        self.now = time_us
        self.grid = (time_us // self.step_us + 1) * self.step_us
        self._clear()
        self.stale = True
        return SETTLE if settled else JUMP

    def _march_to(self, time_us: int) -> int:
        while self.grid <= time_us:
            if self.steps == self.room:
                return FULL
            self._integrate(self.grid)
            self._close()
        self._integrate(time_us)
        self.pending = NEVER
        return DONE

    def take(self, time_us: int, role: int, value: float) -> None:
        """Let *role* have *value* from now on; only a number is a sample."""
        if isfinite(value):
            self.value[role] = value
            self.stamp[role] = max(time_us, self.now)

    def _valid(self, role: int) -> bool:
        return (
            role >= 0
            and self.stamp[role] != NEVER
            and self.now - self.stamp[role] <= self.timeout[role]
        )

    def _vehicle(self, name: str, default: float) -> float:
        role = self.vehicle_role[name]
        return self.value[role] if self._valid(role) else default

    def _refresh(self) -> None:
        """Form speeds and pressures from the values that count now."""
        total, count = 0.0, 0
        for ints in self.corner_ints:
            if self._valid(ints[0]):
                total += abs(self.value[ints[0]])
                count += 1
        if self._valid(self.vehicle_role["vehicle_speed"]):
            self.speed = abs(self._vehicle("vehicle_speed", 0.0))
        else:
            self.speed = total / count if count else 0.0
        self.speed_known = count > 0 or self._valid(
            self.vehicle_role["vehicle_speed"]
        )
        for c, ints in enumerate(self.corner_ints):
            self.wheel[c] = (
                abs(self.value[ints[0]])
                if self._valid(ints[0])
                else self.speed
            )
            pressure = self._pressure(ints)
            self.target[c] = max(0.0, pressure)
        self.stale = False

    def _pressure(self, ints: Sequence[int]) -> float:
        if self._valid(ints[1]):
            return self.value[ints[1]]
        pressure = self._vehicle("primary_pressure", 0.0)
        if ints[2]:
            pressure = self._vehicle("secondary_pressure", pressure)
        if ints[3] and self.points:
            return self._rear(pressure)
        return pressure

    def _rear(self, front: float) -> float:
        x, y, last = self.table_front, self.table_rear, self.points - 1
        if front <= x[0]:
            return y[0]
        if front >= x[last]:
            return y[last]
        i = 0
        while front >= x[i + 1]:
            i += 1
        return y[i] + (front - x[i]) / (x[i + 1] - x[i]) * (y[i + 1] - y[i])

    def _integrate(self, time_us: int) -> None:
        """Hold all values from now to *time_us* and add up."""
        if time_us <= self.now:
            return
        if self.stale:
            self._refresh()
        h = (time_us - self.now) * 1e-6
        v = self.speed
        highest = self._integrate_corners(h)
        gained = 0.0
        if not self.speed_known:
            self.filtered = UNKNOWN
        elif self.filtered < 0.0:
            # a speed that appears is not an acceleration
            self.filtered = v
        else:
            before = self.filtered
            self.filtered = v + (before - v) * exp(-h / self.filter_s)
            gained = self.filtered - before
        force_s = self._force_impulse(h, v, gained)
        if self._pressure_known():
            braking = highest > self.on_pressure
        else:
            braking = force_s > self.on_force * h
        if braking:
            self.force_sum += force_s
            self.energy_fb += force_s * v
        self.speed_sum += v * h
        self.distance += v * h
        self.now = time_us

    def _integrate_corners(self, h: float) -> float:
        """Add up each corner's Feed-Forward; the highest mean pressure."""
        highest = 0.0
        for c, (per_pa, pushout, lag_s, _) in enumerate(self.corner_floats):
            target = self.target[c]
            if lag_s > 0.0:
                decay = exp(-h / lag_s)
                apart = self.lagged[c] - target
                p = target + apart * (lag_s * (1.0 - decay) / h)
                self.lagged[c] = target + apart * decay
            else:
                p = target
                self.lagged[c] = target
            pushing = p - pushout
            if pushing > 0.0:
                power = per_pa * pushing * (self.wheel[c] / self.radius)
                self.energy_ff[c] += power * h
            self.pressure_sum[c] += p * h
            if p > self.on_pressure:
                self.on_time[c] += h
            highest = max(highest, p)
        return highest

    def _force_impulse(self, h: float, v: float, gained: float) -> float:
        """Brake force times time (Eq 4.11) over *h* seconds [N s]."""
        drag = (
            (self.quadratic * v + self.linear) * v + self.constant
            if v > 0.0
            else 0.0
        )
        torque = self._vehicle("powertrain_torque", self.assumed_torque)
        external = self._vehicle("external_force", 0.0)
        impulse = (torque / self.radius + external - drag) * h
        acceleration = self.vehicle_role["acceleration_longitudinal"]
        if self.slope == 0 and self._valid(acceleration):
            return (
                impulse
                - self.mass * self.value[acceleration] * h
                - self.rotating_mass * gained
            )
        return impulse - (self.mass + self.rotating_mass) * gained

    def _pressure_known(self) -> bool:
        if not self.pressure_mapped:
            return False
        return any(
            self._valid(ints[1]) for ints in self.corner_ints
        ) or self._valid(self.vehicle_role["primary_pressure"])

    def _close(self) -> None:
        """Write the row of the step that ends now and start the next."""
        dt_s = self.step_us * 1e-6
        ambient = self._vehicle("ambient_temperature", self.ambient_k)
        wetness = min(max(self._vehicle("rain", 0.0), 0.0), 1.0)
        power_fb = max(self.energy_fb, 0.0) / dt_s
        speed = self.speed_sum / dt_s
        self.total_fb += max(self.energy_fb, 0.0)
        at = self.steps * self.corners * len(CHANNELS)
        for c, ints in enumerate(self.corner_ints):
            power_ff = self.energy_ff[c] / dt_s
            share = self.corner_floats[c][3]
            chosen = (power_ff, share * power_fb, 0.0)[self.mode]
            self.total_ff[c] += self.energy_ff[c]
            self.rows[at : at + 8] = array(
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
                ],
            )
            for i, role in enumerate(ints[4:]):
                self.rows[at + 8 + i] = (
                    self.value[role] if self._valid(role) else float("nan")
                )
            at += len(CHANNELS)
        at = self.steps * len(VEHICLE_CHANNELS)
        self.vehicle_rows[at] = speed
        self.vehicle_rows[at + 1] = self.distance
        self.vehicle_rows[at + 2] = max(self.force_sum, 0.0) / dt_s
        self.vehicle_rows[at + 3] = self._input_age_s()
        self.vehicle_rows[at + 4] = float(self.flags | self._missing())
        self.row_times[self.steps] = self.grid
        self.steps += 1
        self.flags = 0
        self.grid += self.step_us
        self._clear()
        # a value may have aged out: speeds and pressures are formed anew
        self.stale = True

    def _input_age_s(self) -> float:
        """Age of the mandatory input that is silent longest; nan before it."""
        roles = self.vehicle_role
        speed = max(
            self._stamp(roles["vehicle_speed"]),
            *(self._stamp(ints[0]) for ints in self.corner_ints),
        )
        pressure = max(
            self._stamp(roles["primary_pressure"]),
            *(self._stamp(ints[1]) for ints in self.corner_ints),
        )
        oldest = min(speed, pressure) if self.pressure_mapped else speed
        if oldest == NEVER:
            return float("nan")
        return (self.now - oldest) * 1e-6

    def _stamp(self, role: int) -> int:
        return self.stamp[role] if role >= 0 else NEVER

    def _missing(self) -> int:
        flags = 0
        roles = self.vehicle_role
        wheels = any(self._valid(ints[0]) for ints in self.corner_ints)
        if not (wheels or self._valid(roles["vehicle_speed"])):
            flags |= FLAGS["speed_missing"]
        if not self._pressure_known():
            flags |= FLAGS["pressure_missing"]
        if not self._valid(roles["acceleration_longitudinal"]):
            flags |= FLAGS["acceleration_missing"]
        if not self._valid(roles["powertrain_torque"]):
            flags |= FLAGS["torque_missing"]
        if not self._valid(roles["ambient_temperature"]):
            flags |= FLAGS["ambient_missing"]
        return flags

    def _clear(self) -> None:
        self.speed_sum = self.force_sum = self.energy_fb = 0.0
        for c in range(self.corners):
            self.energy_ff[c] = 0.0
            self.pressure_sum[c] = 0.0
            self.on_time[c] = 0.0
