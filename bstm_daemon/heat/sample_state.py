"""The memory of the pass over samples, and what counts as present.

:class:`SampleState` is two flat arrays that the Python and the compiled form
share; :class:`SampleMemory` is the same unpacked for the Python form.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from bstm_daemon.heat.check_layout import (
    CHECK_TIMES,
    NEVER,
    UNKNOWN,
    Watched,
    check_number_names,
    check_time_names,
    new_checks,
)
from bstm_daemon.heat.checks import Checks
from bstm_daemon.heat.friction_law import LAW_POINTS
from bstm_daemon.heat.limits import Limits
from bstm_daemon.heat.observer import Observer
from bstm_daemon.heat.observer_layout import (
    LEARNED_NAMES,
    OBSERVER_NUMBERS,
    STEP_SUMS,
    new_observer,
    observer_number_names,
)
from bstm_daemon.heat.plausibility import PARKING_MS, STANDING_MS
from bstm_daemon.heat.sample_plan import (
    CORNER_PRESSURE,
    FLAGS,
    MODES,
    VEHICLE_ROLES,
    SamplePlan,
)
from bstm_daemon.roles import MEASURED_NODES, ROLES

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence

HEADER: Final = 9
PER_CORNER_INTS: Final = 4 + len(MEASURED_NODES)
VEHICLE_FLOATS: Final = 14
PER_CORNER_FLOATS: Final = 4

OWN: Final = 0
OTHER: Final = 1
NONE: Final = 2

TIMES: Final = ("now", "grid", "pending", "late", "dropped", "jumps")
"""``times`` of the state, then the stamp of each role [us]; then the times of
:mod:`bstm_daemon.heat.checks`."""

NUMBERS: Final = (
    "filtered_speed",
    "speed",
    "distance",
    "force",
    "energy_fb",
    "total_fb",
    "tail",
    "unpressed",
)
"""``numbers`` of the state, then a value per role, then corner sums; then
the numbers of :mod:`bstm_daemon.heat.checks`."""

CORNER_SUMS: Final = (
    "lagged_pressure",
    "energy",
    "pressure",
    "brake_on",
    "total_ff",
    "interface_k",
    "told_k",
)
"""Per corner; ``energy``, ``pressure`` and ``brake_on`` are sums of the open
step. ``told_k``, between disc and pads, is what the thermal model gave last,
0 before; the friction law goes by ``interface_k``, what was told when the
step began: so it does not matter in how many calls the samples come."""


@dataclass(slots=True)
class SampleState:
    """All that the pass remembers; two flat arrays that both forms share.

    ``flags`` are pending bits for the next row (clock jump, settled).
    """

    times: array[int]
    numbers: array[float]
    flags: array[int] = field(default_factory=lambda: array("i", [0]))

    @classmethod
    def new(
        cls, plan: SamplePlan, learned: Sequence[float] | None = None
    ) -> SampleState:
        """Return the state before the first sample.

        *learned* is what :meth:`learned` of an earlier drive returned.
        """
        times = [NEVER] * (len(TIMES) + len(ROLES))
        for name in ("late", "dropped", "jumps"):
            times[TIMES.index(name)] = 0
        size = len(NUMBERS) + len(CORNER_SUMS) * len(plan.corners) + len(ROLES)
        check_times, check_numbers = new_checks(len(plan.corners), len(ROLES))
        numbers = array("d", [0.0] * size + check_numbers)
        numbers.extend(new_observer(len(plan.corners), learned))
        numbers[NUMBERS.index("filtered_speed")] = UNKNOWN
        return cls(array("q", times + check_times), numbers)

    def learned(self, corners: int) -> list[float] | None:
        """Return what the observer has learned, None before any step."""
        first = len(self.numbers) - len(OBSERVER_NUMBERS) - corners
        started = first + OBSERVER_NUMBERS.index("started")
        if self.numbers[started] == 0.0:
            return None
        return list(self.numbers[first : first + len(LEARNED_NAMES)])

    def unlearn(self, corners: int) -> None:
        """Let the observer begin anew at the next step."""
        first = len(self.numbers) - len(OBSERVER_NUMBERS) - corners
        self.numbers[first + OBSERVER_NUMBERS.index("started")] = 0.0

    def heat_interface(
        self, corner: int, corners: int, interface_k: float
    ) -> None:
        """Tell the friction law the temperature between disc and pads.

        *corner*: place among *corners*. Counts from the next step on, or
        at once where none was known.
        """
        first = len(NUMBERS) + len(ROLES) + corner
        told = first + CORNER_SUMS.index("told_k") * corners
        used = first + CORNER_SUMS.index("interface_k") * corners
        self.numbers[told] = interface_k
        if not self.numbers[used] > 0.0:
            self.numbers[used] = interface_k

    def interface_k(self, corner: int, corners: int) -> float:
        """Return what :meth:`heat_interface` told last, 0 before."""
        first = len(NUMBERS) + len(ROLES)
        at = CORNER_SUMS.index("told_k") * corners + corner
        return self.numbers[first + at]

    def count(self, name: str) -> int:
        """Return a counter: late, dropped, jumps, or of refused samples.

        Raises :class:`ValueError` for a name that is none of TIMES and
        CHECK_TIMES.
        """
        if name in TIMES:
            return self.times[TIMES.index(name)]
        return self.times[len(TIMES) + len(ROLES) + CHECK_TIMES.index(name)]

    def last_value(self, role: int) -> float | None:
        """Return the newest value of *role*, however old; None before it."""
        if self.times[len(TIMES) + role] == NEVER:
            return None
        return self.numbers[len(NUMBERS) + role]


def time_names() -> list[str]:
    """Return the name of each entry of :attr:`SampleState.times`."""
    return [*TIMES, *(f"stamp.{r.name}" for r in ROLES), *check_time_names()]


def number_names(corners: Sequence[str]) -> list[str]:
    """Return the name of each entry of :attr:`SampleState.numbers`."""
    return [
        *NUMBERS,
        *(f"value.{role.name}" for role in ROLES),
        *(f"{name}.{corner}" for name in CORNER_SUMS for corner in corners),
        *check_number_names(corners),
        *observer_number_names(corners),
    ]


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
        ints, floats = plan.ints.tolist(), plan.floats.tolist()
        self.state = state
        self.rows, self.vehicle_rows = rows, vehicle_rows
        self.row_times = row_times_us
        self.steps = 0
        self.room = len(row_times_us)
        self.corners = len(plan.corners)
        self.mode, self.slope, self.points = ints[3], ints[4], ints[5]
        self.pressure_mapped, self.assumed = ints[6] != 0, ints[7] != 0
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
            settling_s,
            self.unpressed_share,
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
        at += 2 * self.points
        self.timeout = floats[at : at + len(ROLES)]
        at += len(ROLES)
        limits = [
            floats[at + i * len(ROLES) : at + (i + 1) * len(ROLES)]
            for i in range(len(Limits._fields))
        ]
        at += len(limits) * len(ROLES)
        self.laws = [
            list(
                floats[at + 3 * LAW_POINTS * c : at + 3 * LAW_POINTS * (c + 1)]
            )
            for c in range(self.corners if ints[8] else 0)
        ]
        self._unpack(limits, settling_s)
        self.flags = state.flags[0]
        self.stale = True
        self.pressing_pa = self.on_pressure
        self.speed = 0.0
        self.speed_known = self.pressure_present = False
        self.heading = 1.0
        self.wheel = [0.0] * self.corners
        self.target = [0.0] * self.corners

    def _unpack(
        self, limits: Sequence[Sequence[float]], settling_s: float
    ) -> None:
        """Take what the state's arrays hold."""
        state = self.state
        self.now, self.grid, self.pending = state.times[:3]
        self.late, self.dropped, self.jumps = state.times[3:6]
        self.stamp = state.times[len(TIMES) : len(TIMES) + len(ROLES)].tolist()
        numbers = state.numbers.tolist()
        self.filtered, self.speed_sum, self.distance = numbers[:3]
        self.force_sum, self.energy_fb, self.total_fb = numbers[3:6]
        self.tail_s, self.unpressed_j = numbers[6:8]
        at = len(NUMBERS)
        k = self.corners
        self.value = numbers[at : at + len(ROLES)]
        at += len(ROLES)
        self.lagged = numbers[at : at + k]
        self.energy_ff = numbers[at + k : at + 2 * k]
        self.pressure_sum = numbers[at + 2 * k : at + 3 * k]
        self.on_time = numbers[at + 3 * k : at + 4 * k]
        self.total_ff = numbers[at + 4 * k : at + 5 * k]
        self.interface_k = numbers[at + 5 * k : at + 6 * k]
        self.told_k = numbers[at + 6 * k : at + 7 * k]
        at += len(CORNER_SUMS) * k
        observed = len(numbers) - len(OBSERVER_NUMBERS) - k
        self.checks = Checks(
            limits,
            settling_s,
            self._watched(),
            state.times[len(TIMES) + len(ROLES) :],
            numbers[at:observed],
        )
        self.observer = Observer(
            self.mass,
            self.rotating_mass / self.mass,
            self.constant / self.mass,
            numbers[observed:],
        )

    def _watched(self) -> Watched:
        roles = self.vehicle_role
        return Watched(
            [*(i[0] for i in self.corner_ints), roles["vehicle_speed"]],
            [
                roles["primary_pressure"],
                roles["secondary_pressure"],
                *(i[1] for i in self.corner_ints),
            ],
            roles["acceleration_longitudinal"],
            roles["powertrain_torque"],
            [
                roles["ambient_temperature"],
                *(role for i in self.corner_ints for role in i[4:]),
            ],
        )

    def store(self) -> None:
        """Write the state back."""
        check_times, check_numbers = self.checks.packed()
        self.state.times[:] = array(
            "q",
            [
                *(self.now, self.grid, self.pending),
                *(self.late, self.dropped, self.jumps),
                *self.stamp,
                *check_times,
            ],
        )
        self.state.numbers[:] = array(
            "d",
            [
                *(self.filtered, self.speed_sum, self.distance),
                *(self.force_sum, self.energy_fb, self.total_fb),
                *(self.tail_s, self.unpressed_j, *self.value),
                *(*self.lagged, *self.energy_ff, *self.pressure_sum),
                *(*self.on_time, *self.total_ff, *self.interface_k),
                *self.told_k,
                *check_numbers,
                *self.observer.packed(),
            ],
        )
        self.state.flags[0] = self.flags

    def valid(self, role: int) -> bool:
        """Whether *role* has a value younger than its time-out."""
        if role < 0:
            return False
        stamp = self.stamp[role]
        return stamp != NEVER and self.now - stamp <= self.timeout[role]

    def vehicle(self, name: str, default: float) -> float:
        """Value of the role *name*, or *default* where it is missing."""
        role = self.vehicle_role[name]
        return self.value[role] if self.valid(role) else default

    def rear_pressure(self, front: float) -> float:
        """Return what the valve lets through to the rear axle [Pa]."""
        x, y, last = self.table_front, self.table_rear, self.points - 1
        if front <= x[0]:
            return y[0]
        if front >= x[last]:
            return y[last]
        i = 0
        while front >= x[i + 1]:
            i += 1
        return y[i] + (front - x[i]) / (x[i + 1] - x[i]) * (y[i + 1] - y[i])

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

    def heat_answers(self) -> tuple[list[int], list[bool]]:
        """How each corner's power is known, and whether it may have some.

        The first is OWN, OTHER or NONE: the source of the configured mode,
        the other one, or neither. A corner may take power while the car
        moves; where the speed is not known either, while its pressure is
        above the threshold, or its pressure is unknown too and the car was
        not about to park when its speed was lost.
        """
        roles = self.vehicle_role
        torque, acceleration = (
            self.valid(roles["powertrain_torque"]),
            roles["acceleration_longitudinal"],
        )
        feed_back = self.feed_back_known()
        complete = (
            self.speed_known
            and (torque or roles["powertrain_torque"] < 0)
            and (
                self.slope != 0 or acceleration < 0 or self.valid(acceleration)
            )
        )
        answers, at_risk = [], []
        for c, ints in enumerate(self.corner_ints):
            pressure = self.corner_known(ints)
            feed_forward = self.speed_known and pressure
            if self.mode == MODES["fb"]:
                own = complete or (feed_back and not feed_forward)
                other = feed_forward
            else:
                own = feed_forward or (
                    self.mode == MODES["measured"] and self.valid(ints[4])
                )
                other = feed_back
            answers.append(OWN if own else OTHER if other else NONE)
            if self.speed_known:
                at_risk.append(self.speed > STANDING_MS)
            elif pressure:
                at_risk.append(self.target[c] > self.on_pressure)
            else:
                at_risk.append(self.checks.last_speed > PARKING_MS)
        return answers, at_risk

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

    def feed_back_known(self) -> bool:
        """Whether the motion tells of the braking at all."""
        torque = self.vehicle_role["powertrain_torque"]
        return self.speed_known and (self.valid(torque) or self.assumed)

    def clear(self) -> None:
        """Start the sums of a step anew."""
        self.unpressed_j = 0.0
        self.speed_sum = self.force_sum = self.energy_fb = 0.0
        for c in range(self.corners):
            self.energy_ff[c] = 0.0
            self.pressure_sum[c] = 0.0
            self.on_time[c] = 0.0
            self.observer.brake_sum[c] = 0.0
        for name in STEP_SUMS:
            self.observer.m[name] = 0.0
