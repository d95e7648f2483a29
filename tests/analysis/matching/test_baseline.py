"""The disc of one node, and the disc and hat, on drives that they made."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.matching.baseline import Baseline, baselines
from bstm_daemon.analysis.matching.drives import GRID_S, Drive, Thermocouple
from bstm_daemon.channels import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

MOTION = {"k": 0.1, "a": 2e-3, "b": 2.5e-4, "c": 4e-4}
PRESSURE = {"k": 1.5e-7, "a": 3e-3, "b": 3e-4}
HAT = {"g": 4e-3, "h": 8e-3}
START_K = 350.0


def stops(seconds: float, seed: int = 1) -> npt.NDArray[np.float64]:
    """Return a speed on the grid, (n,): stops from many speeds, and rests."""
    rng = np.random.default_rng(seed)
    speed = [0.0]
    while len(speed) < seconds / GRID_S:
        top = rng.uniform(15.0, 45.0)
        speed += list(np.arange(0.0, top, 1.0)) + [top] * 40
        speed += list(np.arange(top, 0.0, -rng.uniform(1.5, 4.0)))
        speed += [0.0] * int(rng.integers(5, 60))
    return np.array(speed[: round(seconds / GRID_S)])


def made(
    values: Mapping[str, float],
    seconds: float = 1800.0,
    *,
    seed: int = 1,
    name: str = "made",
    within: int = 1,
    corners: tuple[str, ...] = ("FL",),
    air_k: npt.NDArray[np.float64] | float = 290.0,
    gap_s: tuple[float, float] | None = None,
) -> Drive:
    """Return a drive whose FL disc follows the equations exactly.

    They are solved by the midpoint rule in steps of 5 ms. With a c the heat
    is from the motion, seen *within* times in each step of the grid, else
    there is a pressure.
    """
    fine = np.interp(
        np.arange(0.0, seconds, GRID_S / within),
        np.arange(0.0, seconds, GRID_S),
        stops(seconds, seed),
    )
    rate = np.gradient(fine, GRID_S / within)
    on = rate < -2.0
    speed = fine.reshape(-1, within).mean(axis=1)
    air = np.broadcast_to(air_k, speed.shape)
    rows = np.zeros((len(speed), len(corners), len(CHANNELS)))
    rows[:, :, CHANNELS.index("speed_ms")] = speed[:, None]
    rows[:, :, CHANNELS.index("ambient_k")] = air[:, None]
    if "c" in values:
        lost = -(rate + values["c"] * fine**2) * fine
        heat = np.where(on, np.maximum(lost, 0.0), 0.0)
        heat = heat.reshape(-1, within).mean(axis=1)
    else:
        rng = np.random.default_rng(seed)
        pressure = np.where(on, rng.uniform(5e5, 4e6, len(speed)), 0.0)
        rows[:, :, CHANNELS.index("pressure_pa")] = pressure[:, None]
        heat = pressure * speed
    heat *= values["k"]
    cooling = values["a"] + values["b"] * speed
    g, h = values.get("g", 0.0), values.get("h", 0.0)
    disc = hat = START_K
    found, small = np.empty(len(speed)), 100
    step_s = GRID_S / small
    for i in range(len(speed)):
        for _ in range(small if i else 0):
            half = 0.5 * step_s
            loss = cooling[i] * (disc - air[i]) + g * (disc - hat)
            middle = disc + half * (heat[i] - loss)
            middle_hat = hat + half * h * (disc - hat)
            loss = cooling[i] * (middle - air[i]) + g * (middle - middle_hat)
            disc += step_s * (heat[i] - loss)
            hat += step_s * h * (middle - middle_hat)
        found[i] = disc
    time_s = GRID_S * np.arange(1.0, len(speed) + 1.0)
    keep = np.ones(len(speed), bool)
    if gap_s is not None:
        keep = (time_s < gap_s[0]) | (time_s > gap_s[1])
    couple = Thermocouple(time_s[keep], found[keep])
    return Drive(
        name,
        0.0,
        corners,
        rows,
        {"FL": {"disc": couple}},
        speed_ms=fine.reshape(-1, within),
    )


def fitted(drive: Drive, form: int = 0) -> Baseline:
    return baselines([drive])["FL"][form]


def test_the_constants_of_one_node_are_found_from_the_motion() -> None:
    found = fitted(made(MOTION))

    assert found.values == pytest.approx(MOTION, rel=1e-3)
    assert found.rms_k < 0.01
    assert found.heat == "motion"
    assert found.title == "disc of one node"
    assert found.constants == (
        "heat from motion, k 0.1 K s2/m2, a 0.002 1/s, b 0.00025 1/m, "
        "c 0.0004 1/m"
    )


def test_the_constants_of_one_node_are_found_from_the_pressure() -> None:
    found = fitted(made(PRESSURE))

    assert found.values == pytest.approx(PRESSURE, rel=1e-3)
    assert found.heat == "pressure"
    assert "K/(Pa m)" in found.constants


@pytest.mark.parametrize("disc", [MOTION, PRESSURE])
def test_the_constants_of_disc_and_hat_are_found(
    disc: dict[str, float],
) -> None:
    right = disc | HAT

    one, two = baselines([made(right)])["FL"]

    assert two.values == pytest.approx(right, rel=1e-3)
    assert two.title == "disc and hat"
    assert two.rms_k < 0.01
    assert one.rms_k > 1.0


def test_the_air_may_change() -> None:
    air_k = 290.0 + 15.0 * np.sin(np.arange(3600) / 500.0)

    assert fitted(made(MOTION, air_k=air_k)).values == pytest.approx(
        MOTION, rel=1e-3
    )


def test_a_gap_in_the_measurement_counts_for_nothing() -> None:
    whole, gap = made(MOTION), made(MOTION, gap_s=(300.0, 700.0))
    found = fitted(gap)

    assert found.values == pytest.approx(MOTION, rel=1e-3)
    assert found.rms_on([whole]) < 0.01


def test_it_begins_at_the_first_reading() -> None:
    """Half a step of the grid is what its time is known to."""
    found = fitted(made(MOTION, gap_s=(0.0, 600.0)))

    assert found.values == pytest.approx(MOTION, rel=0.01)
    assert found.rms_k < 0.2


def test_a_drive_without_a_pressure_leaves_the_motion() -> None:
    drives = [made(MOTION, name="one"), made(MOTION, seed=2)]
    drives[0].inputs[:, :, CHANNELS.index("pressure_pa")] = 1e6

    assert baselines(drives)["FL"][0].heat == "motion"
    assert fitted(drives[0]).heat == "pressure"


def test_on_another_drive_it_is_computed_from_the_first_reading_alone() -> (
    None
):
    found = fitted(made(MOTION))
    other = made(MOTION, seed=2)
    couple = other.measured["FL"]["disc"]
    hotter = replace(
        other,
        measured={
            "FL": {
                "disc": Thermocouple(
                    couple.time_s,
                    couple.temperature_k
                    + np.where(couple.time_s > GRID_S, 7.0, 0.0),
                )
            }
        },
    )

    assert found.rms_on([other]) < 0.01
    assert found.rms_on([hotter]) == pytest.approx(7.0, rel=1e-3)


def test_several_drives_are_fitted_together() -> None:
    drives = [
        made(MOTION, 600.0, seed=seed, name=f"drive {seed}")
        for seed in (1, 2, 3)
    ]

    found, _ = baselines(drives)["FL"]

    assert found.values == pytest.approx(MOTION, rel=1e-3)
    assert found.drives == ("drive 1", "drive 2", "drive 3")


def test_braking_is_resolved_within_the_step() -> None:
    """Means over half a second blur where a stop begins and ends."""
    drive = made(MOTION, within=10)
    blurred = replace(drive, speed_ms=np.zeros((0, 0)))

    assert fitted(drive).values == pytest.approx(MOTION, rel=1e-3)
    assert fitted(blurred).rms_k > 0.3


def test_a_corner_without_a_thermocouple_at_its_disc_has_none() -> None:
    drive = made(MOTION, 600.0, corners=("FL", "FR"))
    couple = drive.measured["FL"]["disc"]
    drive = replace(
        drive,
        measured={"FL": {"disc_2": couple}, "FR": {"fluid": couple}},
    )

    assert list(baselines([drive])) == ["FL"]
    assert np.isnan(fitted(drive).rms_on([replace(drive, measured={})]))


def test_an_hour_takes_well_below_a_second() -> None:
    drive = made(MOTION | HAT, 60.0)
    hour = replace(
        drive,
        inputs=np.tile(drive.inputs, (60, 1, 1)),
        speed_ms=np.tile(drive.speed_ms, (60, 1)),
        measured={
            "FL": {
                "disc": Thermocouple(
                    GRID_S * np.arange(1.0, 7201.0),
                    np.tile(drive.measured["FL"]["disc"].temperature_k, 60),
                )
            }
        },
    )
    began = time.process_time()

    baselines([hour])

    assert time.process_time() - began < 3.0
