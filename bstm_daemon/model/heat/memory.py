"""The memory of the pass over samples: one layout for both forms.

The fields below are declared here and nowhere else; the compiled form has
them as structs of the same names. A car of fewer corners leaves the last
entries of its lists per corner alone.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Final, TypeAlias

from bstm_daemon.model.heat.check_rules import AIR_FELL
from bstm_daemon.model.heat.learned import Learned
from bstm_daemon.model.heat.observer_rules import STOOD_S
from bstm_daemon.native import layout
from bstm_daemon.native.layout import Length
from bstm_daemon.roles import CORNERS, GROUND_SPEED_ROLES, ROLE_INDEX, ROLES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

NEVER: Final = -(2**63)
UNKNOWN: Final = -1.0

PER_CORNER: Final = Length("MAX_CORNERS", len(CORNERS))
PER_TWIN: Final = Length("TWINS", 3)
PER_SPEED: Final = Length("MAX_SPEEDS", len(CORNERS) + 1)
PER_PRESSURE: Final = Length("MAX_PRESSURES", len(CORNERS) + 2)
PER_ROLE: Final = Length("ROLES", len(ROLES))
PER_GROUND_SPEED: Final = Length("GROUND_SPEEDS", len(GROUND_SPEED_ROLES))
"""Speeds: the corners' wheels, then the vehicle's. Pressures: primary,
secondary, then the wheels'."""

Corners: TypeAlias = Annotated[list[float], PER_CORNER]
Twins: TypeAlias = Annotated[list[float], PER_TWIN]
Speeds: TypeAlias = Annotated[list[float], PER_SPEED]
Pressures: TypeAlias = Annotated[list[float], PER_PRESSURE]
Values: TypeAlias = Annotated[list[float], PER_ROLE]
Stamps: TypeAlias = Annotated[list[int], PER_ROLE]


@dataclass(slots=True)
class PassMemory:
    """Time, held values and the sums of the open step.

    ``now``, ``grid`` (the end of the open step) and ``pending`` (a jump that
    waits to be confirmed) are stamps [us]; ``late``, ``dropped`` and ``jumps``
    count. ``interface_k``, between disc and pads, is the temperature of the
    friction law: ``next_interface_k``, the thermal model's latest (0 before
    any), as it was when the step began. So the result does not depend on how
    the samples are split into calls. ``unseen`` is 1 from the begin of a
    silence to the first speed after it, which is ``speed_after``.
    ``decel_shown`` is the low-passed braking that needs no drive [m/s2],
    ``pedal_lost`` the speed lost by it while the pedal was at rest [m/s],
    ``pedal_seen`` 1 once the pedal has shown braking, 0 once it has not.
    """

    now: int
    grid: int
    pending: int
    late: int
    dropped: int
    jumps: int
    stamp: Stamps
    filtered_speed: float
    speed_sum: float
    distance: float
    force_sum: float
    energy_fb: float
    total_fb: float
    tail_s: float
    unpressed_j: float
    unseen: float
    speed_after: float
    decel_shown: float
    pedal_lost: float
    pedal_seen: float
    value: Values
    lagged_pa: Corners
    energy_ff: Corners
    pressure_sum: Corners
    on_time: Corners
    total_ff: Corners
    interface_k: Corners
    next_interface_k: Corners


