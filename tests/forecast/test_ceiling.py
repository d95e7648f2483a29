"""The ceiling of a parked corner: never below what a member finds."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import cache
from math import inf, isnan, nan
from operator import le
from typing import TYPE_CHECKING

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast.ceiling import (
    KEPT,
    MARGIN_K,
    Ceilings,
    heated_share,
    is_ordered,
)
from bstm_daemon.forecast.corner_march import CornerMarch, Range, Start
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
    HORIZON_S,
    Conditions,
    Job,
    _inputs,
    parked_course,
)
from bstm_daemon.forecast.members import Ensemble, Spread
from bstm_daemon.model.effects.catalogue import effect_names
from bstm_daemon.model.risk.vaporisation import Boiling
from bstm_daemon.model.thermal.network import (
    Link,
    Source,
    difference,
    mean,
    radiation,
    value,
)
from bstm_daemon.model.thermal.program import compile_network
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.native.loader import load_kernel

if TYPE_CHECKING:
    from bstm_daemon.forecast.members import Heat
    from bstm_daemon.model.thermal.network import Network
    from bstm_daemon.model.thermal.program import Program

AIR_K = 288.15
BOILING_K = 420.0
KERNEL = load_kernel()
needs_kernel = pytest.mark.skipif(KERNEL is None, reason="slow in Python")

UNORDERED = {
    "ambient_heat_soak",
    "engine_heat",
    "fluid_exchange",
    "hub_heat",
    "layer_opening",
    "pad_pyrolysis",
}
"""Effects with a part that depends on more than temperatures beside it."""


@cache
def corner(structure: str, place: int, effects: tuple[str, ...]) -> Program:
    """Return the network of a corner of the example car with *effects*."""
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    thermal = config.thermal.model_copy(update={"structure": structure})
    config = config.model_copy(
        update={
            "thermal": thermal,
            "effect": [EffectConfig(name=name) for name in effects],
        }
    )
    return compile_corner(config, config.corner[place])


@cache
def members(structure: str, place: int, effects: tuple[str, ...]) -> Ensemble:
    return Ensemble(corner(structure, place, effects), 8, Spread())


def thesis() -> Network:
    return corner("thesis", 0, ()).network


def state_of(program: Program, nodes_k: list[float]) -> list[float]:
    """Return a state with *nodes_k*; the memories are as at first."""
    net = program.network
    return nodes_k + [memory.initial for memory in net.memories]


@pytest.mark.slow
@needs_kernel
@settings(max_examples=40, deadline=None)
@given(
    structure=st.sampled_from(["thesis", "extended"]),
    place=st.integers(0, 3),
    effects=st.lists(
        st.sampled_from(sorted(set(effect_names()) - UNORDERED)),
        max_size=2,
        unique=True,
    ),
    air_k=st.floats(250.0, 315.0),
    factor=st.sampled_from([1.0, 2.0]),
    data=st.data(),
)
def test_no_member_exceeds_it(
    structure: str,
    place: int,
    effects: list[str],
    air_k: float,
    factor: float,
    data: st.DataObject,
) -> None:
    """From any state below it, also one that no drive leads to."""
    key = structure, place, tuple(sorted(effects))
    try:
        program = corner(*key)
    except ConfigError:
        assume(False)
    ensemble = members(*key)
    count = len(program.network.nodes)
    hot = st.floats(air_k - 5.0, 500.0)
    top = data.draw(st.lists(hot, min_size=count, max_size=count))
    shares = data.draw(
        st.lists(st.floats(0.0, 1.0), min_size=count, max_size=count)
    )
    below = [
        air_k - 5.0 + share * (kelvin - air_k + 5.0)
        for share, kelvin in zip(shares, top, strict=True)
    ]
    colder_k = air_k - data.draw(st.floats(0.0, 3.0))
    above = ensemble.heat(state_of(program, top), air_k, factor)
    # with the spread of the members, and without any above them all
    ceilings = [Ceilings(ensemble), Ceilings(ensemble)]
    for ceiling, heat in zip(
        ceilings, (above, ensemble.highest(above)), strict=True
    ):
        state = [heat.ambient_k + rise_k for rise_k in heat.rises_k]
        course = parked_course(
            *(ensemble, KERNEL, state_of(program, state)),
            *(heat.ambient_k, heat.factor),
        )
        ceiling.keep(heat, course.peaks_k(HORIZON_S), 0.0)

    for nodes_k, now_k in ((top, air_k), (below, air_k), (below, colder_k)):
        state = state_of(program, nodes_k)
        course = parked_course(ensemble, KERNEL, state, now_k, factor)
        peaks_k = course.peaks_k(HORIZON_S)
        heat = ensemble.heat(state, now_k, factor)
        for ceiling in ceilings:
            found = ceiling.lowest(heat, 0.0)
            # an error of the fluid that is large for its rise is the plates'
            assert found is not None or nodes_k is below
            if found is not None:
                assert all(map(le, peaks_k, found.peaks_k))
        # the hottest node, without a march
        _, most_k = ensemble.range_k(heat)
        assert all(map(le, peaks_k, [one + MARGIN_K for one in most_k]))


FURTHER_HEAT = {
    *("ambient_heat_soak", "engine_heat", "hub_heat", "pad_pyrolysis"),
    "residual_drag",
    *("disc_capacity_hot", "pad_conductivity", "wet_disc"),
}
"""Effects with sources beside the brake."""


def duty_peaks_k(
    ensemble: Ensemble, state: list[float], duty: Conditions, factor: float
) -> list[float]:
    """Return the highest fluid of each member on *duty* with its power."""
    width = factor * ensemble.spread.duty_heat
    air_k = ensemble.ambients_k(duty.ambient_k, factor)
    own = [
        duty._replace(
            ambient_k=air,
            power_w=duty.power_w * max(1.0 + width * draw["duty_heat"], 0.0),
        )
        for air, draw in zip(air_k, ensemble.draws, strict=True)
    ]
    job = Job(
        ensemble.batch(KERNEL),
        ensemble.fluid,
        ensemble.states(state, duty.ambient_k, factor),
        _inputs(own),
        DUTY_STEPS,
    )
    job.advance(len(DUTY_STEPS))
    return job.course().peaks_k(HORIZON_S)


@needs_kernel
@settings(max_examples=40, deadline=None)
@given(
    structure=st.sampled_from(["thesis", "extended"]),
    place=st.integers(0, 3),
    effects=st.lists(
        st.sampled_from(sorted(set(effect_names()) - FURTHER_HEAT)),
        max_size=2,
        unique=True,
    ),
    factor=st.sampled_from([1.0, 2.0]),
    duty=st.builds(
        Conditions,
        ambient_k=st.floats(250.0, 315.0),
        speed_ms=st.floats(0.0, 50.0),
        pressure_pa=st.floats(-1e5, 8e6),
        brake_on=st.floats(0.0, 1.0),
        power_w=st.floats(0.0, 60.0),
    ),
    data=st.data(),
)
def test_no_member_on_duty_exceeds_its_heat_over_the_fluid(
    structure: str,
    place: int,
    effects: list[str],
    factor: float,
    duty: Conditions,
    data: st.DataObject,
) -> None:
    key = structure, place, tuple(sorted(effects))
    try:
        program = corner(*key)
    except ConfigError:
        assume(False)
    ensemble = members(*key)
    count = len(program.network.nodes)
    hot = st.floats(duty.ambient_k - 5.0, 500.0)
    nodes_k = data.draw(st.lists(hot, min_size=count, max_size=count))
    state = state_of(program, nodes_k)

    peaks_k = duty_peaks_k(ensemble, state, duty, factor)
    heat = ensemble.heat(state, duty.ambient_k, factor)
    most_k = Ceilings(ensemble).on_duty_k(heat, duty.power_w, HORIZON_S)
    assert max(peaks_k) <= most_k < inf


@needs_kernel
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_a_fluid_that_keeps_all_heat_comes_close_to_its_bound(
    factor: float,
) -> None:
    """By 1 K and the hottest start; with 3 % less heat the bound is wrong."""
    net = thesis()
    net = replace(
        net,
        nodes=tuple(
            node
            if node.name == "fluid"
            else replace(node, capacity_j_k=1e-3 * node.capacity_j_k)
            for node in net.nodes
        ),
        links=tuple(
            replace(link, conductance_w_k=0.0)
            if "ambient" in {link.a, link.b}
            else link
            for link in net.links
        ),
    )
    program = compile_network(net)
    spread = Spread()._replace(heat=0.0, fluid=0.0, fluid_floor_k=0.0)
    ensemble = Ensemble(program, 8, spread._replace(fluid_capacity=0.0))
    state = state_of(program, [AIR_K] * len(net.nodes))
    duty = Conditions(AIR_K, 20.0, 1e6, 1.0, 150.0)

    peaks_k = duty_peaks_k(ensemble, state, duty, factor)
    ceilings = Ceilings(ensemble)
    heat = ensemble.heat(state, AIR_K, factor)
    most_k = ceilings.on_duty_k(heat, 150.0, HORIZON_S)
    assert max(peaks_k) > AIR_K + 120.0
    assert max(peaks_k) <= most_k
    least_k = ceilings.on_duty_k(heat, 0.97 * 150.0, HORIZON_S)
    width_k = max(ensemble.ambients_k(0.0, factor))
    assert max(peaks_k) > least_k - MARGIN_K - width_k


def test_what_no_number_is_bounds_nothing() -> None:
    ceilings = Ceilings(members("thesis", 0, ()))
    heat = at(members("thesis", 0, ()), 330.0)
    heat.rises_k[1] = nan
    assert isnan(ceilings.on_duty_k(heat, 0.0, HORIZON_S))


@pytest.mark.slow
def test_what_else_may_heat() -> None:
    """Unbounded wherever it does not follow from the parts one by one."""
    found = {}
    for effect in effect_names():
        with suppress(ConfigError):
            found[effect] = heated_share(
                corner("extended", 0, (effect,)).network
            )
    assert {name for name, share in found.items() if share == inf} == (
        FURTHER_HEAT & found.keys()
    )
    assert heated_share(thesis()) == pytest.approx(1.0)

    power, table = value("brake_power_w"), Table(0.0, 1.0, (0.5, 0.2))
    negative = Table(0.0, 1.0, (0.5, -0.2))
    sources = {
        0.1: Source("more", "fluid", 0.2, (power, value("brake_on", table))),
        0.0: Source("taken", "fluid", -0.2, (power,)),
    }
    for more, source in sources.items():
        share = heated_share(thesis().with_source(source))
        assert share == pytest.approx(1.0 + more)
    for factors in (
        (),
        (power, power),
        (value("brake_on", table),),
        (power, value("brake_on")),
        (power, value("brake_on", negative)),
        (difference("brake_power_w", "ambient_k"),),
    ):
        source = Source("new", "fluid", -1.0, factors)
        assert heated_share(thesis().with_source(source)) == inf
    for one in (difference("disc", "fluid"), value("pressure_pa")):
        link = Link("new", "disc", "fluid", 1.0, (one,))
        assert heated_share(thesis().with_link(link)) == inf
    filled = thesis().edit_node(
        "fluid", lambda n: replace(n, factors=(value("brake_on"),))
    )
    assert heated_share(filled) == inf


def at(ensemble: Ensemble, kelvin: float, air_k: float = AIR_K) -> Heat:
    """Return all nodes at *kelvin*."""
    nodes = len(ensemble.program.network.nodes)
    return ensemble.heat([kelvin] * nodes, air_k, 1.0)


def test_it_lasts_while_nothing_is_hotter() -> None:
    ensemble = members("thesis", 0, ())
    ceiling = Ceilings(ensemble)
    heat = at(ensemble, 330.0)
    assert ceiling.lowest(heat, 0.0) is None

    ceiling.keep(heat, [340.0, 350.0], 60.0)
    found = ceiling.lowest(heat, 0.0)
    top_k = 350.0 + MARGIN_K
    assert found == (heat, [340.0 + MARGIN_K, top_k], top_k, 60.0)
    assert ceiling.lowest(at(ensemble, 320.0), 0.0) is found
    assert ceiling.lowest(at(ensemble, 320.0, AIR_K - 1.0), 0.0) is found
    assert ceiling.lowest(at(ensemble, 331.0), 0.0) is None
    assert ceiling.lowest(at(ensemble, 330.0, AIR_K + 1.0), 0.0) is None
    assert ceiling.lowest(heat._replace(factor=2.0), 0.0) is None
    assert ceiling.lowest(at(ensemble, nan), 0.0) is None

    # the lowest one, of those used last
    higher = at(ensemble, 400.0)
    ceiling.keep(higher, [400.0], 90.0)
    assert ceiling.lowest(heat, 0.0) is found
    assert ceiling.lowest(at(ensemble, 380.0), 0.0) is not found
    # the one that was used last, where it is low enough
    assert ceiling.lowest(heat, 500.0) is not found
    assert ceiling.lowest(heat, 380.0) is found
    for i in range(2 * KEPT):
        assert ceiling.lowest(heat, 0.0) is found
        ceiling.keep(at(ensemble, 401.0 + i), [401.0 + i], 0.0)
    assert ceiling.lowest(at(ensemble, 380.0), 0.0) is not None
    assert len(ceiling._kept) == KEPT
    # what another one makes useless goes
    ceiling.keep(at(ensemble, 900.0), [300.0], 0.0)
    assert len(ceiling._kept) == 1
    ceiling.keep(heat, [nan], 0.0)
    assert len(ceiling._kept) == 1
    ceiling.clear()
    assert ceiling.lowest(heat, 0.0) is None


@needs_kernel
def test_a_march_bounds_later_ones_and_one_is_made_for_it() -> None:
    """From a hotter state by the largest factor that is of use."""
    ensemble = members("thesis", 0, ())
    march = CornerMarch(ensemble, KERNEL)
    program = ensemble.program
    # vapour is possible at any temperature, so that time counts
    boiling = Boiling([200.0, *(BOILING_K + i for i in range(999))])
    nodes = len(program.network.nodes)

    def start(kelvin: float) -> Start:
        state = state_of(program, [kelvin] * nodes)
        return Start(state, Conditions(AIR_K), 1.0, boiling)

    def range_k(start: Start) -> Range:
        return march.range_k(start, is_present=True)

    def most_k(kelvin: float) -> float:
        return max(range_k(start(kelvin)).most_k)

    # the hottest node at first
    assert 330.0 < most_k(330.0) < 345.0
    hot_disc = start(330.0)
    hot_disc.state[0] = 500.0
    uncovered = range_k(hot_disc)
    assert max(uncovered.most_k) > 500.0
    assert uncovered.safe_in_s == inf
    job = march.begin(hot_disc)
    job.advance(1000)
    peaks_k = job.course().peaks_k(HORIZON_S)
    march.keep(hot_disc, peaks_k, 7.0)
    covered = range_k(hot_disc)
    assert covered.safe_in_s == 7.0
    assert covered.most_k == pytest.approx([p + MARGIN_K for p in peaks_k])

    hotter = hot_disc._replace(state=[k + 9.0 for k in hot_disc.state])
    assert range_k(hotter).safe_in_s == inf
    assert not march.raise_ceiling(hot_disc, peaks_k, lambda _: False)
    asked: list[float] = []
    assert march.raise_ceiling(
        hot_disc, peaks_k, lambda p: asked.append(p) or p < 0.01
    )
    assert asked == sorted(asked, reverse=True)
    assert march.work_ahead(50)
    assert range_k(hotter).safe_in_s == inf
    while march.work_ahead(50):
        pass
    found = range_k(hotter)
    assert found.safe_in_s == 0.0
    assert max(peaks_k) < max(found.most_k) < BOILING_K + 10.0
    # another fluid, another time until it is safe
    other = hotter._replace(boiling=Boiling([300.0, 301.0, 302.0]))
    assert range_k(other).safe_in_s == inf
    # another network
    unknown = march.range_k(start(330.0), is_present=False)
    assert set(unknown.most_k) == {inf}


@needs_kernel
def test_a_ceiling_that_was_higher_than_expected_teaches_the_next() -> None:
    """Radiation brings more than three times the heat to the fluid."""
    ensemble = members("thesis", 0, ())
    march = CornerMarch(ensemble, KERNEL)
    state = state_of(ensemble.program, [AIR_K] * ensemble.nodes)
    state[ensemble.program.state_names.index("disc")] = 600.0
    start = Start(state, Conditions(AIR_K), 1.0, Boiling([200.0, 201.0]))
    job = march.begin(start)
    job.advance(1000)
    peaks_k = job.course().peaks_k(HORIZON_S)
    # the mean of temperatures above the base can be read from the risk
    base_k = max(peaks_k)
    boiling = Boiling([base_k + i for i in range(2001)])
    start = start._replace(boiling=boiling)

    def expected_k() -> float:
        """Return the mean that is expected of the largest factor."""
        asked: list[float] = []
        assert march.raise_ceiling(
            start, peaks_k, lambda p: asked.append(p) or True
        )
        return base_k + 2000.0 * asked[0]

    assert max(march.range_k(start, is_present=True).most_k) > 600.0
    first_k = expected_k()
    while march.work_ahead(50):
        pass
    (made,) = march._ceilings._kept
    second_k = expected_k()

    above_k = AIR_K + MARGIN_K + 0.5
    rise_k = sum(peaks_k) / len(peaks_k) - AIR_K
    assert first_k == pytest.approx(above_k + 3.0 * rise_k, abs=1.0)
    expected_top_k = above_k + 3.0 * (base_k - AIR_K)
    excess = (made.top_k - MARGIN_K - AIR_K) / (expected_top_k - AIR_K)
    assert excess > 1.9
    assert second_k == pytest.approx(above_k + 3.0 * excess * rise_k, abs=1.0)


@needs_kernel
def test_a_ceiling_leaves_room_for_what_warms_behind_a_hot_disc() -> None:
    ensemble = members("thesis", 0, ())
    march = CornerMarch(ensemble, KERNEL)
    state = state_of(ensemble.program, [AIR_K] * ensemble.nodes)
    state[0] = 400.0
    boiling = Boiling([AIR_K + 100.0, 600.0])
    start = Start(state, Conditions(AIR_K), 1.0, boiling)

    def most_k(behind_k: float, disc_k: float) -> float:
        warmer = [disc_k, *(behind_k for _ in state[1:])]
        found = march.range_k(start._replace(state=warmer), is_present=True)
        return max(found.most_k)

    assert most_k(AIR_K, 400.0) > 400.0
    assert march.raise_ceiling(start, [AIR_K + 10.0], lambda _: True)
    while march.work_ahead(50):
        pass

    # of the 100 K, less the spread of the members
    assert most_k(AIR_K + 10.0, 400.0) < AIR_K + 100.0
    assert most_k(AIR_K + 16.0, 400.0) > 400.0
    assert most_k(AIR_K + 10.0, 650.0) > 650.0


@pytest.mark.parametrize("effect", sorted(effect_names()))
def test_each_effect_keeps_the_order_or_is_named(effect: str) -> None:
    try:
        net = corner("extended", 0, (effect,)).network
    except ConfigError:
        pytest.skip("is not for this corner")

    assert is_ordered(net) is (effect not in UNORDERED)


def test_what_keeps_no_order() -> None:
    net = thesis()
    steep = Table(300.0, 100.0, (10.0, 0.1))
    tables = {
        "radiation": (radiation("disc", "fluid"),),
        "gentle": (mean("disc", "fluid", Table(200.0, 800.0, (1.0, 0.9))),),
        "steep": (mean("disc", "fluid", steep),),
        "another node": (value("pad_front"),),
        "another input": (value("ambient_k"),),
        "at rest nothing": (value("speed_ms"), value("pad_front")),
    }
    found = {
        name: is_ordered(
            net.with_link(Link("new", "disc", "fluid", 1.0, factors))
        )
        for name, factors in tables.items()
    }

    assert [name for name, ordered in found.items() if not ordered] == [
        *("steep", "another node", "another input")
    ]
    cut = Link("new", "disc", "fluid", 0.0, tables["steep"])
    assert is_ordered(net.with_link(cut))
    heated = Source("engine", "fluid", 5.0, (value("ambient_k"),))
    assert not is_ordered(net.with_source(heated))
    filled = net.edit_node(
        "fluid", lambda n: replace(n, factors=(value("brake_on"),))
    )
    assert not is_ordered(filled)
