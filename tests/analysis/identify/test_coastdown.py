"""Resistances of the simulated car from its CAN frames."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.identify.coastdown import identify_coast_down
from bstm_daemon.analysis.identify.coasting import coasting, theory
from bstm_daemon.analysis.quality.limits import GRID_S
from bstm_daemon.errors import LogError
from bstm_daemon.simulation import NOMINAL

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.identify.driving import Driving
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

    from .conftest import Logged

    Reader = Callable[..., Driving]
    Example = tuple[Config, SignalMap]

OTHER = replace(
    NOMINAL,
    rolling_resistance=0.0105,
    friction_ns_m=7.0,
    drag_area_m2=0.95,
)
"""A car that is not the configured one: 36 % more drag."""

ONE_WAY = """
[drive]
name = "one way"
description = "one coast-down"
[[segment]]
speed_kmh = 110.0
rate_ms2 = 2.0
gear = 4
duration_s = 40.0
[[segment]]
until_speed_kmh = 15.0
gear = 0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 1.0
gear = 2
"""

CITY = """
[drive]
name = "no coast"
description = "driven and braked"
[[segment]]
speed_kmh = 60.0
rate_ms2 = 2.0
gear = 3
duration_s = 30.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 3.0
"""


@pytest.mark.slow
def test_values_of_another_car(
    logged: Logged, driving: Reader, example: Example
) -> None:
    """Sensors n1, four runs on a grade of 0.2 %: within three errors."""
    found = identify_coast_down(
        [driving(logged("coastdown", car=OTHER))], example[0]
    )

    values = found.values
    assert all(one.identified for one in found.values.values())
    assert values["drag_area_m2"].value == pytest.approx(0.95, abs=0.035)
    assert values["friction_ns_m"].value == pytest.approx(7.0, abs=0.7)
    assert values["rolling_resistance"].value == pytest.approx(
        0.0105, abs=0.0003
    )
    for name, true in (
        ("drag_area_m2", 0.95),
        ("friction_ns_m", 7.0),
        ("rolling_resistance", 0.0105),
    ):
        error = abs(values[name].value - true)
        assert error < 3.5 * values[name].standard_error
    assert found.road == "both ways"
    assert [run.direction for run in found.runs] == [1, -1, 1, -1]
    assert [run.grade for run in found.runs] == pytest.approx(
        [0.002, -0.002] * 2, abs=2e-4
    )


@pytest.mark.parametrize(
    "sensors",
    ["n1", *(pytest.param(n, marks=pytest.mark.slow) for n in ("n2", "n3"))],
)
def test_even_grade_leaves_the_accelerometer_out(
    logged: Logged, driving: Reader, example: Example, sensors: str
) -> None:
    """Speeds alone, quantum 0.01 to 0.06 m/s: 3 % of drag."""
    found = identify_coast_down(
        [driving(logged("coastdown", sensors, car=OTHER))],
        example[0],
        even_grade=True,
    )

    assert found.values["drag_area_m2"].value == pytest.approx(0.95, rel=0.03)
    assert found.values["friction_ns_m"].value == pytest.approx(7.0, abs=0.5)
    assert found.values["rolling_resistance"].value == pytest.approx(
        0.0105, abs=0.0002
    )
    assert found.bias_ms2 is None


@pytest.mark.slow
def test_several_logs_are_one_fit(
    logged: Logged, driving: Reader, example: Example
) -> None:
    """There in one log, back in another: neither knows f_r, both do."""
    there = ONE_WAY.replace("gear = 0\n", "gear = 0\ngrade_percent = 0.5\n")
    back = ONE_WAY.replace("gear = 0\n", "gear = 0\ngrade_percent = -0.5\n")
    # one sensor is on both logs, so the bias is the same
    drivings = [driving(logged(drive, seed=4)) for drive in (there, back)]

    single = identify_coast_down(drivings[:1], example[0])
    both = identify_coast_down(drivings, example[0])

    true = NOMINAL.rolling_resistance
    assert both.road == "both ways"
    assert both.values["rolling_resistance"].value == pytest.approx(
        true, abs=3e-4
    )
    assert single.values["rolling_resistance"].value == pytest.approx(
        true + 0.005, abs=5e-4
    )
    assert any("assumed level" in text for text in single.remarks)


@pytest.mark.slow
def test_one_way_gives_no_rolling_resistance(
    logged: Logged, driving: Reader, example: Example
) -> None:
    found = identify_coast_down(
        [driving(logged("coastdown"))], example[0], one_way=True
    )

    rolling = found.values["rolling_resistance"]
    assert not rolling.identified
    assert "grade" in rolling.caveat
    assert found.values["drag_area_m2"].identified


@pytest.mark.slow
def test_held_value_stays_and_the_others_gain(
    logged: Logged, driving: Reader, example: Example
) -> None:
    """The thesis's own case: drag is known, f_r and C_fric are tuned."""
    drivings = [driving(logged("coastdown"))]
    config = example[0]

    free = identify_coast_down(drivings, config)
    held = identify_coast_down(drivings, config, held={"drag_area_m2"})

    assert held.values["drag_area_m2"].value == config.vehicle.drag_area_m2
    assert held.values["drag_area_m2"].caveat == "held"
    assert held.values["friction_ns_m"].value == pytest.approx(4.0, abs=0.2)
    assert (
        held.values["friction_ns_m"].standard_error
        < 0.4 * free.values["friction_ns_m"].standard_error
    )


