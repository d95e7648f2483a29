"""Wear in the estimator: events in time, networks that follow, energy."""

from __future__ import annotations

import json
from array import array
from dataclasses import replace
from itertools import pairwise
from math import isnan, nan
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.estimate import WearLevel, WearSource
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.memory import StateError
from bstm_daemon.estimator.state import export_state, restore_state
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.model.thermal.regrid import heat_above_j
from bstm_daemon.model.wear.car import (
    KNOWN_DISTANCE_M,
    CarWear,
    exchange,
    keep_totals,
)
from bstm_daemon.model.wear.dose import DISTANCE, DOSE
from bstm_daemon.model.wear.pads import Change
from bstm_daemon.model.wear.table import WEAR_COLUMNS, wear_table
from bstm_daemon.roles import ROLE_INDEX

from ...energy_ledger import read_ledger  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.config.sections import Config, CornerConfig

SECOND = 1_000_000
SPEED, PRESSURE, NEW, WORN, LEFT = (
    ROLE_INDEX[name]
    for name in (
        *("vehicle_speed", "primary_pressure"),
        *("pads_new", "pad_worn_1mm", "pad_2mm_left"),
    )
)
PRESENT = dict.fromkeys((SPEED, PRESSURE, NEW, WORN, LEFT), 60 * SECOND)
AIR_K = 293.15

Sample = tuple[int, int, float]


@pytest.fixture(scope="module")
def car(
    make_car: Callable[..., Config], make_corner: Callable[..., CornerConfig]
) -> Config:
    """Return linings that lose about 2 mm a minute of braking."""
    pad = {"area_m2": 6.5e-3, "thickness_m": 0.009, "new_thickness_m": 0.011}
    # no configuration may say so
    rates = {"pad_wear_m3_j": 8e-11, "disc_wear_m3_j": 4e-11}
    car = make_car(
        make_corner("FL", pad=pad),
        make_corner("RL", pad=pad),
        wear={"model_follows": True},
    )
    return car.model_copy(update={"wear": car.wear.model_copy(update=rates)})


def braking(seconds: float, start_us: int = 0) -> list[Sample]:
    """Return 72 km/h against 5 bar, ten samples a second."""
    return [
        (at, role, value)
        for at in range(start_us, start_us + round(seconds * 1e6), 100_000)
        for role, value in ((SPEED, 20.0), (PRESSURE, 5e5))
    ]


def switch(role: int, on_us: int, end_us: int) -> list[Sample]:
    """Return a switch, a sample a second from 0 on, on from *on_us*."""
    return [(at, role, float(at >= on_us)) for at in range(0, end_us, SECOND)]


def feed(estimator: Estimator, samples: Sequence[Sample]) -> list[Any]:
    """Advance by *samples* in one call."""
    return estimator.advance(
        array("q", [s[0] for s in samples]),
        array("i", [s[1] for s in samples]),
        array("d", [s[2] for s in samples]),
    )


def rows(blocks: list[Any], estimator: Estimator, name: str) -> np.ndarray:
    """Return wear columns and nodes of *name* at all publications."""
    found = []
    for block in blocks:
        for group, output in zip(estimator.groups, block.outputs, strict=True):
            if name not in group.corners:
                continue
            states = np.array(output).reshape(
                len(block.times_us), len(group.corners), group.size
            )[:, group.corners.index(name), : len(group.state_names)]
            dose = states[:, group.state_names.index(DOSE)]
            table = wear_table(block.wear[name], dose)
            found.append(np.hstack([table, states]))
    return np.concatenate(found)


def life() -> list[Sample]:
    """Return 5 min of braking with new pads, both indicators on the way."""
    end = 300 * SECOND
    samples = braking(300.0)
    samples += switch(NEW, 20_300_000, end)
    samples += switch(WORN, 50 * SECOND, end)
    samples += switch(LEFT, 250 * SECOND, end)
    return sorted(samples)


