"""Sensor presets n1 to n4: every level as it is stated."""

import numpy as np
import pytest

from bstm_daemon.errors import UsageError
from bstm_daemon.simulation import Effects, SimulatedDrive, simulate
from bstm_daemon.simulation.sensors import (
    SENSOR_PRESETS,
    sensor_suite,
)

LEVELS = ("n1", "n2", "n3", "n4")
STEADY = np.full(40_000, 400.0)


def errors(preset: str, role: str, truth: float, seed: int = 0) -> np.ndarray:
    """Return the errors of *role* at a steady *truth*, 10 h at 1 Hz."""
    steady = np.full(36_000, truth)
    return (
        sensor_suite(preset, Effects(), seed).read(role, steady, 1.0) - truth
    )


@pytest.mark.parametrize(
    ("preset", "noise_k", "drift_k", "offset_k"),
    [
        ("n1", 0.5, 0.0, 0.0),
        ("n2", 1.0, 1.0, 0.0),
        ("n3", 2.0, 3.0, 3.0),
        ("n4", 5.0, 8.0, 0.0),
    ],
)
def test_thermocouples(
    preset: str, noise_k: float, drift_k: float, offset_k: float
) -> None:
    rows = [errors(preset, "temp_fl_disc", 500.0, seed) for seed in range(40)]
    # neighbours in time share drift and offset: their difference is noise
    noise = np.std([np.diff(row) for row in rows]) / np.sqrt(2)
    whole = np.sqrt(np.mean([row.var() for row in rows]))

    assert noise == pytest.approx(noise_k, rel=0.1)
    assert whole == pytest.approx(np.hypot(noise_k, drift_k), rel=0.06)
    if offset_k:
        assert np.std([r.mean() for r in rows]) == pytest.approx(
            offset_k, rel=0.3
        )
    else:
        assert abs(np.mean(rows)) < 0.3


def test_n3_thermocouples_lag() -> None:
    ramp = 2.0 * np.arange(600.0)
    lags = [
        np.mean(
            ramp[300:]
            - sensor_suite(n, Effects(), 3).read(
                "temp_fl_pad_back", ramp, 1.0
            )[300:]
        )
        for n in ("n2", "n3")
    ]

    # 2 K/s, 5 s behind, within drift and offset
    assert abs(lags[0]) < 3.0
    assert abs(lags[1]) > 1.0
    channel = SENSOR_PRESETS["n3"]
    assert channel is not None
    assert channel.thermocouple.lag_s == 5.0


@pytest.mark.parametrize(
    ("level", "noise", "bias_sd"),
    list(
        zip(
            LEVELS,
            (0.02, 0.05, 0.08, 0.12),
            (0.05, 0.10, 0.15, 0.20),
            strict=True,
        )
    ),
)
def test_accelerometer(level: str, noise: float, bias_sd: float) -> None:
    role = "acceleration_longitudinal"
    suites = [sensor_suite(level, Effects(), seed) for seed in range(300)]
    rows = [suite.read(role, np.zeros(200), 0.01) for suite in suites]

    assert np.mean([row.std() for row in rows]) == pytest.approx(
        noise, rel=0.05
    )
    assert np.std([row.mean() for row in rows]) == pytest.approx(
        bias_sd, rel=0.15
    )


@pytest.mark.parametrize(
    ("level", "offset_pa", "torque"),
    list(
        zip(
            LEVELS, (2e3, 5e3, 1e4, 2e4), (0.01, 0.02, 0.04, 0.06), strict=True
        )
    ),
)
def test_pressure_and_torque(
    level: str, offset_pa: float, torque: float
) -> None:
    truth = np.linspace(1e6, 2e6, 50_001)
    reading = sensor_suite(level, Effects(), 0).read(
        "primary_pressure", truth, 0.01
    )
    noisy = sensor_suite(level, Effects(), 0).read(
        "powertrain_torque", np.full(9000, -200.0), 0.01
    )

    assert abs(np.mean(reading - truth)) == pytest.approx(offset_pa, abs=200.0)
    np.testing.assert_allclose(reading / 1e4, np.rint(reading / 1e4))
    assert noisy.std() == pytest.approx(200.0 * torque, rel=0.05)


@pytest.mark.parametrize(
    ("level", "quantum", "dead_ms"),
    list(
        zip(
            LEVELS, (0.01, 0.03, 0.06, 0.06), (0.0, 0.4, 0.4, 0.4), strict=True
        )
    ),
)
def test_wheel_speed(level: str, quantum: float, dead_ms: float) -> None:
    truth = np.linspace(0.0, 3.0, 3001)
    reading = sensor_suite(level, Effects(), 0).read(
        "wheel_speed_rl", truth, 0.01
    )

    np.testing.assert_allclose(
        reading / quantum, np.rint(reading / quantum), atol=1e-9
    )
    above = truth > dead_ms + quantum
    assert abs(reading - truth)[above].max() <= quantum / 2 + 1e-9
    assert not reading[truth < dead_ms - quantum].any()


def test_body_pitches_under_acceleration(short: SimulatedDrive) -> None:
    level, pitched = (
        simulate(short.drive, sensors=name).roles["acceleration_longitudinal"]
        for name in ("n1", "n2")
    )
    a = short.course.acceleration_ms2
    braking = a < -3.0
    extra = [
        np.mean(row[braking]) - np.mean(row[a == 0])
        for row in (level, pitched)
    ]

    # 0.03 rad per g: 3 % more than the acceleration
    mean = a[braking].mean()
    assert extra[0] == pytest.approx(mean, abs=0.01)
    assert extra[1] == pytest.approx(1.03 * mean, abs=0.02)


def test_seed_repeats_and_changes(short: SimulatedDrive) -> None:
    first, again, other = (
        simulate(short.drive, sensors="n3", seed=seed) for seed in (4, 4, 5)
    )
    for role, values in first.roles.items():
        np.testing.assert_array_equal(again.roles[role], values)
    role = "temp_fl_disc"
    np.testing.assert_array_equal(
        again.temperatures[role], first.temperatures[role]
    )
    assert abs(other.temperatures[role] - first.temperatures[role]).max() > 1.0
    # sensors change what is read, never what happens
    np.testing.assert_array_equal(
        first.truth["FL.disc"], short.truth["FL.disc"]
    )


def test_unknown_level_lists_the_known() -> None:
    with pytest.raises(UsageError, match="n4"):
        sensor_suite("n5", Effects(), 0)
