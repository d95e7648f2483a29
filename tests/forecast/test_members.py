"""Members of an ensemble: around the estimate, and of its structure."""

from __future__ import annotations

from array import array
from dataclasses import replace
from itertools import chain
from math import isnan, nan
from statistics import fmean, stdev

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast.members import Ensemble, Heat, Spread
from bstm_daemon.model.thermal.program import Program, same_structure


@pytest.fixture(scope="module")
def corner() -> Program:
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    return compile_corner(config, config.corner[0])


def test_members_share_the_structure_and_keep_the_mean(
    corner: Program,
) -> None:
    ensemble = Ensemble(corner, 64, Spread())
    assert same_structure([corner, *ensemble.programs])

    for i, value in enumerate(corner.floats):
        drawn = [member.floats[i] for member in ensemble.programs]
        assert fmean(drawn) == pytest.approx(value, rel=1e-9)
        assert min(drawn, default=0.0) >= 0.0 or value < 0.0


@pytest.mark.parametrize(
    ("link", "axis"),
    [
        ("fluid_static", "fluid_loss"),
        ("fluid_dynamic", "fluid_loss"),
        ("disc_convection", "disc_loss"),
        ("shim", "resistance"),
        ("pad_3-pad_4", "lining"),
        ("disc_pad_radiation", "exchange"),
    ],
)
def test_each_conductance_has_the_spread_of_its_kind(
    corner: Program, link: str, axis: str
) -> None:
    spread = Spread()
    ensemble = Ensemble(corner, 64, spread)
    names = [one.name for one in corner.network.links]
    place = len(corner.network.nodes) + names.index(link)
    nominal = corner.floats[place]

    drawn = [member.floats[place] / nominal for member in ensemble.programs]

    assert stdev(drawn) == pytest.approx(getattr(spread, axis), rel=0.15)


def test_states_lie_around_the_estimate_by_what_is_told(
    corner: Program,
) -> None:
    """The fluid's deviation is what fluid_deviation_k says."""
    ensemble = Ensemble(corner, 64, Spread())
    wide = len(corner.state_names)
    state = [400.0 + i for i in range(wide)]

    for factor in (1.0, 2.0):
        states = ensemble.states(state, 290.0, factor)
        fluid = states[ensemble.fluid :: wide].tolist()
        told = ensemble.fluid_deviation_k(state[ensemble.fluid], 290.0, factor)
        assert fmean(fluid) == pytest.approx(state[ensemble.fluid])
        assert stdev(fluid) == pytest.approx(told, rel=0.15)


def test_without_spread_all_members_are_the_estimate(corner: Program) -> None:
    ensemble = Ensemble(corner, 8, Spread().scaled(0.0))
    state = [350.0] * len(corner.state_names)

    assert set(ensemble.states(state, 290.0, 2.0)) == {350.0}
    assert {m.floats.tobytes() for m in ensemble.programs} == {
        corner.floats.tobytes()
    }


def test_members_follow_another_network_of_the_corner(corner: Program) -> None:
    """The same draws around the numbers of a worn lining."""
    first = Ensemble(corner, 8, Spread())
    worn = replace(corner, floats=array("d", [2.0 * x for x in corner.floats]))

    second = Ensemble(worn, 8, Spread())

    assert second.draws == first.draws
    for old, new in zip(first.programs, second.programs, strict=True):
        assert new.floats.tolist() == [2.0 * x for x in old.floats]


def test_air_has_its_spread(corner: Program) -> None:
    """1.5 K, twice as much where degraded."""
    ensemble = Ensemble(corner, 64, Spread())

    for factor in (1.0, 2.0):
        air_k = ensemble.ambients_k(290.0, factor)
        assert fmean(air_k) == pytest.approx(290.0)
        assert stdev(air_k) == pytest.approx(1.5 * factor, rel=0.1)


def test_the_spread_that_is_shipped(corner: Program) -> None:
    """What docs/risk.md says an estimate does not know."""
    ensemble = Ensemble(corner, 8, Spread())

    def deviation_k(fluid_k: float, factor: float) -> float:
        return ensemble.fluid_deviation_k(fluid_k, 290.0, factor)

    # 3 % of the heat and 2 % of its own, 1 K at least
    assert deviation_k(290.0, 1.0) == pytest.approx(1.0)
    assert deviation_k(390.0, 1.0) == pytest.approx(14.0**0.5)
    assert deviation_k(390.0, 2.0) == pytest.approx(2.0 * 14.0**0.5)


def test_a_duty_is_as_uncertain_as_start_power_and_model(
    corner: Program,
) -> None:
    """15 % of the power, twice as much where degraded, 14 % of the model."""
    ensemble = Ensemble(corner, 8, Spread())

    for factor in (1.0, 2.0):
        start_k = ensemble.fluid_deviation_k(60.0, 0.0, factor)
        assert ensemble.duty_deviation_k(60.0, 0.0, factor) == start_k
        both_k = ensemble.duty_deviation_k(60.0, 100.0, factor)
        power_k = 15.0 * factor
        model_k = (
            100.0 * (0.04**2 * 2 + 0.05**2 * 2 + 0.1**2 + 0.015**2) ** 0.5
        )
        assert both_k**2 == pytest.approx(start_k**2 + power_k**2 + model_k**2)


def test_no_member_starts_outside_its_range(corner: Program) -> None:
    """The fluid as it is; no node hotter, with spread and without."""
    ensemble = Ensemble(corner, 64, Spread())
    wide, count = len(corner.state_names), len(corner.network.nodes)
    fluid = ensemble.fluid
    for hottest in (0, fluid, count - 2):
        state = [300.0 + 3.0 * i for i in range(wide)]
        state[hottest] = 420.0
        for factor in (1.0, 2.0):
            heat = ensemble.heat(state, 295.0, factor)
            least_k, most_k = ensemble.range_k(heat)
            states = ensemble.states(state, 295.0, factor)
            starts = [states[i : i + count] for i in range(0, 64 * wide, wide)]
            assert least_k == pytest.approx([one[fluid] for one in starts])
            assert most_k == pytest.approx([max(one) for one in starts])
            top = ensemble.highest(heat)
            for place, rise_k in enumerate(top.rises_k):
                top_k = top.ambient_k + rise_k + 1e-9
                assert max(one[place] for one in starts) <= top_k
            assert top.ambient_k == pytest.approx(
                max(ensemble.ambients_k(295.0, factor))
            )

    unknown = ensemble.heat([nan] * wide, 295.0, 1.0)
    assert all(map(isnan, chain(*ensemble.range_k(unknown))))
    assert not ensemble.is_below(unknown, heat)


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_a_start_is_below_where_no_draw_makes_it_hotter(
    corner: Program, factor: float
) -> None:
    """By the farthest draws of the heat and of the fluid alone."""
    ensemble = Ensemble(corner, 64, Spread())
    heat, fluid = (
        factor * max(abs(draw[axis]) for draw in ensemble.draws)
        for axis in ("heat", "fluid")
    )
    shared = len(ensemble.heat([300.0] * ensemble.nodes, 290.0, factor).own_k)

    def start(rise_k: float, own_k: float) -> Heat:
        return Heat(factor, 290.0, [rise_k] * ensemble.nodes, [own_k] * shared)

    most_k = (1.0 - 0.03 * heat) * 10.0 / fluid
    for own_k, is_below in ((0.99 * most_k, True), (1.01 * most_k, False)):
        for way in (own_k, -own_k):
            found = ensemble.is_below(start(90.0, 0.0), start(100.0, way))
            assert found is is_below
