"""Verdicts on flags, torques and bends of a drive whose truth is known."""

from collections.abc import Callable

import numpy as np
import pytest

from bstm_daemon.analysis.setup.behaviour import Motion, Verdict
from bstm_daemon.analysis.setup.judging import Judge, stage_of
from bstm_daemon.analysis.setup.recording import Samples, Series

Maker = Callable[..., Samples]

TIME_S = np.arange(0.0, 200.0, 0.02)
# 25 s each: away, on, to a stop, standing
PHASE_S = TIME_S % 50.0
SPEED_MS: Series = np.interp(
    PHASE_S, [0.0, 8.0, 16.0, 30.0, 40.0, 50.0], [0, 12.0, 20.0, 20.0, 0, 0]
)
CHANGE_MS2: Series = np.gradient(SPEED_MS, TIME_S)
GEAR: Series = np.select(
    [SPEED_MS < 0.5, SPEED_MS < 6.0, SPEED_MS < 13.0], [0.0, 1.0, 2.0], 3.0
)
CLUTCH: Series = (
    np.convolve(np.abs(np.gradient(GEAR)) > 0, np.ones(25), "same") > 0
).astype(float)
CLUTCH[SPEED_MS < 0.5] = 1.0
RATIO = np.array([0.0, 12.0, 7.0, 4.0])[GEAR.astype(int)]
ENGINE: Series = np.where(CLUTCH > 0, 80.0, RATIO * SPEED_MS / 0.32)
PRESSURE: Series = 0.5e5 + np.maximum(-CHANGE_MS2, 0.0) * 10e5
YAW: Series = np.where((PHASE_S > 18.0) & (PHASE_S < 24.0), 0.2, 0.0)


@pytest.fixture
def judge(series: Maker) -> Judge:
    """Return a judge that knows the speeds, pressure, engine and gear."""
    judge = Judge(Motion({"v": series(SPEED_MS)}), 0.32)
    known = {
        "primary_pressure": PRESSURE,
        "engine_speed": ENGINE,
        "gear": GEAR,
        "wheel_speed_fl": SPEED_MS - 0.75 * YAW,
        "wheel_speed_fr": SPEED_MS + 0.75 * YAW,
    }
    for role, value in known.items():
        judge.known[role] = judge.motion.on_grid(series(value))
    return judge


@pytest.fixture
def verdict(judge: Judge, series: Maker) -> Callable[..., Verdict]:
    def of(role: str, value: Series, unit: str = "bool") -> Verdict:
        return judge.verdict(role, unit, series(value))

    return of


Judged = Callable[..., Verdict]


def flag(mask: object) -> Series:
    return np.asarray(mask).astype(float)


@pytest.mark.parametrize(
    "role",
    ["brake_switch", "park_brake", "clutch_open", "abs_active", "gear"],
)
@pytest.mark.parametrize("value", [0.0, 1.0])
def test_a_constant_shows_nothing(
    verdict: Judged, role: str, value: float
) -> None:
    found = verdict(role, np.full(len(TIME_S), value))

    assert not found.fits
    assert (
        found.reason
        == f"always {value:g} in the log, which shows nothing of it"
    )


def test_the_air_may_be_constant_within_reason(verdict: Judged) -> None:
    constant = np.full(len(TIME_S), 20.0)

    assert verdict("ambient_temperature", constant, "degC").fits
    assert verdict("ignition", constant / 20.0).fits


@pytest.mark.parametrize(
    ("role", "unit", "factor"),
    [("engine_speed", "rpm", 1e5), ("yaw_rate", "rad/s", 30.0)],
)
def test_a_value_out_of_range_is_another_quantity(
    verdict: Judged, role: str, unit: str, factor: float
) -> None:
    found = verdict(role, factor * np.sin(TIME_S), unit)

    assert not found.fits
    assert found.reason.endswith("out of range")


def test_a_brake_switch_is_on_under_pressure(verdict: Judged) -> None:
    """A residual pressure of 0.5 bar is a released brake."""
    braking = PRESSURE > 2e5

    right = verdict("brake_switch", flag(braking))

    assert right.fits
    assert "on 100 % of the time braked and 0 % released" in right.reason
    assert not verdict("brake_switch", flag(~braking)).fits
    assert not verdict("brake_switch", flag(TIME_S > 100.0)).fits


def test_without_a_pressure_the_deceleration_decides(
    verdict: Judged, judge: Judge
) -> None:
    del judge.known["primary_pressure"]
    braking = CHANGE_MS2 < -1.0

    assert verdict("brake_switch", flag(braking)).fits
    assert not verdict("brake_switch", flag(~braking)).fits


def test_a_park_brake_is_on_at_standstill_only(verdict: Judged) -> None:
    standing = (SPEED_MS < 0.1) & (TIME_S > 45.0)

    assert verdict("park_brake", flag(standing)).fits
    assert not verdict("park_brake", flag(CHANGE_MS2 < -1.0)).fits


