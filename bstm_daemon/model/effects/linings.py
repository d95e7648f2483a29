"""The lining in a network: its nodes, and its share of the friction heat."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from math import sqrt
from typing import Literal

from bstm_daemon.model.thermal.network import (
    Link,
    Network,
    Node,
    Source,
    value,
)
from bstm_daemon.model.thermal.table import Table

COLDEST_K = 200.0
HOTTEST_K = 1300.0
POINTS = 221


def edit_lining(
    network: Network,
    node: Callable[[Node], Node] = lambda slab: slab,
    link: Callable[[Link], Link] = lambda between: between,
) -> Network:
    """Replace the slabs of the lining and the links between them.

    A pad builder must add ``pad_front`` and ``pad_back``; what begins with
    ``pad_`` between them is lining too.
    """
    names = [one.name for one in network.nodes]
    first, last = names.index("pad_front"), names.index("pad_back")
    slabs = [n for n in names[first : last + 1] if n.startswith("pad_")]
    chain = set(pairwise(slabs))
    return replace(
        network,
        nodes=tuple(
            node(one) if one.name in slabs else one for one in network.nodes
        ),
        links=tuple(
            link(one) if (one.a, one.b) in chain else one
            for one in network.links
        ),
    )


def with_effusivity(
    network: Network,
    relative: Callable[[float], float],
    name: str,
    node: Literal["pad_front", "disc"] = "pad_front",
) -> Network:
    """Divide the friction heat by what linings or disc are when hot.

    Eq 2.3 and 2.4 hold with the properties at the temperature of the
    interface: where k or cp of a lining has risen *relative* times, its
    effusivity has by the square root, and so has, nearly, its small share;
    it falls as much where those of the disc rise. What the linings take
    more, the disc takes less.

    Args:
        network: with ``disc_heat`` and ``pad_heat`` of the base model.
        relative: k rho cp over its configured value, by temperature [K].
        name: of the effect, for the names of the two sources.
        node: whose property and temperature it is.
    """
    pads, disc = network.source("pad_heat"), network.source("disc_heat")
    share = pads.gain / (pads.gain + disc.gain)

    def more(t: float) -> float:
        ratio = sqrt(relative(t))
        if node == "disc":
            ratio = 1.0 / ratio
        return ratio / (1.0 - share + share * ratio) - 1.0

    table = Table.from_function(more, COLDEST_K, HOTTEST_K, POINTS)
    factors = (*pads.factors, value(node, table))
    return network.with_source(
        Source(f"{name}_pads", "pad_front", pads.gain, factors),
        Source(f"{name}_disc", "disc", -pads.gain, factors),
    )
