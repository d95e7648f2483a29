"""Whole drives: the bands of the reality, energy, resolution, repetition."""

import numpy as np
import pytest

from bstm_daemon.errors import UsageError
from bstm_daemon.simulation import (
    EFFECT_NAMES,
    Effects,
    Mesh,
    SimulatedDrive,
    load_drive,
    load_vehicle,
    parse_drive,
    preset_effects,
    simulate,
)
from bstm_daemon.simulation.parameters import STRONGEST
from bstm_daemon.simulation.profile import SAMPLE_S
from bstm_daemon.simulation.reality import extension
from bstm_daemon.simulation.simulate import Resolution

from ..finer_mesh import with_half_cells  # noqa: TID252  (no package)


def celsius(drive: SimulatedDrive, node: str) -> np.ndarray:
    """Return the true temperature of *node* [degC]."""
    return drive.truth[node] - 273.15


def stop_row(drive: SimulatedDrive) -> int:
    """Return the truth's row at the end of the last motion."""
    return int(np.flatnonzero(drive.course.speed_ms > 0)[-1] * SAMPLE_S)


def test_simalp_lies_in_its_bands(simalp: SimulatedDrive) -> None:
    at = stop_row(simalp)
    fluid = celsius(simalp, "FL.fluid")

    assert 450 < celsius(simalp, "FL.disc")[at] < 700
    assert 150 < celsius(simalp, "FL.pad_back")[at] < 300
    assert 110 < fluid.max() < 180
    assert 8 < (fluid.argmax() - at) / 60 < 20


def test_simalp_is_the_thesis_drive(simalp: SimulatedDrive) -> None:
    at = 800 * 100

    assert simalp.course.speed_ms[at] == pytest.approx(10.0)
    assert simalp.motion.external_force_n[at] == pytest.approx(2130, abs=5)
    assert simalp.motion.brake_force_n[at] == pytest.approx(1740, abs=5)
    assert simalp.brake_power_w[at, 0] == pytest.approx(
        0.35 * simalp.brake_power_w[at].sum()
    )
    assert simalp.truth["FL.fluid"][0] == pytest.approx(283.15, abs=0.01)
    assert simalp.time_s[-1] - stop_row(simalp) == pytest.approx(3600, abs=5)


def test_nodes_stand_in_their_order(simalp: SimulatedDrive) -> None:
    at = stop_row(simalp)
    order = ("disc", "pad_front", "pad_back", "backplate", "fluid")
    temperatures = [celsius(simalp, f"FL.{node}")[at] for node in order]

    assert temperatures == sorted(temperatures, reverse=True)
    # fluid and caliper are one piece when nothing splits them
    split = celsius(simalp, "FL.fluid") - celsius(simalp, "FL.caliper")
    assert abs(split).max() < 3.0


def test_pad_follows_the_disc_slowly_into_the_soak(
    simalp: SimulatedDrive,
) -> None:
    at = stop_row(simalp)
    disc = celsius(simalp, "FL.disc_mean")[at:]
    back = celsius(simalp, "FL.pad_back")[at:]

    assert disc.argmax() < 10
    assert back.argmax() > 20
    assert (disc[600] - 10) / (disc[0] - 10) < (back[600] - 10) / (
        back[0] - 10
    )


def test_energy_balance_closes(simalp: SimulatedDrive) -> None:
    assert np.abs(simalp.balance_residual).max() < 1e-11
    power = simalp.motion.brake_force_n * simalp.course.speed_ms
    np.testing.assert_allclose(simalp.brake_power_w.sum(axis=1), power)
    assert simalp.brake_energy_j[-1].sum() == pytest.approx(
        power.sum() * SAMPLE_S
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("finer", "disc_k", "fluid_k"),
    [
        (Resolution(step_s=0.25, soak_step_s=1.0), 0.2, 0.002),
        (Resolution(mesh=with_half_cells(Mesh())), 0.6, 0.1),
    ],
    ids=["half the step", "half the cells"],
)
def test_resolution_is_fine_enough(
    simalp: SimulatedDrive, finer: Resolution, disc_k: float, fluid_k: float
) -> None:
    fine = simulate(simalp.drive, resolution=finer)

    for node, limit in (("FL.disc", disc_k), ("FL.fluid", fluid_k)):
        assert abs(fine.truth[node] - simalp.truth[node]).max() < limit


