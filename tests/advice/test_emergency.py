"""A6: standby, a score, three requests."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.advice.conditions import Conditions
from bstm_daemon.advice.emergency import EmergencyAssist
from bstm_daemon.estimate import (
    Assist,
    CornerEstimate,
    Intervention,
    RiskLevel,
    Validity,
)

if TYPE_CHECKING:
    from collections.abc import Callable

NAMES = ("FL", "FR", "RL", "RR")


class Brakes:
    """A car that brakes, ten times a second."""

    def __init__(
        self,
        make_car: Callable[..., Any],
        make_corner: Callable[..., Any],
        **advice: Any,
    ) -> None:
        car = make_car(*map(make_corner, NAMES), advice=advice)
        self.machine = EmergencyAssist(car)
        self.time_us = 0

    def brake(
        self,
        seconds: float,
        *,
        pressure_pa: float = 3e6,
        answer: float = 1.0,
        speed_ms: float = 10.0,
        hot: str = "FL FR",
        level: RiskLevel = RiskLevel.CRITICAL,
        **driver: float,
    ) -> tuple[Assist, Intervention, float]:
        """Return what is asked for; the brakes give *answer* of their due."""
        # four times 2 p A mu r over the mass and the wheel radius
        torque_nm = 4 * 2 * pressure_pa * 2.83e-3 * 0.38 * 0.13
        due_ms2 = torque_nm / 0.3418 / 2194.0
        corners = {
            name: CornerEstimate(
                sure_level=level if name in hot else RiskLevel.NORMAL,
                validity=Validity.VALID,
            )
            for name in NAMES
        }
        inputs = {"acceleration_longitudinal": -answer * due_ms2} | driver
        found = Assist.OFF, Intervention.NONE, 0.0
        for _ in range(round(seconds * 10)):
            self.time_us += 100_000
            found = self.machine.update(
                Conditions(
                    self.time_us,
                    corners,
                    speed_ms,
                    pressures_pa=dict.fromkeys(NAMES, pressure_pa),
                    driver={
                        k: v
                        for k, v in inputs.items()
                        if v == v  # noqa: PLR0124
                    },
                )
            )
        return found


@pytest.fixture
def brakes(
    make_car: Callable[..., Any], make_corner: Callable[..., Any]
) -> Brakes:
    return Brakes(make_car, make_corner)


def test_off_while_nothing_can_boil(brakes: Brakes) -> None:
    """Brakes that do not answer are no matter of vapour then."""
    found = brakes.brake(3.0, answer=0.0, level=RiskLevel.NORMAL)

    assert found == (Assist.OFF, Intervention.NONE, 0.0)


def test_unknown_is_no_reason(brakes: Brakes) -> None:
    found = brakes.brake(3.0, answer=0.0, level=RiskLevel.UNKNOWN)

    assert found[0] is Assist.OFF


def test_standby_while_the_brakes_answer(brakes: Brakes) -> None:
    found = brakes.brake(5.0, answer=0.95)

    assert found[:2] == (Assist.STANDBY, Intervention.NONE)
    assert found[2] < 0.1


def test_large_pressure_without_deceleration_is_detected(
    brakes: Brakes,
) -> None:
    """Not before it has lasted; over when the pedal is released."""
    assert brakes.brake(0.4, answer=0.05)[0] is Assist.STANDBY

    state, request, score = brakes.brake(1.5, answer=0.05)

    assert state is Assist.DETECTED
    assert request is Intervention.ISOLATE_FRONT
    assert score == pytest.approx(1.0)
    assert brakes.brake(0.2, pressure_pa=0.0)[0] is Assist.STANDBY


@pytest.mark.parametrize("slip", ["abs_active", "esc_active"])
def test_ice_is_not_vapour(brakes: Brakes, slip: str) -> None:
    found = brakes.brake(3.0, answer=0.05, **{slip: 1.0})

    assert found[0] is Assist.STANDBY


def test_a_pedal_at_the_floor_without_pressure(brakes: Brakes) -> None:
    """Vapour is compressed: far down, and nothing comes of it."""
    brakes.brake(0.5, pressure_pa=0.0, brake_pedal_travel=0.0)

    found = brakes.brake(
        1.5, pressure_pa=3e5, brake_pedal_travel=0.9, brake_switch=1.0
    )

    assert found[0] is Assist.DETECTED


def test_a_pressure_that_is_missing_is_not_small(brakes: Brakes) -> None:
    brakes.brake(0.5, pressure_pa=nan, brake_pedal_travel=0.0)

    found = brakes.brake(
        1.5, pressure_pa=nan, brake_pedal_travel=0.9, brake_switch=1.0
    )

    assert found == (Assist.STANDBY, Intervention.NONE, 0.0)


def test_a_fast_pedal_makes_it_count_more(brakes: Brakes) -> None:
    """An anxious driver: half a score becomes more of one."""
    brakes.brake(1.0, answer=0.4, brake_pedal_travel=0.1)
    calm = brakes.brake(0.5, answer=0.4, brake_pedal_travel=0.1)[2]

    anxious = brakes.brake(0.1, answer=0.4, brake_pedal_travel=0.4)[2]

    assert calm == pytest.approx(0.5, abs=0.02)
    assert anxious == pytest.approx(1.25 * calm, rel=0.02)


def test_without_an_accelerometer_the_slope_is_that_of_the_pitch(
    brakes: Brakes,
) -> None:
    """Down 10 % at constant speed the brakes do their due of 1 m/s2."""
    nothing = float("nan")
    pressure_pa = 0.67e6
    found = brakes.brake(
        3.0,
        pressure_pa=pressure_pa,
        acceleration_longitudinal=nothing,
        pitch=-0.0998,
    )
    assert found[2] == 0.0

    # level road, same pressure as before and no change of speed
    found = brakes.brake(
        3.0, pressure_pa=3e6, acceleration_longitudinal=nothing, pitch=0.0
    )
    assert found[2] == pytest.approx(1.0)

    found = brakes.brake(
        3.0, pressure_pa=3e6, acceleration_longitudinal=nothing
    )
    assert found[2] == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("split", "hot", "speed_ms", "request_"),
    [
        ("front-rear", "FL FR", 10.0, Intervention.MAXIMUM_PRESSURE),
        ("diagonal", "FL", 10.0, Intervention.MAXIMUM_PRESSURE),
        ("diagonal", "FL FR", 10.0, Intervention.ISOLATE_FRONT),
        ("diagonal", "FL FR RL RR", 5.0, Intervention.PARK_BRAKE),
        ("diagonal", "FL FR RL RR", 10.0, Intervention.MAXIMUM_PRESSURE),
        ("front-rear", "FL RR", 5.0, Intervention.PARK_BRAKE),
    ],
)
def test_the_request_is_what_the_circuits_leave(
    make_car: Callable[..., Any],
    make_corner: Callable[..., Any],
    split: str,
    hot: str,
    speed_ms: float,
    request_: Intervention,
) -> None:
    brakes = Brakes(make_car, make_corner, brake_split=split)

    found = brakes.brake(2.0, answer=0.0, hot=hot, speed_ms=speed_ms)

    assert found[:2] == (Assist.DETECTED, request_)


def test_a_car_that_stands_has_no_deceleration_to_miss(
    brakes: Brakes,
) -> None:
    assert brakes.brake(3.0, answer=0.0, speed_ms=0.0)[2] == 0.0
