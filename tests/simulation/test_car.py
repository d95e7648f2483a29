"""The car: the forces balance at every sample."""

import numpy as np
import pytest

from bstm_daemon.simulation import (
    NOMINAL,
    Effects,
    drive_names,
    load_drive,
    parse_drive,
)
from bstm_daemon.simulation.car import (
    MODULATION_HZ,
    SECONDARY,
    line_pressure,
    move,
    wheel_pressures,
)
from bstm_daemon.simulation.profile import SAMPLE_S, plan_course
from bstm_daemon.simulation.simulate import nominal_power
from bstm_daemon.simulation.vehicle import real_car

HEAD = '[drive]\nname = "d"\ndescription = "x"\n'


QUICK = {"alpine-descent", "ams", "assist", "idiada-pulse", "slippery"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow)
        for n in drive_names()
    ],
)
def test_forces_balance_on_every_drive(name: str) -> None:
    drive = load_drive(name)
    course = plan_course(drive, NOMINAL)
    motion = move(
        course, NOMINAL, Effects(), pushed=drive.drive.propulsion == "push"
    )
    v = course.speed_ms
    driving = v > 0

    accelerating = (
        (motion.powertrain_torque_nm + motion.motor_torque_nm)
        / NOMINAL.wheel_radius_m
        + motion.external_force_n
        - motion.brake_force_n
        - NOMINAL.resistance(v, course.slope_rad)
    )

    np.testing.assert_allclose(
        accelerating[driving],
        NOMINAL.effective_mass_kg * course.acceleration_ms2[driving],
        atol=1e-6,
    )
    assert motion.brake_force_n.min() >= 0.0
    assert not motion.brake_force_n[~driving].any()


def test_thesis_vehicle_needs_its_pressure() -> None:
    # 410 Pa/N from the pistons of thesis vehicle 1; front corner 35 %
    gains = NOMINAL.gains

    assert 1 / gains.sum() == pytest.approx(428.0, abs=2.0)
    np.testing.assert_allclose(
        gains / gains.sum(), [0.35, 0.35, 0.15, 0.15], atol=1e-9
    )


def test_wind_is_met_squared() -> None:
    """20 m/s against 10: the air of 30; from behind at 25 it pushes."""
    v, flat = np.array([20.0]), np.zeros(1)
    calm = NOMINAL.resistance(v, flat)
    air = 0.5 * 1.2 * NOMINAL.drag_area_m2

    against = NOMINAL.resistance(v, flat, 10.0) - calm
    behind = NOMINAL.resistance(v, flat, -25.0) - calm

    assert against[0] == pytest.approx(air * (30.0**2 - 20.0**2), rel=0.02)
    assert behind[0] == pytest.approx(-air * (5.0**2 + 20.0**2), rel=0.02)


def test_the_engine_holds_against_the_wind() -> None:
    """A segment's headwind, faded in over some seconds."""
    drive = parse_drive(
        HEAD + "[[segment]]\nspeed_kmh = 72.0\nduration_s = 60.0\n"
        "[[segment]]\nspeed_kmh = 72.0\nduration_s = 30.0\n"
        "headwind_ms = 10.0\n",
        "f.toml",
    )
    course = plan_course(drive, NOMINAL)
    torque = move(course, NOMINAL, Effects(), pushed=False)

    more = np.ptp(torque.powertrain_torque_nm[[5000, 8000]])
    air = 0.5 * 1.2 * NOMINAL.drag_area_m2
    assert more / NOMINAL.wheel_radius_m == pytest.approx(
        air * (30.0**2 - 20.0**2), rel=0.02
    )


def test_wheels_add_a_hundredth_to_the_mass() -> None:
    assert NOMINAL.effective_mass_kg == pytest.approx(2194.0 + 26.4, abs=0.1)


def test_engine_drags_in_gear_and_drives_uphill() -> None:
    drive = parse_drive(
        HEAD + "[[segment]]\nspeed_kmh = 50.0\ngear = 4\nduration_s = 60.0\n"
        "[[segment]]\nspeed_kmh = 50.0\ngear = 4\nduration_s = 60.0\n"
        "grade_percent = 5.0\n"
        "[[segment]]\nspeed_kmh = 50.0\ngear = 4\nduration_s = 60.0\n"
        "grade_percent = -8.0\n",
        "f.toml",
    )
    course = plan_course(drive, NOMINAL)
    motion = move(course, NOMINAL, Effects(), pushed=False)

    assert motion.powertrain_torque_nm[9000] > 300.0
    assert motion.brake_force_n[9000] == 0.0
    assert motion.powertrain_torque_nm[15000] < -50.0
    assert motion.brake_force_n[15000] > 500.0
    assert motion.engine_speed_rad_s[15000] > 100.0


def test_given_pressure_is_pressed_and_balanced() -> None:
    drive = parse_drive(
        HEAD + "[[segment]]\nspeed_kmh = 50.0\nduration_s = 60.0\n"
        "brake_pressure_bar = 10.0\n"
        "[[segment]]\nspeed_kmh = 0.0\n"
        "[[segment]]\nparked = true\nduration_s = 9.0\n"
        "brake_pressure_bar = 20.0\n",
        "f.toml",
    )
    course = plan_course(drive, NOMINAL)
    motion = move(course, NOMINAL, Effects(), pushed=True)

    assert motion.pressure_pa[4000] == pytest.approx(1e6)
    assert motion.external_force_n[4000] > motion.brake_force_n[4000] > 2e3
    assert motion.pressure_pa[-1] == pytest.approx(2e6)
    assert motion.brake_force_n[-1] == 0.0


