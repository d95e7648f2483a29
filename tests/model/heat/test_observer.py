"""What the observer learns, when it does not, and that both forms agree."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.model.heat.learned import LEARNED_NAMES, learned_fault
from bstm_daemon.model.heat.memory import ObserverMemory, SampleState
from bstm_daemon.model.heat.observer_faults import (
    compare_forces,
    count_drive,
    is_outlier,
    unbalanced,
)
from bstm_daemon.model.heat.observer_rules import P0_STD
from bstm_daemon.native.layout import zeros
from bstm_daemon.native.loader import load_kernel

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from bstm_daemon.native.loader import Kernel

    from .conftest import Run

ROLES = (
    "vehicle_speed",
    "primary_pressure",
    "acceleration_longitudinal",
    "powertrain_torque",
    "motor_torque",
    "gear",
    "acceleration_lateral",
    "brake_switch",
    "esc_active",
)
GRAVITY = 9.80665
PER_PA = 2.0 * 2.83e-3 * 0.38 * 0.13 / 0.3418  # N/Pa of a corner
CORNERS = ("FL", "FR", "RL", "RR")


@dataclass(frozen=True)
class Truth:
    """A car that is not quite the configured one, and its sensors."""

    mass_kg: float = 2500.0
    bias: float = 0.2
    friction: float = 0.8
    pitch: float = 0.03
    grade: float = 0.0
    push: float = 0.0  # m/s2 from outside
    scale: float = 1.0  # of the accelerometer
    radius: float = 1.0  # of the speeds
    pressed: bool = True  # the pressure is measured
    motor: bool = False  # what brakes is the motor
    dead_torque: bool = False


@dataclass
class Driver:
    """Drives a car through phases; keeps samples and true brake work."""

    car: Truth
    every_us: int = 50_000
    now: int = 0
    speed: float = 10.0
    height: float = 0.0
    work_j: float = 0.0

    def drive(
        self, seconds: float, rate: float, *, gear: int = 3, **more: float
    ) -> Iterator[tuple[int, str, float]]:
        """Yield samples of *seconds* at *rate* [m/s2], braked if below -1."""
        car = self.car
        for _ in range(round(seconds * 1e6 / self.every_us)):
            v = self.speed
            rotating = 3.0809 / 0.3418**2
            drag = 0.5 * 1.2 * 0.7 * v**2 + 4.0 * v
            weight = car.mass_kg * GRAVITY * (car.grade + 0.014)
            needed = (car.mass_kg + rotating) * rate + drag + weight
            needed -= car.push * car.mass_kg
            braked = rate < -1.0
            torque = 0.0 if braked or car.dead_torque else needed * 0.3418
            brake_n = max(-needed, 0.0) if braked else 0.0
            dt = self.every_us * 1e-6
            self.now += self.every_us
            self.speed = max(v + rate * dt, 0.0)
            self.height += v * dt * car.grade
            self.work_j += brake_n * v * dt
            felt = rate * (1.0 + car.pitch) + GRAVITY * car.grade
            pressure = brake_n / (4.0 * PER_PA * car.friction)
            if car.motor or not car.pressed:
                pressure = 0.0
            yield from (
                (self.now, "vehicle_speed", self.speed * car.radius),
                (self.now, "primary_pressure", pressure),
                (
                    self.now,
                    "acceleration_longitudinal",
                    car.scale * felt + car.bias,
                ),
                (self.now, "powertrain_torque", torque),
                (
                    self.now,
                    "motor_torque",
                    -brake_n * 0.3418 if car.motor else 0.0,
                ),
                (self.now, "gear", float(gear)),
                (self.now, "acceleration_lateral", more.get("lateral", 0.0)),
                (self.now, "esc_active", more.get("esc", 0.0)),
                (
                    self.now,
                    "brake_switch",
                    float(braked and car.pressed and not car.motor),
                ),
                (self.now, "altitude", self.height),
                (self.now, "gnss_speed", self.speed),
            )

    def town(self, rounds: int, **more: float) -> list[tuple[int, str, float]]:
        """Return *rounds* of pulling away, cruising and braking."""
        samples: list[tuple[int, str, float]] = []
        for turn in range(rounds):
            gain = 0.8 + 0.4 * (turn % 4)
            samples += self.drive(10.0, gain, **more)
            samples += self.drive(5.0, 0.0, **more)
            loss = 1.5 + 0.5 * (turn % 3)
            samples += self.drive(10.0 * gain / loss, -loss, **more)
        return samples


@pytest.fixture
def kernel() -> Kernel | None:
    """Return the form that is there; one test compares both."""
    return load_kernel()


@pytest.fixture
def fused(
    start: Callable[..., Run], make_car: Any, make_corner: Any
) -> Callable[..., Run]:
    """Return what starts a pass of a fused car: (kernel, *more roles)."""

    def make(kernel: Kernel | None, *more: str, **timeouts: int) -> Run:
        car = make_car(
            *(make_corner(name) for name in CORNERS), heat={"mode": "fused"}
        )
        return start(car, kernel, *ROLES, *more, **timeouts)

    return make


def learned(run: Run, name: str) -> float:
    numbers = run.state.learned()
    assert numbers is not None
    return numbers[LEARNED_NAMES.index(name)]


def untaught(run: Run) -> bool:
    """Whether the states are those of a first start."""
    return (
        learned(run, "mass_ratio") == 1.0
        and learned(run, "bias") == pytest.approx(-0.014 * GRAVITY)
        and learned(run, "level") == 0.0
    )


@pytest.mark.parametrize("grade", [0.0, -0.06])
def test_it_finds_mass_bias_and_friction(
    kernel: Kernel | None, fused: Callable[..., Run], grade: float
) -> None:
    """Of a car 14 % heavier, 0.2 m/s2 off, with 20 % less friction."""
    driver = Driver(Truth(grade=grade))
    run = fused(kernel).feed(driver.town(24))

    assert run.of_car("mass_kg")[-1] == pytest.approx(2500.0, rel=0.03)
    assert run.of_car("accel_bias_ms2")[-1] == pytest.approx(0.2, abs=0.03)
    assert run.of_car("friction_scale")[-1] == pytest.approx(0.8, rel=0.04)
    assert run.of_car("grade")[-1] == pytest.approx(grade, abs=0.004)
    assert not any(run.flag("external_force_suspected"))
    spread = run.of_car("mass_std_kg")
    assert spread[-1] < 0.3 * spread[0]


@pytest.mark.parametrize("travel_m", [0.002, 0.005, 0.006])
def test_a_foot_that_rests_on_the_pedal_hides_no_motion(
    kernel: Kernel | None, fused: Callable[..., Run], travel_m: float
) -> None:
    """The switch is on throughout; up to 5 mm the pads do not brake."""
    driver = Driver(Truth())
    samples = []
    for at, role, value in driver.town(24):
        now = 1.0 if role == "brake_switch" else value
        samples.append((at, role, now))
        if role == "brake_switch":
            pressed_m = 0.02 if value > 0.0 else travel_m
            samples.append((at, "brake_pedal_travel", pressed_m))
    run = fused(kernel, "brake_pedal_travel").feed(samples)

    if travel_m > 0.005:
        assert learned(run, "mass_ratio") == 1.0
        return
    assert run.of_car("mass_kg")[-1] == pytest.approx(2500.0, rel=0.03)
    assert run.of_car("friction_scale")[-1] == pytest.approx(0.8, rel=0.04)


@pytest.mark.parametrize(
    ("resting_n", "friction", "bias"),
    [
        (60.0, 1.0, 0.2),
        (100.0, 1.0, 0.2),
        (140.0, 1.0, 0.2),
        (160.0, 1.0, None),
        (100.0, 0.7, 0.2),
        (180.0, 1.3, 0.2),
        (200.0, 1.3, None),
    ],
)
def test_what_the_resting_foot_brakes_is_no_bias(
    kernel: Kernel | None,
    fused: Callable[..., Run],
    resting_n: float,
    friction: float,
    bias: float | None,
) -> None:
    """Pads that drag by less than 150 N at nominal friction are taken off.

    60 N are by 0.18 bar, which is not yet counted as heat.
    """
    driver = Driver(Truth(friction=friction))
    pressure = resting_n / (4.0 * PER_PA * friction)
    samples = []
    for at, role, value in driver.town(24):
        now = value
        if role == "primary_pressure":
            now = max(value, pressure)
        elif role == "brake_switch":
            now = 1.0
            pressed_m = 0.02 if value > 0.0 else 0.003
            samples.append((at, "brake_pedal_travel", pressed_m))
        elif role == "acceleration_longitudinal":
            now = value - (resting_n / 2500.0 if value > -1.0 else 0.0)
        samples.append((at, role, now))
    run = fused(kernel, "brake_pedal_travel").feed(samples)

    if bias is None:
        assert learned(run, "mass_ratio") == 1.0
        return
    found = run.of_car("accel_bias_ms2")[-1]
    assert found == pytest.approx(bias, abs=0.012)


@pytest.mark.parametrize("resting_n", [160.0, 300.0])
def test_a_light_pressure_without_a_switch_is_no_bias(
    kernel: Kernel | None, fused: Callable[..., Run], resting_n: float
) -> None:
    """Up to 1 bar is no heat, but brakes: it is taken off."""
    driver = Driver(Truth(friction=1.0))
    pressure = resting_n / (4.0 * PER_PA)
    assert pressure < 1e5
    samples = []
    for at, role, value in driver.town(24):
        now = value
        if role == "primary_pressure":
            now = max(value, pressure)
        elif role == "acceleration_longitudinal":
            now = value - (resting_n / 2500.0 if value > -1.0 else 0.0)
        if role != "brake_switch":
            samples.append((at, role, now))
    run = fused(kernel).feed(samples)

    found = run.of_car("accel_bias_ms2")[-1]
    assert found == pytest.approx(0.2, abs=0.015)
    assert run.of_car("friction_scale")[-1] == pytest.approx(1.0, rel=0.02)


def test_a_resting_foot_may_press_one_circuit_alone(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
) -> None:
    """One offset reads as pressed and the other not: neither brakes."""
    rear = {"circuit": "secondary"}
    car = make_car(
        *(
            make_corner(name, **rear if name[0] == "R" else {})
            for name in CORNERS
        ),
        heat={"mode": "fused"},
    )
    samples = []
    for at, role, value in Driver(Truth()).town(12):
        now = value
        if role == "primary_pressure":
            samples.append((at, "secondary_pressure", value))
            now = max(value, 25e3)
        elif role == "brake_switch":
            now = 1.0
            pressed_m = 0.02 if value > 0.0 else 0.003
            samples.append((at, "brake_pedal_travel", pressed_m))
        samples.append((at, role, now))
    more = "brake_pedal_travel", "secondary_pressure"
    run = start(car, kernel, *ROLES, *more).feed(samples)

    assert run.of_car("mass_kg")[-1] == pytest.approx(2500.0, rel=0.04)


def test_heat_is_right_once_learned(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """And lies within what is said to be its uncertainty."""
    driver = Driver(Truth())
    run = fused(kernel).feed(driver.town(24))
    before, first = driver.work_j, len(run.times)
    run.feed(driver.town(4))
    real = driver.work_j - before
    found = sum(
        sum(run.column("brake_power_w", c)[first:]) * 0.05 for c in range(4)
    )
    spread = sum(
        sum(run.column("brake_power_std_w", c)[first:]) * 0.05
        for c in range(4)
    )

    assert found == pytest.approx(real, rel=0.03)
    assert abs(found - real) < 2.0 * spread < 0.3 * real


@pytest.mark.slow
def test_both_forms_give_the_same_bits(
    compiled: Kernel, fused: Callable[..., Run]
) -> None:
    """Rows, learned states and flags, over all that can happen."""
    runs = []
    for kernel in (None, compiled):
        driver = Driver(Truth())
        samples = driver.town(3)
        samples += driver.town(2, lateral=3.0)
        samples += driver.town(1, esc=1.0)
        driver.car = replace(driver.car, pressed=False)
        samples += driver.town(2)
        driver.car = replace(driver.car, push=1.0, dead_torque=True)
        samples += driver.town(3)
        driver.car = Truth(scale=0.5, radius=1.1, grade=0.05)
        samples += driver.town(6)
        runs.append(
            fused(kernel, altitude=5_000_000, gnss_speed=2_000_000).feed(
                samples
            )
        )

    assert runs[0].bits() == runs[1].bits()
    assert any(runs[0].flag("braking_unpressed"))
    assert any(runs[0].flag("acceleration_scale"))


def test_chunks_change_no_bit(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    whole, cut = fused(kernel), fused(kernel)
    samples = Driver(Truth()).town(2)
    whole.feed(samples)
    for at in range(0, len(samples), 997):
        cut.feed(samples[at : at + 997])

    assert whole.bits() == cut.bits()


def test_a_pushed_car_teaches_nothing(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """Pushed up to speed, then along against the brakes (Eq 4.7)."""
    driver = Driver(Truth(push=0.9, dead_torque=True, bias=0.0), speed=0.5)
    samples = list(driver.drive(12.0, 0.7, gear=0))
    driver.car = Truth(push=0.8, bias=0.0)
    for _ in range(1200):  # at constant speed the brakes take the push
        samples += [
            (driver.now + i * 50_000, role, value)
            for i in (1,)
            for role, value in (
                ("vehicle_speed", driver.speed),
                ("primary_pressure", 8e5),
                ("acceleration_longitudinal", 0.0),
                ("powertrain_torque", 0.0),
                ("motor_torque", 0.0),
                ("gear", 0.0),
                ("brake_switch", 1.0),
                ("esc_active", 0.0),
                ("acceleration_lateral", 0.0),
            )
        ]
        driver.now += 50_000
    run = fused(kernel).feed(samples)

    assert run.flag("external_force_suspected")[-1]
    assert run.flag("forces_unproven") == run.flag("external_force_suspected")
    assert untaught(run)
    assert run.column("brake_power_w")[-1] == pytest.approx(
        PER_PA * 8e5 * driver.speed
    )


@pytest.mark.parametrize("pressed", [True, False])
def test_braking_proves_the_pressure_after_an_external_force(
    kernel: Kernel | None,
    fused: Callable[..., Run],
    pressed: bool,  # noqa: FBT001
) -> None:
    """Half seconds of calm braking, 5 s of them; without a pressure none."""
    driver = Driver(Truth(push=0.9, dead_torque=True, bias=0.0), speed=0.5)
    samples = list(driver.drive(12.0, 0.7, gear=0))
    driver.car = Truth(bias=0.0, pressed=pressed)
    samples += driver.town(4)
    run = fused(kernel).feed(samples)

    unproven = run.flag("forces_unproven")
    first = unproven.index(True)
    assert run.flag("external_force_suspected")[first]
    assert unproven[-1] is not pressed
    proof = zip(
        unproven[first:], run.column("pressure_pa")[first:], strict=True
    )
    braked_s = 0.05 * sum(is_open and p > 1e5 for is_open, p in proof)
    assert (braked_s >= 5.0) is pressed


@pytest.mark.parametrize(
    ("share", "contradicts"), [(0.5, True), (0.8, False), (2.0, True)]
)
def test_a_pressure_that_changes_its_scale_contradicts(
    kernel: Kernel | None,
    fused: Callable[..., Run],
    share: float,
    contradicts: bool,  # noqa: FBT001
) -> None:
    """After 5 s of braking; linings change by less, and not at once."""
    driver = Driver(Truth(friction=1.0))
    samples = driver.town(8)
    from_s = driver.now * 1e-6
    driver.car = replace(driver.car, friction=1.0 / share)
    samples += driver.town(4)
    run = fused(kernel).feed(samples)

    marks = run.flag("forces_contradict")
    assert any(marks) is contradicts
    if contradicts:
        first = marks.index(True)
        begun = round(from_s / 0.05)
        braked = [p > 1e5 for p in run.column("pressure_pa")[begun:first]]
        assert 5.0 < 0.05 * sum(braked) < 15.0
        assert run.flag("acceleration_suspect")[first]


def test_wheels_on_a_stand_teach_nothing(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
) -> None:
    """The rear wheels turn, the front ones and the body do not move."""
    car = make_car(
        *(make_corner(name) for name in CORNERS), heat={"mode": "fused"}
    )
    wheels = [f"wheel_speed_{name.lower()}" for name in CORNERS]
    run = start(car, kernel, *wheels, *ROLES[1:])
    samples = []
    for step in range(600):
        at = step * 50_000
        turning = min(0.02 * step, 8.0)
        samples += [(at, wheel, turning) for wheel in wheels[2:]]
        samples += [(at, wheel, 0.0) for wheel in wheels[:2]]
        samples += [(at, role, 0.0) for role in ROLES[1:]]
    run.feed(samples)

    assert run.flag("external_force_suspected")[-1]
    assert untaught(run)


@pytest.mark.parametrize("scale", [-1.0, 0.0, 0.6, 1.4])
def test_a_wrong_scale_is_named_and_unlearned(
    kernel: Kernel | None, fused: Callable[..., Run], scale: float
) -> None:
    run = fused(kernel).feed(Driver(Truth(scale=scale)).town(10))

    assert run.flag("acceleration_scale")[-1]
    assert untaught(run)


def test_a_wrong_radius_shows_against_satellites(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    right, wrong = (
        fused(kernel, gnss_speed=2_000_000).feed(
            Driver(Truth(radius=radius), speed=12.0).town(12)
        )
        for radius in (1.0, 1.09)
    )

    assert not any(right.flag("wheel_radius"))
    assert wrong.flag("wheel_radius")[-1]


def test_a_receiver_that_filters_shows_no_wrong_radius(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """Hard stops, braking with interventions: it is behind by 0.6 s."""
    driver = Driver(Truth(), speed=0.0)
    samples = []
    ground = 0.0
    for _ in range(10):
        drive = [*driver.drive(9.0, 3.0), *driver.drive(3.4, -8.0, esc=1.0)]
        for at, role, value in drive:
            if role == "gnss_speed":
                ground += (value - ground) * 0.05 / 0.6
            samples.append(
                (at, role, ground if role == "gnss_speed" else value)
            )
    run = fused(kernel, "gnss_speed").feed(samples)

    assert not any(run.flag("wheel_radius"))
    assert run.of_car("mass_kg")[-1] > 2250.0


@dataclass
class Balance:
    """A drive with several pressures, by a torque and an accelerometer."""

    torque_nm: float = 0.0
    torque_gain: float = 1.0
    accel: float = 0.0

    def samples(self) -> list[tuple[int, str, float]]:
        """Return some minutes of town, braking at 1.5 to 4 m/s2."""
        driver = Driver(Truth(bias=0.0, friction=1.0, mass_kg=2194.0))
        found = list(driver.drive(2.0, 1.0))
        for turn in range(12):
            found += driver.drive(12.0, 0.1 if turn % 2 else 1.9)
            found += driver.drive(6.0 - 0.5 * (turn % 4), -1.3 - turn % 3)
        return [
            (
                at,
                role,
                {
                    "powertrain_torque": self.torque_gain * value
                    + self.torque_nm,
                    "acceleration_longitudinal": value + self.accel,
                }.get(role, value),
            )
            for at, role, value in found
        ]


@pytest.mark.parametrize(
    ("fault", "comes"),
    [
        (Balance(), False),
        (Balance(torque_gain=0.8), False),
        (Balance(torque_gain=0.5), True),
        (Balance(torque_gain=1.5), False),  # heat is added, none is hidden
    ],
)
def test_less_mass_than_the_car_has_is_named(
    kernel: Kernel | None,
    fused: Callable[..., Run],
    fault: Balance,
    comes: bool,  # noqa: FBT001
) -> None:
    """A torque that reads half teaches half of the mass."""
    run = fused(kernel).feed(fault.samples())

    assert run.flag("forces_contradict")[-1] is comes
    assert run.flag("torque_suspect") == run.flag("forces_contradict")
    if comes:
        pressed = run.column("brake_energy_ff_j")
        late = len(pressed) * 2 // 3
        heat = sum(run.column("brake_power_w")[late:]) * 0.05
        assert heat >= 0.99 * (pressed[-1] - pressed[late])


@pytest.mark.parametrize(
    ("gain", "comes"), [(2.0, True), (1.2, False), (0.7, False)]
)
def test_a_torque_that_begins_to_read_too_much_is_named(
    kernel: Kernel | None,
    fused: Callable[..., Run],
    gain: float,
    comes: bool,  # noqa: FBT001
) -> None:
    """The learned car gains too little speed by it: after 5 s of drive."""
    driver = Driver(Truth(bias=0.0))
    samples = driver.town(8)
    from_us = driver.now
    samples += driver.town(2)
    run = fused(kernel).feed(
        [
            (
                at,
                role,
                gain * value
                if role == "powertrain_torque" and at > from_us
                else value,
            )
            for at, role, value in samples
        ]
    )

    marks = run.flag("forces_contradict")
    assert any(marks) is comes
    if comes:
        after_s = 0.05 * marks.index(True) - from_us * 1e-6
        assert 5.0 < after_s < 10.0
        assert run.flag("torque_suspect")[marks.index(True)]


@pytest.mark.parametrize(
    ("innovation", "drive", "found_s"),
    [
        (-0.4, 1.0, 4.5),  # less than 0.7 of it
        (-0.29, 1.0, 4.0),  # beyond 4 deviations, but little of the drive
        (-0.2, 1.0, 3.5),  # within 4 deviations: it moves as it should
        (-0.4, 0.14, 4.0),  # idling
        (0.4, 1.0, 4.0),  # pushed
    ],
)
def test_windows_in_which_a_drive_moves_the_car_too_little(
    innovation: float, drive: float, found_s: float
) -> None:
    m = zeros(ObserverMemory)
    m.held_back_s = 4.0
    count_drive(m, innovation, 0.06, drive)
    assert m.held_back_s == found_s


@pytest.mark.parametrize(
    ("innovation", "outlier_s"),
    [
        (0.24, 3.5),  # within four deviations
        (-0.24, 3.5),
        (0.40, 4.0),
        (0.41, 4.5),
        (-0.55, 4.0),
        (-0.57, 4.5),
    ],
)
def test_friction_that_is_not_to_be_learned(
    innovation: float, outlier_s: float
) -> None:
    """What a fading brake or a wet one explains does not contradict."""
    m = zeros(ObserverMemory)
    m.outlier_s = 4.0
    is_small = abs(innovation) < 0.25
    std = 0.25 / 4.0 if is_small else 0.01
    assert is_outlier(m, innovation, std) is not is_small
    assert m.outlier_s == outlier_s
    m.outlier_s = 10.0
    is_outlier(m, innovation, std)
    assert m.outlier_s <= 10.0


def line(
    n: int,
    *,
    offset: float,
    slope: float = 0.9,
    step: float = 0.5,
    std: float = 0.0,
) -> ObserverMemory:
    """Return the memory after *n* windows along a line."""
    m = zeros(ObserverMemory)
    for i in range(n):
        x = step + step * (i % 4)
        compare_forces(m, x, offset + slope * x, std)
    return m


def test_braking_that_an_offset_hides_or_adds() -> None:
    """0.15 m/s2 and 15 % of the braking, over 20 windows of several kinds."""
    assert unbalanced(line(40, offset=-0.16, step=0.3))
    assert not unbalanced(line(40, offset=-0.14, step=0.3))
    assert unbalanced(line(40, offset=-0.19))  # 0.15 of 1.25 m/s2
    assert not unbalanced(line(40, offset=-0.18))
    assert unbalanced(line(40, offset=-0.25, std=0.03))
    assert not unbalanced(line(40, offset=-0.25, std=0.032))  # 2 deviations
    assert unbalanced(line(40, offset=0.45))  # 0.35 of 1.25 m/s2
    assert not unbalanced(line(40, offset=0.42))
    assert not unbalanced(line(40, offset=0.6, slope=0.7))  # they fade
    assert not unbalanced(line(40, offset=-0.5, slope=1.5))  # they recover
    assert not unbalanced(line(19, offset=-0.5))
    m = zeros(ObserverMemory)
    for i in range(40):
        x = 5.0 + 0.4 * (i % 4)
        compare_forces(m, x, -0.7 + 0.9 * x, 0.0)
    assert not unbalanced(m)  # 12 % of hard stops
    m = zeros(ObserverMemory)
    for i in range(40):
        x = 1.0 + 0.1 * (i % 4)
        compare_forces(m, x, -0.5 + 0.9 * x, 0.0)
    assert not unbalanced(m)  # all of one kind: no line


def test_dead_pressure_is_named(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """The brake light is on, the car slows hard, and there is no pressure."""
    driver = Driver(Truth(bias=0.0, pressed=False))
    samples = [
        (at, role, 1.0 if role == "brake_switch" and value < -2 else value)
        for at, role, value in driver.town(8)
    ]
    rates = {}
    last = None
    for at, role, value in samples:
        if role == "vehicle_speed":
            rates[at] = last is not None and value < last - 0.05
            last = value
    samples = [
        (at, role, float(rates[at]) if role == "brake_switch" else value)
        for at, role, value in samples
    ]
    run = fused(kernel).feed(samples)

    assert run.flag("pressure_dead")[-1]


@pytest.mark.parametrize(
    "more", [{"lateral": 3.0}, {"esc": 1.0}], ids=["bend", "esc"]
)
def test_it_does_not_learn_in(
    kernel: Kernel | None, fused: Callable[..., Run], more: dict[str, float]
) -> None:
    run = fused(kernel).feed(Driver(Truth()).town(4, **more))

    assert untaught(run)


@pytest.mark.parametrize("form", [load_kernel(), None], ids=type)
def test_a_car_whose_gear_is_not_known_does_not_shift(
    fused: Callable[..., Run], form: Kernel | None
) -> None:
    """It is calm from its first whole step on."""
    samples = Driver(Truth(), speed=10.0).drive(1.0, 0.5)
    run = fused(form).feed([s for s in samples if s[1] != "gear"])

    observer = run.state.memory().observer
    assert observer.last_gear == 0.0
    assert observer.calm_s == pytest.approx(0.95)


def test_it_does_not_learn_from_gear_changes(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """A gear a half second: never calm for long enough."""
    driver = Driver(Truth())
    samples = []
    for turn in range(60):
        samples += driver.drive(0.5, 1.0 if turn < 30 else -0.9, gear=turn % 5)
    run = fused(kernel).feed(samples)

    assert untaught(run)


def test_nan_resets_and_is_told(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    driver = Driver(Truth())
    run = fused(kernel).feed(driver.town(2))
    memory = run.state.memory()
    memory.observer.known.x[0] = nan
    run.state.store(memory)
    run.feed(list(driver.drive(1.0, 0.5)))

    assert run.flag("observer_reset").count(True) == 1
    assert run.state.memory().observer.resets == 1.0
    assert np.isfinite(run.of_car("mass_kg")[-1])


def test_height_tells_bias_from_rolling_resistance(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    """The balance of forces gives b - g f_r only; the road's height both."""
    car = Truth(bias=0.2, grade=0.03)
    told = fused(kernel, altitude=5_000_000).feed(Driver(car).town(24))
    alone = fused(kernel).feed(Driver(car).town(24))

    assert told.of_car("grade")[-1] == pytest.approx(0.03, abs=0.003)
    assert told.of_car("grade_std")[-1] < 0.9 * alone.of_car("grade_std")[-1]


def test_what_is_learned_passes_its_own_check(
    kernel: Kernel | None, fused: Callable[..., Run]
) -> None:
    run = fused(kernel).feed(Driver(Truth()).town(6))
    numbers = run.state.learned()

    assert numbers is not None
    assert learned_fault(numbers) is None
    assert SampleState.new(numbers).learned() == numbers


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mass_ratio", 3.0),
        ("bias", nan),
        ("mass_ratio_mass_ratio", -0.01),
        ("mass_ratio_mass_ratio", 2.0 * P0_STD[0] ** 2),
        ("bias_drag_ratio", 1.0),
        ("rolling_variance", 0.0),
    ],
)
def test_what_can_not_have_been_learned_is_refused(
    kernel: Kernel | None,
    fused: Callable[..., Run],
    name: str,
    value: float,
) -> None:
    run = fused(kernel).feed(Driver(Truth()).town(1))
    numbers = run.state.learned()
    assert numbers is not None
    numbers[LEARNED_NAMES.index(name)] = value

    assert learned_fault(numbers)
    assert learned_fault(numbers[:-1])
