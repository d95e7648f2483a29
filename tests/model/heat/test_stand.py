"""Wheels that stand while others turn: a test stand, or dead sensors."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import pytest

from bstm_daemon.channels import WHEEL_SUSPECT
from bstm_daemon.roles import CORNERS

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.native.loader import Kernel

    from .conftest import Run

    Make = Callable[..., Run]

WHEELS: Final = tuple(f"wheel_speed_{name.lower()}" for name in CORNERS)
ACCEL: Final = "acceleration_longitudinal"
STEP_US: Final = 20_000
BRAKED_S: Final = 30.0
PRESSURE_PA: Final = 2e6


def speed_at(at_s: float) -> float:
    """Up to 25 m/s within 10 s, held, and braked to 5 m/s from 30 s on."""
    return min(2.5 * at_s, 25.0) - 4.0 * min(max(at_s - BRAKED_S, 0.0), 5.0)


@pytest.fixture
def driven(
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
    kernel: Kernel | None,
) -> Make:
    """Return what drives: (heat mode, share of the rate that it measures)."""

    def make(
        mode: str, share: float | None, noise: float = 0.05, **heat: Any
    ) -> Run:
        car = make_car(
            *(make_corner(name) for name in CORNERS),
            heat={"mode": mode, "assume_powertrain_torque_nm": 0.0, **heat},
        )
        roles = [*WHEELS, "vehicle_speed"]
        roles += [ACCEL] if share is not None else []
        roles += ["primary_pressure"] if mode == "ff" else []
        samples = []
        for i in range(round(40.0 / STEP_US * 1e6)):
            at_s = i * STEP_US * 1e-6
            speed = speed_at(at_s)
            rate = (speed_at(at_s + 0.1) - speed_at(at_s - 0.1)) / 0.2
            values = [0.0, 0.0, speed, speed, speed]
            if share is not None:
                values.append(share * rate + 0.3 + noise * (i % 3 - 1))
            if mode == "ff":
                values.append(PRESSURE_PA if at_s > BRAKED_S else 0.0)
            samples += [
                (i * STEP_US, role, value)
                for role, value in zip(roles, values, strict=True)
            ]
        return start(car, kernel, *roles).feed(samples)

    return make


def energy_j(run: Run, corner: int) -> float:
    """Heat of *corner*."""
    return 0.05 * sum(run.column("brake_power_w", corner))


@pytest.mark.parametrize(
    ("mode", "heat"), [("ff", {}), ("fb", {"slope": "flat"})]
)
def test_on_a_stand_a_disc_at_rest_gets_no_heat(
    driven: Make, mode: str, heat: dict[str, Any]
) -> None:
    """The other axle turns, and the accelerometer measures none of it."""
    run = driven(mode, 0.0, **heat)

    assert energy_j(run, 0) == energy_j(run, 1) == 0.0
    assert energy_j(run, 2) == energy_j(run, 3) > 10e3
    # whatever the air does to the brakes, it is not that of this speed
    assert run.flag("speed_suspect")[-1]
    assert run.flag("acceleration_contradicts")[-1]
    assert (
        int(run.of_car("flags")[-1]) & 3 * WHEEL_SUSPECT == 3 * WHEEL_SUSPECT
    )


@pytest.mark.parametrize(
    ("share", "noise"),
    [(1.0, 0.05), (0.5, 0.05), (None, 0.0), (0.0, 0.0)],
    ids=["sound", "half", "none", "frozen"],
)
@pytest.mark.parametrize(
    ("mode", "heat"), [("ff", {}), ("fb", {"slope": "flat"})]
)
def test_on_the_road_dead_sensors_leave_no_brake_cold(
    driven: Make,
    mode: str,
    heat: dict[str, Any],
    share: float | None,
    noise: float,
) -> None:
    """Nor where nothing tells the two apart: the other speeds count."""
    run = driven(mode, share, noise, **heat)

    assert energy_j(run, 0) == energy_j(run, 1) > 10e3
    assert energy_j(run, 0) >= energy_j(run, 2)
    assert (
        int(run.of_car("flags")[-1]) & 3 * WHEEL_SUSPECT == 3 * WHEEL_SUSPECT
    )


def test_a_single_wheel_at_rest_is_a_dead_sensor(
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
    kernel: Kernel | None,
) -> None:
    """No stand turns one wheel of an axle and holds the other."""
    car = make_car(*(make_corner(name) for name in CORNERS))
    roles = (*WHEELS, ACCEL, "primary_pressure")
    run = start(car, kernel, *roles)
    for i in range(2000):
        at_s = i * STEP_US * 1e-6
        speed = speed_at(at_s)
        pressed = PRESSURE_PA if at_s > BRAKED_S else 0.0
        noise = 0.01 * (i % 3)
        values = (0.0, speed, speed, speed, noise, pressed)
        run.feed(
            [(i * STEP_US, *one) for one in zip(roles, values, strict=True)]
        )

    assert energy_j(run, 0) == pytest.approx(energy_j(run, 1), rel=1e-9)
    assert energy_j(run, 0) > 10e3