def test_a_life_of_linings(car: Config) -> None:
    """New, first and second indicator, each seen by the front axle only."""
    estimator = Estimator(car, PRESENT, history_known=True)

    blocks = feed(estimator, life())
    thickness = rows(blocks, estimator, "FL")[:, 0] * 1e3

    # publications are every 0.1 s; an event counts with its second sample
    assert thickness[0] == pytest.approx(9.0, abs=0.01)
    assert thickness[225] == pytest.approx(11.0, abs=0.05)
    assert thickness[505:515] == pytest.approx(10.0, abs=0.05)
    assert thickness[2510] == pytest.approx(2.0, abs=0.05)
    assert (np.diff(thickness[230:500]) <= 0.0).all()
    assert estimator.wear.pads["FL"].law.source is WearSource.SECOND_INDICATOR
    assert estimator.wear.pads["RL"].law.source is WearSource.CONFIGURED


def test_the_table_agrees_with_the_law(car: Config) -> None:
    estimator = Estimator(car, PRESENT, history_known=True)
    blocks = feed(estimator, life())

    for block in blocks:
        for begin, law in block.wear["FL"]:
            doses = np.linspace(0.0, 3e6, 7)
            table = wear_table(((0, law),), doses)
            assert begin >= 0
            for dose, line in zip(doses.tolist(), table, strict=True):
                # to the bit: frames and tables show the same
                assert line.tolist() == [
                    law.thickness_at_m(dose),
                    law.std_at_m(dose),
                    law.disc_loss_at_m(dose),
                ]
    names = "pad_thickness_m", "pad_thickness_std_m", "disc_loss_m"
    assert names == WEAR_COLUMNS


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
@given(cuts=st.lists(st.integers(1, 6500), max_size=6))
def test_how_a_stream_is_cut_changes_no_bit(
    car: Config, cuts: list[int]
) -> None:
    """Events and exchanged networks included."""
    whole = Estimator(car, PRESENT, history_known=True)
    pieces = Estimator(car, PRESENT, history_known=True)
    samples = life()
    expected = rows(feed(whole, samples), whole, "FL")

    blocks = []
    edges = [0, *sorted({c for c in cuts if c < len(samples)}), len(samples)]
    for begin, end in pairwise(edges):
        blocks += feed(pieces, samples[begin:end])

    found = rows(blocks, pieces, "FL")
    # not compared as bytes: nobody could read the difference
    assert found.shape == expected.shape
    assert np.array_equal(found, expected)
    assert pieces.wear.export() == whole.wear.export()


@pytest.mark.parametrize("cut_s", [10.0, 20.5, 59.0, 61.0, 120.0, 260.0])
def test_a_restart_changes_no_bit(car: Config, cut_s: float) -> None:
    whole = Estimator(car, PRESENT, history_known=True)
    samples = life()
    feed(whole, samples)
    first = Estimator(car, PRESENT, history_known=True)
    before = [s for s in samples if s[0] < cut_s * 1e6]
    feed(first, before)
    text = json.dumps(export_state(first), allow_nan=False)

    second = Estimator(car, PRESENT)
    restore_state(second, json.loads(text), resume=True)
    feed(second, samples[len(before) :])

    assert second.state("FL") == whole.state("FL")
    assert second.wear.export() == whole.wear.export()
    built = second.programs["FL"].floats
    assert built == whole.programs["FL"].floats


def test_the_networks_follow(car: Config) -> None:
    """Thinner slabs conduct better, a lighter disc holds less."""
    estimator = Estimator(car, PRESENT, history_known=True)
    new = estimator.programs["FL"].network

    feed(estimator, [*braking(125.0), (125 * SECOND, TICK, 0.0)])

    old = estimator.programs["FL"].network
    law = estimator.wear.pads["FL"].law
    dose_j = estimator.state("FL")[DOSE]
    thickness_m = estimator.wear.built_corner("FL").pad
    assert thickness_m is not None
    # followed at 120 s: five seconds of wear behind
    assert thickness_m.thickness_m == pytest.approx(
        law.thickness_at_m(dose_j), abs=5e-4
    )
    ratio = 0.009 / thickness_m.thickness_m
    assert ratio > 1.1
    assert old.link("pad_1-pad_2").conductance_w_k == pytest.approx(
        ratio * new.link("pad_1-pad_2").conductance_w_k
    )
    lost_kg = 0.5 * law.disc_loss_at_m(dose_j) * 0.085 * 7200.0
    assert old.node("disc").capacity_j_k == pytest.approx(
        7.5 - lost_kg, abs=0.05 * lost_kg
    )
    assert lost_kg > 0.05


