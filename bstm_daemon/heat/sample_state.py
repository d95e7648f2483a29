"""The memory of the pass over samples, and what counts as present.

:class:`SampleState` is two flat arrays that the Python and the compiled form
share; :class:`SampleMemory` is the same unpacked for the Python form.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from bstm_daemon.heat.sample_plan import (
    CORNER_PRESSURE,
    FLAGS,
    VEHICLE_ROLES,
    SamplePlan,
)
from bstm_daemon.roles import MEASURED_NODES, ROLES

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

NEVER: Final = -(2**63)
UNKNOWN: Final = -1.0
"""The filtered speed while no speed is known."""

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
    "tail",
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

    def last_value(self, role: int) -> float | None:
        """Return the newest value of *role*, however old; None before it."""
        if self.times[len(TIMES) + role] == NEVER:
            return None
        return self.numbers[len(self.numbers) - len(ROLES) + role]


class SampleMemory:
    """A state with its arrays unpacked; :meth:`store` packs them again."""

    def __init__(
        self,
        plan: SamplePlan,
        state: SampleState,
        rows: MutableSequence[float],
        vehicle_rows: MutableSequence[float],
        row_times_us: MutableSequence[int],
    ) -> None:
        """Unpack *plan* and *state*; take the row space."""
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
        self.tail_s = numbers[6]
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
        self.heading = 1.0
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
                *(self.tail_s, *self.lagged, *self.energy_ff),
                *(*self.pressure_sum, *self.on_time, *self.total_ff),
                *self.value,
            ],
        )
        self.state.flags[0] = self.flags

    def valid(self, role: int) -> bool:
        """Whether *role* has a value younger than its time-out."""
        return (
            role >= 0
            and self.stamp[role] != NEVER
            and self.now - self.stamp[role] <= self.timeout[role]
        )

    def vehicle(self, name: str, default: float) -> float:
        """Value of the role *name*, or *default* where it is missing."""
        role = self.vehicle_role[name]
        return self.value[role] if self.valid(role) else default

    def pressure_known(self) -> bool:
        """Whether any brake's pressure is present."""
        return any(self.corner_known(ints) for ints in self.corner_ints)

    def corner_known(self, ints: Sequence[int]) -> bool:
        """Whether the pressure of the corner with *ints* is present."""
        return (
            self.valid(ints[1])
            or self.valid(self.vehicle_role["primary_pressure"])
            or (
                ints[2] != 0
                and self.valid(self.vehicle_role["secondary_pressure"])
            )
        )

    def input_age_s(self) -> float:
        """Age of the mandatory input that is silent longest; nan before it."""
        roles = self.vehicle_role
        speed = max(
            self._stamp(roles["vehicle_speed"]),
            *(self._stamp(ints[0]) for ints in self.corner_ints),
        )
        pressure = max(
            self._stamp(roles["primary_pressure"]),
            self._stamp(roles["secondary_pressure"]),
            *(self._stamp(ints[1]) for ints in self.corner_ints),
        )
        oldest = min(speed, pressure) if self.pressure_mapped else speed
        if oldest == NEVER:
            return float("nan")
        return (self.now - oldest) * 1e-6

    def _stamp(self, role: int) -> int:
        return self.stamp[role] if role >= 0 else NEVER

    def missing(self) -> int:
        """Bits of FLAGS for the inputs that are missing now."""
        flags = 0
        roles = self.vehicle_role
        wheels = any(self.valid(ints[0]) for ints in self.corner_ints)
        if not (wheels or self.valid(roles["vehicle_speed"])):
            flags |= FLAGS["speed_missing"]
        for c, ints in enumerate(self.corner_ints):
            if not self.corner_known(ints):
                flags |= FLAGS["pressure_missing"] | CORNER_PRESSURE << c
        if not self.valid(roles["acceleration_longitudinal"]):
            flags |= FLAGS["acceleration_missing"]
        if not self.valid(roles["powertrain_torque"]):
            flags |= FLAGS["torque_missing"]
        if not self.valid(roles["ambient_temperature"]):
            flags |= FLAGS["ambient_missing"]
        return flags

    def clear(self) -> None:
        """Start the sums of a step anew."""
        self.speed_sum = self.force_sum = self.energy_fb = 0.0
        for c in range(self.corners):
            self.energy_ff[c] = 0.0
            self.pressure_sum[c] = 0.0
            self.on_time[c] = 0.0
