"""Sensors: clean by default, seeded where they err."""

import numpy as np
import pytest

from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.simulation import Effects, SimulatedDrive
from bstm_daemon.simulation.sensors import (
    DRIFT_S,
    Channel,
    SensorSuite,
    drifting,
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


def test_quantum_offset_and_dead_zone() -> None:
    channel = Channel(offset=1.0, quantum=0.25, dead_below=2.0)
    suite = SensorSuite(Effects(), 0, {"yaw_rate": channel})

    reading = suite.read("yaw_rate", TRUTH, 0.01)

    offset = reading[-1] - TRUTH[-1]
    assert abs(offset) == 1.0
    expected = np.where(reading > 0, TRUTH + offset, 0.0)
    np.testing.assert_allclose(reading, expected, atol=0.1251)
    np.testing.assert_array_equal(reading * 4, np.rint(reading * 4))
    assert reading[reading > 0].min() == 2.0


def test_bias_is_drawn_once_a_drive() -> None:
    channels = {"yaw_rate": Channel(bias_sd=0.5)}
    biases = []
    for seed in range(400):
        suite = SensorSuite(Effects(), seed, channels)
        error = suite.read("yaw_rate", TRUTH[:3], 0.01) - TRUTH[:3]
        assert np.ptp(error) < 1e-12
        biases.append(error[0])

    assert np.std(biases) == pytest.approx(0.5, rel=0.1)
    assert abs(np.mean(biases)) < 0.1


def test_relative_noise_grows_with_the_reading() -> None:
    suite = SensorSuite(
        Effects(), 0, {"yaw_rate": Channel(relative_noise=0.04)}
    )
    low, high = np.full(4000, 10.0), np.full(4000, 100.0)

    assert suite.read("yaw_rate", low, 0.01).std() == pytest.approx(
        0.4, rel=0.1
    )
    assert suite.read("yaw_rate", high, 0.01).std() == pytest.approx(
        4.0, rel=0.1
    )


def test_drift_is_stationary_with_its_time() -> None:
    series = drifting(np.random.default_rng(1), 400_000, 1.0)
    later = int(DRIFT_S)

    assert series.std() == pytest.approx(1.0, rel=0.05)
    correlation = np.mean(series[:-later] * series[later:]) / series.var()
    assert correlation == pytest.approx(np.exp(-1.0), abs=0.06)


def test_lag_follows_a_ramp_at_its_distance() -> None:
    out = lagged(TRUTH, 0.5, 0.01)

    # a ramp of 1/s, 0.5 s behind
    assert TRUTH[-1] - out[-1] == pytest.approx(0.495, abs=0.005)
    assert out[0] == TRUTH[0]
    # whatever the blocks: the recursion itself
    decay, last, expected = np.exp(-0.01 / 0.5), TRUTH[0], []
    for value in TRUTH:
        last = value + (last - value) * decay
        expected.append(last)
    np.testing.assert_allclose(out, expected, atol=1e-12)


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

    np.testing.assert_allclose(torque[1:], 0.92 * TRUTH[1:] + 12.0)
    assert torque[0] == 0.0
    # a cold sensor's bias grows while it warms up
    np.testing.assert_allclose(force - TRUTH, 0.07, atol=0.001)
    fluid = temperatures["temp_fl_fluid"]
    np.testing.assert_allclose(
        fluid - TRUTH, 9.0 + 0.02 * (TRUTH - 293.15), atol=1e-9
    )


def test_thermocouple_lag_is_two_in_a_row() -> None:
    suite = SensorSuite(Effects(thermocouple_lag=1.0), 0)

    reading = suite.read("temp_fl_disc", np.arange(300.0), 1.0)

    assert 299.0 - reading[-1] == pytest.approx(14.0, abs=0.5)


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