@dataclass(slots=True)
class CheckMemory:
    """Memory of the input checks.

    ``last_sample`` of any role, ``last_of_car`` of any but the thermocouples
    and ``suspect_until``, the end of the last hold, are stamps [us]; per role
    ``jump_stamp`` and ``jump_value`` of a jump that waits to be confirmed.
    Fields ``*_fault_s`` count the seconds that a check has failed.
    ``agreement`` and ``motion`` are sums over the last minutes of acceleration
    times gain of speed, and of the gain's square [m2/s3]. ``outage_s``: how
    long a corner's heat was unknown, ``aftermath_s``: how long that still has
    an effect. ``mark`` is the speed of the others when a value was first held;
    ``vehicle_mark`` is the vehicle's when a wheel last turned on.
    ``left_out`` is 1 for a speed that is not used. ``scale_error`` is a speed
    over the median of all, less 1. Fields ``band_*`` filter the speed's
    derivative and the accelerometer; ``rate_square``, ``accel_square`` and
    ``accel_rate`` are sums of their squares and product in the band,
    ``unmoved_square`` that of the accelerometer while no speed changes
    [m2/s3]; ``median_speed`` is that of all speeds a step before;
    ``standing_accel`` is what it measured first while all speeds are
    0, ``tilted_s`` for how long it has measured something else, UNKNOWN
    without such a first. ``accel_held_s``: how long the accelerometer has
    read ``accel_held``. ``air_k`` is the air by its own history, 0 before
    any. ``parked_s``: for how long the car was parked when
    that was last known, ``unproven_s``: for how long its bus has been awake
    since. ``twin_pressed_s``: for how long an axle has been pressed,
    ``twin_pressure`` and ``twin_difference`` filter the mean of its brakes and
    what they differ by.
    """

    last_sample: int
    last_of_car: int
    suspect_until: int
    out_of_range: int
    jumps_refused: int
    jump_stamp: Stamps
    until: Stamps
    slow_speed: float
    slow_acceleration: float
    inertia_fault_s: float
    switch_fault_s: float
    pair_fault_s: float
    vehicle_mark: float
    last_speed: float
    agreement: float
    motion: float
    reversed_fault_s: float
    band_speed: float
    band_s: float
    band_rate: float
    band_slow_rate: float
    band_accel: float
    band_slow_accel: float
    rate_square: float
    accel_square: float
    accel_rate: float
    turn_square: float
    lateral_square: float
    turn_lateral: float
    median_speed: float
    unmoved_square: float
    unmoved_fault_s: float
    standing_accel: float
    tilted_s: float
    accel_held: float
    accel_held_s: float
    lowest_code_s: float
    air_k: float
    air_fault_s: float
    parked_s: float
    unproven_s: float
    jump_value: Values
    twin_pressed_s: Twins
    twin_pressure: Twins
    twin_difference: Twins
    twin_fault_s: Twins
    outage_s: Corners
    aftermath_s: Corners
    deviation_fault_s: Speeds
    scale_error: Speeds
    speed_held: Speeds
    speed_held_s: Speeds
    speed_mark: Speeds
    speed_stuck_s: Speeds
    left_out: Speeds
    pressure_held: Pressures
    pressure_held_s: Pressures
    pressure_mark: Pressures
    pressure_stuck_s: Pressures
    zero_fault_s: Pressures


@dataclass(slots=True)
class ObserverMemory:
    """Memory of the vehicle observer.

    Accelerations and forces over the configured mass are in m/s2, so that the
    states have the size of 1. ``recent`` and ``earlier`` are copies of what
    is learned, ``first`` is that as this drive began. ``window_*`` are sums
    of half a second of one kind, ``sum_*`` and ``brake_sum`` (the force by
    pressure [N s]) those of the open step. ``gain_product`` and
    ``gain_square`` are sums of (measured less rate) times rate, and of the
    rate's square, as rates change. ``proof_s`` is the braking that must
    still prove the pressure after an external force. ``balance_*`` count and
    sum braking by pressure x and by motion y, their squares and product
    [m2/s4], over half seconds, and the deviation of y that the learned states
    leave; ``outlier_s`` is how long they were apart,
    ``held_back_s`` how long a drive moved the car too little.
    """

    known: Learned
    recent: Learned
    earlier: Learned
    first: Learned
    copy_age_s: float
    started: float
    resets: float
    last_speed: float
    rate: float
    accel_measured: float
    slow_rate: float
    slow_accel: float
    gain_time_s: float
    roughness: float
    calm_s: float
    released_s: float
    pressed_s: float
    last_gear: float
    last_clutch: float
    external_s: float
    external_held_s: float
    proof_s: float
    gain_product: float
    gain_square: float
    radius_ratio: Annotated[list[float], PER_GROUND_SPEED]
    unpressed_s: float
    balance_count: float
    balance_x: float
    balance_y: float
    balance_xx: float
    balance_xy: float
    balance_yy: float
    balance_std: float
    outlier_s: float
    held_back_s: float
    stood_s: float
    window_kind: float
    window_s: float
    window_accel: float
    window_drive: float
    window_drag: float
    window_brake: float
    window_pressure: float
    window_speed: float
    window_first_speed: float
    sine: float
    height_last: float
    height_work: float
    height_path: float
    tare_primary: float
    tare_secondary: float
    slow_braking: float
    slow_brake: float
    silent_s: float
    silent_energy: float
    sum_time: float
    sum_accel: float
    sum_drive: float
    sum_drag: float
    brake_sum: Corners