def test_an_intervention_is_rare(verdict: Judged) -> None:
    acting = (CHANGE_MS2 < -1.0) & (TIME_S < 100.0)

    assert verdict("abs_active", flag(acting)).fits
    assert not verdict("abs_active", flag(~acting)).fits
    assert not verdict("ignition", flag(acting)).fits


@pytest.mark.parametrize("without", ["gear", "engine_speed"])
def test_a_clutch_opens_between_gears_or_parts_engine_and_wheels(
    verdict: Judged, judge: Judge, without: str
) -> None:
    """One of the two is enough; the clutch of a compressor does neither."""
    del judge.known[without]

    assert verdict("clutch_open", CLUTCH).fits
    assert not verdict("clutch_open", flag(TIME_S % 37.0 < 16.0)).fits


def test_a_clutch_that_nothing_confirms_is_not_sure(
    verdict: Judged, judge: Judge
) -> None:
    del judge.known["gear"], judge.known["engine_speed"]

    assert not verdict("clutch_open", CLUTCH).fits


def test_gears_lower_the_engines_turns_a_metre(verdict: Judged) -> None:
    right = verdict("gear", GEAR, "count")

    assert right.fits
    assert "37.5 in 1, 21.9 in 2, 12.5 in 3" in right.reason
    assert not verdict("gear", 4.0 - GEAR, "count").fits


def test_torque_at_the_wheels_has_the_mass_of_a_car(verdict: Judged) -> None:
    """1500 kg; a crankshaft's torque would be that of a tenth."""
    force_n = 1500.0 * CHANGE_MS2 + 300.0
    torque = np.maximum(force_n, -50.0) * 0.32

    wheels = verdict("powertrain_torque", torque, "Nm")

    assert wheels.fits
    assert wheels.proven
    assert "as of 1492 kg" in wheels.reason
    assert not verdict("powertrain_torque", 0.1 * torque, "Nm").fits
    assert verdict("engine_torque", 0.1 * torque, "Nm").fits
    assert not verdict("engine_torque", np.sin(TIME_S), "Nm").fits


@pytest.mark.parametrize("sign", [1, -1])
def test_the_wheels_give_the_sign_of_the_yaw_rate(
    verdict: Judged, sign: int
) -> None:
    found = verdict("yaw_rate", sign * YAW, "rad/s")

    assert (found.fits, found.sign) == (True, sign)
    assert f"{1.5 * sign:.2f} m x value" in found.reason
    assert not verdict("yaw_rate", 0.1 * YAW + 0.06, "rad/s").fits


def test_an_acceleration_along_the_car_is_not_lateral(
    verdict: Judged, judge: Judge
) -> None:
    judge.known["yaw_rate"] = judge.motion.on_grid(Samples(TIME_S, YAW))

    assert verdict("acceleration_lateral", YAW * SPEED_MS, "m/s2").sign == 1
    assert verdict("acceleration_lateral", -YAW * SPEED_MS, "m/s2").sign == -1
    assert not verdict("acceleration_lateral", CHANGE_MS2, "m/s2").fits


def test_what_does_not_follow_the_yaw_rate_is_not_lateral(
    verdict: Judged, judge: Judge
) -> None:
    """As check says of it: not of one quantity."""
    judge.known["yaw_rate"] = judge.motion.on_grid(Samples(TIME_S, YAW))
    noise = np.random.default_rng(1).normal(0.0, 1.0, len(TIME_S) // 50 + 1)
    other = np.repeat(noise, 50)[: len(TIME_S)]

    found = verdict("acceleration_lateral", YAW * SPEED_MS + 3.0 * other, "g")

    assert not verdict("acceleration_lateral", other, "m/s2").fits
    assert not found.fits


def test_what_others_are_judged_by_comes_first() -> None:
    roles = ("primary_pressure", "wheel_speed_fl", "gear", "clutch_open")

    assert [stage_of(role) for role in roles] == [0, 0, 1, 2]


def test_a_disc_gets_hot_while_braked_and_cools_else(
    verdict: Judged,
) -> None:
    """20 K/s braked, a little less at the edges; air shows nothing."""
    rise_k_s = np.where(CHANGE_MS2 < -1.5, 20.0, -2.0)
    disc_c = 200.0 + np.cumsum(rise_k_s) * 0.02
    air_c = 20.0 + 0.01 * TIME_S

    disc = verdict("temp_fl_disc", disc_c, "degC")

    assert disc.proven
    assert disc.reason.endswith("+19.8 K/s braked, -2.0 K/s else")
    assert not verdict("temp_fl_disc", air_c, "degC").proven
    assert not verdict("temp_fl_disc", 400.0 - disc_c, "degC").proven
