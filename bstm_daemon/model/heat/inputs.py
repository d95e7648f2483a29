"""Current inputs of the pass: valid values, speeds, pressures, heat source.

The pure-Python form of ``native/heat/inputs.c``; both do the same operations
in the same order.
"""

from __future__ import annotations

from math import isnan, nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.channels import CORNER_PRESSURE, FLAGS, MODES, SLOPES
from bstm_daemon.model.heat import check_rules as rules
from bstm_daemon.model.heat.checks import Checks, Watched
from bstm_daemon.model.heat.memory import NEVER, UNKNOWN
from bstm_daemon.model.heat.motion_checks import stand_shown, unproven
from bstm_daemon.model.heat.observer import Observer
from bstm_daemon.model.heat.readings import Readings
from bstm_daemon.roles import MEASURED_NODES, ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.model.heat.memory import SampleMemory
    from bstm_daemon.model.heat.sample_plan import SamplePlan

MODE_FB: Final = MODES["fb"]
MODE_MEASURED: Final = MODES["measured"]
MODE_FUSED: Final = MODES["fused"]
SLOPE_ACCELEROMETER: Final = SLOPES["accelerometer"]

OWN: Final = 0
OTHER: Final = 1
NONE: Final = 2
"""Where a corner's power comes from: the configured mode's source, the other
one, or neither."""

PEDAL_UNKNOWN: Final = 0
PEDAL_AT_REST: Final = 1
PEDAL_BRAKES: Final = 2
"""What brake switch, pedal travel and the bus's brake torque show together."""

LIGHT_PRESSURE_PA: Final = 2e4
"""Pressure counts from here on while the brake switch is on (mode fused)."""

_FIRST: Final = {
    name: ROLE_INDEX[f"{name}_fl"]
    for name in ("wheel_speed", "wheel_pressure")
}
_FIRST_TEMPERATURE: Final = ROLE_INDEX[f"temp_fl_{MEASURED_NODES[0]}"]
_SPEED: Final = ROLE_INDEX["vehicle_speed"]
_PRIMARY: Final = ROLE_INDEX["primary_pressure"]
_SECONDARY: Final = ROLE_INDEX["secondary_pressure"]
_ACCELERATION: Final = ROLE_INDEX["acceleration_longitudinal"]
_LATERAL: Final = ROLE_INDEX["acceleration_lateral"]
_YAW_RATE: Final = ROLE_INDEX["yaw_rate"]
_TORQUE: Final = ROLE_INDEX["powertrain_torque"]
_SWITCH: Final = ROLE_INDEX["brake_switch"]
_TRAVEL: Final = ROLE_INDEX["brake_pedal_travel"]
BRAKE_TORQUE_ROLE: Final = ROLE_INDEX["brake_torque"]
_PARK_BRAKE: Final = ROLE_INDEX["park_brake"]
_IGNITION: Final = ROLE_INDEX["ignition"]
_AMBIENT: Final = ROLE_INDEX["ambient_temperature"]


