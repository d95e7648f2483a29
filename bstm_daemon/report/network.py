"""The thermal network of a corner as a graph with values, and as text."""

from __future__ import annotations

from dataclasses import dataclass
from math import prod
from typing import TYPE_CHECKING, Final

from bstm_daemon.report.text import table
from bstm_daemon.units import KELVIN_OFFSET, to_celsius

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from bstm_daemon.model.thermal.network import Factor, Memory, Network
    from bstm_daemon.model.thermal.table import Table

TEMPERATURE_K: Final = 300.0 + KELVIN_OFFSET
SPEED_MS: Final = 100.0 / 3.6


@dataclass(frozen=True, slots=True)
class GraphNode:
    """A lump with its heat capacity, or a boundary that follows an input."""

    name: str
    capacity_j_k: float
    capacity_table: Table | None
    boundary_input: str | None

    @property
    def value(self) -> str:
        """What it has, as text."""
        if self.capacity_j_k > 0.0:
            return f"{_short(self.capacity_j_k)} J/K"
        return self.boundary_input or "no capacity"


@dataclass(frozen=True, slots=True)
class GraphEdge:
    """A link from node a to b [W/K], or a source from input a into node b.

    ``standing`` and ``driving`` are ``constant`` times the factors. The law
    is ``constant``, ``convection`` (it depends on the speed), ``radiation``,
    ``varying`` (it depends on anything else) or ``source``, whose value is
    the heat flow [W] for each unit of its input.
    """

    name: str
    a: str
    b: str
    law: str
    standing: float
    driving: float
    constant: float
    factors: tuple[Factor, ...]

    @property
    def value(self) -> str:
        """Its value as text, standing and driving where they differ."""
        both = dict.fromkeys(map(_short, (self.standing, self.driving)))
        unit = f"\u00d7 {self.a}" if self.law == "source" else "W/K"
        return f"{' … '.join(both)} {unit}"


@dataclass(frozen=True, slots=True)
class Graph:
    """A network, dry and with the brake released, at a stated point.

    All nodes but boundaries have ``temperature_k``; *standing* is at rest,
    *driving* at ``speed_ms``. ``layout`` is the version of this record.
    """

    title: str
    ambient_k: float
    nodes: list[GraphNode]
    links: list[GraphEdge]
    sources: list[GraphEdge]
    memories: tuple[Memory, ...]
    temperature_k: float = TEMPERATURE_K
    speed_ms: float = SPEED_MS
    layout: int = 1

    @property
    def point(self) -> str:
        """At which point the values are, as text."""
        return (
            f"nodes {to_celsius(self.temperature_k):.0f} °C, air "
            f"{to_celsius(self.ambient_k):.0f} °C, standing … "
            f"{3.6 * self.speed_ms:.0f} km/h, brake released"
        )


def network_graph(net: Network, title: str, ambient_k: float) -> Graph:
    """Return *net*, a corner's with its effects, as a graph with *title*."""
    standing = (
        dict.fromkeys(net.inputs, 0.0)
        | {"ambient_k": ambient_k}
        | {memory.name: memory.initial for memory in net.memories}
    )
    for node in net.nodes:
        fixed = node.boundary_input is not None and node.capacity_j_k == 0.0
        standing[node.name] = ambient_k if fixed else TEMPERATURE_K
    driving = standing | {"speed_ms": SPEED_MS}
    nodes = []
    for node in net.nodes:
        by_table = node.capacity_table
        capacity_j_k = node.capacity_j_k * _product(node.factors, standing)
        if by_table is not None:
            capacity_j_k *= by_table(TEMPERATURE_K)
        nodes.append(
            GraphNode(node.name, capacity_j_k, by_table, node.boundary_input)
        )
    links = [
        GraphEdge(
            *(link.name, link.a, link.b, _law(link.factors)),
            link.conductance_w_k * _product(link.factors, standing),
            link.conductance_w_k * _product(link.factors, driving),
            *(link.conductance_w_k, link.factors),
        )
        for link in net.links
    ]
    sources = []
    for source in net.sources:
        # the input itself is the factor without a table
        names = [f.a for f in source.factors if f.table is None]
        of = next((name for name in names if name in net.inputs), "1 W")
        share = source.gain * _product(source.factors, driving | {of: 1.0})
        sources.append(
            GraphEdge(
                *(source.name, of, source.node, "source", share, share),
                *(source.gain, source.factors),
            )
        )
    return Graph(title, ambient_k, nodes, links, sources, net.memories)


def graph_text(graph: Graph) -> str:
    """Return *graph* as lines of text."""
    edges = [
        (one.name, one.law, f"{one.a} - {one.b}", one.value)
        for one in (*graph.links, *graph.sources)
    ]
    nodes = [(one.name, one.value) for one in graph.nodes]
    return "\n".join(
        (
            *(graph.title, graph.point, ""),
            *(*table(("node", "capacity"), nodes), ""),
            *table(("link or source", "law", "between", "value"), edges),
        )
    )


def _law(factors: Iterable[Factor]) -> str:
    if any(factor.kind == "radiation" for factor in factors):
        return "radiation"
    drivers = {factor.a for factor in factors}
    if "speed_ms" in drivers:
        return "convection"
    return "varying" if drivers else "constant"


def _product(factors: Iterable[Factor], slots: Mapping[str, float]) -> float:
    return prod(
        factor(slots[factor.a], slots[factor.b or factor.a])
        for factor in factors
    )


def _short(number: float) -> str:
    return f"{float(f'{number:.3g}'):g}"
