"""Sensors: clean by default, seeded where they err."""

import numpy as np
import pytest

from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.simulation import Effects, SimulatedDrive
from bstm_daemon.simulation.sensors import (
    Channel,
    SensorSuite,
    lagged,
    measured_temperatures,
)
from bstm_daemon.units import GRAVITY_MS2

TRUTH = np.linspace(0.0, 10.0, 1001)


def test_clean_channel_reads_the_truth() -> None:
    reading = SensorSuite(Effects(), 0).read("yaw_rate", TRUTH, 0.01)

    np.testing.assert_array_equal(reading, TRUTH)


def test_noise_depends_on_seed_and_channel_only() -> None:
    channels = {
        "yaw_rate": Channel(noise=0.5),
        "vehicle_speed": Channel(noise=0.5),
    }
    suite = SensorSuite(Effects(), 7, channels)

    first = suite.read("yaw_rate", TRUTH, 0.01)
    suite.read("vehicle_speed", TRUTH, 0.01)
    again = SensorSuite(Effects(), 7, channels).read("yaw_rate", TRUTH, 0.01)
    other = SensorSuite(Effects(), 8, channels).read("yaw_rate", TRUTH, 0.01)
    speed = suite.read("vehicle_speed", TRUTH, 0.01)

    np.testing.assert_array_equal(first, again)
    assert (first - TRUTH).std() == pytest.approx(0.5, rel=0.1)
    assert abs(first - other).max() > 0.1
    assert abs(first - speed).max() > 0.1


def test_bias_gain_lag_and_quantum() -> None:
    channel = Channel(bias=1.0, gain=2.0, quantum=0.25)
    suite = SensorSuite(Effects(), 0, {"yaw_rate": channel})

    reading = suite.read("yaw_rate", TRUTH, 0.01)

    np.testing.assert_allclose(reading, 2 * TRUTH + 1, atol=0.1251)
    np.testing.assert_array_equal(reading * 4, np.rint(reading * 4))


def test_lag_follows_a_ramp_at_its_distance() -> None:
    out = lagged(TRUTH, 0.5, 0.01)

    # a ramp of 1/s, 0.5 s behind
    assert TRUTH[-1] - out[-1] == pytest.approx(0.495, abs=0.005)
    assert out[0] == TRUTH[0]


def test_sensor_effects_act_on_their_channels() -> None:
    effects = Effects(
        thermocouple_offset=1.0,
        accelerometer_bias=1.0,
        powertrain_torque_error=1.0,
    )
    suite = SensorSuite(effects, 0)
    truth = {
        f"{c}.{n}": TRUTH
        for c in ("FL", "FR")
        for n in (
            "disc",
            "disc_2",
            "pad_front",
            "pad_back",
            "fluid",
            "caliper",
        )
    }

    torque = suite.read("powertrain_torque", TRUTH, 0.01)
    force = suite.read("acceleration_longitudinal", TRUTH, 0.01)
    temperatures = measured_temperatures(truth, suite)

    np.testing.assert_allclose(torque, 0.92 * TRUTH)
    np.testing.assert_allclose(force, TRUTH + 0.1)
    np.testing.assert_allclose(temperatures["temp_fl_fluid"], TRUTH + 15.0)


def test_every_role_is_a_role(short: SimulatedDrive) -> None:
    names = {*short.roles, *short.temperatures}

    assert names <= set(ROLE_INDEX)
    assert {len(v) for v in short.roles.values()} == {len(short.time_s)}
    assert {len(v) for v in short.temperatures.values()} == {
        len(short.slow_time_s)
    }


def test_accelerometer_reads_specific_force(short: SimulatedDrive) -> None:
    reading = short.roles["acceleration_longitudinal"]
    slope = (reading - short.course.acceleration_ms2) / GRAVITY_MS2

    np.testing.assert_allclose(slope, np.sin(short.course.slope_rad))