def test_energy_closes_with_what_is_worn(car: Config) -> None:
    """Generated = given off + stored + left with the dust, to rounding."""
    estimator = Estimator(car, PRESENT, history_known=True)
    (batch, names) = estimator.batches[0]
    member = names.index("FL")
    start = estimator.state("FL")
    before_j = heat_above_j(
        estimator.programs["FL"].network, list(start.values()), AIR_K
    )

    feed(estimator, [*braking(185.0), (185 * SECOND, TICK, 0.0)])

    program = estimator.programs["FL"]
    state = list(estimator.state("FL").values())
    wide = batch.ledger_width
    energies = batch.ledger[member * wide : (member + 1) * wide]
    ledger = read_ledger(program, energies, state, state)
    stored_j = heat_above_j(program.network, state, AIR_K) - before_j
    worn_j = estimator.wear.worn_heat_j["FL"]
    assert worn_j > 1e4
    left_j = sum(ledger.given_off.values()) + worn_j
    assert ledger.generated - left_j == pytest.approx(
        stored_j, abs=1e-9 * ledger.generated
    )


@pytest.fixture
def still(car: Config, make_car: Callable[..., Config]) -> Config:
    """Return the same car with what ``model_follows`` is by default."""
    default = make_car().wear.model_follows
    wear = car.wear.model_copy(update={"model_follows": default})
    return car.model_copy(update={"wear": wear})


def test_without_following_the_model_stays(still: Config) -> None:
    """Wear is estimated, and comes to its warning, all the same."""
    estimator = Estimator(still, PRESENT, history_known=True)
    first = estimator.programs["FL"]

    feed(estimator, [*braking(125.0), (125 * SECOND, TICK, 0.0)])

    assert estimator.programs["FL"] is first
    assert (
        estimator.wear.pads["FL"].law.thickness_at_m(
            estimator.state("FL")[DOSE]
        )
        < 0.008
    )
    worn = estimator.wear
    law = worn.pads["FL"].law
    levels = [
        worn.estimate("FL", law, worn_m / law.rate_m_j, 1e5).level
        for worn_m in (1e-3, 5e-3, 8e-3)
    ]
    assert levels == [WearLevel.OK, WearLevel.CHECK, WearLevel.WORN]


def test_a_state_of_worn_networks_without_following(
    car: Config, still: Config
) -> None:
    """Temperatures and wear go on, in networks as configured."""
    worn = Estimator(car, PRESENT, history_known=True)
    feed(worn, [*braking(65.0), (65 * SECOND, TICK, 0.0)])
    document = json.loads(json.dumps(export_state(worn)))
    estimator = Estimator(still, PRESENT)
    configured = estimator.programs["FL"].floats

    restore_state(estimator, document, resume=True)

    assert worn.programs["FL"].floats != configured
    assert estimator.programs["FL"].floats == configured
    assert estimator.state("FL") == worn.state("FL")
    assert estimator.wear.pads["FL"].law == worn.wear.pads["FL"].law


def test_a_disc_keeps_most_of_its_mass(car: Config) -> None:
    """A fifth, however much the estimate says it has lost."""
    estimator = Estimator(car, PRESENT, history_known=True)
    disc = car.corner[0].disc
    assert disc is not None

    refit = estimator.wear.refit("FL", 1e9)

    assert refit is not None
    assert refit.corner.disc is not None
    assert refit.corner.disc.mass_kg == pytest.approx(0.8 * disc.mass_kg)


