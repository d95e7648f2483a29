"""The picture of a thermal network: a column of lumps beside bars of air.

Lumps stand below each other in an order that keeps linked ones together;
equal slabs are one box. The picture is narrow, so that it can be read on a
phone and on paper.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.errors import require_packages
from bstm_daemon.report.shell import template_environment

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from bstm_daemon.report.network import Graph, GraphEdge, GraphNode

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