@dataclass(slots=True)
class SampleMemory:
    """All of it."""

    samples: PassMemory
    checks: CheckMemory
    observer: ObserverMemory


def _new_memory(learned: Sequence[float] | None) -> SampleMemory:
    """Return the memory before the first sample."""
    memory = layout.zeros(SampleMemory)
    samples, checks, observer = (
        memory.samples,
        memory.checks,
        memory.observer,
    )
    samples.now = samples.grid = samples.pending = NEVER
    samples.stamp = [NEVER] * len(ROLES)
    samples.filtered_speed = UNKNOWN
    checks.last_sample = checks.last_of_car = NEVER
    checks.suspect_until = NEVER
    checks.jump_stamp = [NEVER] * len(ROLES)
    checks.until = [NEVER] * len(ROLES)
    checks.slow_speed = checks.band_speed = UNKNOWN
    checks.median_speed = UNKNOWN
    if learned is not None:
        observer.known = observer.first = Learned.of(learned)
        observer.recent = observer.earlier = Learned.of(learned)
        observer.started = 1.0
        observer.radius_ratio = [1.0] * PER_GROUND_SPEED.entries
        observer.last_speed = UNKNOWN
        # people may have got in
        observer.stood_s = 2.0 * STOOD_S
    return memory


_KNOWN: Final = layout.first(SampleMemory, "observer.known.x")
_STARTED: Final = layout.first(SampleMemory, "observer.started")
_INTERFACE: Final = layout.first(SampleMemory, "samples.interface_k")
_NEXT: Final = layout.first(SampleMemory, "samples.next_interface_k")
_STAMP: Final = layout.first(SampleMemory, "samples.stamp")
_VALUE: Final = layout.first(SampleMemory, "samples.value")
_UNSEEN: Final = layout.first(SampleMemory, "samples.unseen")
_SPEED_AFTER: Final = layout.first(SampleMemory, "samples.speed_after")
_LAST_SPEED: Final = layout.first(SampleMemory, "checks.last_speed")
_AIR: Final = layout.first(SampleMemory, "checks.air_k")
_AIR_FAULT: Final = layout.first(SampleMemory, "checks.air_fault_s")
_LAST_SAMPLE: Final = layout.first(SampleMemory, "checks.last_sample")


