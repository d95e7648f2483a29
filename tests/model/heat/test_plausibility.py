"""Checks of the inputs: each comes, goes and stays away; both forms agree."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.channels import (
    CORNER_PRESSURE,
    CORNER_PRESSURE_SUSPECT,
    FLAGS,
    HEAT_LOST,
    HEAT_UNCERTAIN,
    WHEEL_SUSPECT,
)
from bstm_daemon.model.heat.check_rules import Hysteresis
from bstm_daemon.model.heat.memory import CheckMemory, SampleState
from bstm_daemon.model.heat.motion_checks import compare_turns
from bstm_daemon.model.heat.plausibility import (
    FAULTS,
    SUSPECT,
    WORDS,
    fault_names,
    reasons,
)
from bstm_daemon.native.layout import zeros
from bstm_daemon.native.loader import load_module
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from bstm_daemon.native.loader import Kernel

    from .conftest import Run

COMPILED = load_module("native._kernel") is not None


@pytest.fixture(
    scope="module",
    params=[
        # slow beside the compiled form, to whose bits a test here holds it
        pytest.param(
            "reference", marks=[pytest.mark.slow, pytest.mark.full] * COMPILED
        ),
        "compiled",
    ],
)
def kernel(request: pytest.FixtureRequest) -> Kernel | None:
    """Return None for the pure-Python form, then the compiled kernel."""
    if request.param == "reference":
        return None
    found: Kernel = request.getfixturevalue("compiled")
    return found


Samples = list[tuple[int, str | int, float]]
CORNERS = ("fl", "fr", "rl", "rr")
WHEELS = tuple(f"wheel_speed_{corner}" for corner in CORNERS)
EVERY_US = 50_000
STEPS_PER_S = 20


class Drive:
    """Samples of many roles, second by second."""

    def __init__(self) -> None:
        """Begin at 0."""
        self.at_us = 0
        self.samples: Samples = []

    def hold(self, seconds: float, **values: float) -> Drive:
        """Keep *values*; a role that is not named is silent."""
        return self.ramp(
            seconds, **{role: (v, v) for role, v in values.items()}
        )

    def ramp(self, seconds: float, **values: tuple[float, float]) -> Drive:
        """Go from the first to the last of each value."""
        count = round(seconds * 1e6 / EVERY_US)
        for i in range(count):
            self.at_us += EVERY_US
            for role, (first, last) in values.items():
                value = first + (last - first) * i / count
                self.samples.append((self.at_us, role, value))
        return self


def wheels(speed: float, **others: float) -> dict[str, float]:
    """Return all wheels at *speed* but those named by their corner."""
    return {
        f"wheel_speed_{corner}": others.get(corner, speed)
        for corner in CORNERS
    }


@pytest.fixture(scope="session")
def four(make_car: Any, make_corner: Any) -> Callable[..., Any]:
    """Return the maker of a car with four corners."""

    def make(**sections: Any) -> Any:
        return make_car(*(make_corner(c.upper()) for c in CORNERS), **sections)

    return make


@pytest.fixture(scope="session")
def circuits(make_car: Any, make_corner: Any) -> Callable[..., Any]:
    """Return the maker of a car with corners by circuit."""

    def make(mode: str = "ff", **corners: list[str]) -> Any:
        return make_car(
            *(
                make_corner(name, circuit=circuit)
                for circuit, names in corners.items()
                for name in names
            ),
            heat={"mode": mode},
        )

    return make


def bits(run: Run, mask: int) -> list[bool]:
    """Return whether any bit of *mask* is set, over the steps."""
    return [bool(int(f) & mask) for f in run.of_car("flags")]


def first_s(marks: list[bool]) -> float:
    """Return when the first mark is, in seconds."""
    return marks.index(True) / STEPS_PER_S


# One sample at a time


@pytest.mark.parametrize(
    ("role", "normal", "spike", "bit"),
    [
        ("vehicle_speed", 20.0, 60.0, "speed_suspect"),
        ("primary_pressure", 1e6, 200e5, "pressure_suspect"),
        ("acceleration_longitudinal", 0.0, -60.0, "acceleration_suspect"),
        ("powertrain_torque", 500.0, 9e4, "torque_suspect"),
        ("ambient_temperature", 290.0, 320.0, "temperature_suspect"),
        ("temp_fl_disc", 400.0, 1500.0, "temperature_suspect"),
    ],
)
def test_a_spike_is_not_taken(  # noqa: PLR0917
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    role: str,
    normal: float,
    spike: float,
    bit: str,
) -> None:
    """One sample far off: counted, suspect for 2 s, never computed with."""
    drive = Drive().hold(1.0, **{role: normal}).hold(0.05, **{role: spike})
    drive.hold(4.0, **{role: normal})
    run = start(make_car(), kernel, role).feed(drive.samples)

    assert run.state.memory().checks.jumps_refused == 1
    assert run.state.memory().checks.out_of_range == 0
    marks = bits(run, FLAGS[bit])
    assert first_s(marks) == pytest.approx(1.0, abs=0.1)
    assert marks.count(True) == pytest.approx(2 * STEPS_PER_S, abs=1)
    assert bits(run, FLAGS["samples_refused"]) == marks
    for channel in ("speed_ms", "pressure_pa"):
        assert len(set(run.column(channel)[2:])) == 1
    held = [v for v in run.column("measured_disc_k") if v == v]  # noqa: PLR0124
    assert set(held) <= {400.0}


DAY_US = 86_400_000_000


@pytest.mark.parametrize("days", [-40, 40])
def test_a_role_is_no_longer_suspect_when_the_clock_is_set(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    days: int,
) -> None:
    """Two seconds in all, some before the step and the rest after it."""
    normal = {"ambient_temperature": 290.0, "vehicle_speed": 5.0}
    drive = Drive().hold(1.0, **normal).hold(0.05, ambient_temperature=320.0)
    drive.hold(0.5, **normal)
    drive.at_us += days * DAY_US
    drive.hold(4.0, **normal)
    run = start(make_car(), kernel, *normal).feed(drive.samples)

    assert run.count("jumps") == 1
    marks = bits(run, FLAGS["temperature_suspect"])
    assert first_s(marks) == pytest.approx(1.0, abs=0.1)
    assert marks.count(True) == pytest.approx(2 * STEPS_PER_S, abs=2)
    assert bits(run, FLAGS["samples_refused"]) == marks


@pytest.mark.parametrize("days", [-40, 40])
def test_a_step_may_be_confirmed_after_the_clock_is_set(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    days: int,
) -> None:
    drive = Drive().hold(1.0, vehicle_speed=0.0).hold(0.05, vehicle_speed=50.0)
    drive.hold(0.1, primary_pressure=0.0)
    drive.at_us += days * DAY_US
    drive.hold(0.4, vehicle_speed=50.0)
    run = start(make_car(), kernel, "vehicle_speed", "primary_pressure").feed(
        drive.samples
    )

    assert run.count("jumps") == 1
    assert run.state.memory().checks.jumps_refused == 1
    assert run.column("speed_ms")[-1] == pytest.approx(50.0)


@pytest.mark.parametrize("days", [-40, 40])
def test_a_bus_falls_silent_after_the_clock_is_set(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    tick: int,
    days: int,
) -> None:
    """A second after the last sample, by whatever clock."""
    drive = Drive().hold(1.0, vehicle_speed=5.0)
    run = start(make_car(), kernel, "vehicle_speed").feed(drive.samples)
    steps, at_us = len(run.times), drive.at_us + days * DAY_US
    run.feed([(at_us + EVERY_US * i, tick, 0.0) for i in range(60)])

    assert run.count("jumps") == 1
    marks = bits(run, FLAGS["silent"])
    assert not any(marks[: steps + STEPS_PER_S - 2])
    assert all(marks[steps + STEPS_PER_S + 2 :])
    assert len(marks) > steps + 2 * STEPS_PER_S


def test_a_step_that_is_confirmed_is_taken(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """The second sample near the first confirms it: the world changed."""
    drive = Drive().hold(1.0, vehicle_speed=0.0).hold(1.0, vehicle_speed=50.0)
    run = start(make_car(), kernel, "vehicle_speed").feed(drive.samples)

    assert run.state.memory().checks.jumps_refused == 1
    assert run.column("speed_ms")[-1] == pytest.approx(50.0)


def test_two_spikes_apart_confirm_nothing(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """Random values stay out, one after the other."""
    drive = Drive().hold(1.0, vehicle_speed=0.0)
    for value in (100.0, 30.0, 140.0, 60.0):
        drive.hold(0.05, vehicle_speed=value)
    drive.hold(0.5, vehicle_speed=0.5)
    run = start(make_car(), kernel, "vehicle_speed").feed(drive.samples)

    assert run.state.memory().checks.jumps_refused == 4
    assert max(run.column("speed_ms")) < 1.0


@pytest.mark.parametrize(
    ("role", "value"),
    [
        ("wheel_speed_fl", 151.0),
        ("vehicle_speed", -151.0),
        ("primary_pressure", 401e5),
        ("wheel_pressure_fl", -6e5),
        ("ambient_temperature", 400.0),
        ("temp_fl_fluid", 100.0),
    ],
)
def test_what_can_not_be_is_no_sample(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    role: str,
    value: float,
) -> None:
    """Out of the physical range, even as the first sample or confirmed."""
    run = start(make_car(), kernel, role)
    run.feed(Drive().hold(1.0, **{role: value}).samples)

    assert run.state.memory().checks.out_of_range == STEPS_PER_S
    assert run.state.last_value(0) is None
    assert all(bits(run, FLAGS["samples_refused"]))


def test_the_hardest_braking_is_no_jump(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """A wheel that locks at 20 g, pressure at 1500 bar/s, sampled slowly."""
    drive = Drive().hold(1.0, wheel_speed_fl=30.0, primary_pressure=0.0)
    drive.ramp(0.15, wheel_speed_fl=(30.0, 0.6), primary_pressure=(0.0, 220e5))
    drive.hold(1.0, wheel_speed_fl=0.0, primary_pressure=220e5)
    run = start(make_car(), kernel, "wheel_speed_fl", "primary_pressure").feed(
        drive.samples
    )

    assert run.state.memory().checks.jumps_refused == 0


def test_a_value_that_comes_back_is_no_jump(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """After a gap beyond the time-out there is nothing to compare with."""
    drive = Drive().hold(1.0, vehicle_speed=0.0).hold(1.0)
    drive.at_us += 1_000_000
    drive.hold(1.0, vehicle_speed=90.0)
    run = start(make_car(), kernel, "vehicle_speed").feed(drive.samples)

    assert run.state.memory().checks.jumps_refused == 0
    assert run.column("speed_ms")[-1] == pytest.approx(90.0)


# Wheels


def test_a_wheel_apart_comes_goes_and_is_left_out(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """After 2 s; the mean is then that of the others.

    5 s leave 0.088 of the 0.4 in the filtered scale, below 0.07 4.8 s later;
    10 s after that it is gone.
    """
    drive = Drive().hold(1.0, **wheels(20.0, rr=12.0))
    drive.hold(4.0, **wheels(20.0, rr=12.0)).hold(20.0, **wheels(20.0))
    run = start(four(), kernel, *WHEELS).feed(drive.samples)

    marks = bits(run, WHEEL_SUSPECT << 3)
    assert first_s(marks) == pytest.approx(2.0, abs=0.1)
    assert marks.count(True) / STEPS_PER_S == pytest.approx(17.8, abs=0.2)
    assert not marks[-1]
    assert bits(run, FLAGS["wheels_contradict"]) == marks
    assert not any(bits(run, WHEEL_SUSPECT * 7 | FLAGS["speed_suspect"]))
    speed = run.of_car("speed_ms")
    assert speed[20] == pytest.approx(18.0)
    assert speed[60] == pytest.approx(20.0)


def test_an_axle_that_spins_does_not_heat_the_brakes(
    compiled: Kernel, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """In both forms the speed over ground is that of the slower axle."""
    roles = (*WHEELS, "powertrain_torque", "acceleration_longitudinal")
    found = []
    for front in (10.0, 12.0):
        drive = Drive().hold(
            5.0,
            **wheels(10.0, fl=front, fr=front),
            powertrain_torque=200.0,
            acceleration_longitudinal=-3.0,
        )
        runs = [
            start(four(heat={"mode": "fb"}), form, *roles).feed(drive.samples)
            for form in (None, compiled)
        ]
        assert runs[0].bits() == runs[1].bits()
        found.append(runs[0].column("brake_energy_fb_j")[-1])

    assert found[0] > 1e5
    assert found[1] == pytest.approx(found[0], rel=1e-9)


def test_wheels_that_drive_on_are_not_stuck_where_two_die(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """Constant to the bit, while the median falls from 10 to 5 m/s."""
    drive = Drive().hold(10.0, **wheels(10.0))
    drive.hold(10.0, **wheels(10.0, fl=0.0, fr=0.0))
    run = start(four(), kernel, *WHEELS).feed(drive.samples)

    assert not any(bits(run, FLAGS["stuck"]))
    marks = bits(run, FLAGS["wheels_contradict"])
    assert first_s(marks) == pytest.approx(12.0, abs=0.1)
    assert marks[-1]
    assert bits(run, FLAGS["speed_suspect"])[-1]


CONSTANT = [(40.0, 15.0, 15.0, 0.0)]
BRISK = [(10.0, 5.0, 5.0, 0.0), (5.0, 5.0, 20.0, 3.0), (40.0, 20.0, 20.0, 0.0)]
"""Seconds, first and last speed [m/s], acceleration [m/s2]."""


@pytest.mark.parametrize(
    ("spans", "more", "from_s"),
    [
        # 0.4 MJ of braking, and no change of speed
        (CONSTANT, (), "at 0.4 MJ"),
        # a satellite knows the speed, not what the accelerometer reads
        (CONSTANT, ("gnss_speed",), "at 0.4 MJ"),
        # one brisk start has shown it
        (BRISK, (), None),
        # all speeds leap, the car does not
        ([*BRISK, (9.0, 10.0, 10.0, 0.0)], (), 55.0),
        # a slow signal of a car that brakes leaps as well
        ([*BRISK, (9.0, 10.0, 10.0, -6.0)], (), None),
    ],
)
def test_speeds_are_unproven_until_they_have_changed(
    kernel: Kernel | None,
    start: Callable[..., Run],
    four: Callable[..., Any],
    spans: list[tuple[float, float, float, float]],
    more: tuple[str, ...],
    from_s: float | str | None,
) -> None:
    """Half of a constant speed looks like the whole of it."""
    drive, roles = Drive(), (*WHEELS, *more)
    for seconds, first, last, accel in spans:
        drive.ramp(
            seconds,
            **dict.fromkeys(roles, (first, last)),
            acceleration_longitudinal=(accel, accel),
            primary_pressure=(2e6, 2e6),
        )
    others = ("primary_pressure", "acceleration_longitudinal")
    run = start(four(), kernel, *roles, *others).feed(drive.samples)

    marks = bits(run, FLAGS["speed_unproven"])
    assert any(marks) is (from_s is not None)
    if isinstance(from_s, float):
        assert first_s(marks) == pytest.approx(from_s, abs=0.11)
        assert marks[-1]
    elif from_s:
        heats = [run.column("brake_energy_ff_j", c) for c in range(4)]
        braked = [False, *(sum(j) > 4e5 for j in zip(*heats, strict=True))]
        assert marks == braked[:-1]
        assert 0.0 < first_s(marks) < 30.0


def test_a_dead_wheel_has_the_speed_of_the_others(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """A brake does not stay cold because its sensor is broken."""
    drive = Drive().hold(6.0, **wheels(20.0, fl=0.0), primary_pressure=2e6)
    run = start(four(), kernel, *WHEELS, "primary_pressure").feed(
        drive.samples
    )

    power = [run.column("brake_power_w", corner)[-1] for corner in range(4)]
    assert power[0] == pytest.approx(power[1])
    assert run.column("brake_power_w", 0)[5] == 0.0


@pytest.mark.parametrize(
    ("speeds", "braking"),
    [
        # 4.5 m around the bend's centre, 1.5 m track, at 12 km/h
        ({"fl": 2.9, "fr": 4.0, "rl": 2.4, "rr": 3.6}, False),
        # inner and outer wheels 18 % apart at 40 km/h
        ({"fl": 10.1, "fr": 12.1, "rl": 10.0, "rr": 11.9}, False),
        # anti-lock braking, a quarter slower
        ({"fl": 15.0, "fr": 20.0, "rl": 18.0, "rr": 19.0}, True),
    ],
)
def test_bends_slip_and_spin_contradict_nothing(
    kernel: Kernel | None,
    start: Callable[..., Run],
    four: Callable[..., Any],
    speeds: dict[str, float],
    braking: bool,  # noqa: FBT001
) -> None:
    """For as long as it lasts."""
    pressure = 60e5 if braking else 0.0
    drive = Drive().hold(
        10.0, **wheels(0.0, **speeds), primary_pressure=pressure
    )
    run = start(four(), kernel, *WHEELS, "primary_pressure").feed(
        drive.samples
    )

    assert not any(bits(run, FLAGS["wheels_contradict"] | WHEEL_SUSPECT * 15))


@pytest.mark.parametrize("rl", [0.5, 0.85, 0.92, 1.08, 1.5])
def test_a_wrong_scale_is_left_out(
    kernel: Kernel | None,
    start: Callable[..., Run],
    four: Callable[..., Any],
    rl: float,
) -> None:
    """Of one wheel, while the brakes are on: the others' speed counts."""
    drive = Drive().hold(
        120.0, **wheels(20.0, rl=20.0 * rl), primary_pressure=10e5
    )
    run = start(four(), kernel, *WHEELS, "primary_pressure").feed(
        drive.samples
    )

    assert bits(run, WHEEL_SUSPECT << 2)[-1]
    assert not any(bits(run, WHEEL_SUSPECT * 11 | FLAGS["speed_suspect"]))
    assert run.of_car("speed_ms")[-1] == pytest.approx(20.0)
    # filtered over 20 s, then 2 s; a speed far off is found at once
    if rl in {0.85, 0.92}:
        error = 1.0 - rl
        found_s = -20.0 * math.log(1.0 - 0.07 / error) + 2.0
        first = first_s(bits(run, WHEEL_SUSPECT << 2))
        assert first == pytest.approx(found_s, abs=0.15)


