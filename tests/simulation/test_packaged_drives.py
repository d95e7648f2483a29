"""Every packaged drive: speed, energy balance and temperatures in bands."""

import numpy as np
import pytest

from bstm_daemon.simulation import (
    SimulatedDrive,
    drive_names,
    load_drive,
    simulate,
)

from ..drive_ledger import energy_ledger  # noqa: TID252  (no package)

# top speed [km/h], then highest disc and fluid temperature, FL [degC], and
# duration [min]: from - to
BANDS = {
    "simalp": (36, (450, 700), (110, 180), (85, 86)),
    "alpine-descent": (41, (450, 700), (110, 180), (84, 87)),
    "grossglockner": (70, (450, 700), (60, 110), (80, 95)),
    "coastdown": (110, (20, 30), (19, 22), (12, 15)),
    "idiada-step": (110, (150, 260), (20, 30), (7, 11)),
    "idiada-ramp": (110, (130, 230), (20, 30), (5, 9)),
    "idiada-pulse": (110, (120, 220), (20, 30), (5, 9)),
    "ams": (100, (500, 780), (50, 90), (30, 35)),
    "cooling": (150, (500, 720), (85, 130), (100, 103)),
    "cooldown": (130, (500, 820), (35, 70), (50, 55)),
    "soak": (42, (600, 800), (140, 180), (135, 145)),
    "long-run": (110, (400, 650), (75, 130), (130, 175)),
    "city": (50, (80, 200), (22, 40), (28, 37)),
    "rich": (140, (600, 850), (105, 160), (95, 110)),
    "wind-tunnel": (36, (450, 700), (100, 180), (85, 86)),
    "track": (165, (600, 900), (70, 140), (35, 45)),
    "wet": (120, (300, 550), (50, 100), (45, 53)),
    "slippery": (60, (150, 450), (0, 30), (30, 40)),
    "assist": (110, (250, 500), (40, 90), (38, 45)),
    "regen": (100, (300, 550), (40, 90), (45, 52)),
    "m01": (36, (450, 700), (110, 180), (85, 86)),
    "m02": (100, (200, 400), (28, 55), (15, 20)),
    "m03": (50, (200, 420), (35, 70), (28, 33)),
    "m04": (150, (580, 780), (60, 110), (60, 70)),
    "m05": (100, (500, 640), (45, 90), (92, 100)),
    "m06": (100, (330, 520), (38, 70), (50, 55)),
    "m07": (40, (350, 550), (45, 85), (32, 36)),
    "m08": (100, (280, 480), (32, 60), (50, 56)),
    "m09": (80, (350, 560), (55, 100), (88, 93)),
    "m10": (110, (600, 850), (85, 140), (99, 106)),
    "m11": (60, (220, 400), (32, 60), (24, 28)),
    "m12": (36, (450, 700), (110, 190), (85, 86)),
    "m13": (110, (740, 860), (50, 100), (27, 32)),
    "m14": (80, (400, 600), (42, 75), (83, 88)),
    "m15": (105, (25, 70), (19, 23), (14, 17)),
}
QUICK = {"ams", "coastdown", "idiada-pulse", "slippery", "m02", "m07"}


def test_every_packaged_drive_has_its_band() -> None:
    assert set(BANDS) == set(drive_names())
    assert {f"m{n:02}" for n in range(1, 16)} <= set(BANDS)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[] if n in QUICK else pytest.mark.slow)
        for n in BANDS
    ],
)
def test_drive_lies_in_its_bands(name: str) -> None:
    top_kmh, disc_c, fluid_c, minutes = BANDS[name]
    driven = simulate(load_drive(name))
    ledger = energy_ledger(driven)

    assert driven.course.speed_ms.max() * 3.6 == pytest.approx(top_kmh, abs=3)
    assert minutes[0] <= driven.time_s[-1] / 60 <= minutes[1]
    for node, band in (("disc", disc_c), ("fluid", fluid_c)):
        highest = driven.truth[f"FL.{node}"].max() - 273.15
        assert band[0] <= highest <= band[1], node
    # what the wheels do and what the brakes hold, each against its own sums
    assert abs(ledger.residual) < 0.01
    assert np.abs(driven.balance_residual).max() < 1e-10
    assert driven.brake_energy_j[-1].sum() == pytest.approx(
        ledger.brakes, rel=1e-3
    )
    assert all(np.isfinite(v).all() for v in driven.roles.values())


