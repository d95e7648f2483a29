"""A network flattened into the two arrays that the kernel runs.

``ints`` holds the structure: which slots a driver reads, which factors a part
multiplies, and the symmetric factorisation as a flat list of operations
computed here once (elimination order by least degree, fill-in included).
``floats`` holds every number a member of a batch may have for itself. The
layout is written once, by :class:`_Compiler`, and read by
``native/thermal/march.c`` and :mod:`bstm_daemon.model.thermal.reference` in
the order of :data:`SECTIONS`.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING, Final

from bstm_daemon.model.thermal.network import (
    Factor,
    Link,
    Memory,
    Network,
    NetworkError,
    Node,
    Source,
)

if TYPE_CHECKING:
    from bstm_daemon.model.thermal.table import Table

LAYOUT_VERSION: Final = 1

DRIVER_KINDS: Final = {"value": 0, "difference": 1, "mean": 2, "radiation": 3}
MEMORY_KINDS: Final = {"integral": 0, "latch": 1}

COUNTS: Final = (
    "layout",
    "nodes",
    "memories",
    "inputs",
    "links",
    "sources",
    "factors",
    "tables",
    "uses",
    "entries",
    "operations",
    "pivots",
    "floats",
)
"""The header of ``ints``: one count each."""

SECTIONS: Final = (
    "node_table",  # per node: own-temperature table or -1
    "node_input",  # per node: input that fixes its temperature or -1
    "node_free",  # per node: 1 = an unknown of the solve, 0 = boundary
    "link_a",
    "link_b",
    "link_entry",  # per link: off-diagonal entry or -1
    "source_node",
    "memory_kind",
    "use_start",  # per part (nodes, links, sources, memories) + 1
    "use_factor",  # the factors of all parts, concatenated
    "factor_kind",
    "factor_a",  # slot numbers: nodes, then memories, then inputs
    "factor_b",
    "factor_table",
    "factor_steady",  # 1: driven by inputs alone, so constant in a step
    "table_points",
    "table_offset",  # into floats: x0, 1/dx, values...
    "pivot_node",
    "pivot_entry_start",
    "pivot_operation_start",
    "entry_row",  # the later node of each entry, entries in pivot order
    "operation_left",
    "operation_right",
    "operation_target",  # entry, or -1 - node for a diagonal
)
"""The arrays of ``ints`` after the header, each preceded by its length."""


@dataclass(frozen=True, slots=True)
class Program:
    """A compiled network.

    ``state`` is nodes then memories; ``outputs`` adds each source's running
    energy [J]; ``ledger`` is each link's, then each source's energy [J].
    """

    network: Network
    ints: array[int]
    floats: array[float]
    slots: dict[str, int]

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the state in order: nodes, then memories."""
        net = self.network
        nodes = tuple(node.name for node in net.nodes)
        return nodes + tuple(memory.name for memory in net.memories)

    @property
    def ledger_names(self) -> tuple[str, ...]:
        """Names of the ledger in order: links, then sources."""
        net = self.network
        links = tuple(link.name for link in net.links)
        return links + tuple(source.name for source in net.sources)

    def initial_state(self, temperature_k: float) -> array[float]:
        """Every node at *temperature_k*, memories at their initial value."""
        net = self.network
        return array(
            "d",
            [temperature_k] * len(net.nodes)
            + [memory.initial for memory in net.memories],
        )


def compile_network(network: Network) -> Program:
    """Flatten *network*.

    Raises:
        NetworkError: a name used twice or nowhere defined, a constant that
            is not finite or has the wrong sign, a table that could make a
            conductance negative or a capacity 0, or an algebraic node with
            no link.
    """
    return _Compiler(network).program()


def same_structure(programs: Sequence[Program]) -> bool:
    """Whether *programs* can be members of one batch."""
    first = programs[0].ints
    return all(program.ints == first for program in programs)


