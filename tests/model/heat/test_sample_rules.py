"""Rules of the pass: reverse, the brake's threshold, wheel pressures."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.native.loader import Kernel

FB = {"mode": "fb", "assume_powertrain_torque_nm": 0.0}


def slowing(sign: float) -> list[tuple[int, str, float]]:
    """Return 3 s of braking from 10 m/s at 3 m/s2, forwards or reversing."""
    samples: list[tuple[int, str, float]] = []
    for at in range(0, 3_000_000, 10_000):
        speed = 10.0 - 3.0 * at * 1e-6
        samples += [
            (at, "vehicle_speed", sign * speed),
            (at, "primary_pressure", 1e6),
            (at, "acceleration_longitudinal", -3.0 * sign),
        ]
    return samples


def test_reversing_brakes_as_much_as_driving(
    kernel: Kernel | None, start: Callable[..., Any], make_car: Any
) -> None:
    """The accelerometer points forward whichever way the car goes."""
    roles = ("vehicle_speed", "primary_pressure", "acceleration_longitudinal")
    forwards, back = (
        start(make_car(heat=FB), kernel, *roles)
        .feed(slowing(sign))
        .column("brake_energy_fb_j")[-1]
        for sign in (1.0, -1.0)
    )

    assert forwards > 20e3
    assert back == forwards


@pytest.mark.parametrize(("pressure_pa", "heats"), [(0.9e5, 0), (1.1e5, 1)])
def test_an_offset_of_the_sensor_heats_nothing(
    kernel: Kernel | None,
    start: Callable[..., Any],
    make_car: Any,
    pressure_pa: float,
    heats: int,
) -> None:
    """Feed-Forward begins above brake_on_pressure_pa, 1 bar by default."""
    run = start(make_car(), kernel, "vehicle_speed", "primary_pressure").feed(
        [
            (at, role, value)
            for at in range(0, 1_000_000, 20_000)
            for role, value in (
                ("vehicle_speed", 30.0),
                ("primary_pressure", pressure_pa),
            )
        ]
    )

    assert (run.column("brake_energy_ff_j")[-1] > 0) == bool(heats)


def test_a_pressure_at_the_wheel_has_its_lag_already(
    kernel: Kernel | None, start: Callable[..., Any], make_car: Any
) -> None:
    """The circuit's lag is between the primary signal and the wheel."""
    car = make_car(heat={"primary_lag_s": 2.0})
    samples = [(at, "wheel_pressure_fl", 2e6) for at in (0, 50_000, 100_000)]
    run = start(car, kernel, "wheel_pressure_fl").feed(samples)

    assert run.column("pressure_pa")[-1] == pytest.approx(2e6)