class Inputs:
    """The current inputs of a plan, with the memory of the pass.

    ``plan`` are its numbers and ``m`` the memory of the samples; ``speed``,
    ``wheel``, ``target`` (pressures) and the like hold from one sample to the
    next and are computed again when ``stale``. ``ground_speed`` is that of
    the axle that grips while the other one is ``spinning``; axles ``apart``:
    one turns, the other stands.
    """

    def __init__(self, plan: SamplePlan, memory: SampleMemory) -> None:
        """Take *plan* and *memory*, which changes in place."""
        self.plan = plan.numbers
        self.laws = plan.laws
        self.table = plan.table_front_pa, plan.table_rear_pa
        self.m = memory.samples
        self.corners = self.plan.corners
        places = self.plan.place[: self.corners]
        nodes = len(MEASURED_NODES)
        self.wheel_role = [_FIRST["wheel_speed"] + i for i in places]
        self.pressure_role = [_FIRST["wheel_pressure"] + i for i in places]
        self.measured_roles = [
            range(
                _FIRST_TEMPERATURE + i * nodes,
                _FIRST_TEMPERATURE + (i + 1) * nodes,
            )
            for i in places
        ]
        watched = Watched(
            [*self.wheel_role, _SPEED],
            [_PRIMARY, _SECONDARY, *self.pressure_role],
            _ACCELERATION,
            _TORQUE,
            [_AMBIENT, *(r for roles in self.measured_roles for r in roles)],
        )
        self.checks = Checks(watched, self.plan, memory.checks)
        self.observer = Observer(self.plan, memory.observer)
        self.stale = True
        self.pressing_pa = self.plan.on_pressure_pa
        self.speed = 0.0
        self.speed_known = self.pressure_present = False
        self.heading = 1.0
        self.ground_speed, self.spinning = 0.0, False
        self.apart = self.on_stand = False
        self.pedal = PEDAL_UNKNOWN
        self.wheel = [0.0] * self.corners
        self.target = [0.0] * self.corners
        self.known = [False] * self.corners
        self.twin_low, self.twin_high = [nan] * 3, [nan] * 3
        at = {self.plan.place[c]: c for c in range(self.corners)}
        self.pairs = [
            (axle, at[2 * axle], at[2 * axle + 1])
            for axle in range(2)
            if {2 * axle, 2 * axle + 1} <= at.keys()
        ]

    def mapped(self, role: int) -> bool:
        """Whether a signal has *role*."""
        return self.plan.timeout[role] >= 0.0

    def valid(self, role: int) -> bool:
        """Whether *role* has a value younger than its timeout."""
        stamp = self.m.stamp[role]
        return stamp != NEVER and self.m.now - stamp <= self.plan.timeout[role]

    def reading(self, role: int) -> float:
        """Value of *role*, nan where it is missing."""
        return self.m.value[role] if self.valid(role) else nan

    def vehicle(self, name: str, default: float) -> float:
        """Value of the role *name*, or *default* where it is missing."""
        role = ROLE_INDEX[name]
        return self.m.value[role] if self.valid(role) else default

    def corner_known(self, c: int) -> bool:
        """Whether the pressure of corner *c* is present."""
        return (
            self.valid(self.pressure_role[c])
            or self.valid(_PRIMARY)
            or (self.plan.secondary[c] != 0 and self.valid(_SECONDARY))
        )

    def refresh(self) -> None:
        """Compute speeds and pressures from the values that are valid now."""
        value = self.m.value
        counts = present = [self.valid(role) for role in self.wheel_role]
        by_vehicle = vehicle = self.valid(_SPEED)
        if any(self.checks.m.left_out):
            counts, by_vehicle = self._believed(counts, vehicle=vehicle)
        total, signed, count = 0.0, 0.0, 0
        for own, role in zip(counts, self.wheel_role, strict=True):
            if own:
                total += abs(value[role])
                signed += value[role]
                count += 1
        if by_vehicle:
            signed = value[_SPEED]
            self.speed = abs(signed)
        else:
            self.speed = total / count if count else 0.0
        # in reverse a forward force acts against the motion
        self.heading = -1.0 if signed < 0.0 else 1.0
        self.speed_known = count > 0 or vehicle
        fast, slow = self._axles(present)
        resting = 0.0 <= slow < rules.STANDING_MS
        self.apart = resting and fast > rules.STAND_TURNS_MS
        self.on_stand = resting and stand_shown(self.checks.m)
        for c, role in enumerate(self.wheel_role):
            turning = abs(value[role])
            # there a wheel at rest is no dead sensor
            rests = self.on_stand and turning < rules.STANDING_MS
            known = counts[c] or (rests and present[c])
            self.wheel[c] = turning if known else self.speed
        self._refresh_pressures()
        self._refresh_twins()
        self._refresh_ground_speed(counts)
        # the foot is on the pedal: fusion counts the lightest pressure
        self.pressing_pa = self.plan.on_pressure_pa
        if (
            self.plan.mode == MODE_FUSED
            and self.vehicle("brake_switch", 0.0) > 0.0
        ):
            self.pressing_pa = min(self.pressing_pa, LIGHT_PRESSURE_PA)
        self.stale = False

    def _believed(
        self, present: list[bool], *, vehicle: bool
    ) -> tuple[list[bool], bool]:
        """Return which wheels, and whether the vehicle speed, are used.

        Those that the others contradict are not, unless none is left.
        """
        left_out = self.checks.m.left_out
        wheels = [own and left_out[c] == 0.0 for c, own in enumerate(present)]
        by_vehicle = vehicle and left_out[self.corners] == 0.0
        if by_vehicle or any(wheels):
            return wheels, by_vehicle
        return present, vehicle

    def _axles(self, counts: Sequence[bool]) -> tuple[float, float]:
        """Return the mean speed of the faster and the slower axle [m/s].

        *counts*: which wheels count; both are UNKNOWN where an axle has none.
        """
        total, count = [0.0, 0.0], [0, 0]
        for c, role in enumerate(self.wheel_role):
            if counts[c]:
                axle = int(self.plan.place[c] >= 2)
                total[axle] += abs(self.m.value[role])
                count[axle] += 1
        if count[0] == 0 or count[1] == 0:
            return UNKNOWN, UNKNOWN
        front, rear = total[0] / count[0], total[1] / count[1]
        return max(front, rear), min(front, rear)

    def _intervenes(self) -> bool:
        """Whether any system slows or spins single wheels."""
        return any(
            self.vehicle(f"{name}_active", 0.0) > 0.0
            for name in ("abs", "esc", "tc")
        )

    def _pedal(self) -> int:
        """What shows braking where no pressure does."""
        found = PEDAL_UNKNOWN
        least_nm = (
            rules.TORQUE_REST * self.plan.on_force_n * self.plan.radius_m
        )
        for role, least in (
            (_SWITCH, 0.0),
            (_TRAVEL, rules.PEDAL_REST),
            (BRAKE_TORQUE_ROLE, least_nm),
        ):
            if self.valid(role):
                if abs(self.m.value[role]) > least:
                    return PEDAL_BRAKES
                found = PEDAL_AT_REST
        # the torque shows what an intervention brakes, the pedal does not
        covered = self.valid(BRAKE_TORQUE_ROLE) and self.m.pedal_seen != 0.0
        if self._intervenes() and not covered:
            return PEDAL_UNKNOWN
        return found

    def _refresh_ground_speed(self, counts: Sequence[bool]) -> None:
        """Set the speed without the axle that the engine spins."""
        self.pedal = self._pedal()
        self.ground_speed, self.spinning = self.speed, False
        torque_nm = self.heading * self.vehicle("powertrain_torque", 0.0)
        # the driven axle slips forward, not the braked one back
        drives = torque_nm > 0.0 and not self._intervenes()
        if self.pressure_present or self.pedal == PEDAL_BRAKES or not drives:
            return
        fast, slow = self._axles(counts)
        # an axle at rest may be two dead sensors
        slips = fast > (1.0 + rules.SLIP_FORWARD) * slow
        if slips and slow > rules.STANDING_MS:
            self.spinning = True
            self.ground_speed = min(self.speed, slow)

    def _refresh_pressures(self) -> None:
        """Set each corner's pressure: its own, its circuit's or axle's."""
        value, observed = self.m.value, self.observer.m
        by_secondary = self.valid(_SECONDARY)
        tare = observed.tare_primary
        axle = (value[_PRIMARY] if self.valid(_PRIMARY) else tare) - tare
        other = value[_SECONDARY] - observed.tare_secondary
        self.known = [self.corner_known(c) for c in range(self.corners)]
        self.pressure_present = any(self.known)
        for c in range(self.corners):
            second = self.plan.secondary[c] and by_secondary
            pressure = other if second else axle
            if self.valid(self.pressure_role[c]):
                pressure = value[self.pressure_role[c]]
            elif self.plan.place[c] >= 2 and self.plan.points:
                pressure = self._rear_pressure(pressure)
            self.target[c] = max(0.0, pressure)

    def _refresh_twins(self) -> None:
        """Set what the brakes of each axle read, and the two circuits.

        Where left and right contradict each other, nobody knows which is
        right: both brake by the higher.
        """
        value, m = self.m.value, self.observer.m
        if (
            self.plan.mode == MODE_FUSED
            and self.valid(_PRIMARY)
            and self.valid(_SECONDARY)
        ):
            one = max(0.0, value[_PRIMARY] - m.tare_primary)
            two = max(0.0, value[_SECONDARY] - m.tare_secondary)
            self.twin_low[2], self.twin_high[2] = min(one, two), max(one, two)
        else:
            self.twin_low[2] = self.twin_high[2] = nan
        known, target = self.known, self.target
        for axle, c, d in self.pairs:
            if not (known[c] and known[d]):
                self.twin_low[axle] = self.twin_high[axle] = nan
                continue
            one, two = target[c], target[d]
            low, high = (one, two) if one < two else (two, one)
            self.twin_low[axle], self.twin_high[axle] = low, high
            fault_s = self.checks.m.twin_fault_s[axle]
            if fault_s >= rules.TWIN.comes_s and not self._intervenes():
                target[c] = target[d] = high

    def _rear_pressure(self, front: float) -> float:
        """Return the rear axle's pressure behind the valve [Pa]."""
        x, y = self.table
        last = self.plan.points - 1
        if front <= x[0]:
            return y[0]
        if front >= x[last]:
            return y[last]
        i = 0
        while front >= x[i + 1]:
            i += 1
        return y[i] + (front - x[i]) / (x[i + 1] - x[i]) * (y[i + 1] - y[i])

    def input_age_s(self) -> float:
        """Age of the oldest mandatory input; nan until all have a sample."""
        speed = self._newest(_SPEED, *self.wheel_role)
        pressure = self._newest(_PRIMARY, _SECONDARY, *self.pressure_role)
        mapped = self.plan.pressure_mapped
        oldest = min(speed, pressure) if mapped else speed
        if oldest == NEVER:
            return nan
        return (self.m.now - oldest) * 1e-6

    def _newest(self, *roles: int) -> int:
        """Newest stamp of *roles*, of those that are mapped."""
        stamps = (self.m.stamp[r] for r in roles if self.mapped(r))
        return max(stamps, default=NEVER)

    def feed_back_known(self) -> bool:
        """Whether the motion gives the braking at all."""
        return self.speed_known and (
            self.valid(_TORQUE) or self.plan.torque_assumed != 0
        )

    def heat_sources(self) -> tuple[list[int], list[bool]]:
        """How each corner's power is known, and whether it may have some.

        The first is OWN, OTHER or NONE. A corner may take power while the car
        moves; where the speed is not known either, while its pressure is
        above the threshold, or its pressure is unknown too and the car was
        not about to park when its speed was lost.
        """
        plan = self.plan
        feed_back = self.feed_back_known()
        felt = plan.slope == SLOPE_ACCELEROMETER
        needed = (_TORQUE, _ACCELERATION) if felt else (_TORQUE,)
        complete = self.speed_known and all(
            self.valid(role) or not self.mapped(role) for role in needed
        )
        sources, at_risk = [], []
        for c in range(self.corners):
            pressure = self.corner_known(c)
            feed_forward = self.speed_known and pressure
            if plan.mode == MODE_FB:
                own = complete or (feed_back and not feed_forward)
                other = feed_forward
            else:
                own = feed_forward or (
                    plan.mode == MODE_MEASURED
                    and self.valid(self.measured_roles[c][0])
                )
                other = feed_back
            sources.append(OWN if own else OTHER if other else NONE)
            if self.speed_known:
                at_risk.append(self.speed > rules.STANDING_MS)
            elif pressure:
                at_risk.append(self.target[c] > plan.on_pressure_pa)
            else:
                at_risk.append(self.checks.m.last_speed > rules.PARKING_MS)
        return sources, at_risk

    def input_flags(self) -> int:
        """Bits of FLAGS for the inputs that are missing now, or no measure."""
        flags = 0
        lost = self.m.pedal_lost > rules.PEDAL_LOST_MS
        if lost and not self.pressure_present:
            flags |= FLAGS["switch_contradicts"]
        if self.on_stand:
            flags |= FLAGS["speed_suspect"] | FLAGS["acceleration_contradicts"]
        if not any(self.valid(role) for role in (*self.wheel_role, _SPEED)):
            flags |= FLAGS["speed_missing"]
        for c in range(self.corners):
            if not self.corner_known(c):
                flags |= FLAGS["pressure_missing"] | CORNER_PRESSURE << c
        for role, name in (
            (_ACCELERATION, "acceleration_missing"),
            (_TORQUE, "torque_missing"),
            (_AMBIENT, "ambient_missing"),
        ):
            flags |= 0 if self.valid(role) else FLAGS[name]
        return flags | FLAGS["speed_unproven"] * self._unproven()

    def _unproven(self) -> bool:
        """Whether no change of speed was compared with the accelerometer.

        A satellite speed is no substitute: it does not check the latter.
        """
        if not self.mapped(_ACCELERATION):
            return False
        pressed_j = 0.0
        for c in range(self.corners):
            pressed_j += self.m.total_ff[c]
        return unproven(self.checks.m, max(self.m.total_fb, pressed_j))

    def readings(
        self, dt_s: float, sources: Sequence[int], at_risk: list[bool]
    ) -> Readings:
        """Return what the checks need of the step that ends now."""
        brake_switch = self.vehicle("brake_switch", nan)
        return Readings(
            now=self.m.now,
            dt_s=dt_s,
            speed=self.speed,
            speed_known=self.speed_known,
            braking=brake_switch > 0.0
            or max(self.target, default=0.0) > self.plan.on_pressure_pa,
            brake_switch=brake_switch,
            esc_active=self.vehicle("esc_active", 0.0),
            intervenes=self._intervenes(),
            secured=self._secured(),
            acceleration=self.heading * self.reading(_ACCELERATION),
            lateral=self.reading(_LATERAL),
            yaw_rate=self.reading(_YAW_RATE),
            ambient_k=self.reading(_AMBIENT),
            speeds=[
                abs(self.reading(role)) for role in (*self.wheel_role, _SPEED)
            ],
            pressures=[
                self.reading(role)
                for role in (_PRIMARY, _SECONDARY, *self.pressure_role)
            ],
            pressure_of=[self._pressure_of(c) for c in range(self.corners)],
            twin_low=self.twin_low,
            twin_high=self.twin_high,
            heat_known=[source != NONE for source in sources],
            at_risk=at_risk,
        )

    def _secured(self) -> float:
        """Return 1 if the car is secured against rolling, nan: unknown."""
        brake, ignition = self.reading(_PARK_BRAKE), self.reading(_IGNITION)
        if brake > 0.0 or ignition == 0.0:
            return 1.0
        return nan if isnan(brake) and isnan(ignition) else 0.0

    def _pressure_of(self, c: int) -> int:
        """Index of the pressure that corner *c* uses."""
        if self.valid(self.pressure_role[c]):
            return 2 + c
        if self.plan.secondary[c] and self.valid(_SECONDARY):
            return 1
        return 0