@pytest.mark.slow
def test_alpine_descent_takes_the_same_energy(
    simalp: SimulatedDrive,
) -> None:
    descent = simulate(load_drive("alpine-descent"))
    moving = descent.course.speed_ms > 0

    assert descent.brake_energy_j[-1].sum() == pytest.approx(
        simalp.brake_energy_j[-1].sum(), rel=0.02
    )
    assert moving.sum() * SAMPLE_S == pytest.approx(1500, abs=15)
    assert descent.course.speed_ms[moving].mean() * 3.6 == pytest.approx(
        36, abs=0.5
    )
    assert descent.motion.powertrain_torque_nm.min() < -50
    off = np.flatnonzero(~descent.bus_on)[0] * SAMPLE_S
    assert off - stop_row(descent) == pytest.approx(120, abs=3)
    assert descent.logger_on.all()


def test_same_arguments_give_the_same_drive(short: SimulatedDrive) -> None:
    again = simulate(short.drive)

    for role, values in short.roles.items():
        np.testing.assert_array_equal(again.roles[role], values)
    for node, values in short.truth.items():
        np.testing.assert_array_equal(again.truth[node], values)


def test_stop_heats_by_its_kinetic_energy(short: SimulatedDrive) -> None:
    kinetic = 0.5 * (2194.0 + 26.4) * 20.0**2
    heat = short.brake_energy_j[-1].sum()

    # resistance and the dragging engine take their part
    assert 0.88 * kinetic < heat < 0.97 * kinetic


def test_drive_sets_mass_and_start() -> None:
    text = (
        '[drive]\nname = "d"\ndescription = "x"\nstart_c = 90.0\n'
        "mass_kg = {}\n[[segment]]\nspeed_kmh = 50.0\n"
        "[[segment]]\nspeed_kmh = 0.0\nrate_ms2 = 3.0\n"
    )
    light, heavy = (
        simulate(parse_drive(text.format(mass), "d.toml"))
        for mass in (1000.0, 3000.0)
    )

    assert light.truth["FL.fluid"][0] == pytest.approx(363.15, abs=0.5)
    ratio = heavy.brake_energy_j[-1] / light.brake_energy_j[-1]
    assert ratio == pytest.approx(np.full(4, 3.0), rel=0.05)


def test_unknown_preset_lists_the_known() -> None:
    with pytest.raises(UsageError, match="plain"):
        simulate(load_drive("simalp"), preset="rosy")


def test_road_has_exactly_the_effects_of_the_extended_structure() -> None:
    # those marked E in the table of effects, all at strength 1
    road = preset_effects("road")
    on = {name for name in EFFECT_NAMES if getattr(road, name) != 0.0}

    assert on == {
        "friction_fade",
        "friction_speed",
        "friction_pressure",
        "gap_conduction",
        "disc_radiation_driving",
        "local_air",
        "disc_hat",
        "bracket_conduction",
        "disc_caliper_radiation",
        "contact_conductance",
        "caliper_fluid_split",
    }
    assert {getattr(road, name) for name in on} == {1.0}


def test_effects_can_be_given_themselves(short: SimulatedDrive) -> None:
    hot = simulate(short.drive, preset=Effects(brake_share=1.0))

    assert hot.brake_energy_j[-1, 0] == pytest.approx(
        1.1 * short.brake_energy_j[-1, 0]
    )


@pytest.mark.parametrize("strength", [-0.1, 3.1, float("nan")])
def test_strength_beyond_its_range_is_refused(strength: float) -> None:
    with pytest.raises(UsageError, match="disc_hat"):
        Effects().with_strength("disc_hat", strength)


def test_car_is_the_same_compiled_and_not(
    short: SimulatedDrive, monkeypatch: pytest.MonkeyPatch
) -> None:
    if extension() is None:
        pytest.skip("the compiled reality is not installed")
    everything = Effects(**dict.fromkeys(EFFECT_NAMES, 1.0))
    second = load_vehicle("second")
    fast = simulate(short.drive, second, preset=everything)
    monkeypatch.setenv("BSTM_KERNEL", "reference")
    slow = simulate(short.drive, second, preset=everything)

    for node, values in slow.truth.items():
        np.testing.assert_allclose(fast.truth[node], values, atol=1e-7)
    np.testing.assert_allclose(
        fast.brake_power_w, slow.brake_power_w, rtol=1e-9
    )


def test_strongest_effects_stay_physical(short: SimulatedDrive) -> None:
    everything = Effects(**dict.fromkeys(EFFECT_NAMES, STRONGEST))

    driven = simulate(short.drive, preset=everything)

    assert np.abs(driven.balance_residual).max() < 1e-10
    for series in driven.truth.values():
        assert series.min() > 250.0
        assert series.max() < 600.0
