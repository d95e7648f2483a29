"""Courses: durations, distances, free rolling."""

import numpy as np
import pytest

from bstm_daemon.simulation import NOMINAL, parse_drive
from bstm_daemon.simulation.profile import SAMPLE_S, Course, plan_course

HEAD = '[drive]\nname = "d"\ndescription = "x"\n'


def course(segments: str) -> Course:
    """Return the course of a drive of *segments*."""
    return plan_course(parse_drive(HEAD + segments, "f.toml"), NOMINAL)


def test_speed_is_reached_and_held() -> None:
    c = course(
        "[[segment]]\nspeed_kmh = 72.0\nrate_ms2 = 2.0\nduration_s = 30.0\n"
        "[[segment]]\nspeed_kmh = 0.0\nrate_ms2 = 4.0\n"
    )

    assert c.time_s[-1] == pytest.approx(36.0 - SAMPLE_S)
    assert c.speed_ms[2000] == pytest.approx(20.0)
    assert c.speed_ms[500] == pytest.approx(10.0, abs=0.1)
    assert c.acceleration_ms2[500] == pytest.approx(2.0)
    assert c.acceleration_ms2[3200] == pytest.approx(-4.0)
    assert c.speed_ms[-1] == 0.0
    # rounding moves no distance: 100 + 20 * 20 + 50 m
    assert c.speed_ms.sum() * SAMPLE_S == pytest.approx(550.0, abs=1.0)


def test_distance_ends_a_segment() -> None:
    c = course(
        "[[segment]]\nspeed_kmh = 36.0\ndistance_m = 1000.0\n"
        "[[segment]]\nspeed_kmh = 0.0\nrate_ms2 = 1.0\n"
    )

    assert c.speed_ms.sum() * SAMPLE_S == pytest.approx(1050.0, abs=0.5)


def test_grade_is_uphill_positive() -> None:
    c = course(
        "[[segment]]\nspeed_kmh = 36.0\nduration_s = 30.0\n"
        "grade_percent = -10.0\n"
    )

    assert np.tan(c.slope_rad[1500]) == pytest.approx(-0.10)


def test_coast_down_loses_its_energy_to_the_resistances() -> None:
    c = course(
        "[[segment]]\nspeed_kmh = 100.0\nrate_ms2 = 3.0\n"
        "[[segment]]\nuntil_speed_kmh = 20.0\n"
    )
    # away from the rounded corners at both ends
    v = c.speed_ms[(c.segment == 1) & (c.speed_ms > 7.0)][100:]
    work = (NOMINAL.resistance(v, np.zeros_like(v)) * v).sum() * SAMPLE_S
    kinetic = 0.5 * NOMINAL.effective_mass_kg * (v[0] ** 2 - v[-1] ** 2)

    assert work == pytest.approx(kinetic, rel=0.01)


def test_given_brake_force_decides_the_deceleration() -> None:
    c = course(
        "[[segment]]\nspeed_kmh = 72.0\nrate_ms2 = 4.0\nduration_s = 10.0\n"
        "[[segment]]\nuntil_speed_kmh = 10.0\nbrake_force_n = 6000.0\n"
    )
    middle = np.flatnonzero(c.segment == 1)[200]
    resisting = NOMINAL.resistance(c.speed_ms[[middle]], np.zeros(1))[0]

    assert c.acceleration_ms2[middle] == pytest.approx(
        -(6000.0 + resisting) / NOMINAL.effective_mass_kg, rel=0.01
    )