@pytest.mark.slow
def test_accelerometer_bias_and_pitch_are_found(
    logged: Logged, driving: Reader, example: Example
) -> None:
    """n2 pitches by 0.03 rad per g; the bias is the drive's own."""
    log = logged("coastdown", "n2")
    read = driving(log)
    found = identify_coast_down([read], example[0])

    assert read.pitch == pytest.approx(0.03, abs=0.008)
    assert found.bias_ms2 is not None
    # it is parked on a level place: what it reads there is bias alone
    standing = read.speed_ms < 0.1
    quiet = standing & (read.time_s > read.time_s[-1] - 60.0)
    bias = float(np.nanmean(read.accel_measured_ms2[quiet]))
    assert found.bias_ms2 == pytest.approx(bias, abs=0.01)


@pytest.mark.slow
def test_energy_is_balanced_in_the_right_form(
    logged: Logged, driving: Reader, example: Example
) -> None:
    """Eq 4.5 with 1/2 J w^2: the wheels' 1.2 % would be seen to miss."""
    found = identify_coast_down(
        [driving(logged("coastdown", "none"))], example[0]
    )

    for run in found.runs:
        assert abs(run.miss) < 2e-4
        assert run.residual_rms_ms < 0.005
        wheels_j = (
            0.5
            * 3.0809
            / 0.3418**2
            * (run.speed_ms[0] ** 2 - run.speed_ms[-1] ** 2)
        )
        assert wheels_j / run.balance.kinetic_j == pytest.approx(
            0.0119, abs=2e-4
        )


def test_theory_solves_eq_4_2(driving: Reader, logged: Logged) -> None:
    """Coasting from 30 m/s: the deceleration is that of the formula."""
    car = driving(logged("coastdown")).vehicle
    speed = np.full(201, 30.0)
    zero = np.zeros(201)

    fallen = theory(car, speed, zero, zero)

    rate = -car.resistance_n(float(fallen[100])) / car.effective_mass_kg
    assert (fallen[101] - fallen[99]) / 0.1 == pytest.approx(rate, rel=1e-4)


def test_no_coast_down_says_what_was_searched(
    logged: Logged, driving: Reader, example: Example
) -> None:
    drive = driving(logged(CITY))

    with pytest.raises(LogError) as caught:
        identify_coast_down([drive], example[0])

    text = str(caught.value)
    assert caught.value.exit_code == 65
    assert drive.name in text
    assert re.search(r"above 9 km/h \d+ s, brakes released \d+ s", text)
    assert "0 pieces of 15 s" in text


def test_short_coast_down_is_no_value(
    logged: Logged, driving: Reader, example: Example
) -> None:
    """From 110 to 70 km/h drag and C_fric are one."""
    short = ONE_WAY.replace("until_speed_kmh = 15.0", "until_speed_kmh = 70")
    found = identify_coast_down([driving(logged(short))], example[0])

    assert not any(one.identified for one in found.values.values())


def test_braking_and_pulling_are_no_coasting(
    logged: Logged, driving: Reader
) -> None:
    """Every stretch lies in a neutral segment of the drive."""
    read = driving(logged("coastdown"))
    stretches, _ = coasting(read)

    assert len(stretches) == 4
    for stretch in stretches:
        gear = read.value("gear")[stretch.points]
        pressure = read.value("primary_pressure")[stretch.points]
        assert (gear == 0).all()
        assert pressure.max() < 0.5e5


def test_the_released_level_is_that_of_the_log(
    logged: Logged, driving: Reader
) -> None:
    """A noisy residual pressure, 11 % of it above 1.05 bar."""
    read = driving(logged("coastdown"))
    random = np.random.default_rng(1)
    held = {
        name: value + 0.55e5 + 0.4e5 * random.standard_normal(len(value))
        for name, value in read.pressures.items()
    }
    noisy = replace(read, pressures=held)

    found, _ = coasting(noisy)

    clean, _ = coasting(read)
    assert len(clean) == 4
    for one, other in zip(clean, found, strict=True):
        assert abs(one.first - other.first) * GRID_S < 1.0
        assert abs(one.last - other.last) * GRID_S < 1.0