@pytest.mark.parametrize("rl", [0.94, 1.06])
def test_a_spare_tyre_has_another_scale(
    kernel: Kernel | None,
    start: Callable[..., Run],
    four: Callable[..., Any],
    rl: float,
) -> None:
    """6 % are no finding, however long."""
    drive = Drive().hold(300.0, **wheels(20.0, rl=20.0 * rl))
    run = start(four(), kernel, *WHEELS).feed(drive.samples)
    assert not any(bits(run, WHEEL_SUSPECT * 15))


def test_two_wheels_against_two(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """Nobody knows which are right: all are suspect, and the speed."""
    drive = Drive().hold(60.0, **wheels(20.0, fl=10.0, fr=10.0))
    run = start(four(), kernel, *WHEELS).feed(drive.samples)
    assert bits(run, WHEEL_SUSPECT * 15)[-1]
    assert bits(run, FLAGS["speed_suspect"])[-1]


def test_wheels_against_the_vehicle_s_speed(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """Four wheels share a tyre's radius: nobody knows which is right."""
    drive = Drive().hold(60.0, **wheels(20.0), vehicle_speed=30.0)
    run = start(four(), kernel, *WHEELS, "vehicle_speed").feed(drive.samples)
    assert bits(run, FLAGS["speed_suspect"])[-1]
    assert not any(bits(run, WHEEL_SUSPECT * 15))


def test_half_of_a_low_speed(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """The highest speed says whether the car is in a narrow bend."""
    drive = Drive().hold(60.0, **wheels(7.0), vehicle_speed=7.9)
    run = start(four(), kernel, *WHEELS, "vehicle_speed").feed(drive.samples)
    assert not any(bits(run, FLAGS["speed_suspect"]))

    drive = Drive().hold(60.0, **wheels(7.0), vehicle_speed=8.1)
    run = start(four(), kernel, *WHEELS, "vehicle_speed").feed(drive.samples)
    assert bits(run, FLAGS["speed_suspect"])[-1]


def test_an_intervention_is_no_wrong_scale(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """The stability system slows one wheel by a tenth for half a minute."""
    drive = Drive().hold(
        30.0, **wheels(20.0, rl=18.0), esc_active=1.0, primary_pressure=0.0
    )
    run = start(
        four(), kernel, *WHEELS, "esc_active", "primary_pressure"
    ).feed(drive.samples)
    assert not any(bits(run, WHEEL_SUSPECT * 15))


def test_of_two_speeds_both_are_suspect(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """One says 20, one 30 m/s: the speed itself is suspect; then not."""
    drive = Drive().hold(4.0, wheel_speed_fl=20.0, vehicle_speed=30.0)
    drive.hold(14.0, wheel_speed_fl=25.0, vehicle_speed=25.0)
    run = start(make_car(), kernel, "wheel_speed_fl", "vehicle_speed").feed(
        drive.samples
    )

    marks = bits(run, FLAGS["speed_suspect"])
    assert first_s(marks) == pytest.approx(2.0, abs=0.1)
    assert bits(run, WHEEL_SUSPECT) == marks
    assert marks.count(True) / STEPS_PER_S == pytest.approx(12.0, abs=0.2)


def test_a_wheel_that_stands_still_while_the_car_starts_is_stuck(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """Two of four are dead: no majority, but the others move."""
    drive = Drive().hold(8.0, **wheels(0.0))
    drive.ramp(
        10.0,
        wheel_speed_fl=(0.0, 0.0),
        wheel_speed_fr=(0.0, 0.0),
        wheel_speed_rl=(0.0, 20.0),
        wheel_speed_rr=(0.0, 20.0),
    )
    run = start(four(), kernel, *WHEELS).feed(drive.samples)

    assert bits(run, FLAGS["stuck"])[-1]
    assert bits(run, WHEEL_SUSPECT) == bits(run, WHEEL_SUSPECT << 1)
    assert not any(bits(run, WHEEL_SUSPECT << 2 | WHEEL_SUSPECT << 3))
    assert run.of_car("speed_ms")[-1] == pytest.approx(20.0, abs=0.2)


@pytest.mark.parametrize("held", [0.0, 20.0])
def test_all_wheels_freeze_while_the_vehicle_drives_on(
    kernel: Kernel | None,
    start: Callable[..., Run],
    four: Callable[..., Any],
    held: float,
) -> None:
    """They are in one message: the one that moves is right, and unchecked."""
    dead = dict.fromkeys(WHEELS, (held, held))
    drive = Drive().hold(8.0, **wheels(held), vehicle_speed=held)
    drive.ramp(30.0, **dead, vehicle_speed=(held, held + 15.0))
    drive.hold(2.0, **wheels(held), vehicle_speed=held + 15.0)
    run = start(four(), kernel, *WHEELS, "vehicle_speed").feed(drive.samples)

    # 3 m/s at 0.5 m/s2, and a second
    marks = bits(run, FLAGS["stuck"])
    assert first_s(marks) == pytest.approx(15.0, abs=0.1)
    assert marks[-1]
    assert bits(run, FLAGS["speed_suspect"])[-1]
    assert bits(run, WHEEL_SUSPECT << 3) == marks
    assert run.of_car("speed_ms")[-1] == pytest.approx(held + 15.0, abs=0.2)


# Pressure


@pytest.mark.parametrize(
    ("read", "more", "comes"),
    [
        (0.84, {}, True),
        (1.19, {}, True),
        (0.86, {}, False),
        (0.5, {"abs_active": 1.0}, False),
    ],
)
def test_left_against_right_of_an_axle(
    kernel: Kernel | None,
    start: Callable[..., Run],
    circuits: Callable[..., Any],
    read: float,
    more: dict[str, float],
    comes: bool,  # noqa: FBT001
) -> None:
    """10 % of 10 bar beyond 0.5 bar: both brake by the higher."""
    roles = "primary_pressure", "secondary_pressure", "vehicle_speed", *more
    held = dict(zip(roles, (1e6, read * 1e6, 20.0), strict=False))
    drive = Drive().hold(10.0, **held, **more)
    car = circuits(primary=["FL"], secondary=["FR", "RR"])
    run = start(car, kernel, *roles).feed(drive.samples)

    marks = bits(run, FLAGS["pressure_contradicts"])
    assert any(marks) is comes
    assert bits(run, FLAGS["pressure_suspect"]) == marks
    assert bits(run, CORNER_PRESSURE_SUSPECT) == marks
    assert bits(run, CORNER_PRESSURE_SUSPECT << 1) == marks
    assert not any(bits(run, CORNER_PRESSURE_SUSPECT << 2))
    left, right = (run.column("pressure_pa", c)[-1] for c in range(2))
    assert left == pytest.approx(max(1.0, read if comes else 1.0) * 1e6)
    if comes:
        # settled for 0.5 s, then failing for 2 s
        assert first_s(marks) == pytest.approx(2.5, abs=0.11)
        assert left == right
    else:
        assert right == pytest.approx(read * 1e6)


@pytest.mark.parametrize("most_pa", [2e6, 1e7])
def test_left_against_right_forgets_noise(
    kernel: Kernel | None,
    start: Callable[..., Run],
    circuits: Callable[..., Any],
    most_pa: float,
) -> None:
    """Of any difference 60 % of 10 bar counts, 10 s long, and 5 s more."""
    roles = "primary_pressure", "secondary_pressure", "vehicle_speed"
    noise = dict(zip(roles, (most_pa, most_pa / 4.0, 20.0), strict=True))
    sound = dict(zip(roles, (8e5, 8e5, 20.0), strict=True))
    drive = Drive().hold(4.0, **noise).hold(30.0, **sound)
    car = circuits(primary=["FL"], secondary=["FR", "RR"])
    run = start(car, kernel, *roles).feed(drive.samples)

    marks = bits(run, FLAGS["pressure_contradicts"])
    # 6 f exp(-t / 10 s) = 0.1 (8 (1 - exp(-t / 10 s)) + 10 f exp(-t / 10 s))
    filled = 1.0 - math.exp(-0.35)
    ends_s = 10.0 * math.log(1.0 + (6.0 - 1.0) * filled / 0.8)
    assert first_s(marks) == pytest.approx(2.5, abs=0.11)
    assert marks.count(True) / STEPS_PER_S == pytest.approx(
        4.0 - 2.5 + ends_s + 5.0, abs=0.2
    )


@pytest.mark.parametrize("mode", ["ff", "fused"])
def test_circuits_of_two_axles(
    kernel: Kernel | None,
    start: Callable[..., Run],
    circuits: Callable[..., Any],
    mode: str,
) -> None:
    """Mode fused sees the sum of both only; a balance bar looks the same."""
    car = circuits(mode, primary=["FL", "FR"], secondary=["RL", "RR"])
    roles = "primary_pressure", "secondary_pressure", "vehicle_speed"
    held = dict(zip(roles, (1e6, 6e5, 20.0), strict=True))
    run = start(car, kernel, *roles).feed(Drive().hold(9.0, **held).samples)
    assert any(bits(run, FLAGS["pressure_suspect"])) is (mode == "fused")
    assert run.column("pressure_pa", 2)[-1] == pytest.approx(6e5)


def test_a_pressure_that_never_moves_is_stuck(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """20 bar to the bit for 30 s while the speed changes; then alive."""
    drive = Drive()
    for first, last in ((20.0, 30.0), (30.0, 20.0), (20.0, 30.0)):
        drive.ramp(
            12.0, vehicle_speed=(first, last), primary_pressure=(2e6,) * 2
        )
    stuck_s = drive.at_us * 1e-6
    drive.ramp(15.0, vehicle_speed=(30.0, 30.0), primary_pressure=(2e6, 1e6))
    run = start(make_car(), kernel, "vehicle_speed", "primary_pressure").feed(
        drive.samples
    )

    marks = bits(run, FLAGS["stuck"])
    assert 30.0 < first_s(marks) < stuck_s
    assert bits(run, FLAGS["pressure_suspect"]) == marks
    assert bits(run, CORNER_PRESSURE_SUSPECT) == marks
    assert not marks[-1]
    assert marks[round((stuck_s + 5) * STEPS_PER_S)]


@pytest.mark.parametrize(
    ("pressure_pa", "switch", "esc", "comes"),
    [
        (6e5, 0.0, 0.0, True),
        (4e5, 0.0, 0.0, False),  # a light touch, or an offset
        (6e5, 1.0, 0.0, False),
        (6e5, 0.0, 1.0, False),  # the stability system brakes
        (0.0, 1.0, 0.0, False),  # a foot that rests on the pedal
    ],
)
def test_pressure_without_the_switch(  # noqa: PLR0917
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    pressure_pa: float,
    switch: float,
    esc: float,
    comes: bool,  # noqa: FBT001
) -> None:
    """More than 5 bar for more than 1 s; goes after 10 s of agreement."""
    common = {"vehicle_speed": 20.0, "esc_active": esc}
    drive = Drive().hold(
        3.0, primary_pressure=pressure_pa, brake_switch=switch, **common
    )
    drive.hold(12.0, primary_pressure=0.0, brake_switch=0.0, **common)
    run = start(
        make_car(), kernel, "primary_pressure", "brake_switch", *common
    ).feed(drive.samples)

    marks = bits(run, FLAGS["switch_contradicts"])
    assert any(marks) is comes
    if comes:
        assert first_s(marks) == pytest.approx(1.0, abs=0.1)
        assert marks.count(True) / STEPS_PER_S == pytest.approx(12.0, abs=0.2)
        assert bits(run, FLAGS["pressure_suspect"]) == marks


@pytest.mark.parametrize(
    ("low_pa", "comes"), [(-0.9e5, True), (-0.7e5, False)]
)
@pytest.mark.parametrize("mode", ["ff", "fb", "fused"])
def test_a_pressure_below_that_of_the_air(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    mode: str,
    low_pa: float,
    comes: bool,  # noqa: FBT001
) -> None:
    """No brake has it: the zero is off, and is when it brakes as well."""
    drive = Drive().hold(2.0, vehicle_speed=20.0, primary_pressure=low_pa)
    drive.hold(299.0, vehicle_speed=20.0, primary_pressure=1e6)
    braked = len(drive.samples)
    drive.hold(4.0, vehicle_speed=20.0, primary_pressure=0.0)
    run = start(
        make_car(heat={"mode": mode}),
        kernel,
        "vehicle_speed",
        "primary_pressure",
    ).feed(drive.samples)

    marks = bits(run, FLAGS["pressure_contradicts"])
    assert any(marks) is comes
    assert marks[braked // 2 - 1] is comes
    assert not marks[-1]
    if comes:
        assert first_s(marks) == pytest.approx(1.0, abs=0.1)
    assert bits(run, FLAGS["pressure_suspect"]) == marks
    assert bits(run, CORNER_PRESSURE_SUSPECT) == marks


@pytest.mark.parametrize(
    ("air_k", "comes"), [(233.15, True), (232.9, False), (233.4, False)]
)
def test_air_at_the_lowest_code(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    air_k: float,
    comes: bool,  # noqa: FBT001
) -> None:
    """-40 degC for a minute may be weather, and is more often no sensor."""
    drive = Drive().hold(70.0, ambient_temperature=air_k)
    drive.hold(12.0, ambient_temperature=235.0)
    run = start(make_car(), kernel, "ambient_temperature").feed(drive.samples)

    marks = bits(run, FLAGS["ambient_suspect"])
    assert any(marks) is comes
    if comes:
        assert first_s(marks) == pytest.approx(60.0, abs=0.1)
    assert not marks[-1]
    # the configured one is warmer
    found = run.column("ambient_k")[65 * STEPS_PER_S]
    assert found == pytest.approx(293.15 if comes else air_k)


@pytest.mark.parametrize(
    ("below_k", "over_s", "comes_s"),
    [
        (20.0, 0.0, 10.0),
        (12.0, 0.0, None),  # too little: the history follows within 8 s
        (30.0, 120.0, None),  # out of a garage
    ],
)
def test_air_that_falls_faster_than_weather(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    below_k: float,
    over_s: float,
    comes_s: float | None,
) -> None:
    """The history, 0.25 K/s lower by then, stands in until the air is back."""
    drive = Drive().hold(20.0, ambient_temperature=300.0)
    for second in range(round(over_s)):
        part = second / over_s
        drive.hold(1.0, ambient_temperature=300.0 - part * below_k)
    drive.hold(60.0, ambient_temperature=300.0 - below_k)
    drive.hold(15.0, ambient_temperature=297.0)
    car = make_car(vehicle={"ambient_c": 0.0})
    run = start(car, kernel, "ambient_temperature").feed(drive.samples)

    marks = bits(run, FLAGS["ambient_suspect"])
    assert any(marks) is (comes_s is not None)
    assert not marks[-1]
    if comes_s is not None:
        assert first_s(marks) == pytest.approx(20.0 + comes_s, abs=0.1)
        late = round(75.0 * STEPS_PER_S)
        assert marks[late]
        assert run.column("ambient_k")[late] == pytest.approx(
            300.0 - 0.25 * comes_s, abs=0.1
        )
        assert run.state.last_air_k == 297.0


def test_air_is_any_after_half_a_day(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    drive = Drive().hold(2.0, ambient_temperature=300.0)
    drive.at_us += 13 * 3_600_000_000
    drive.hold(20.0, ambient_temperature=280.0)
    run = start(make_car(), kernel, "ambient_temperature").feed(drive.samples)

    assert run.flag("settled")[-1] is False
    assert any(run.flag("settled"))
    assert not any(run.flag("ambient_suspect"))
    assert run.state.air_k == 280.0


def test_air_without_a_reading_falls_as_in_a_clear_night(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """3 K/h; what is known before the first sample counts."""
    run = start(make_car(), kernel, "ambient_temperature")
    run.state.know_air(300.0)
    run.feed(Drive().hold(120.0, vehicle_speed=5.0).samples)
    assert run.state.air_k == pytest.approx(299.9, abs=1e-3)

    cold = Drive()
    cold.at_us = 120_000_000
    run.feed(cold.hold(20.0, ambient_temperature=280.0).samples)
    marks = bits(run, FLAGS["ambient_suspect"])
    assert first_s(marks) == pytest.approx(130.0, abs=0.2)
    assert run.state.last_air_k == pytest.approx(297.4, abs=0.1)


# Accelerometer


@pytest.mark.parametrize(
    ("felt", "comes"),
    [
        (lambda a: a / 9.80665, True),  # in g
        (lambda a: a, False),
        (lambda a: a + 2.0, False),  # 20 % uphill
    ],
)
def test_acceleration_against_the_wheels(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    felt: Callable[[float], float],
    comes: bool,  # noqa: FBT001
) -> None:
    """Stops at 6 m/s2; comes after 5 s, stays until it is right again."""
    drive = Drive()
    for found in (*[felt] * 4, *[float] * 6):
        for first, last, a in ((0.0, 54.0, 6.0), (54.0, 0.0, -6.0)):
            drive.ramp(
                9.0,
                vehicle_speed=(first, last),
                acceleration_longitudinal=(found(a),) * 2,
            )
    run = start(
        make_car(), kernel, "vehicle_speed", "acceleration_longitudinal"
    ).feed(drive.samples)

    marks = bits(run, FLAGS["acceleration_contradicts"])
    assert any(marks) is comes
    assert marks[72 * STEPS_PER_S] is comes
    assert not marks[-1]
    assert bits(run, FLAGS["acceleration_suspect"]) == marks


def cycles(count: int, rate: float, sign: float, drive: Drive) -> Drive:
    """Speed up and stop *count* times at *rate*; *sign* as it is mounted."""
    top = 9.0 * rate
    for _ in range(count):
        for first, last, a in ((0.0, top, rate), (top, 0.0, -rate)):
            drive.ramp(
                9.0,
                vehicle_speed=(first, last),
                acceleration_longitudinal=(sign * a,) * 2,
            )
    return drive


@pytest.mark.parametrize(
    ("rate", "comes_s"), [(3.0, 18.0), (6.0, 9.0), (1.5, 0.0)]
)
def test_an_accelerometer_the_wrong_way_round(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    rate: float,
    comes_s: float,
) -> None:
    """Found where a slope is no excuse; gone once it is mounted right."""
    drive = cycles(2, rate, -1.0, Drive())
    wrong_s = drive.at_us * 1e-6
    cycles(6, rate, 1.0, drive)
    run = start(
        make_car(), kernel, "vehicle_speed", "acceleration_longitudinal"
    ).feed(drive.samples)

    marks = bits(run, FLAGS["acceleration_contradicts"])
    assert any(marks) is bool(comes_s)
    if comes_s:
        assert first_s(marks) < comes_s
        assert marks[round(wrong_s * STEPS_PER_S)]
    assert not marks[-1]


def town(
    drive: Drive, seconds: float, *, speed: float, accel: float, grade: float
) -> Drive:
    """Speed up and slow down by 1.2 m/s2, every 8 s, on a rolling road."""
    rate, now = 1.2, 15.0
    for i in range(round(seconds * STEPS_PER_S)):
        at_s = i / STEPS_PER_S
        rate = 1.2 if at_s % 16.0 < 8.0 else -1.2
        now += rate / STEPS_PER_S
        slope = 9.81 * grade * math.sin(at_s / 5.0)
        drive.hold(
            0.05,
            vehicle_speed=speed * now,
            acceleration_longitudinal=accel * (rate + slope),
        )
    return drive


@pytest.mark.parametrize(
    ("speed", "felt", "active", "comes"),
    [
        (1.0, 1.0, 0.0, False),
        (1.0, 1.1, 0.0, False),  # the body rolls
        (1.0, 0.8, 0.0, False),  # a bend is banked
        (1.15, 1.0, 0.0, False),  # too much heat hides none
        (0.85, 1.0, 0.0, True),
        (0.85, -1.0, 0.0, True),  # positive to the other side
        (0.85, 1.0, 1.0, False),  # a skid is no bend
    ],
)
def test_speeds_that_are_too_low_for_their_bends(  # noqa: PLR0917
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    speed: float,
    felt: float,
    active: float,
    comes: bool,  # noqa: FBT001
) -> None:
    """Bends of 2 m/s2 to both sides, at 15 m/s; then the speed is right."""
    drive = Drive()
    for i in range(40):
        side = 2.0 * (-1.0) ** i
        drive.hold(
            2.0,
            vehicle_speed=15.0 * (speed if i < 20 else 1.0),
            yaw_rate=side / 15.0,
            acceleration_lateral=side * (felt if i < 20 else 1.0),
            esc_active=active,
        )
    run = start(
        make_car(),
        kernel,
        *("vehicle_speed", "yaw_rate", "acceleration_lateral", "esc_active"),
    ).feed(drive.samples)

    marks = bits(run, FLAGS["speed_suspect"])
    assert any(marks) is comes
    if comes:
        # 15 m2/s3 by a speed of 0.85
        assert first_s(marks) == pytest.approx(5.2, abs=0.1)
    assert not marks[-1]


@pytest.mark.parametrize(
    ("speed", "accel", "comes"),
    [
        (1.0, 1.0, False),
        (0.85, 1.0, False),  # no slope may look like a fault
        (1.0, 0.8, False),
        (0.62, 1.0, True),  # mph
        (0.5, 1.0, True),
        (1.0, 0.5, True),
        (1.6, 1.0, True),
        (1.0, 2.0, True),
    ],
)
@pytest.mark.parametrize("mode", ["ff", "fb"])
def test_all_speeds_or_the_accelerometer_by_a_factor(  # noqa: PLR0917
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    mode: str,
    speed: float,
    accel: float,
    comes: bool,  # noqa: FBT001
) -> None:
    """Both are suspect; right again after some minutes of right values."""
    drive = town(Drive(), 100.0, speed=speed, accel=accel, grade=0.06)
    town(drive, 200.0, speed=1.0, accel=1.0, grade=0.06)
    roles = ("vehicle_speed", "acceleration_longitudinal")
    run = start(make_car(heat={"mode": mode}), kernel, *roles).feed(
        drive.samples
    )

    marks = bits(run, FLAGS["acceleration_contradicts"])
    assert marks[99 * STEPS_PER_S] is comes
    assert any(marks) is comes
    assert not marks[-1]
    assert bits(run, FLAGS["speed_suspect"]) == marks
    assert bits(run, FLAGS["acceleration_suspect"]) == marks


@pytest.mark.parametrize(
    ("held", "step", "comes"),
    [(0.0, 1.5, True), (12.0, 1.5, True), (12.0, 1.0, False)],
)
def test_all_speeds_frozen(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    held: float,
    step: float,
    comes: bool,  # noqa: FBT001
) -> None:
    """Constant to the bit while the car brakes; no crest is as abrupt."""
    roles = ("vehicle_speed", "wheel_speed_fl", "wheel_speed_rr")
    speeds = dict.fromkeys(roles, held)
    drive = Drive().hold(8.0, **speeds, acceleration_longitudinal=0.0)
    drive.hold(4.0, **speeds, acceleration_longitudinal=-step)
    drive.hold(8.0, **speeds, acceleration_longitudinal=-step)
    drive.ramp(
        15.0,
        acceleration_longitudinal=(-step, -step),
        **dict.fromkeys(roles, (held, held + 10.0)),
    )
    run = start(make_car(), kernel, *roles, "acceleration_longitudinal").feed(
        drive.samples
    )

    marks = bits(run, FLAGS["speed_suspect"])
    assert any(marks) is comes
    assert bits(run, FLAGS["stuck"]) == marks
    if comes:
        assert 8.5 < first_s(marks) < 11.0
        assert marks[20 * STEPS_PER_S]
    assert not marks[-1]


@pytest.mark.parametrize(
    ("accel", "seconds", "comes"),
    [(0.45, 12.0, True), (0.35, 60.0, False), (0.45, 6.0, False)],
)
@pytest.mark.parametrize("speed", [0.0, 10.0])
def test_a_standing_car_does_not_change_its_slope(  # noqa: PLR0917
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    speed: float,
    accel: float,
    seconds: float,
    comes: bool,  # noqa: FBT001
) -> None:
    """A gentle start that no speed shows; at constant speed it is a hill."""
    roles = ("vehicle_speed", "acceleration_longitudinal")
    drive = Drive()
    for found, held_s in ((0.0, 8.0), (accel, seconds), (0.0, 10.0)):
        drive.hold(
            held_s, vehicle_speed=speed, acceleration_longitudinal=found
        )
    run = start(make_car(), kernel, *roles).feed(drive.samples)

    marks = bits(run, FLAGS["speed_suspect"])
    assert any(marks) is (comes and speed == 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_noise_leaves_no_doubt(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    seed: int,
) -> None:
    """No car drove what noise made of the speed; the steady one after did.

    Its pedal is held and its speed constant, so that neither check could
    take back what it had found.
    """
    chance = random.Random(seed)  # noqa: S311
    steady = {
        "vehicle_speed": 20.0,
        "primary_pressure": 2e6,
        "acceleration_longitudinal": 0.0,
    }
    drive = Drive().hold(10.0, **steady)
    for _ in range(10 * STEPS_PER_S):
        noise = {
            "vehicle_speed": chance.uniform(-20.0, 200.0),
            "primary_pressure": chance.uniform(-5e5, 400e5),
            "acceleration_longitudinal": chance.uniform(-120.0, 120.0),
        }
        drive.hold(0.05, **(noise if chance.random() < 0.5 else steady))
    sound_s = drive.at_us * 1e-6 + 5.0
    drive.hold(60.0, **steady)
    run = start(make_car(), kernel, *steady).feed(drive.samples)

    assert any(bits(run, FLAGS["samples_refused"]))
    after = bits(run, SUSPECT)[round(sound_s * STEPS_PER_S) :]
    assert not any(after)


# What is done without heat


FB = {"mode": "fb", "assume_powertrain_torque_nm": 0.0}


def braking(seconds: float, **others: float) -> dict[str, tuple[float, float]]:
    """Return a stop of 3 m/s2 that lasts *seconds*."""
    return {
        "vehicle_speed": (10.0 + 3.0 * seconds, 10.0),
        **{role: (value, value) for role, value in others.items()},
    }


def test_without_pressure_feed_back_stands_in(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """Mode ff, no pressure, speed and an assumed torque: 70 : 30."""
    car = four(heat={"assume_powertrain_torque_nm": 0.0})
    drive = Drive().hold(1.0, vehicle_speed=28.0).ramp(6.0, **braking(6.0))
    run = start(car, kernel, "vehicle_speed", "primary_pressure").feed(
        drive.samples
    )

    assert all(bits(run, FLAGS["heat_substituted"])[2:])
    assert not any(bits(run, FLAGS["heat_unknown"])[1:])
    front, rear = (run.column("brake_power_w", c)[100] for c in (0, 2))
    assert front == pytest.approx(
        0.35
        * run.of_car("brake_force_n")[100]
        * (run.of_car("speed_ms")[100]),
        rel=0.1,
    )
    assert rear == pytest.approx(front * 0.3 / 0.7)


def test_without_torque_feed_forward_stands_in(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """Mode fb whose torque falls silent, with a pressure."""
    car = four(heat={"mode": "fb"})
    roles = ("vehicle_speed", "primary_pressure", "powertrain_torque")
    held = {"vehicle_speed": 20.0, "primary_pressure": 2e6}
    drive = Drive().hold(2.0, **held, powertrain_torque=-500.0)
    drive.hold(2.0, **held)
    run = start(car, kernel, *roles).feed(drive.samples)
    by_pressure = start(four(), kernel, *roles).feed(drive.samples)

    other = bits(run, FLAGS["heat_substituted"])
    assert not any(other[:40])
    assert other[-1]
    for corner in range(4):
        assert (
            run.column("brake_power_w", corner)[-1]
            == by_pressure.column("brake_power_w", corner)[-1]
            > 0.0
        )


def test_heat_that_nobody_knows(
    kernel: Kernel | None, start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """Told at once, lost after 10 s, felt 30 times as long."""
    common = {"vehicle_speed": 20.0}
    drive = Drive().hold(2.0, **common, wheel_pressure_fl=0.0)
    drive.hold(12.5, **common).hold(
        30.0 * 12.0 + 10.0, **common, wheel_pressure_fl=0.0
    )
    if kernel is None:
        drive.samples = drive.samples[:600]
    run = start(four(), kernel, "vehicle_speed", "wheel_pressure_fl").feed(
        drive.samples
    )

    # the others have no pressure from the start
    assert bits(run, HEAT_LOST << 1).index(True) == pytest.approx(200, abs=2)
    unknown, lost, aftermath = (
        bits(run, bit)
        for bit in (FLAGS["heat_unknown"], HEAT_LOST, HEAT_UNCERTAIN)
    )
    assert all(unknown)
    # missing after the time-out of 0.5 s
    assert first_s(lost) == pytest.approx(12.5, abs=0.1)
    assert lost.count(True) == pytest.approx(2.0 * STEPS_PER_S, abs=2)
    assert aftermath.index(True) == lost.index(True) + lost.count(True)
    if kernel is not None:
        assert aftermath.count(True) / STEPS_PER_S == pytest.approx(
            30.0 * 12.0, abs=2.0
        )
        assert not aftermath[-1]


@pytest.mark.parametrize(
    "values",
    [
        {"vehicle_speed": 0.0},  # a car that stands
        {"primary_pressure": 0.5e5},  # a brake that is released
        {"primary_pressure": 2e6, "vehicle_speed": 20.0},
    ],
)
def test_heat_that_is_known_to_be_there_or_not(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    values: dict[str, float],
) -> None:
    """No outage where the missing input can not matter."""
    run = start(make_car(), kernel, "vehicle_speed", "primary_pressure")
    run.feed(Drive().hold(15.0, **values).samples)

    assert not any(bits(run, FLAGS["heat_unknown"] | HEAT_LOST))


def test_a_speed_lost_while_braking_is_heat_unknown(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """Pressure above the threshold and no speed."""
    run = start(make_car(), kernel, "vehicle_speed", "primary_pressure")
    run.feed(Drive().hold(12.0, primary_pressure=2e6).samples)

    assert bits(run, HEAT_LOST)[-1]


def test_a_silent_bus_is_a_parked_car(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any, tick: int
) -> None:
    """Whatever was before: nothing is lost by silence alone."""
    run = start(make_car(), kernel, "vehicle_speed", "primary_pressure")
    run.feed(
        Drive().hold(2.0, vehicle_speed=30.0, primary_pressure=2e6).samples
    )
    run.feed([(40_000_000, tick, 0.0)])

    assert bits(run, FLAGS["silent"])[-1]
    assert not any(bits(run, HEAT_LOST | HEAT_UNCERTAIN))


# Both forms


VALUES = {
    "speed": st.sampled_from([0.0, 0.3, 4.0, 12.0, 20.0, 28.0]),
    "pressure": st.sampled_from([0.0, 2e5, 6e5, 2e6, 2e6]),
    "acceleration": st.sampled_from([-8.0, -3.0, 0.0, 3.0]),
}
KINDS = {
    **dict.fromkeys((*WHEELS, "vehicle_speed"), "speed"),
    **dict.fromkeys(
        ("primary_pressure", "secondary_pressure", "wheel_pressure_rr"),
        "pressure",
    ),
    "acceleration_longitudinal": "acceleration",
}
OTHERS = ("brake_switch", "esc_active", "powertrain_torque", "temp_rl_disc")
EPISODES = st.lists(
    st.tuples(
        st.sampled_from([0.3, 1.1, 3.0, 9.0]),
        st.fixed_dictionaries(
            {},
            optional={
                role: st.tuples(VALUES[kind], VALUES[kind])
                for role, kind in KINDS.items()
            }
            | {
                "brake_switch": st.sampled_from([(0.0, 0.0), (1.0, 1.0)]),
                "esc_active": st.just((0.0, 0.0)),
                "powertrain_torque": st.just((300.0, -200.0)),
            },
        ),
        st.sampled_from([None, *KINDS, "powertrain_torque", "temp_rl_disc"]),
        st.floats(-1e3, 1e8),
    ),
    min_size=1,
    max_size=6,
)


def driven(episodes: list[Any]) -> Iterator[tuple[int, str | int, float]]:
    """Yield episodes of ramps, each with one odd sample."""
    drive = Drive()
    for seconds, values, odd, value in episodes:
        drive.ramp(seconds, **values)
        if odd is not None:
            drive.samples.append((drive.at_us, odd, value))
    yield from drive.samples
    yield drive.at_us + 2_000_000, -1, 0.0


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(
    episodes=EPISODES,
    mode=st.sampled_from(["ff", "fb", "measured"]),
    assumed=st.sampled_from([None, 0.0]),
    cuts=st.lists(st.floats(0.0, 1.0), max_size=3),
)
def test_both_forms_judge_alike(  # noqa: PLR0917
    compiled: Kernel,
    start: Callable[..., Run],
    four: Callable[..., Any],
    episodes: list[Any],
    mode: str,
    assumed: float | None,
    cuts: list[float],
) -> None:
    """Bit for bit, memory included, over all that goes wrong at once.

    Cut anywhere, too: whatever is suspect is so in the next call.
    """
    heat = {"mode": mode, "assume_powertrain_torque_nm": assumed}
    roles = (*KINDS, *OTHERS)
    samples = list(driven(episodes))
    one, two = (
        start(four(heat=heat), form, *roles).feed(samples)
        for form in (None, compiled)
    )

    assert one.bits() == two.bits()
    pieces = start(four(heat=heat), compiled, *roles)
    places = sorted(round(cut * len(samples)) for cut in cuts)
    for first, last in pairwise([0, *places, len(samples)]):
        pieces.feed(samples[first:last])
    assert pieces.bits() == two.bits()


# Names and words


def test_the_memory_is_unpacked_by_name(
    start: Callable[..., Run], four: Callable[..., Any]
) -> None:
    """Each entry of the arrays has a name; storing changes none."""
    state = SampleState.new()
    memory = state.memory()
    assert memory.samples.filtered_speed == memory.checks.slow_speed == -1.0
    run = start(four(), None, "vehicle_speed").feed(
        Drive().hold(1.0, vehicle_speed=7.0).samples
    )
    before = run.bits()
    memory = run.state.memory()
    role = ROLE_INDEX["vehicle_speed"]
    assert memory.samples.value[role] == memory.checks.speed_held[4] == 7.0
    assert memory.checks.last_sample == memory.samples.stamp[role] == 1_000_000
    run.state.store(memory)
    assert run.bits() == before


def test_bits_are_apart() -> None:
    """No two flags share a bit, and a float64 holds them all."""
    single = [*FLAGS.values()]
    for first in (
        CORNER_PRESSURE,
        WHEEL_SUSPECT,
        CORNER_PRESSURE_SUSPECT,
        HEAT_LOST,
        HEAT_UNCERTAIN,
    ):
        single += [first << corner for corner in range(4)]

    assert sum(single) == (1 << len(single)) - 1 < 2**53


def test_words() -> None:
    """Plain words, corners by name, groups by their worst."""
    flags = (
        FLAGS["speed_missing"]
        | FLAGS["pressure_suspect"]
        | FLAGS["switch_contradicts"]
        | WHEEL_SUSPECT << 2
    )

    assert reasons(0) == []
    assert reasons(flags) == [
        "speed missing",
        "pressure suspect",
        "braking without brake switch",
        "wheel speed suspect: RL",
    ]
    assert all(reasons(1 << bit) for bit in range(50))


def test_faults_name_every_bit_once() -> None:
    """But those of the clock, and what is also said of the whole car."""
    clock = FLAGS["clock_jump"] | FLAGS["settled"]
    also = 0b1111 * (CORNER_PRESSURE | CORNER_PRESSURE_SUSPECT)

    assert sum(FAULTS.values()) == ((1 << 53) - 1) & ~clock & ~also
    assert FAULTS.keys() <= WORDS.keys()
    assert fault_names(clock) == ()
    assert fault_names(FLAGS["stuck"] | HEAT_LOST << 3) == (
        "stuck",
        "heat_lost",
    )


def test_hysteresis() -> None:
    """Comes after its time, goes after its own, waits where unknown."""
    check = Hysteresis(1.0, 3.0)
    fault_s = 0.0
    outcomes = []
    for failed in [True] * 3 + [None] * 9 + [False] * 5 + [True]:
        fault_s = check.advance(fault_s, 0.5, failed=failed)
        outcomes.append(fault_s >= check.comes_s)

    assert outcomes == [False] + [True] * 16 + [True]
    for _ in range(6):
        fault_s = check.advance(fault_s, 0.5, failed=False)
    assert fault_s == 0.0


def test_each_reason_has_words_of_its_own() -> None:
    assert all(len(words) > 5 for words in WORDS.values())
    assert len(set(WORDS.values())) == len(WORDS)


@pytest.mark.parametrize(
    ("turn_ms2", "speed_ms", "counts"),
    [
        (0.9, 20.0, False),
        (-1.1, 20.0, True),
        (3.0, 4.9, False),
        (3.0, 5.1, True),
    ],
)
def test_a_bend_counts_above_its_speed_and_acceleration(
    turn_ms2: float, speed_ms: float, *, counts: bool
) -> None:
    """From 1 m/s2 and 5 m/s on; what is kept is of the last 30 m2/s3."""
    m = zeros(CheckMemory)
    now: Any = SimpleNamespace(
        speed=speed_ms,
        yaw_rate=turn_ms2 / speed_ms,
        dt_s=0.1,
        lateral=1.5 * turn_ms2,
        intervenes=False,
    )

    compare_turns(m, now)

    square = 0.1 * turn_ms2 * turn_ms2 if counts else 0.0
    assert m.turn_square == pytest.approx(square)
    assert m.turn_lateral == pytest.approx(1.5 * square)
    assert m.lateral_square == pytest.approx(2.25 * square)
    for _ in range(4000):
        compare_turns(m, now)
    assert m.turn_square == pytest.approx(30.0 if counts else 0.0)
