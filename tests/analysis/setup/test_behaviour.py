"""Verdicts on made-up drives whose truth is known."""

from collections.abc import Callable

import numpy as np
import pytest

from bstm_daemon.analysis.setup.behaviour import Motion
from bstm_daemon.analysis.setup.recording import Samples, Series

Maker = Callable[..., Samples]

TIME_S = np.arange(0.0, 200.0, 0.02)
SPEED_MS: Series = 15.0 + 8.0 * np.sin(0.1 * TIME_S)
CHANGE_MS2: Series = 0.8 * np.cos(0.1 * TIME_S)


@pytest.fixture
def motion(series: Maker) -> Motion:
    return Motion({name: series(SPEED_MS) for name in "abcd"})


def test_the_change_of_speed_is_known(motion: Motion) -> None:
    expected = 0.8 * np.cos(0.1 * motion.grid_s)

    assert motion.change_ms2[20:-20] == pytest.approx(
        expected[20:-20], abs=0.01
    )


@pytest.mark.parametrize(
    ("factor", "sign", "scale"),
    [(1.0, 1, 1.0), (-1.0, -1, 1.0), (-1.5, -1, 0.667), (9.8, 1, 0.102)],
)
def test_sign_and_scale_of_an_acceleration(
    motion: Motion, series: Maker, factor: float, sign: int, scale: float
) -> None:
    noise = np.random.default_rng(1).normal(0.0, 0.1, len(TIME_S))

    verdict = motion.acceleration_verdict(series(factor * CHANGE_MS2 + noise))

    assert verdict.fits
    assert verdict.sign == sign
    assert verdict.scale == pytest.approx(scale, rel=0.03)
    assert "r = " in verdict.reason


def test_a_grade_lowers_no_scale(motion: Motion, series: Maker) -> None:
    """What the road adds makes the fit worse but is no fault of the DBC."""
    grade = 0.5 * np.sin(0.037 * TIME_S)

    verdict = motion.acceleration_verdict(series(CHANGE_MS2 + grade))

    assert (verdict.fits, verdict.sign, verdict.scale) == (True, 1, 1.0)


def test_what_does_not_follow_the_speed_is_no_acceleration(
    motion: Motion, series: Maker
) -> None:
    lateral = np.sin(0.7 * TIME_S)

    assert not motion.acceleration_verdict(series(lateral)).fits
    assert not motion.acceleration_verdict(series(0 * lateral)).fits


def test_a_speed_agrees_or_not(motion: Motion, series: Maker) -> None:
    assert motion.speed_verdict(series(1.02 * SPEED_MS)).fits
    assert not motion.speed_verdict(series(3.6 * SPEED_MS)).fits
    assert not motion.speed_verdict(series(0.0 * SPEED_MS)).fits


def test_a_speed_is_compared_with_others_only(
    motion: Motion, series: Maker
) -> None:
    speed = series(SPEED_MS)
    alone = Motion({"vehicle": speed, "standing": series(0.0 * SPEED_MS)})

    assert (
        alone.speed_verdict(speed).reason == "up to 23.0 m/s, the only speed"
    )
    assert "0.0 % off the other" in motion.speed_verdict(speed).reason


def test_a_wheel_that_stands_has_no_say(series: Maker) -> None:
    names = {"fl": 0.0, "fr": 0.0, "rl": 1.0, "rr": 1.0}
    motion = Motion({k: series(v * SPEED_MS) for k, v in names.items()})

    assert motion.speed_ms.mean() == pytest.approx(SPEED_MS.mean(), rel=0.01)


def test_a_pressure_slows_the_car(motion: Motion, series: Maker) -> None:
    braking = np.where(CHANGE_MS2 < -0.3, -10 * CHANGE_MS2, 0.0)
    driving = np.where(CHANGE_MS2 > 0.3, 10 * CHANGE_MS2, 0.0)

    assert motion.pressure_verdict(series(braking)).fits
    assert not motion.pressure_verdict(series(driving)).fits


def test_a_flag_is_no_pressure(motion: Motion, series: Maker) -> None:
    flag = np.where(CHANGE_MS2 < -0.3, 256.0, 0.0)

    verdict = motion.pressure_verdict(series(flag))

    assert not verdict.fits
    assert "takes only 2 values up to 256" in verdict.reason


def test_without_motion_nothing_is_refuted(series: Maker) -> None:
    motion = Motion({"a": series(np.zeros(100))})

    assert motion.speed_verdict(series(np.zeros(100))).fits
    assert motion.acceleration_verdict(series(np.ones(100))).fits
    assert motion.pressure_verdict(series(np.arange(100.0))).fits


def test_no_signal_at_all() -> None:
    motion = Motion({})

    assert not motion.known
    assert motion.moving_s == 0.0
