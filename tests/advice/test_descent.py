"""P3 and A4: a slope, a town, a shift."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.advice.conditions import Conditions
from bstm_daemon.advice.descent import Descent
from bstm_daemon.estimate import Downshift

if TYPE_CHECKING:
    from collections.abc import Callable

NONE, DOWN = Downshift.NONE, Downshift.SHIFT_DOWN
MASS_KG = 2194.0


class Road:
    """Speed and brake power told ten times a second."""

    def __init__(self, make_car: Callable[..., Any], gearbox: str) -> None:
        self.machine = Descent(make_car(advice={"gearbox": gearbox}))
        self.time_us = 0

    def drive(
        self,
        seconds: float,
        speed_ms: tuple[float, float],
        power_w: float,
        **driver: float,
    ) -> tuple[Downshift, Downshift]:
        """Return the advice after *seconds* from one speed to another."""
        steps = round(seconds * 10)
        found = NONE, NONE
        for i in range(1, steps + 1):
            self.time_us += 100_000
            v = speed_ms[0] + (speed_ms[1] - speed_ms[0]) * i / steps
            found = self.machine.update(
                Conditions(self.time_us, {}, v, power_w, driver=driver)
            )
        return found


@pytest.fixture(params=["manual", "automatic"])
def road(request: pytest.FixtureRequest, make_car: Callable[..., Any]) -> Road:
    return Road(make_car, request.param)


def either(found: tuple[Downshift, Downshift]) -> Downshift:
    return max(found)


def test_a_held_descent_asks_for_a_lower_gear(
    make_car: Callable[..., Any],
) -> None:
    """9 kW at 36 km/h for a minute; who is asked depends on the gearbox."""
    for gearbox, expected in (
        ("manual", (DOWN, NONE)),
        ("automatic", (NONE, DOWN)),
        ("none", (NONE, NONE)),
    ):
        found = Road(make_car, gearbox).drive(60.0, (10.0, 10.0), 9e3)
        assert found == expected


def test_a_stop_is_no_descent(road: Road) -> None:
    """Ten stops from 50 km/h: all of the heat is the car's own speed."""
    v = 50 / 3.6
    power_w = 0.5 * MASS_KG * v**2 / 5.0
    for _ in range(10):
        assert either(road.drive(20.0, (v, v), 0.0)) is NONE
        assert either(road.drive(5.0, (v, 0.1), power_w * 0.9)) is NONE
    assert road.machine.slope_power_w < 1e3


def test_braking_in_bends_of_a_descent_counts_without_the_stops(
    road: Road,
) -> None:
    """8 % down: from 70 to 40 km/h and on, brake power above the speed's."""
    fast, slow = 70 / 3.6, 40 / 3.6
    kinetic_w = 0.5 * MASS_KG * (fast**2 - slow**2) / 6.0
    found = []
    for _ in range(12):
        road.drive(8.0, (slow, fast), 0.0)
        found.append(either(road.drive(6.0, (fast, slow), kinetic_w + 2e4)))

    assert found[0] is NONE
    assert DOWN in found


def test_it_ends_with_the_slope(road: Road) -> None:
    road.drive(60.0, (10.0, 10.0), 9e3)

    assert either(road.drive(120.0, (10.0, 10.0), 0.0)) is NONE


@pytest.mark.parametrize(
    "driver",
    [
        {"gear": 1.0},
        {"gear": 3.0, "clutch_open": 1.0},
        {"gear": 3.0, "engine_speed": 420.0},
    ],
)
def test_not_where_a_lower_gear_can_not_be(
    road: Road, driver: dict[str, float]
) -> None:
    assert either(road.drive(60.0, (10.0, 10.0), 9e3, **driver)) is NONE


def test_a_driver_who_has_shifted_is_left_alone(road: Road) -> None:
    assert either(road.drive(60.0, (10.0, 10.0), 9e3, gear=4.0)) is DOWN
    assert either(road.drive(1.0, (10.0, 10.0), 9e3, gear=3.0)) is NONE
    assert either(road.drive(10.0, (10.0, 10.0), 9e3, gear=3.0)) is DOWN


def test_standing_asks_for_nothing(road: Road) -> None:
    road.drive(60.0, (10.0, 10.0), 9e3)

    assert either(road.drive(0.5, (0.0, 0.0), 9e3)) is NONE