def test_new_linings_are_as_warm_as_the_air(car: Config) -> None:
    estimator = Estimator(car, PRESENT, history_known=True)
    samples = braking(60.5) + switch(NEW, 55 * SECOND, 60_500_000)

    feed(estimator, sorted(samples))

    # half a second of braking after the exchange
    assert estimator.state("FL")["pad_back"] == pytest.approx(AIR_K, abs=1.0)
    assert estimator.state("RL")["pad_back"] > AIR_K + 5.0


def test_nothing_follows_temperatures_that_are_no_numbers(
    car: Config,
) -> None:
    estimator = Estimator(car, PRESENT, history_known=True)
    (batch, _), *_ = estimator.batches
    nodes = len(batch.programs[0].network.nodes)
    batch.state[:nodes] = array("d", [nan] * nodes)

    lost_j = exchange(batch, 0, batch.programs[0], Change.WORN, AIR_K)

    assert lost_j == 0.0
    assert all(map(isnan, batch.state[:nodes]))


def test_a_dose_that_is_no_number_is_no_wear(car: Config) -> None:
    estimator = Estimator(car, PRESENT, history_known=True)

    assert estimator.wear.refit("FL", nan) is None


def test_one_sample_is_no_switch(car: Config) -> None:
    estimator = Estimator(car, PRESENT, history_known=True)
    samples = [
        *braking(10.0),
        *((at * SECOND, NEW, float(at == 5)) for at in range(10)),
    ]

    feed(estimator, sorted(samples))

    assert estimator.wear.pads["FL"].law.source is WearSource.CONFIGURED


def test_columns_and_lists_are_heard_alike(car: Config) -> None:
    """NumPy columns of a replay, arrays of the live service."""
    samples = life()
    listed = Estimator(car, PRESENT, history_known=True)
    feed(listed, samples)
    columns = Estimator(car, PRESENT, history_known=True)

    columns.advance(
        np.array([s[0] for s in samples], np.int64),
        np.array([s[1] for s in samples], np.int32),
        np.array([s[2] for s in samples], np.float64),
    )

    assert columns.wear.export() == listed.wear.export()


def test_remaining_distance_and_level(car: Config) -> None:
    """Known after 50 km; judged by two standard deviations."""
    wear = Estimator(car, PRESENT).wear
    law = wear.pads["FL"].law
    dose_j = 2e-3 / law.rate_m_j

    early = wear.estimate("FL", law, dose_j, 49_000.0)
    late = wear.estimate("FL", law, dose_j, 100_000.0)
    end = wear.estimate("FL", law, 3.6 * dose_j, 400_000.0)

    assert np.isnan(early.remaining_distance_m)
    known = wear.estimate("FL", law, dose_j, KNOWN_DISTANCE_M)
    assert known.remaining_distance_m == pytest.approx(125_000.0)
    assert KNOWN_DISTANCE_M == 50_000.0
    # 7 mm left, 5 of them to use, 2 mm in 100 km
    assert late.remaining_distance_m == pytest.approx(250_000.0)
    assert late.level is WearLevel.OK
    assert wear.estimate("FL", law, 2 * dose_j, 1e5).level is WearLevel.CHECK
    assert end.level is WearLevel.WORN
    assert end.remaining_distance_m == 0.0
    for deviations, level in ((1.99, "CHECK"), (2.05, "OK")):
        thickness_m = car.wear.limit_m + deviations * law.thickness_std_m
        near = replace(law, thickness_m=thickness_m)
        found = wear.estimate("FL", near, law.dose_j, 0.0)
        assert found.level is WearLevel[level]


def test_remaining_distance_counts_from_the_new_pads(car: Config) -> None:
    wear = CarWear(car, PRESENT)
    pad = wear.pads["FL"]
    pad.happened("pads_new", 5e9, 1e6, seen=True)
    dose_j = 5e9 + 2e-3 / pad.law.rate_m_j

    found = wear.estimate("FL", pad.law, dose_j, 1e6 + 100_000.0)

    # 2 mm of 11 in 100 km, down to 2 mm
    assert found.remaining_distance_m == pytest.approx(350_000.0)


def noted(wear: CarWear, role: int, values: Sequence[float]) -> None:
    """Let *wear* have two samples of each of *values*, a second apart."""
    twice = [value for value in values for _ in range(2)]
    times = [at * SECOND for at in range(len(twice))]
    wear.note(times, [role] * len(twice), twice)


