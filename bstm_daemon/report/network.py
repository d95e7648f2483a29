"""The thermal network of a corner as a graph: as text and as a picture.

The picture is a column of lumps beside bars of air. Lumps stand below each
other in an order that keeps linked ones together; equal slabs are one box. It
is narrow, so that it can be read on a phone and on paper.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import prod
from typing import Final

import numpy as np

from bstm_daemon.errors import require_packages
from bstm_daemon.model.thermal.network import Factor, Memory, Network
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.report.shell import template_environment
from bstm_daemon.report.text import table
from bstm_daemon.units import KELVIN_OFFSET, to_celsius

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


ROW: Final = 33
"""Height of an edge at a side of a box: a name, its line, a value."""
LINE, TOP, GAP, BAR_X, BAR_STEP = 16, 58, 8, 500, 26


@dataclass(slots=True)
class _Box:
    """Lumps drawn as one, and the edges at its sides, from top to bottom."""

    nodes: list[GraphNode]
    left: list[GraphEdge] = field(default_factory=list)
    right: list[GraphEdge] = field(default_factory=list)
    below: list[GraphEdge] = field(default_factory=list)
    y: int = 0

    def row_y(self, row: int) -> int:
        """Return where the line of an edge at a side is."""
        return self.y + GAP // 2 + ROW * row + ROW // 2

    @property
    def bottom(self) -> int:
        """Where it ends."""
        rows = max(len(self.right), len(self.left), 1)
        return self.y + rows * ROW + GAP

    @property
    def next_y(self) -> int:
        """Where the next one begins."""
        return self.bottom + max(LINE * len(self.below), GAP) + GAP


def picture(graph: Graph) -> str:
    """Return the picture of *graph* as SVG.

    Links and sources that are 0 both standing and driving are left out.

    Raises:
        MissingExtraError: jinja2 is not installed.
    """
    links = [one for one in graph.links if one.standing or one.driving]
    sources = [one for one in graph.sources if one.driving]
    used = {end for one in (*links, *sources) for end in (one.a, one.b)}
    nodes = [one for one in graph.nodes if one.name in used]
    bars = _bars(nodes, links)
    lumps = [one for one in nodes if one.name not in bars]
    boxes = _boxes(lumps, links, sources)
    arcs, of_bars = _place(boxes, links, sources)
    y = TOP + LINE * (len(bars) - 1)
    for box in boxes:
        box.y, y = y, y + box.next_y - box.y
    require_packages("jinja2", extra="report", purpose="-o FILE.svg")
    template = template_environment().get_template("network.svg")
    parts = {"boxes": boxes, "bars": bars, "arcs": arcs, "of_bars": of_bars}
    return template.render(parts, graph=graph, y=y)


def _bars(
    nodes: Iterable[GraphNode], links: Sequence[GraphEdge]
) -> dict[str, int]:
    """Return where boundaries stand, after air that has no capacity."""
    empty = {one.name: one for one in nodes if one.capacity_j_k == 0.0}
    fixed = {one.name for one in empty.values() if one.boundary_input}
    linked = [{one.a, one.b} for one in links if fixed & {one.a, one.b}]
    names = [name for name in empty if name in fixed.union(*linked)]
    names.sort(key=fixed.__contains__)
    return {name: BAR_X + BAR_STEP * i for i, name in enumerate(names)}


def _boxes(
    lumps: Sequence[GraphNode],
    links: Sequence[GraphEdge],
    sources: Sequence[GraphEdge],
) -> list[_Box]:
    """Return the boxes of *lumps* in their order from top to bottom.

    The order is that of the second eigenvector of the network's Laplacian,
    which makes the sum of conductance times distance squared small. The node
    that takes most heat is in the upper half.
    """
    number = {node.name: i for i, node in enumerate(lumps)}
    laplacian = np.zeros((len(lumps), len(lumps)))
    ends = Counter(2 * [source.b for source in sources])
    for link in links:
        ends.update((link.a, link.b))
        if link.a in number and link.b in number:
            a, b = number[link.a], number[link.b]
            weight = max(link.standing, link.driving)
            laplacian[[a, b], [b, a]] -= weight
            laplacian[[a, b], [a, b]] += weight
    vectors = np.linalg.eigh(laplacian)[1]
    order = np.argsort(vectors[:, min(1, len(lumps) - 1)]).tolist()
    heated = max(sources, key=lambda one: one.driving, default=None)
    place = order.index(number.get(heated.b, order[0])) if heated else 0
    if 2 * place >= len(order):
        order.reverse()
    boxes: list[_Box] = []
    for node in (lumps[i] for i in order):
        last = boxes[-1].nodes[-1] if boxes else node
        inner = ends[last.name] == ends[node.name] == 2
        if boxes and inner and last.value == node.value:
            boxes[-1].nodes.append(node)
        else:
            boxes.append(_Box([node]))
    return boxes


def _place(
    boxes: Sequence[_Box],
    links: Sequence[GraphEdge],
    sources: Sequence[GraphEdge],
) -> tuple[list[GraphEdge], list[GraphEdge]]:
    """Put edges at the sides of *boxes*; return arcs, and those of bars."""
    place = {n.name: i for i, box in enumerate(boxes) for n in box.nodes}
    arcs, of_bars = [], []
    for one in (*sources, *links):
        found = [place[end] for end in (one.a, one.b) if end in place]
        if not found:
            of_bars.append(one)
            continue
        upper, lower = boxes[min(found)], boxes[max(found)]
        if one.law == "source":
            upper.left.append(one)
        elif len(found) == 1:
            upper.right.append(one)
        elif max(found) == min(found) + 1:
            upper.below.append(one)
        elif upper is not lower:
            arcs.append(one)
            upper.left.append(one)
            lower.left.append(one)
    return arcs, of_bars
