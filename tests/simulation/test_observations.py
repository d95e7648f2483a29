"""What the thesis saw in its measurements (sections 3.1 to 3.3)."""

import numpy as np
import pytest

from bstm_daemon.simulation import (
    SimulatedDrive,
    load_drive,
    load_vehicle,
    simulate,
)


@pytest.fixture(scope="module", params=["plain", "road"])
def second(request: pytest.FixtureRequest) -> SimulatedDrive:
    """Return simalp on the second car."""
    car = load_vehicle("second")
    return simulate(load_drive("simalp"), car, preset=request.param)


@pytest.fixture(scope="module", params=["plain", "road"])
def nominal(request: pytest.FixtureRequest) -> SimulatedDrive:
    """Return simalp on the nominal car."""
    return simulate(load_drive("simalp"), preset=request.param)


def stop_row(driven: SimulatedDrive) -> int:
    """Return the truth's row at the stop."""
    return int(np.flatnonzero(driven.course.speed_ms > 0)[-1] * 0.01)


def test_discs_two_thermocouples_agree_within_20_k(
    second: SimulatedDrive,
) -> None:
    spread = np.abs(second.truth["FL.disc"] - second.truth["FL.disc_2"])

    assert 1.0 < spread.max() < 20.0


@pytest.mark.slow
def test_measured_spread_is_of_that_size(nominal: SimulatedDrive) -> None:
    read = simulate(nominal.drive, sensors="n3").temperatures
    spread = read["temp_fl_disc"] - read["temp_fl_disc_2"]

    # offsets and drifts of two junctions; noise is no place
    smooth = np.convolve(spread, np.full(60, 1 / 60), "valid")
    assert 2.0 < np.abs(smooth).max() < 25.0


def test_disc_cools_faster_than_the_pad_in_the_soak(
    nominal: SimulatedDrive,
) -> None:
    at = stop_row(nominal)
    ambient = nominal.truth["FL.disc"][0]
    left = {
        node: (nominal.truth[f"FL.{node}"][at + 900] - ambient)
        / (nominal.truth[f"FL.{node}"][at] - ambient)
        for node in ("disc", "pad_front", "pad_back")
    }

    assert left["disc"] < left["pad_back"]
    # the face follows the disc only where air in the gap conducts: without,
    # it first levels with the pad behind it
    if nominal.truth["FL.hat"].max() > ambient + 20.0:
        assert left["disc"] < left["pad_front"]


def test_pads_hold_little_of_the_discs_energy(
    nominal: SimulatedDrive,
) -> None:
    corner = nominal.car.front
    pad_j_k = (
        2
        * corner.pad_density_kg_m3
        * corner.pad_area_m2
        * corner.pad_thickness_m
        * corner.pad_heat_capacity_j_kgk
    )

    assert pad_j_k < 0.12 * corner.ring_mass_kg * 550.0


def test_fluid_peaks_higher_and_later_on_the_hotter_side(
    second: SimulatedDrive,
) -> None:
    left, right = second.truth["FL.fluid"], second.truth["FR.fluid"]
    at = stop_row(second)

    assert second.truth["FL.disc"][at] > second.truth["FR.disc"][at] + 5.0
    assert left.max() > right.max() + 5.0
    assert left.argmax() > right.argmax() + 20


def test_caliper_has_nearly_the_fluids_temperature(
    nominal: SimulatedDrive,
) -> None:
    fluid, caliper = nominal.truth["FL.fluid"], nominal.truth["FL.caliper"]

    assert np.abs(fluid - caliper).max() < 7.0
    # the body around the piston lies slightly lower, never far above
    assert (fluid - caliper)[fluid.argmax()] > 0.0


def test_fluid_overheats_only_after_the_stop(
    nominal: SimulatedDrive,
) -> None:
    at = stop_row(nominal)
    fluid = nominal.truth["FL.fluid"]

    assert fluid.max() > fluid[at] + 15.0
    # the slow parts of a road car, bracket and warm air, delay the peak
    assert 8 < (fluid.argmax() - at) / 60 < 22
