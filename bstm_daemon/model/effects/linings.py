"""The lining in a network: its nodes, and its share of the friction heat."""

from __future__ import annotations

from math import sqrt
from typing import TYPE_CHECKING, Literal

from bstm_daemon.model.thermal.network import Network, Source, value
from bstm_daemon.model.thermal.table import Table

if TYPE_CHECKING:
    from collections.abc import Callable

COLDEST_K = 200.0
HOTTEST_K = 1300.0
POINTS = 221


def pad_nodes(network: Network) -> list[str]:
    """Return the names of the lining's nodes in their order.

    A pad builder must add ``pad_front`` and ``pad_back``; what begins with
    ``pad_`` between them is lining too.
    """
    names = [node.name for node in network.nodes]
    first, last = names.index("pad_front"), names.index("pad_back")
    return [n for n in names[first : last + 1] if n.startswith("pad_")]


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