@dataclass(slots=True)
class SampleState:
    """The whole memory of the pass, as the arrays that both forms share.

    ``times`` and ``numbers`` are the integers and the floats of
    :class:`SampleMemory`; ``flags`` are pending bits for the next row (clock
    jump, settled).
    """

    times: array[int]
    numbers: array[float]
    flags: array[int] = field(default_factory=lambda: array("i", [0]))

    @classmethod
    def new(cls, learned: Sequence[float] | None = None) -> SampleState:
        """Return the state before the first sample.

        *learned* is what :meth:`learned` of an earlier drive returned.
        """
        state = cls(array("q"), array("d"))
        state.store(_new_memory(learned))
        return state

    def memory(self) -> SampleMemory:
        """Return the arrays unpacked; :meth:`store` packs them again."""
        return layout.unpack(
            SampleMemory,
            iter(self.times.tolist()),
            iter(self.numbers.tolist()),
        )

    def store(self, memory: SampleMemory) -> None:
        """Write *memory* back."""
        times: list[int] = []
        numbers: list[float] = []
        layout.pack(memory, times, numbers)
        self.times[:] = array("q", times)
        self.numbers[:] = array("d", numbers)

    def exported(self, corners: int) -> tuple[list[int], list[float]]:
        """Return the times and numbers used by a car of *corners*."""
        return (
            [self.times[i] for i in _used(int, corners)],
            [self.numbers[i] for i in _used(float, corners)],
        )

    @classmethod
    def imported(
        cls,
        corners: int,
        times: Sequence[int],
        numbers: Sequence[float],
        flags: Sequence[int],
    ) -> SampleState:
        """Return the state that :meth:`exported` gave *times* and *numbers*.

        Raises:
            ValueError: not as many of them as a car of *corners* has.
        """
        state = cls.new()
        for i, time in zip(_used(int, corners), times, strict=True):
            state.times[i] = time
        for i, number in zip(_used(float, corners), numbers, strict=True):
            state.numbers[i] = number
        (state.flags[0],) = flags
        return state

    def learned(self) -> list[float] | None:
        """Return the learned numbers, None before any step."""
        if self.numbers[_STARTED] == 0.0:
            return None
        size = layout.size(Learned, float)
        return list(self.numbers[_KNOWN : _KNOWN + size])

    def unlearn(self) -> None:
        """Reset the observer at the next step."""
        self.numbers[_STARTED] = 0.0

    def heat_interface(self, corner: int, interface_k: float) -> None:
        """Set the friction law's temperature between disc and pads.

        It applies from the next step on, or at once if none was known.
        """
        self.numbers[_NEXT + corner] = interface_k
        if not self.numbers[_INTERFACE + corner] > 0.0:
            self.numbers[_INTERFACE + corner] = interface_k

    def know_air(self, air_k: float) -> None:
        """Set the history of the air [K] before the first sample."""
        self.numbers[_AIR] = air_k

    @property
    def air_k(self) -> float:
        """The air [K] by its own history, 0 or less before any."""
        return self.numbers[_AIR]

    def await_speed(self) -> None:
        """Let the pass return ``BACK`` at the next speed."""
        self.numbers[_UNSEEN] = 1.0

    @property
    def last_sample_us(self) -> int:
        """Stamp of the newest sample of any role [us], NEVER before any."""
        return self.times[_LAST_SAMPLE]

    @property
    def last_speed_ms(self) -> float:
        """Speed at the last step that knew one, 0 before any."""
        return self.numbers[_LAST_SPEED]

    @property
    def speed_after_ms(self) -> float:
        """The speed that ended the last silence."""
        return self.numbers[_SPEED_AFTER]

    def interface_k(self, corner: int) -> float:
        """Return the last value of :meth:`heat_interface`, 0 before any."""
        return self.numbers[_NEXT + corner]

    @property
    def last_air_k(self) -> float | None:
        """The newest air [K], or its history, if higher, where it fell."""
        known = self.last_value(ROLE_INDEX["ambient_temperature"])
        if known is None or self.numbers[_AIR_FAULT] < AIR_FELL.comes_s:
            return known
        return max(known, self.air_k)

    def last_value(self, role: int) -> float | None:
        """Return the newest value of *role*, however old; None before it."""
        if self.times[_STAMP + role] == NEVER:
            return None
        return self.numbers[_VALUE + role]


def _used(kind: type, corners: int) -> Iterator[int]:
    """Entries of *kind* that a car of *corners* uses, in order."""
    unused = len(CORNERS) - corners
    for place in layout.places(SampleMemory, kind):
        per_corner = place.length in {PER_CORNER, PER_SPEED, PER_PRESSURE}
        count = place.entries - (unused if per_corner else 0)
        yield from range(place.first, place.first + count)