class _Compiler:
    """One pass over a network; its attributes are the sections to write."""

    def __init__(self, network: Network) -> None:
        self.net = network
        self.slots = _slots(network)
        # by identity: two members whose numbers happen to agree must not
        # get a structure of their own
        self.factors: dict[int, Factor] = {}
        self.factor_number: dict[int, int] = {}
        self.tables: dict[int, Table] = {}
        self.table_number: dict[int, int] = {}
        self.floats: list[float] = []

    def program(self) -> Program:
        net = self.net
        for node in net.nodes:
            _check_constant(node.name, "capacity", node.capacity_j_k)
            tables = (f.table for f in node.factors)
            _check_tables(node.name, "capacity", *tables)
            _check_own_table(node)
        for link in net.links:
            _check_constant(link.name, "conductance", link.conductance_w_k)
            tables = (f.table for f in link.factors)
            _check_tables(link.name, "conductance", *tables)
        for source in net.sources:
            if not isfinite(source.gain):
                msg = f"{source.name!r}: gain {source.gain} is not finite"
                raise NetworkError(msg)
        for memory in net.memories:
            _check_memory(memory)
        _check_names("link", net.links)
        _check_names("source", net.sources)
        _check_algebraic(net)
        self.floats.extend(n.capacity_j_k for n in net.nodes)
        self.floats.extend(k.conductance_w_k for k in net.links)
        self.floats.extend(s.gain for s in net.sources)
        for memory in net.memories:
            self.floats.extend((memory.scale, memory.lower, memory.upper))
        sections = self._part_sections()
        sections |= self._factor_sections()
        sections |= self._table_sections()
        elimination = _Elimination(net)
        sections |= elimination.sections
        counts = {
            "layout": LAYOUT_VERSION,
            "nodes": len(net.nodes),
            "memories": len(net.memories),
            "inputs": len(net.inputs),
            "links": len(net.links),
            "sources": len(net.sources),
            "factors": len(self.factors),
            "tables": len(self.tables),
            "uses": len(sections["use_factor"]),
            "entries": len(sections["entry_row"]),
            "operations": len(sections["operation_left"]),
            "pivots": len(sections["pivot_node"]),
            "floats": len(self.floats),
        }
        ints = array("i", [counts[name] for name in COUNTS])
        for name in SECTIONS:
            ints.append(len(sections[name]))
            ints.extend(sections[name])
        return Program(net, ints, array("d", self.floats), self.slots)

    def _index(self, slot: str, where: str) -> int:
        try:
            return self.slots[slot]
        except KeyError:
            known = ", ".join(self.slots)
            msg = f"{where}: no slot {slot!r}; there are: {known}"
            raise NetworkError(msg) from None

    def _node_index(self, name: str, where: str) -> int:
        index = self._index(name, where)
        if index >= len(self.net.nodes):
            msg = f"{where}: {name!r} is not a node"
            raise NetworkError(msg)
        return index

    def _part_sections(self) -> dict[str, list[int]]:
        net = self.net
        inputs = len(net.nodes) + len(net.memories)
        uses: list[int] = []
        starts = [0]
        products = [
            *((n.name, n.factors) for n in net.nodes),
            *((k.name, k.factors) for k in net.links),
            *((s.name, s.factors) for s in net.sources),
            *((m.name, m.factors) for m in net.memories),
        ]
        for name, factors in products:
            uses.extend(self._factor(factor, name) for factor in factors)
            starts.append(len(uses))
        return {
            "node_table": [self._table(n.capacity_table) for n in net.nodes],
            "node_input": [
                -1
                if n.boundary_input is None
                else self._index(n.boundary_input, n.name) - inputs
                for n in net.nodes
            ],
            "node_free": [int(_is_unknown(n)) for n in net.nodes],
            "link_a": [self._node_index(k.a, k.name) for k in net.links],
            "link_b": [self._node_index(k.b, k.name) for k in net.links],
            "source_node": [
                self._node_index(s.node, s.name) for s in net.sources
            ],
            "memory_kind": [MEMORY_KINDS[m.kind] for m in net.memories],
            "use_start": starts,
            "use_factor": uses,
        }

    def _factor(self, factor: Factor, where: str) -> int:
        self._index(factor.a, where)
        if factor.b is not None:
            self._index(factor.b, where)
        elif factor.kind != "value":
            msg = f"{where}: the driver {factor.kind!r} needs two slots"
            raise NetworkError(msg)
        self.factors.setdefault(id(factor), factor)
        return self.factor_number.setdefault(
            id(factor), len(self.factor_number)
        )

    def _table(self, table: Table | None) -> int:
        if table is None:
            return -1
        self.tables.setdefault(id(table), table)
        return self.table_number.setdefault(id(table), len(self.table_number))

    def _factor_sections(self) -> dict[str, list[int]]:
        inputs = len(self.net.nodes) + len(self.net.memories)
        factors = list(self.factors.values())
        a = [self.slots[f.a] for f in factors]
        b = [self.slots[f.b or f.a] for f in factors]
        return {
            "factor_kind": [DRIVER_KINDS[f.kind] for f in factors],
            "factor_a": a,
            "factor_b": b,
            "factor_table": [self._table(f.table) for f in factors],
            "factor_steady": [
                int(left >= inputs and right >= inputs)
                for left, right in zip(a, b, strict=True)
            ],
        }

    def _table_sections(self) -> dict[str, list[int]]:
        offsets = []
        for table in self.tables.values():
            offsets.append(len(self.floats))
            self.floats.extend((table.x0, 1.0 / table.dx, *table.values))
        return {
            "table_points": [len(t.values) for t in self.tables.values()],
            "table_offset": offsets,
        }