def test_a_switch_is_on_above_a_half_and_both_corners_hear_it(
    car: Config,
) -> None:
    both = car.wear.model_copy(update={"indicators": "all"})
    wear = CarWear(car.model_copy(update={"wear": both}), PRESENT)
    noted(wear, WORN, [0.4, 0.6])

    assert wear.laws([], lambda *_: (0.0, 0.0)) == {}
    laws = wear.laws([0, 10 * SECOND], lambda *_: (0.0, 0.0))

    assert wear.export()["levels"]["pad_worn_1mm"] is True
    for name in ("FL", "RL"):
        lowest_m = [law.lowest_m for _, law in laws[name]]
        # off: above 10 mm, which the entered 9 mm contradict; on: below
        assert lowest_m == [0.0, 0.0, 0.0]
        assert wear.pads[name].law.highest_m == pytest.approx(0.010)
        assert [at for at, _ in laws[name]] == [0, 1, 1]


def test_the_last_events_are_kept(car: Config) -> None:
    """64 of them: more come from a wrong clock."""
    wear = CarWear(car, PRESENT)
    noted(wear, NEW, [0.0, 1.0] * 40)

    laws = wear.laws([0, 1000 * SECOND], lambda *_: (0.0, 0.0))

    assert len(laws["FL"]) == 1 + 64
    assert len(laws["RL"]) == 1


def test_a_disc_that_was_entered_worn_has_its_mass(car: Config) -> None:
    """The configured mass is that of the disc as it was measured."""
    corner = car.corner[0]
    assert corner.disc is not None
    worn = corner.disc.model_copy(update={"worn_m": 5e-4})
    corner = corner.model_copy(update={"disc": worn})

    wear = CarWear(car.model_copy(update={"corner": [corner]}), PRESENT)

    built = wear.built_corner("FL").disc
    assert built is not None
    assert built.mass_kg == worn.mass_kg


def test_a_corner_that_was_not_saved_keeps_none_from_its_own(
    car: Config,
) -> None:
    worn = CarWear(car, PRESENT)
    for pad in worn.pads.values():
        pad.happened("pads_new", 1e6, 0.0, seen=True)

    fresh = CarWear(car, PRESENT).restored(worn.export(), {"RL": 2e6})

    assert fresh.pads["FL"].law.source is WearSource.CONFIGURED
    assert fresh.pads["RL"].law == worn.pads["RL"].law


def test_totals_outlive_unknown_temperatures() -> None:
    names = ["disc", DOSE, DISTANCE]
    fresh = array("d", [300.0, 0.0, 0.0])

    keep_totals(fresh, names, array("d", [nan, 5.0, 7.0]))
    assert [*fresh] == [300.0, 5.0, 7.0]
    keep_totals(fresh, names, array("d", [400.0, nan, -0.5]))
    assert [*fresh] == [300.0, 5.0, 7.0]
    assert (DOSE, DISTANCE) == ("wear_dose_j", "wear_distance_m")


@pytest.mark.parametrize(
    "wear",
    [{}, [], {"levels": {}}, {"levels": None, "corners": {}}, 5],
)
def test_wear_that_is_none_is_refused_whole(car: Config, wear: Any) -> None:
    estimator = Estimator(car, PRESENT)
    document = export_state(Estimator(car, PRESENT)) | {"wear": wear}
    before = estimator.state("FL")

    with pytest.raises(StateError, match=r"^wear"):
        restore_state(estimator, document, resume=False)

    assert estimator.state("FL") == before


def test_a_state_from_before_there_was_wear(car: Config) -> None:
    """Begins as configured, with its temperatures."""
    document = export_state(Estimator(car, PRESENT, initial_k=350.0))
    del document["wear"]
    estimator = Estimator(car, PRESENT)

    restore_state(estimator, document, resume=False)

    assert estimator.state("FL")["disc"] == pytest.approx(350.0)
    assert estimator.wear.pads["FL"].law.thickness_m == pytest.approx(0.009)
