"""The ceiling of a parked corner: never below what a member finds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from math import inf, nan
from typing import TYPE_CHECKING

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast.ceiling import KEPT, Ceilings, is_ordered
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
    HORIZON_S,
    Conditions,
    Job,
    parked_course,
)
from bstm_daemon.forecast.members import Ensemble, Spread
from bstm_daemon.model.effects.catalogue import effect_names
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
    highest_k, _ = ensemble.highest(state_of(program, top), air_k, factor)
    # a ceiling of them would be above the temperatures that are checked
    assume(max(highest_k) < 550.0)
    ceiling = Ceilings(ensemble, KERNEL)
    raised = ceiling.higher(
        *(state_of(program, top), air_k, factor), peak_k=air_k, limit_k=inf
    )
    assert raised is not None
    raised[1].advance(1000)
    ceiling.accept(*raised)
    below = [
        air_k - 5.0 + share * (kelvin - air_k + 5.0)
        for share, kelvin in zip(shares, top, strict=True)
    ]

    for nodes_k in (top, below):
        state = state_of(program, nodes_k)
        course = parked_course(ensemble, KERNEL, state, air_k, factor)
        peak_k = max(course.peaks_k(HORIZON_S))
        bound_k = ceiling.peak_k(state, air_k, factor)
        # an error of the fluid that is large for its rise is the plates' too
        assert peak_k <= bound_k
        assert bound_k < inf or nodes_k is below


@needs_kernel
def test_it_lasts_while_nothing_is_hotter() -> None:
    ensemble = members("thesis", 0, ())
    ceiling = Ceilings(ensemble, KERNEL)
    state = state_of(ensemble.program, [330.0] * len(thesis().nodes))
    assert ceiling.peak_k(state, AIR_K, 1.0) == inf

    raised = ceiling.higher(state, AIR_K, 1.0, peak_k=330.0, limit_k=BOILING_K)
    assert raised is not None
    assert ceiling.peak_k(state, AIR_K, 1.0) == inf
    raised[1].advance(1000)
    ceiling.accept(*raised)

    bound_k = ceiling.peak_k(state, AIR_K, 1.0)
    course = parked_course(ensemble, KERNEL, state, AIR_K, 1.0)
    assert max(course.peaks_k(HORIZON_S)) < bound_k < 385.0
    warmer = [kelvin + 20.0 for kelvin in state]
    assert ceiling.peak_k(warmer, AIR_K, 1.0) == bound_k
    disc = ensemble.program.state_names.index("disc")
    hot = [*state[:disc], 400.0, *state[disc + 1 :]]
    assert ceiling.peak_k(hot, AIR_K, 1.0) == inf
    assert ceiling.peak_k(state, AIR_K + 6.0, 1.0) == inf
    unknown = [*state[:disc], nan, *state[disc + 1 :]]
    assert ceiling.peak_k(unknown, AIR_K, 1.0) == inf

    # the next one is kept beside it
    raised = ceiling.higher(hot, AIR_K, 1.0, peak_k=330.0, limit_k=BOILING_K)
    assert raised is not None
    raised[1].advance(1000)
    ceiling.accept(*raised)
    assert ceiling.peak_k(warmer, AIR_K, 1.0) == bound_k
    assert bound_k <= ceiling.peak_k(hot, AIR_K, 1.0) < BOILING_K

    # those used last are kept
    above, job = raised
    for i in range(2 * KEPT):
        assert ceiling.peak_k(state, AIR_K, 1.0) == bound_k
        nodes_k = [AIR_K - 1.0 - i, *above.nodes_k[1:]]
        nodes_k[1] += 1.0 + i
        ceiling.accept(above._replace(nodes_k=nodes_k), job)
    assert len(ceiling._kept) == KEPT


def test_there_is_none_where_it_would_be_of_no_use() -> None:
    ensemble = members("thesis", 0, ())
    ceiling = Ceilings(ensemble, KERNEL)
    cool = state_of(ensemble.program, [330.0] * len(thesis().nodes))
    hot = state_of(ensemble.program, [800.0] * len(thesis().nodes))

    for state, peak_k in ((cool, 410.0), (cool, nan), (hot, 330.0)):
        assert (
            ceiling.higher(state, AIR_K, 1.0, peak_k=peak_k, limit_k=BOILING_K)
            is None
        )


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


@needs_kernel
@settings(max_examples=100, deadline=None)
@given(
    place=st.integers(0, 3),
    factor=st.sampled_from([1.0, 2.0]),
    warm_k=st.lists(st.floats(0.0, 1.0), min_size=3, max_size=3),
    speed_ms=st.floats(0.0, 40.0),
    power_w=st.floats(0.0, 8000.0),
)
def test_members_on_duty_rise_less_than_is_assumed(
    place: int,
    factor: float,
    warm_k: list[float],
    speed_ms: float,
    power_w: float,
) -> None:
    """Else the time of vapour on duty would be that of the estimate alone."""
    ensemble = Ensemble(corner("thesis", place, ()), 64, Spread())
    disc, pad, fluid = warm_k
    pad_k = 250.0 * disc * pad
    rises = {"disc": 250.0 * disc, "fluid": pad_k * fluid}
    nodes_k = [
        AIR_K
        + rises.get(
            node.name,
            0.0
            if node.boundary_input
            else pad_k
            if node.name.startswith("pad_")
            else pad_k * fluid,
        )
        for node in ensemble.program.network.nodes
    ]
    state = state_of(ensemble.program, nodes_k)
    duty = Conditions(AIR_K, speed_ms, 2e6 * (power_w > 0.0), 0.3, power_w)
    peaks_k = []
    for one in (ensemble, ensemble.alone):
        job = Job(one, KERNEL, state, duty, DUTY_STEPS, factor=factor)
        job.advance(1000)
        peaks_k.append(max(job.course().peaks_k(HORIZON_S)))

    most_k = AIR_K + ensemble.widest_rise(factor) * (peaks_k[1] - AIR_K)
    # the least that any fluid boils at
    assert peaks_k[0] < 367.0 or most_k >= 367.0
