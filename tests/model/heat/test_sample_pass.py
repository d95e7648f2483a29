"""Brake power from samples, against closed forms, in both forms."""

from __future__ import annotations

from math import exp
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.channels import FLAGS
from bstm_daemon.model.heat.sample_plan import plan_samples
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.units import KELVIN_OFFSET

from .conftest import Run

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from bstm_daemon.native.loader import Kernel

PER_PA = 2.0 * 2.83e-3 * 0.38 * 0.13  # Nm/Pa of the corner
RADIUS = 0.3418


def held(
    seconds: float, every_us: int = 10_000, start_us: int = 0, **values: float
) -> Iterator[tuple[int, str, float]]:
    """Yield constant samples of several roles up to and with the end."""
    for at in range(start_us, start_us + round(seconds * 1e6) + 1, every_us):
        for role, value in values.items():
            yield at, role, value


def test_energy_of_a_stop_at_constant_pressure(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """Torque over radius times distance, exactly, at uneven stamps."""
    run = start(make_car(), kernel, "vehicle_speed", "primary_pressure")
    samples: list[tuple[int, str, float]] = [
        (0, "primary_pressure", 2e6),
        (0, "vehicle_speed", 30.0),
    ]
    at, speed, distance = 0, 30.0, 0.0
    while speed > 0.0:
        gap = 7_000 + (at * 31) % 11_000
        distance += speed * gap * 1e-6
        at += gap
        speed = max(speed - 6.0 * gap * 1e-6, 0.0)
        samples += [(at, "vehicle_speed", speed)]
        samples += [(at, "primary_pressure", 2e6)]
    samples.append((at + 100_000, "vehicle_speed", 0.0))
    run.feed(samples)
    energy = run.column("brake_energy_ff_j")[-1]
    assert energy == pytest.approx(PER_PA * 2e6 / RADIUS * distance)
    assert sum(run.column("brake_power_w")) * 0.05 == pytest.approx(energy)
    assert run.of_car("distance_m")[-1] == pytest.approx(distance)
    assert distance == pytest.approx(30.0**2 / 12.0, rel=0.01)


def test_each_wheel_has_its_speed_and_pressure(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
) -> None:
    """Wheel signals go before the vehicle's; the other falls back."""
    car = make_car(make_corner("FL"), make_corner("FR"))
    run = start(
        car, kernel, "wheel_speed_fl", "wheel_pressure_fl",
        "vehicle_speed", "primary_pressure",
    )  # fmt: skip
    run.feed(
        [
            *held(
                1.0,
                wheel_speed_fl=-9.0,
                wheel_pressure_fl=3e6,
                vehicle_speed=10.0,
                primary_pressure=1e6,
            )
        ]
    )
    left = run.column("brake_power_w", 0)[5]
    right = run.column("brake_power_w", 1)[5]
    assert left == pytest.approx(PER_PA * 3e6 * 9.0 / RADIUS)
    assert right == pytest.approx(PER_PA * 1e6 * 10.0 / RADIUS)


def test_secondary_circuit_and_rear_table(
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
) -> None:
    """A proportioning valve's points, between them and beyond the ends."""
    car = make_car(
        make_corner("FL"),
        make_corner("FR", circuit="secondary"),
        make_corner("RL"),
        heat={
            "front_pressure_pa": [1e5, 2e6, 6e6],
            "rear_pressure_pa": [1e5, 2e6, 3e6],
        },
    )
    for front, rear in ((0.0, 1e5), (1e6, 1e6), (4e6, 2.5e6), (9e6, 3e6)):
        run = start(car, kernel, "primary_pressure", "secondary_pressure")
        run.feed([*held(0.3, primary_pressure=front, secondary_pressure=7e5)])
        assert run.column("pressure_pa", 0)[3] == pytest.approx(front)
        assert run.column("pressure_pa", 1)[3] == pytest.approx(7e5)
        assert run.column("pressure_pa", 2)[3] == pytest.approx(rear)


def test_lag_is_first_order(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """Means over the steps of p (1 - exp(-t / tau)), exactly."""
    tau, p = 0.15, 2e6
    run = start(
        make_car(heat={"primary_lag_s": tau}), kernel, "primary_pressure"
    )
    run.feed([*held(1.0, primary_pressure=p)])
    for k, found in enumerate(run.column("pressure_pa")):
        a, b = 0.05 * k, 0.05 * (k + 1)
        mean = p * (1.0 - tau * (exp(-a / tau) - exp(-b / tau)) / 0.05)
        assert found == pytest.approx(mean, rel=1e-9)


def test_brake_on_is_a_share_of_the_step(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """Pressed for 20 of 50 ms."""
    run = start(make_car(), kernel, "primary_pressure")
    run.feed(
        [
            (0, "primary_pressure", 0.0),
            (30_000, "primary_pressure", 1e6),
            (50_000, "primary_pressure", 0.0),
            (100_000, "primary_pressure", 0.0),
        ]
    )
    assert run.column("brake_on") == pytest.approx([0.4, 0.0])
    assert run.column("pressure_pa")[0] == pytest.approx(0.4e6)


FB = {"mode": "fb", "assume_powertrain_torque_nm": 0.0}


def stop(slowing: float, **others: float) -> list[tuple[int, str, float]]:
    """Return 2 s at 30 m/s, a stop of constant deceleration, 3 s at 2 m/s."""
    samples: list[tuple[int, str, float]] = []
    speed = 30.0
    end = 5_000_000 + round((30.0 - 2.0) / slowing * 1e6)
    for at in range(0, end, 10_000):
        slowed = at < 2_000_000 or speed < 2.0 + 1e-9
        rate = 0.0 if slowed else -slowing
        samples.append((at, "vehicle_speed", speed))
        pressed = 0.0 if rate == 0.0 else 2e6
        samples.append((at, "primary_pressure", pressed))
        for role, value in others.items():
            shift = rate if role == "acceleration_longitudinal" else 0.0
            samples.append((at, role, value + shift))
        speed += rate * 0.01
    return samples


@pytest.mark.parametrize("form", ["accelerometer", "flat"])
def test_feed_back_energy_of_a_stop(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any, form: str
) -> None:
    """Kinetic energy less drag work, split 70 : 30 over the axles.

    Without an accelerometer the filtered speed follows late, but with the
    same kinetic energy: the brake lets go, and its tail is counted too. In
    the tail, 1.2 s at 2 m/s, drag is taken off that the brake did not do.
    """
    car = make_car(heat={**FB, "slope": form})
    roles = ["vehicle_speed", "primary_pressure"]
    others = {}
    if form == "accelerometer":
        others = {"acceleration_longitudinal": 0.0}
        roles += others
    run = start(car, kernel, *roles).feed(stop(4.0, **others))
    speeds = [30.0 - 0.04 * i for i in range(701)]
    mass = 2194.0 + 3.0809 / RADIUS**2
    kinetic = 0.5 * mass * (30.0**2 - 2.0**2)
    drag = sum(
        ((0.5 * 0.7 * 1.2041 * v + 4.0) * v + 2194.0 * 9.80665 * 0.014) * v
        for v in speeds
    )
    expected = 0.35 * (kinetic - drag * 0.01)
    found = run.column("brake_energy_fb_j")[-1]
    # speed is held for 10 ms, so 5 ms late: 0.12 % at this deceleration
    assert found == pytest.approx(expected, rel=0.002)
    assert sum(run.column("brake_power_w")) * 0.05 == pytest.approx(found)


def test_accelerometer_holds_the_slope(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """8 % downhill at constant 10 m/s: weight less resistance."""
    run = start(
        make_car(heat=FB), kernel, "vehicle_speed", "primary_pressure",
        "acceleration_longitudinal",
    )  # fmt: skip
    sensed = -9.80665 * 0.08
    run.feed(
        [
            *held(
                3.0,
                vehicle_speed=10.0,
                primary_pressure=5e5,
                acceleration_longitudinal=sensed,
            )
        ]
    )
    drag = (0.35 * 1.2041 * 10.0 + 4.0) * 10.0 + 2194.0 * 9.80665 * 0.014
    force = 2194.0 * 9.80665 * 0.08 - drag
    assert run.of_car("brake_force_n")[20] == pytest.approx(force)
    assert run.column("brake_power_w")[20] == pytest.approx(
        0.35 * force * 10.0
    )


def test_a_log_that_begins_while_driving_has_no_jolt(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """A speed that appears, first or after a gap, is no acceleration."""
    run = start(
        make_car(heat={**FB, "slope": "flat"}), kernel,
        "vehicle_speed", "powertrain_torque", "primary_pressure",
    )  # fmt: skip
    for first, seconds, speed in (
        (0, 1, 30.0),
        (1.01, 3, None),
        (4.02, 1, 30.0),
    ):
        held_values = {"powertrain_torque": 1000.0, "primary_pressure": 1e6}
        if speed is not None:
            held_values["vehicle_speed"] = speed
        run.feed([*held(seconds, 10_000, round(first * 1e6), **held_values)])
    drag = (0.35 * 1.2041 * 30.0 + 4.0) * 30.0 + 2194.0 * 9.80665 * 0.014
    force = 1000.0 / RADIUS - drag
    found = run.of_car("brake_force_n")
    assert found[:10] == pytest.approx([force] * 10)
    assert found[-10:] == pytest.approx([force] * 10)


def test_without_pressure_the_force_decides(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """Engine braking below 300 N of brake force heats nothing."""
    run = start(
        make_car(heat=FB), kernel, "vehicle_speed",
        "acceleration_longitudinal",
    )  # fmt: skip
    drag = (0.35 * 1.2041 * 20.0 + 4.0) * 20.0 + 2194.0 * 9.80665 * 0.014
    for force, braking in ((290.0, False), (310.0, True)):
        sensed = -(drag + force) / 2194.0
        first = run.state.times[0] + 10_000 if run.times else 0
        run.feed(
            [
                *held(
                    1.0,
                    start_us=first,
                    vehicle_speed=20.0,
                    acceleration_longitudinal=sensed,
                )
            ]
        )
        assert (run.of_car("brake_force_n")[-1] > 0.0) is braking
        assert (run.column("brake_power_w")[-1] > 0.0) is braking


def test_ambient_of_a_silent_bus_is_the_last_one(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """The air does not jump to the configured default, but is flagged."""
    run = start(make_car(), kernel, ambient_temperature=100_000)
    run.feed([(0, "ambient_temperature", 260.0), (900_000, "rain", 0.0)])

    assert set(run.column("ambient_k")[1:]) == {260.0}
    flags = [int(bits) for bits in run.of_car("flags")]
    assert flags[-1] & FLAGS["ambient_missing"]


def test_ambient_wetness_and_measured_are_held(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """Configured ambient until a sample; measured is nan when aged."""
    run = start(
        make_car(), kernel,
        ambient_temperature=60_000_000, rain=60_000_000,
        temp_fl_disc=100_000,
    )  # fmt: skip
    run.feed(
        [
            (0, "rain", 3.0),
            (60_000, "ambient_temperature", 260.0),
            (60_000, "temp_fl_disc", 500.0),
            (300_000, "rain", 0.25),
            (400_000, "rain", 0.25),
        ]
    )
    ambient = run.column("ambient_k")
    assert ambient[0] == pytest.approx(20.0 + KELVIN_OFFSET)
    assert set(ambient[1:]) == {260.0}
    assert run.column("wetness")[0] == 1.0
    assert run.column("wetness")[-1] == 0.25
    measured = run.column("measured_disc_k")
    assert measured[1:3] == [500.0, 500.0]
    assert all(m != m for m in (measured[0], *measured[4:]))  # noqa: PLR0124


def test_motion_gives_its_kinetic_energy_up_exactly(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """From 20 to 12 m/s in steps of any size: all of it and no more.

    The filter spreads it in time; the mean of its speed over an interval
    makes the sum that of the kinetic energies at both ends.
    """
    car = make_car(
        vehicle={
            "rolling_resistance": 0.0,
            "friction_ns_m": 0.0,
            "drag_area_m2": 0.0,
        },
        heat={"mode": "fb", "slope": "flat"},
    )
    run = start(car, kernel, "vehicle_speed", "primary_pressure")
    at, samples = 0, []
    for speed, count in ((20.0, 60), (16.0, 4), (15.0, 1), (12.0, 500)):
        for _ in range(count):
            at += 20_000
            samples += [
                (at, "vehicle_speed", speed),
                (at, "primary_pressure", 1e6),
            ]
    run.feed(samples)

    vehicle = car.vehicle
    mass_kg = (
        vehicle.mass_kg
        + vehicle.wheel_inertia_kg_m2 / vehicle.wheel_radius_m**2
    )
    expected = 0.5 * mass_kg * (20.0**2 - 12.0**2)
    found = run.state.memory().samples.total_fb
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_braking_that_no_pressure_shows_counts_by_its_share(
    kernel: Kernel | None, make_car: Any, share: float
) -> None:
    """Held back against 1000 Nm: force, power and brake on."""
    car = make_car(heat={**FB, "slope": "flat"})
    roles = ("vehicle_speed", "powertrain_torque", "primary_pressure")
    present = {ROLE_INDEX[role]: 500_000 for role in roles}
    run = Run(
        plan_samples(car, present, 50_000, unpressed_share=share), kernel
    )
    values = dict(zip(roles, (20.0, 1000.0, 0.0), strict=True))
    run.feed([*held(1.0, **values)])

    drag = (0.35 * 1.2041 * 20.0 + 4.0) * 20.0 + 2194.0 * 9.80665 * 0.014
    force = 1000.0 / RADIUS - drag
    assert force > 2000.0
    assert run.of_car("brake_force_n")[5:] == (
        pytest.approx([share * force] * len(run.times[5:]))
    )
    part = run.plan.numbers.force_share[0]
    assert run.column("brake_power_w")[-1] == (
        pytest.approx(part * share * force * 20.0)
    )
    assert run.column("brake_on")[-1] == pytest.approx(float(share > 0.0))
