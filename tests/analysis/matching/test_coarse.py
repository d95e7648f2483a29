"""The search for what is only guessed, on a sparse drive of known values."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
import pytest

from bstm_daemon.analysis.matching.coarse import (
    CAPACITY,
    CAR_MASS,
    COHERENT,
    DRAG_FACTORS,
    FILTER,
    FILTERS_S,
    NEAR_FACTORS,
    Reading,
    check_mass,
    driven_keys,
    guesses_of,
    read_as_guessed,
    search,
)
from bstm_daemon.analysis.matching.drives import Thermocouple
from bstm_daemon.analysis.matching.matcher import match_drives
from bstm_daemon.analysis.matching.power_by import PowerBy
from bstm_daemon.analysis.matching.tunables import (
    BEYOND_MS,
    DRAG,
    LEVEL,
    MASS,
    NODES_MS,
    REFINED,
    Target,
)
from bstm_daemon.analysis.statistics.whitening import SensorNoise
from bstm_daemon.channels import CHANNELS
from bstm_daemon.errors import UsageError
from bstm_daemon.report.match import headline

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.config.sections import Config

PROFILE: Final = (
    (20.0, 0.0, 20.0),
    *((40.0, 40000.0, 8.0), (20.0, 0.0, 40.0), (80.0, 0.0, 30.0)) * 6,
    (30.0, 20000.0, 10.0),
    (10.0, 0.0, 60.0),
)
GUESSED: Final = frozenset({MASS, LEVEL, DRAG, *NODES_MS})
RIGHT: Final = {MASS: 0.4, LEVEL: 5.0}


@pytest.fixture
def sparse(made: Callable[..., Drive]) -> Drive:
    """A light disc that is cooled well; of the car's drag nothing is known.

    Its power is that of 0.8 m2; a smaller drag would leave more of it.
    """
    drive = made(RIGHT, profile=PROFILE, nodes=("disc",), noise_k=0.5)
    power = drive.inputs[:, :, CHANNELS.index("brake_power_w")]
    areas = np.array([0.4, 0.8, 1.6])
    braked = power > 0.0
    powers = np.array([power + braked * 1e4 * (0.8 - area) for area in areas])
    inputs = drive.inputs.copy()
    inputs[:, :, CHANNELS.index("brake_power_w")] = powers[0]
    power_by = {
        corner: PowerBy(DRAG, areas, powers[:, :, i])
        for i, corner in enumerate(drive.corners)
    }
    return replace(drive, inputs=inputs, power_by=power_by)


@pytest.fixture
def guessing(target: Target) -> Target:
    vehicle = target.config.vehicle.model_copy(update={"drag_area_m2": 0.4})
    config = target.config.model_copy(update={"vehicle": vehicle})
    return replace(target, config=config, guessed=GUESSED)


@pytest.mark.slow
def test_mass_cooling_and_drag_are_found_from_afar(
    guessing: Target, sparse: Drive
) -> None:
    shown: list[float] = []

    (match,) = match_drives(
        guessing.config,
        [Reading(None, [sparse])],
        guessed=GUESSED,
        progress=shown.append,
    )

    assert shown == sorted(shown)
    assert shown[-1] == 1.0
    after = match.after
    thermal = after.config.thermal_of(after.corner)
    assert thermal.disc_mass_correction_factor == pytest.approx(0.4, rel=0.05)
    assert after.config.vehicle.drag_area_m2 == pytest.approx(0.8, rel=0.1)
    old = guessing.config.cooling_of(guessing.corner)
    new = after.config.cooling_of(after.corner)
    at = old.speed_ms.index(19.44)
    assert new.s_per_s[at] == pytest.approx(5.0 * old.s_per_s[at], rel=0.1)
    accuracy = match.accuracy
    assert accuracy.rms_k["disc"] < 8.0
    assert accuracy.before_k["disc"] > 5.0 * accuracy.rms_k["disc"]
    assert accuracy.left_out.startswith("made from ")
    assert not match.verdict


def test_what_discs_do_not_show_is_left_out_and_named(
    guessing: Target, sparse: Drive
) -> None:
    keys, why = driven_keys(guessing, [sparse], REFINED)

    assert set(keys) <= {MASS, DRAG, *NODES_MS, *REFINED}
    assert not any("fluid" in key or "pad" in key for key in keys)
    (left_out,) = why
    assert "thermal.fluid_caliper_thermal_capacity_j_k" in left_out
    # a third of the time at 288 km/h
    assert set(BEYOND_MS) <= set(keys)


def test_the_share_of_time_beyond_the_cooling_table_is_said(
    guessing: Target, sparse: Drive
) -> None:
    """A fifth of the drive at 100 m/s, beyond the point at 320 km/h."""
    inputs = sparse.inputs.copy()
    fast = len(inputs) // 5
    inputs[:fast, :, CHANNELS.index("speed_ms")] = 100.0

    _, why = driven_keys(guessing, [replace(sparse, inputs=inputs)], REFINED)

    assert why[-1].startswith("20 % of the time is faster than")
    assert "320 km/h" in why[-1]

    # where the table is not matched, nobody asks
    keys, why = driven_keys(
        guessing, [replace(sparse, inputs=inputs, power_by={})], [MASS]
    )
    assert (keys, why) == ((MASS,), [])


def test_a_second_thermocouple_of_a_disc_is_of_the_disc(
    guessing: Target, sparse: Drive
) -> None:
    (disc,) = sparse.measured["FL"].values()
    twice = {"FL": {"disc": disc, "disc_2": disc}}
    fluid = {"FL": {"disc": disc, "fluid": disc}}

    for measured, alone in ((twice, True), (fluid, False)):
        drive = replace(sparse, measured=measured, power_by={})
        keys, _ = driven_keys(guessing, [drive], ["thermal.disc_emissivity"])
        assert (not keys) == alone


def test_nothing_is_searched_where_nothing_is_guessed(
    target: Target, sparse: Drive
) -> None:
    plain = replace(sparse, power_by={})

    found = search(target, [Reading(None, [plain])])

    assert found.target is target
    assert not found.noise


@pytest.mark.slow
def test_what_the_search_leaves_is_noise_of_each_point(
    guessing: Target, sparse: Drive
) -> None:
    """Also where a constant heat capacity is tried, and a filter beside."""
    plain = replace(guessing, guessed=GUESSED | {CAPACITY})
    disc = sparse.measured["FL"]["disc"]
    wrong_k = disc.temperature_k + np.resize([40.0, -40.0], len(disc.time_s))
    couple = Thermocouple(disc.time_s, wrong_k)
    off = replace(sparse, measured={"FL": {"disc": couple}})
    readings = [Reading(None, [off]), Reading(0.02, [sparse])]

    found = search(plain, readings)

    assert found.reading is readings[1]
    heat = found.target.config.heat
    assert heat.derivative_filter_s == 0.02
    assert found.target.setting(MASS) == pytest.approx(0.4, rel=0.1)
    (noise,) = found.noise.values()
    left_k = noise.white_k / COHERENT
    assert 0.3 < left_k < 8.0
    assert noise == SensorNoise(noise.white_k, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_constant_heat_capacity_is_found(
    guessing: Target, made: Callable[..., Drive]
) -> None:
    constant = guessing.with_disc(heat_capacity_exponent=0.0)
    drive = made(
        {MASS: 0.4},
        profile=PROFILE,
        nodes=("disc",),
        noise_k=0.5,
        target=constant,
    )
    guessed = frozenset({MASS, CAPACITY})

    found = search(
        replace(guessing, guessed=guessed), [Reading(None, [drive])]
    )

    assert found.target.corner.disc is not None
    assert found.target.corner.disc.heat_capacity_exponent == 0.0
    assert found.target.setting(MASS) == pytest.approx(0.4, rel=0.02)


def with_motion_alone(config: Config) -> Config:
    """Return a car whose heat comes from its motion, without a pressure."""
    signals = {
        role: one
        for role, one in config.signals.items()
        if "pressure" not in role
    }
    heat = config.heat.model_copy(update={"mode": "fb"})
    return config.model_copy(update={"signals": signals, "heat": heat})


def test_drives_are_read_with_each_drag_and_filter(
    guessing: Target, sparse: Drive
) -> None:
    """The first as configured; the power of each area is its reading's."""
    config = with_motion_alone(guessing.config)
    place = CHANNELS.index("brake_power_w")
    asked: list[tuple[float, float]] = []

    def read(of: Config) -> Sequence[Drive]:
        area_m2 = of.vehicle.drag_area_m2
        asked.append((of.heat.derivative_filter_s, area_m2))
        inputs = sparse.inputs.copy()
        inputs[:, :, place] = area_m2
        return [replace(sparse, inputs=inputs, power_by={})]

    found = read_as_guessed(config, frozenset({DRAG, FILTER}), read)

    configured = config.vehicle.drag_area_m2
    areas = sorted({configured, *(f * configured for f in DRAG_FACTORS)})
    filters = (config.heat.derivative_filter_s, *FILTERS_S)
    assert sorted(asked) == sorted(
        (filter_s, area) for filter_s in filters for area in areas
    )
    assert [one.filter_s for one in found] == [None, *FILTERS_S]
    for reading in found:
        (drive,) = reading.drives
        for by in drive.power_by.values():
            assert by.key == DRAG
            assert by.value.tolist() == areas
            assert by.power_w[:, 0].tolist() == areas
        assert drive.power_by.keys() == set(drive.corners)
        assert drive.inputs[0, 0, place] == configured

    asked.clear()
    near = read_as_guessed(config, frozenset({DRAG}), read, [0.5, 0.9])
    wanted = {one * of for one in NEAR_FACTORS for of in (0.5, 0.9)}
    assert {area for _, area in asked} == wanted | {configured}
    assert [one.filter_s for one in near] == [None]

    asked.clear()
    for of, guessed in (
        (config, frozenset({FILTER})),
        (guessing.config, frozenset({DRAG})),
    ):
        (plain,) = read_as_guessed(of, guessed, read)
        assert not plain.drives[0].power_by
    assert len(asked) == 2