def test_motor_takes_its_share() -> None:
    drive = parse_drive(
        HEAD + "[[segment]]\nspeed_kmh = 80.0\nrate_ms2 = 3.0\n"
        "[[segment]]\nspeed_kmh = 10.0\nrate_ms2 = 3.0\nregeneration = 0.6\n",
        "f.toml",
    )
    course = plan_course(drive, NOMINAL)
    motion = move(course, NOMINAL, Effects(), pushed=False)
    at = np.flatnonzero(course.segment == 1)[200]

    recovered = -motion.motor_torque_nm[at] / NOMINAL.wheel_radius_m
    assert recovered == pytest.approx(1.5 * motion.brake_force_n[at])
    assert recovered > 2000.0


def test_share_error_keeps_the_sum() -> None:
    car = real_car(NOMINAL, Effects(brake_share=1.0, mass_error=1.0))

    assert car.gains.sum() == pytest.approx(NOMINAL.gains.sum())
    assert car.gains[0] == pytest.approx(1.10 * NOMINAL.gains[0])
    assert car.mass_kg == pytest.approx(1.06 * 2194.0)
    assert real_car(NOMINAL, Effects()) == NOMINAL


INTERVENING = """
[[segment]]
speed_kmh = 60.0
gear = 3
duration_s = 30.0
[[segment]]
speed_kmh = 60.0
gear = 3
duration_s = 10.0
corner_pressure_bar = [0.0, 30.0, 0.0, 0.0]
[[segment]]
speed_kmh = 0.0
rate_ms2 = 3.0
modulation = 0.4
slip = [0.1, 0.2, 0.0, 0.0]
"""


def test_single_brake_is_balanced_by_the_engine() -> None:
    course = plan_course(parse_drive(HEAD + INTERVENING, "f.toml"), NOMINAL)
    motion = move(course, NOMINAL, Effects(), pushed=False)

    alone = motion.corner_force_n[3500]
    assert alone[1] == pytest.approx(30e5 * NOMINAL.gains[1])
    assert not alone[[0, 2, 3]].any()
    assert motion.brake_force_n[3500] == pytest.approx(alone.sum())
    more = (
        motion.powertrain_torque_nm[3500] - motion.powertrain_torque_nm[2500]
    )
    assert more / NOMINAL.wheel_radius_m == pytest.approx(alone.sum())
    # the driver's foot is elsewhere
    assert motion.pressure_pa[3500] == 0.0


def test_anti_lock_keeps_the_sum_and_slipping_wheels_their_power() -> None:
    course = plan_course(parse_drive(HEAD + INTERVENING, "f.toml"), NOMINAL)
    motion = move(course, NOMINAL, Effects(), pushed=False)
    stop = (course.segment == 2) & (course.speed_ms > 1)
    force = motion.corner_force_n[stop]

    np.testing.assert_allclose(force.sum(1), motion.brake_force_n[stop])
    assert np.ptp(force[:, 0] / force.sum(1)) > 0.2
    power = nominal_power(course, motion)[stop]
    np.testing.assert_allclose(
        power / (force * course.speed_ms[stop, None]),
        np.broadcast_to([0.9, 0.8, 1.0, 1.0], force.shape),
    )


GAINS = NOMINAL.gains
PULSE = np.concatenate(
    (np.zeros(50), np.full(100, 3e6), np.zeros(100), np.full(150, 1e6))
)
NONE = np.zeros(len(PULSE))


def test_all_wheels_get_the_demand() -> None:
    pressures = wheel_pressures(PULSE, GAINS, Effects(), modulation=NONE)

    np.testing.assert_array_equal(pressures, np.tile(PULSE, (4, 1)).T)


def test_second_circuit_is_late_and_the_force_the_same() -> None:
    pressures = wheel_pressures(
        PULSE, GAINS, Effects(hydraulic_lag=1.0), modulation=NONE
    )

    np.testing.assert_allclose(pressures @ GAINS, PULSE * GAINS.sum())
    assert pressures.min() >= 0.0
    early, late = pressures[55, ~SECONDARY], pressures[55, SECONDARY]
    assert early.min() > 3e6 > late.max()
    # both settle at the demand, both end with it
    np.testing.assert_allclose(pressures[149], 3e6, rtol=0.01)
    assert not pressures[150].any()


def test_anti_lock_swings_left_against_right() -> None:
    demand = np.full(400, 4e6)
    pressures = wheel_pressures(
        demand, GAINS, Effects(), modulation=np.full(400, 0.5)
    )

    np.testing.assert_allclose(pressures @ GAINS, 4e6 * GAINS.sum())
    assert pressures[:, 0].max() == pytest.approx(6e6, rel=0.01)
    # nobody gains over the cycles of one step of the reality
    step = round(0.5 / SAMPLE_S)
    assert (MODULATION_HZ * 0.5).is_integer()
    np.testing.assert_allclose(pressures[:step].mean(axis=0), 4e6)


def test_line_leads_the_clamp() -> None:
    clamp = np.concatenate((np.zeros(50), np.linspace(0, 2e6, 100)))

    plain = line_pressure(clamp, Effects())
    lagging = line_pressure(clamp, Effects(hydraulic_lag=1.0))
    pushed = line_pressure(clamp, Effects(pushout_pressure=1.0))

    np.testing.assert_array_equal(plain, clamp)
    # 2 MPa a second, 0.15 s ahead
    assert lagging[100] - clamp[100] == pytest.approx(3.03e5, rel=0.01)
    assert pushed[149] - clamp[149] == pytest.approx(1e5, rel=1e-3)
    # the seals give way bit by bit
    assert 0 < pushed[51] - clamp[51] < 0.5e5
    assert pushed[10] == 0.0
