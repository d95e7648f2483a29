"""The ceiling of a parked corner: never below what a member finds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import inf, nan
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
    is_ordered,
)
from bstm_daemon.forecast.corner_march import CornerMarch, Range, Start
from bstm_daemon.forecast.march import HORIZON_S, Conditions, parked_course
from bstm_daemon.forecast.members import Ensemble, Spread
from bstm_daemon.model.effects.catalogue import effect_names
from bstm_daemon.model.risk.vaporisation import Boiling
from bstm_daemon.model.thermal.network import (
    Link,
    Source,
    mean,
    radiation,
    value,
)
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
    heated = Source("engine", "fluid", 5.0, (value("ambient_k"),))
    assert not is_ordered(net.with_source(heated))
    filled = net.edit_node(
        "fluid", lambda n: replace(n, factors=(value("brake_on"),))
    )
    assert not is_ordered(filled)