def test_a_car_that_nobody_weighed_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_text("[vehicle]\nmass_kg = 1600.0  # kg, weighed\n")
    check_mass(path)

    path.write_text("[vehicle]\nmass_kg = 1600.0  # kg, typical\n")
    with pytest.raises(UsageError) as told:
        check_mass(path)
    assert str(told.value) == (
        f"{path}: vehicle.mass_kg is a typical value, and what forces show "
        "depends on it: weigh the car and take the word out of the line, or "
        "give --anyway"
    )


@pytest.mark.slow
def test_a_value_at_its_bound_is_no_success(
    target: Target, made: Callable[..., Drive]
) -> None:
    """Half the heat is missing: the disc would have to be too light."""
    drive = made(nodes=("disc",)).with_power_times(0.5)

    (match,) = match_drives(target.config, [Reading(None, [drive])])

    assert any("at its bound 0.7" in one for one in match.verdict)
    assert "run bstm gap" in headline(match)
    assert headline(match).startswith("FL: RMS on made from ")


def test_guesses_stand_in_comments_and_missing_lines(tmp_path: Path) -> None:
    path = tmp_path / "car.toml"
    path.write_text(
        "[vehicle]\n"
        "mass_kg = 1600.0  # kg, as driven; typical, replace\n"
        "drag_area_m2 = 0.7  # m2; typical, replace\n"
        "[[corner]]\n"
        "disc.mass_kg = 6.0  # kg, weighed\n"
    )

    assert guesses_of(path) == {CAR_MASS, DRAG, LEVEL, FILTER, *NODES_MS}

    path.write_text(
        "[[corner]]\n"
        "disc.mass_kg = 6.0  # kg, typical, replace\n"
        "[heat]\nderivative_filter_s = 0.3\n"
        "[cooling]\ns_per_s = [1.0]  # typically\n"
    )

    assert guesses_of(path) == {MASS, CAPACITY}


def test_beside_pads_and_fluid_the_search_says_the_level_alone(
    target: Target, made: Callable[..., Drive]
) -> None:
    """What those take must not come out as the shape of the table."""
    drive = made({LEVEL: 2.5}, profile=PROFILE, noise_k=0.5)
    guessing = replace(target, guessed=frozenset({LEVEL, *NODES_MS}))

    found = search(guessing, [Reading(None, [drive])])

    before, after = (
        one.config.cooling_of(one.corner) for one in (target, found.target)
    )
    factors = np.divide(after.s_per_s, before.s_per_s)
    assert factors == pytest.approx(2.5, rel=0.25)
    assert np.ptp(factors) < 1e-6
    assert (
        after.standstill_convection_fraction
        == before.standstill_convection_fraction
    )
    assert not found.noise
