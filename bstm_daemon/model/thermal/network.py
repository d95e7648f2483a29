"""A thermal network as data: nodes, links, sources and memories.

Nothing here steps in time and nothing here knows a brake. A *slot* is
anything a look-up can depend on, by name: a node's temperature [K], a memory,
or an input. The conductance of a link, the capacity of a node, the gain of a
source and the rate of a memory are each a constant times a product of
*factors*; a factor is a look-up in a *driver* formed from one or two slots.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from bstm_daemon.model.thermal.table import Table

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


DriverKind = Literal["value", "difference", "mean", "radiation"]
Number = TypeVar("Number", float, "npt.NDArray[np.float64]")


@dataclass(frozen=True, slots=True)
class Factor:
    """One look-up: a driver and its table, or the driver itself.

    Drivers: ``value`` a; ``difference`` a - b; ``mean`` (a + b) / 2;
    ``radiation`` (a^2 + b^2)(a + b), which turns a link into net exchange
    proportional to a^4 - b^4 (temperatures in kelvin).
    """

    kind: DriverKind
    a: str
    b: str | None = None
    table: Table | None = None

    def driver(self, a: Number, b: Number) -> Number:
        """Return what the table is looked up at where its slots are so."""
        found: dict[DriverKind, Number] = {
            "value": a,
            "difference": a - b,
            "mean": 0.5 * (a + b),
            "radiation": (a * a + b * b) * (a + b),
        }
        return found[self.kind]

    def __call__(self, a: float, b: float) -> float:
        """Return the factor where its slots are *a* and *b*."""
        driver = self.driver(a, b)
        return driver if self.table is None else self.table(driver)


def value(slot: str, table: Table | None = None) -> Factor:
    """Return the factor *table* of one slot, or the slot itself."""
    return Factor("value", slot, None, table)


def difference(a: str, b: str, table: Table | None = None) -> Factor:
    """Return the factor *table* of slot *a* minus slot *b*."""
    return Factor("difference", a, b, table)


def mean(a: str, b: str, table: Table | None = None) -> Factor:
    """Return the factor *table* of the mean of two slots."""
    return Factor("mean", a, b, table)


def radiation(a: str, b: str) -> Factor:
    """Return the factor (Ta^2 + Tb^2)(Ta + Tb) of two nodes [K^3]."""
    return Factor("radiation", a, b)


@dataclass(frozen=True, slots=True)
class Node:
    """A lump: ``C = capacity_j_k * capacity_table(T) * factors`` [J/K].

    A capacity of 0 makes the node algebraic. With ``boundary_input`` the
    node is a boundary whose temperature [K] is that input. What lies in a
    lining has its depth below the friction face.
    """

    name: str
    capacity_j_k: float
    capacity_table: Table | None = None
    factors: tuple[Factor, ...] = ()
    boundary_input: str | None = None
    depth_m: float | None = None


@dataclass(frozen=True, slots=True)
class Link:
    """A conductance [W/K] between two nodes: constant times factors.

    Heat flow from a to b is ``G (Ta - Tb)``; what one node loses the other
    gains, so a link can not create energy.
    """

    name: str
    a: str
    b: str
    conductance_w_k: float
    factors: tuple[Factor, ...] = ()


@dataclass(frozen=True, slots=True)
class Source:
    """A heat flow into a node [W]: gain times factors (the input is one)."""

    name: str
    node: str
    gain: float
    factors: tuple[Factor, ...] = ()


@dataclass(frozen=True, slots=True)
class Memory:
    """A number of the state with its own law.

    ``integral``: dm/dt = scale * factors. ``latch``: the largest value that
    ``scale * factors`` has taken. Both stay within [lower, upper].
    """

    name: str
    kind: Literal["integral", "latch"]
    scale: float
    factors: tuple[Factor, ...]
    initial: float = 0.0
    lower: float = 0.0
    upper: float = 1.0


Part = TypeVar("Part", Node, Link, Source)


class NetworkError(ValueError):
    """A network that cannot be built: the message names the part."""


@dataclass(frozen=True, slots=True)
class Network:
    """A network; every edit returns a new one.

    ``inputs`` names the input channels in their order in an input row.
    """

    inputs: tuple[str, ...]
    nodes: tuple[Node, ...] = ()
    links: tuple[Link, ...] = ()
    sources: tuple[Source, ...] = ()
    memories: tuple[Memory, ...] = ()
    notes: dict[str, Any] = field(default_factory=dict)

    def node(self, name: str) -> Node:
        """Return the node *name*; raises NetworkError where there is none."""
        return _named(self.nodes, name, "node")

    def link(self, name: str) -> Link:
        """Return the link *name*; raises NetworkError where there is none."""
        return _named(self.links, name, "link")

    def source(self, name: str) -> Source:
        """Return the source *name*; raises NetworkError if there is none."""
        return _named(self.sources, name, "source")

    def with_node(self, *nodes: Node) -> Network:
        """Add *nodes*."""
        return replace(self, nodes=self.nodes + nodes)

    def with_link(self, *links: Link) -> Network:
        """Add *links*."""
        return replace(self, links=self.links + links)

    def with_source(self, *sources: Source) -> Network:
        """Add *sources*."""
        return replace(self, sources=self.sources + sources)

    def with_memory(self, *memories: Memory) -> Network:
        """Add *memories*."""
        return replace(self, memories=self.memories + memories)

    def with_input(self, *names: str) -> Network:
        """Append input channels."""
        return replace(self, inputs=self.inputs + names)

    def edit_node(self, name: str, edit: Callable[[Node], Node]) -> Network:
        """Replace the node *name* by ``edit(node)``."""
        old = self.node(name)
        nodes = tuple(edit(n) if n is old else n for n in self.nodes)
        return replace(self, nodes=nodes)

    def edit_link(self, name: str, edit: Callable[[Link], Link]) -> Network:
        """Replace the link *name* by ``edit(link)``."""
        old = self.link(name)
        links = tuple(edit(k) if k is old else k for k in self.links)
        return replace(self, links=links)

    def with_extra_heat(self, node: str) -> Network:
        """Let *node* take the extra heat flow of ``extra_<node>_w`` [W]."""
        channel = f"extra_{node}_w"
        return self.with_input(channel).with_source(
            Source(f"extra_{node}", node, 1.0, (value(channel),))
        )

    def with_forced(self, node: str) -> Network:
        """Let *node* follow the input ``forced_<node>_k`` where it is finite.

        The node keeps its capacity: in a step whose series is not finite it
        is free again.
        """
        channel = f"forced_{node}_k"
        return self.with_input(channel).edit_node(
            node, lambda n: replace(n, boundary_input=channel)
        )


def with_factors(part: Part, *factors: Factor) -> Part:
    """Multiply *part* by further *factors*."""
    return replace(part, factors=part.factors + factors)


def _named(parts: tuple[Part, ...], name: str, what: str) -> Part:
    for part in parts:
        if part.name == name:
            return part
    known = ", ".join(part.name for part in parts)
    msg = f"no {what} {name!r} in the network; it has: {known}"
    raise NetworkError(msg)
