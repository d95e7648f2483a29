"""Networks as data: edits, named errors, structure, the elimination."""

from array import array
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.model.thermal.brake_corner import CornerSpec, build_corner
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.network import (
    Factor,
    Link,
    Memory,
    Network,
    NetworkError,
    Node,
    Source,
    difference,
    radiation,
    value,
    with_factors,
)
from bstm_daemon.model.thermal.program import compile_network, same_structure
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.native.loader import Kernel

INPUTS = ("speed_ms", "brake_on", "ambient_k", "brake_power_w")
GAMMA = 1.0 - 0.5**0.5


def bar(*nodes: Node, **parts: Any) -> Network:
    """Return a network of *nodes* with the input ``x``."""
    return Network(("x",), nodes, **parts)


A, B = Node("a", 10.0), Node("b", 20.0)
NEGATIVE = value("a", Table(0.0, 1.0, (1.0, -1.0)))


@pytest.mark.parametrize(
    ("network", "named"),
    [
        (bar(A, A), "'a' is used twice"),
        (bar(A, Node("x", 1.0)), "'x' is used twice"),
        (bar(A, links=(Link("ab", "a", "b", 1.0),)), "ab: no slot 'b'"),
        (bar(A, links=(Link("ax", "a", "x", 1.0),)), "'x' is not a node"),
        (bar(A, sources=(Source("q", "c", 1.0),)), "q: no slot 'c'"),
        (
            bar(A, sources=(Source("q", "a", 1.0, (value("c"),)),)),
            "q: no slot 'c'",
        ),
        (
            bar(A, sources=(Source("q", "a", 1.0, (difference("a", "c"),)),)),
            "q: no slot 'c'",
        ),
        (
            bar(
                A,
                sources=(Source("q", "a", 1.0, (Factor("radiation", "a"),)),),
            ),
            "q: the driver 'radiation' needs two slots",
        ),
        (bar(replace(A, boundary_input="y")), "a: no slot 'y'"),
        (bar(Node("a", -1.0)), "'a': capacity -1.0"),
        (bar(Node("a", float("nan"))), "'a': capacity nan"),
        (bar(Node("a", 0.0)), "'a' has neither capacity nor link"),
        (
            bar(Node("a", 1.0, Table(0.0, 1.0, (0.0, 1.0)))),
            "'a': its capacity table",
        ),
        (bar(with_factors(A, NEGATIVE)), "'a': a table makes its capacity"),
        (bar(A, B, links=(Link("ab", "a", "b", -1.0),)), "'ab': conductance"),
        (
            bar(A, B, links=(Link("ab", "a", "b", 1.0, (NEGATIVE,)),)),
            "'ab': a table makes its conductance negative",
        ),
        (
            bar(A, B, links=(Link("k", "a", "b", 1.0),) * 2),
            "the link name 'k' is used twice",
        ),
        (
            bar(A, sources=(Source("q", "a", 1.0),) * 2),
            "the source name 'q' is used twice",
        ),
        (bar(A, sources=(Source("q", "a", float("inf")),)), "'q': gain inf"),
        (
            bar(A, memories=(Memory("m", "latch", 1.0, (), initial=2.0),)),
            "memory 'm'",
        ),
        (
            bar(
                A,
                memories=(
                    Memory("good", "latch", 1.0, ()),
                    Memory("m", "latch", float("nan"), ()),
                ),
            ),
            "memory 'm'",
        ),
    ],
)
def test_error_names_the_part(network: Network, named: str) -> None:
    """A network that can not be built names what is wrong."""
    with pytest.raises(NetworkError, match=named):
        compile_network(network)


def test_edits_return_new_networks() -> None:
    """Each edit touches one part; an unknown name lists the known ones."""
    net = bar(
        A,
        B,
        links=(Link("ab", "a", "b", 1.0),),
        sources=(Source("q", "a", 1.0),),
    )
    edited = net.edit_node("a", lambda n: replace(n, capacity_j_k=99.0))
    assert (edited.node("a").capacity_j_k, net.node("a")) == (99.0, A)
    assert edited.node("b") is B
    linked = net.edit_link("ab", lambda k: replace(k, conductance_w_k=3.0))
    assert linked.link("ab").conductance_w_k == 3.0
    extra = net.with_extra_heat("b").with_forced("a")
    assert extra.inputs == ("x", "extra_b_w", "forced_a_k")
    assert extra.source("extra_b").node == "b"
    for look_up in (net.node, net.link, net.source):
        with pytest.raises(NetworkError, match=r"no .* 'zz' in the network"):
            look_up("zz")


def test_structure_does_not_depend_on_numbers(
    make_spec: Callable[..., CornerSpec],
) -> None:
    """Numbers may agree or differ; parts and table sizes are structure."""

    def program(**corner: Any) -> Any:
        return compile_network(build_corner(make_spec(corner), INPUTS))

    plain = program()
    heavier = program(
        disc={"mass_kg": 9.0, "swept_area_m2": 0.09, "total_area_m2": 0.3}
    )
    # as the emissivities agree, two links have equal constants
    equal = program(thermal={"disc_emissivity": 0.7, "pad_emissivity": 0.7})
    finer = program(pad={"area_m2": 6.5e-3, "thickness_m": 0.011, "slabs": 11})
    assert same_structure([plain, heavier, equal])
    assert not same_structure([plain, finer])
    with pytest.raises(NetworkError, match="one structure"):
        Batch([plain, finer], 300.0)


