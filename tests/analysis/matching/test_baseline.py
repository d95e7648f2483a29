"""The disc of one node, and the disc and hat, on drives that they made."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.analysis.matching.baseline import Baseline, baselines
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.thermocouples import Thermocouple
from bstm_daemon.channels import CHANNELS

from ...made_drives import lumped as made  # noqa: TID252

MOTION = {"k": 0.1, "a": 2e-3, "b": 2.5e-4, "c": 4e-4}
PRESSURE = {"k": 1.5e-7, "a": 3e-3, "b": 3e-4}
HAT = {"g": 4e-3, "h": 8e-3}


def fitted(drive: Drive, form: int = 0) -> Baseline:
    return baselines([drive])["FL"][form]


@pytest.mark.slow
def test_the_constants_of_one_node_are_found_from_the_motion() -> None:
    found = fitted(made(MOTION))

    assert found.values == pytest.approx(MOTION, rel=1e-3)
    assert found.rms_k < 0.01
    assert found.heat == "motion"
    assert found.title == "disc of one node"


@pytest.mark.slow
def test_the_constants_of_one_node_are_found_from_the_pressure() -> None:
    found = fitted(made(PRESSURE))

    assert found.values == pytest.approx(PRESSURE, rel=1e-3)
    assert found.heat == "pressure"


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


@pytest.mark.slow
def test_the_air_may_change() -> None:
    air_k = 290.0 + 15.0 * np.sin(np.arange(3600) / 500.0)

    assert fitted(made(MOTION, air_k=air_k)).values == pytest.approx(
        MOTION, rel=1e-3
    )


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_drive_without_a_pressure_leaves_the_motion() -> None:
    drives = [made(MOTION, name="one"), made(MOTION, seed=2)]
    drives[0].inputs[:, :, CHANNELS.index("pressure_pa")] = 1e6

    assert baselines(drives)["FL"][0].heat == "motion"
    assert fitted(drives[0]).heat == "pressure"


@pytest.mark.slow
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


@pytest.mark.slow
def test_several_drives_are_fitted_together() -> None:
    drives = [
        made(MOTION, 600.0, seed=seed, name=f"drive {seed}")
        for seed in (1, 2, 3)
    ]

    found, _ = baselines(drives)["FL"]

    assert found.values == pytest.approx(MOTION, rel=1e-3)
    assert found.drives == ("drive 1", "drive 2", "drive 3")


@pytest.mark.slow
def test_braking_is_resolved_within_the_step() -> None:
    """Means over half a second blur where a stop begins and ends."""
    drive = made(MOTION, within=10)
    blurred = replace(drive, speed_ms=np.zeros((0, 0)))

    assert fitted(drive).values == pytest.approx(MOTION, rel=1e-3)
    assert fitted(blurred).rms_k > 0.3


@pytest.mark.slow
def test_a_corner_without_a_thermocouple_at_its_disc_has_none() -> None:
    drive = made(MOTION, 600.0, corners=("FL", "FR"))
    couple = drive.measured["FL"]["disc"]
    drive = replace(
        drive,
        measured={"FL": {"disc_2": couple}, "FR": {"fluid": couple}},
    )

    assert list(baselines([drive])) == ["FL"]
    assert np.isnan(fitted(drive).rms_on([replace(drive, measured={})]))


@pytest.mark.slow
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