def run(name: str) -> SimulatedDrive:
    """Return the drive *name* on its own vehicle."""
    return simulate(load_drive(name))


def test_steps_hold_their_pressure_out_of_gear() -> None:
    driven = run("idiada-step")
    primary = driven.roles["primary_pressure"] / 1e5
    labels = [s.label for s in driven.course.segments]
    for index, bar in enumerate((10.0, 20.0, 35.0, 55.0)):
        here = driven.course.segment == labels.index(f"{bar:g} bar")
        middle = primary[here][50:-50]
        np.testing.assert_allclose(middle, bar, rtol=1e-6)
        begun = driven.course.speed_ms[here][0] * 3.6
        assert begun == pytest.approx(100.0, abs=1.5), index
        # neutral: nothing but smoothing is left at the wheels
        torque = driven.roles["powertrain_torque"][here][50:-50]
        assert abs(torque).max() < 30.0


def test_ramp_rises_linearly() -> None:
    driven = run("idiada-ramp")
    labels = [s.label for s in driven.course.segments]
    here = driven.course.segment == labels.index("4 bar/s")
    bar = driven.roles["primary_pressure"][here][50:-50] / 1e5

    np.testing.assert_allclose(np.diff(bar), 0.04, atol=1e-6)


def test_assist_brakes_without_primary_pressure() -> None:
    driven = run("assist")
    course = driven.course
    assisted = course.level([float(s.assist) for s in course.segments]) > 0
    braking = assisted & (driven.motion.brake_force_n > 500.0)

    assert braking.sum() > 1000
    assert not driven.roles["primary_pressure"][assisted].any()
    assert not driven.roles["brake_switch"][assisted].any()
    assert driven.roles["secondary_pressure"][braking].min() > 1e5


def test_slippery_shows_its_interventions() -> None:
    driven = run("slippery")
    roles = driven.roles
    v = roles["vehicle_speed"]
    for flag, role, sign in (
        ("abs_active", "wheel_speed_fr", -1.0),
        ("tc_active", "wheel_speed_fl", 1.0),
    ):
        on = (roles[flag] > 0) & (v > 2.0)
        assert (sign * (roles[role] - v)[on]).min() > 0.1
    esc = roles["esc_active"] > 0
    single = driven.motion.corner_pressure_pa[esc]
    assert ((single > 1e5).sum(axis=1) == 1).mean() > 0.5
    assert energy_ledger(driven).tyres > 1e4


@pytest.mark.slow
def test_regeneration_spares_the_pads() -> None:
    ledger = energy_ledger(run("regen"))

    assert 0.3 < ledger.regeneration / ledger.brakes < 3.0


@pytest.mark.slow
def test_open_rims_cool_the_soak() -> None:
    closed, tunnel = run("simalp"), run("wind-tunnel")
    rise = {
        d.drive.name: d.truth["FL.fluid"].max() - d.truth["FL.fluid"][0]
        for d in (closed, tunnel)
    }

    # thesis section 6.2.2: cooler fluid with more open rims
    assert rise["wind-tunnel"] < rise["simalp"] - 5.0


@pytest.mark.slow
def test_worn_pads_pass_more_heat_to_the_fluid() -> None:
    new, worn = run("m01"), run("m12")

    assert worn.truth["FL.fluid"].max() > new.truth["FL.fluid"].max() + 3.0
    assert (
        worn.truth["FL.pad_back"].argmax()
        < new.truth["FL.pad_back"].argmax() + 60
    )