@dataclass(frozen=True)
class Case:
    """A linear network with its temperatures and inputs."""

    capacity: list[float]
    links: list[tuple[int, int, float]]
    heat: list[float]
    start: list[float]
    target: dict[int, float]
    dt_s: float


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Draw a network: any links, boundaries, nodes without capacity."""
    n = draw(st.integers(2, 9))
    index = st.integers(0, n - 1)
    conductance = st.floats(0.01, 1000.0)
    capacity = draw(st.lists(st.floats(1.0, 1e4), min_size=n, max_size=n))
    links = draw(
        st.lists(
            st.tuples(index, index, conductance).filter(
                lambda k: k[0] != k[1]
            ),
            max_size=3 * n,
        )
    )
    for i in draw(st.sets(st.integers(1, n - 1), max_size=3)):
        capacity[i] = 0.0
        links.append((0, i, draw(conductance)))
    temperature = st.floats(250.0, 900.0)
    return Case(
        capacity,
        links,
        draw(st.lists(st.floats(-1e4, 1e4), min_size=n, max_size=n)),
        draw(st.lists(temperature, min_size=n, max_size=n)),
        draw(st.dictionaries(index, temperature, max_size=2)),
        draw(st.floats(0.001, 100.0)),
    )


def dense_step(case: Case) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return one ROS2 step with dense matrices (Verwer et al. 1999)."""
    n, dt = len(case.capacity), case.dt_s
    laplace = np.zeros((n, n))
    for a, b, g in case.links:
        laplace[[a, b], [a, b]] += g
        laplace[[a, b], [b, a]] -= g
    capacity = np.diag(case.capacity)
    matrix = capacity + GAMMA * dt * laplace
    start, heat = np.array(case.start), np.array(case.heat)
    fixed = sorted(case.target)
    free = [i for i in range(n) if i not in case.target]
    rate = np.array([(case.target[i] - start[i]) / dt for i in fixed])

    def stage(right: Any, fixed_rate: Any) -> Any:
        x = np.zeros(n)
        x[fixed] = fixed_rate
        known = GAMMA * dt * laplace[np.ix_(free, fixed)] @ fixed_rate
        x[free] = np.linalg.solve(
            matrix[np.ix_(free, free)], right[free] - known
        )
        return x

    x1 = stage(heat - laplace @ start, rate)
    right = heat - laplace @ (start + dt * x1) - 2.0 * capacity @ x1
    x2 = stage(right, -rate)
    result: np.ndarray[Any, np.dtype[np.float64]] = start + dt * (
        1.5 * x1 + 0.5 * x2
    )
    return result


@settings(max_examples=150, deadline=None)
@given(case=cases())
def test_elimination_solves_the_dense_system(
    case: Case, kernel: Kernel | None
) -> None:
    """One step of a random linear network, sparse against dense."""
    names = [f"n{i}" for i in range(len(case.capacity))]
    net = Network(
        tuple(f"in_{i}" for i in case.target),
        tuple(
            Node(
                name,
                case.capacity[i],
                boundary_input=f"in_{i}" if i in case.target else None,
            )
            for i, name in enumerate(names)
        ),
        tuple(
            Link(f"k{j}", names[a], names[b], g)
            for j, (a, b, g) in enumerate(case.links)
        ),
        tuple(
            Source(f"q{i}", names[i], heat) for i, heat in enumerate(case.heat)
        ),
    )
    batch = Batch([compile_network(net)], 0.0, kernel=kernel, sets=1)
    batch.state[:] = array("d", case.start)
    batch.march(array("d", case.target.values()), 1, case.dt_s)
    expected = dense_step(case)
    scale = float(np.max(np.abs(expected)))
    assert list(batch.state) == pytest.approx(
        list(expected), abs=1e-9 * scale, rel=1e-9
    )


def test_radiation_driver_is_the_fourth_power_law(
    kernel: Kernel | None,
) -> None:
    """A link with it carries k (Ta^4 - Tb^4)."""
    net = Network(
        ("hot_k", "cold_k"),
        (
            Node("hot", 0.0, boundary_input="hot_k"),
            Node("cold", 0.0, boundary_input="cold_k"),
        ),
        (Link("r", "hot", "cold", 1e-8, (radiation("hot", "cold"),)),),
    )
    batch = Batch([compile_network(net)], 300.0, kernel=kernel)
    batch.march(array("d", [800.0, 300.0]), 1, 1.0)
    before = batch.ledger[0]
    batch.march(array("d", [800.0, 300.0] * 10), 10, 1.0)
    energy = 10.0 * 1e-8 * (800.0**4 - 300.0**4)
    assert batch.ledger[0] - before == pytest.approx(energy)
