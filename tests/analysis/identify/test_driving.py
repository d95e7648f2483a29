"""The motion that identification works on."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.identify.driving import driving_of, pitch_of
from bstm_daemon.analysis.quality.limits import GRID_S
from bstm_daemon.errors import LogError

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.identify.driving import Driving
    from bstm_daemon.analysis.quality.recording import Recording
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation import SimulatedDrive

    from .conftest import Logged


def motion() -> tuple[np.ndarray, np.ndarray]:
    """Return rate and speed of a car that speeds up and slows down."""
    time_s = np.arange(0.0, 300.0, GRID_S)
    rate = 1.5 * np.sign(np.sin(2 * np.pi * time_s / 15.0))
    return rate, np.full(len(rate), 20.0)


def test_pitch_is_told_from_grade_and_bias() -> None:
    rate, speed = motion()
    time_s = np.arange(len(rate)) * GRID_S
    grade = 0.5 * np.sin(2 * np.pi * time_s / 200.0)
    noise = np.random.default_rng(1).normal(0.0, 0.05, len(rate))

    pitch, error = pitch_of(rate, 1.03 * rate + grade + 0.2 + noise, speed)

    assert pitch == pytest.approx(0.03, abs=0.01)
    assert 0.0 < error < 0.01


def test_no_pitch_where_none_is_seen() -> None:
    """Constant speed, no accelerometer, a slope that no body has."""
    rate, speed = motion()

    assert pitch_of(np.zeros(len(rate)), rate, speed)[0] == 0.0
    assert pitch_of(rate, np.full(len(rate), np.nan), speed)[0] == 0.0
    assert pitch_of(rate, 1.5 * rate, speed)[0] == 0.0


@pytest.mark.slow
def test_torque_is_none_where_the_line_is_open(
    logged: Logged, driving: Callable[..., Driving]
) -> None:
    read = driving(logged("coastdown"))

    assert (read.torque_nm[np.abs(read.value("gear")) < 0.5] == 0.0).all()
    assert np.nanmax(np.abs(read.torque_nm)) > 1000.0
    assert "gear" in read.line_known


def test_a_log_without_speed_is_refused(
    simulated: Callable[..., SimulatedDrive],
    sampled: Callable[..., Recording],
    example: tuple[Config, SignalMap],
) -> None:
    config, plan = example
    recording = sampled(simulated("idiada-ramp"), "primary_pressure")

    with pytest.raises(LogError, match="bare: no speed in this log"):
        driving_of("bare", recording, config, plan)


def test_a_turned_accelerometer_is_left_out_and_said(
    simulated: Callable[..., SimulatedDrive],
    sampled: Callable[..., Recording],
    example: tuple[Config, SignalMap],
) -> None:
    """Named by the checks of the log, not fitted."""
    config, plan = example
    recording = sampled(
        simulated("idiada-ramp"), "vehicle_speed", "acceleration_longitudinal"
    )
    turned = recording.series["acceleration_longitudinal"]
    turned.value[:] *= -1.0

    read = driving_of("turned", recording, config, plan)

    assert not read.has_accelerometer
    assert any("acceleration_longitudinal" in one for one in read.remarks)


def test_a_pressure_that_rests_above_zero_is_released_there(
    simulated: Callable[..., SimulatedDrive],
    sampled: Callable[..., Recording],
    example: tuple[Config, SignalMap],
) -> None:
    config, plan = example
    roles = ("vehicle_speed", "primary_pressure")
    recording = sampled(simulated("coastdown"), *roles)
    as_is = driving_of("as it is", recording, config, plan).released()
    recording.series["primary_pressure"].value[:] += 0.7e5

    shifted = driving_of("shifted", recording, config, plan).released()

    assert as_is.mean() > 0.5
    assert (shifted == as_is).mean() > 0.99