class _Elimination:
    """Least-degree order and fill-in of the symmetric matrix C + c G."""

    def __init__(self, net: Network) -> None:
        names = {node.name: i for i, node in enumerate(net.nodes)}
        unknown = [i for i, node in enumerate(net.nodes) if _is_unknown(node)]
        neighbours: dict[int, set[int]] = {i: set() for i in unknown}
        for link in net.links:
            a, b = names[link.a], names[link.b]
            if a in neighbours and b in neighbours and a != b:
                neighbours[a].add(b)
                neighbours[b].add(a)
        order, rows = _eliminate(neighbours)
        rank = {node: i for i, node in enumerate(order)}
        entry: dict[tuple[int, int], int] = {}
        entry_row: list[int] = []
        starts = [0]
        for pivot, later in zip(order, rows, strict=True):
            for node in sorted(later, key=rank.__getitem__):
                entry[pivot, node] = len(entry)
                entry_row.append(node)
            starts.append(len(entry_row))
        left: list[int] = []
        right: list[int] = []
        target: list[int] = []
        operation_starts = [0]
        for pivot, later in zip(order, rows, strict=True):
            ranked = sorted(later, key=rank.__getitem__)
            for i, p in enumerate(ranked):
                for q in ranked[i:]:
                    left.append(entry[pivot, p])
                    right.append(entry[pivot, q])
                    target.append(-1 - p if p == q else entry[p, q])
            operation_starts.append(len(left))

        def entry_of(link: Link) -> int:
            a, b = names[link.a], names[link.b]
            return entry.get((a, b), entry.get((b, a), -1))

        self.sections = {
            "link_entry": [entry_of(link) for link in net.links],
            "pivot_node": order,
            "pivot_entry_start": starts,
            "pivot_operation_start": operation_starts,
            "entry_row": entry_row,
            "operation_left": left,
            "operation_right": right,
            "operation_target": target,
        }


def _eliminate(
    neighbours: dict[int, set[int]],
) -> tuple[list[int], list[set[int]]]:
    """Return the elimination order and, per pivot, the nodes still to come."""
    graph = {node: set(near) for node, near in neighbours.items()}
    order: list[int] = []
    rows: list[set[int]] = []
    while graph:
        pivot = min(graph, key=lambda node: (len(graph[node]), node))
        near = graph.pop(pivot)
        for node in near:
            graph[node] |= near
            graph[node] -= {node, pivot}
        order.append(pivot)
        rows.append(near)
    return order, rows


def _is_unknown(node: Node) -> bool:
    """A forced node keeps its capacity and is free where its series ends."""
    forced = node.boundary_input is not None
    return not forced or node.capacity_j_k > 0


def _slots(net: Network) -> dict[str, int]:
    slots: dict[str, int] = {}
    names = (
        *(node.name for node in net.nodes),
        *(memory.name for memory in net.memories),
        *net.inputs,
    )
    for name in names:
        if name in slots:
            msg = f"the name {name!r} is used twice in the network"
            raise NetworkError(msg)
        slots[name] = len(slots)
    return slots


def _check_constant(name: str, what: str, constant: float) -> None:
    if not (isfinite(constant) and constant >= 0):
        msg = f"{name!r}: {what} {constant} must be finite and at least 0"
        raise NetworkError(msg)


def _check_tables(name: str, what: str, *tables: Table | None) -> None:
    for table in tables:
        if table is not None and min(table.values) < 0:
            msg = f"{name!r}: a table makes its {what} negative"
            raise NetworkError(msg)


def _check_own_table(node: Node) -> None:
    """Refuse a capacity whose temperature could not follow its heat."""
    own = node.capacity_table
    if own is not None and min(own.values) <= 0:
        msg = f"{node.name!r}: its capacity table must stay above 0"
        raise NetworkError(msg)


def _check_names(what: str, parts: Sequence[Link | Source]) -> None:
    seen: set[str] = set()
    for part in parts:
        if part.name in seen:
            msg = f"the {what} name {part.name!r} is used twice in the network"
            raise NetworkError(msg)
        seen.add(part.name)


def _check_algebraic(net: Network) -> None:
    """Refuse a node without capacity that nothing holds at a temperature."""
    linked = {name for k in net.links for name in (k.a, k.b)}
    for node in net.nodes:
        held = node.boundary_input is not None or node.name in linked
        if node.capacity_j_k == 0 and not held:
            msg = f"node {node.name!r} has neither capacity nor link"
            raise NetworkError(msg)


def _check_memory(memory: Memory) -> None:
    ordered = memory.lower <= memory.initial <= memory.upper
    if not (ordered and isfinite(memory.scale)):
        msg = (
            f"memory {memory.name!r}: needs lower <= initial <= upper and a "
            f"finite scale"
        )
        raise NetworkError(msg)
