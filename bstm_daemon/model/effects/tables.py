"""Tables, limits and edits of the lining that several effects share."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import sqrt
from typing import TYPE_CHECKING, Literal

from bstm_daemon.model.thermal.network import (
    Factor,
    Link,
    Network,
    Node,
    Source,
    value,
)
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Callable

ROOM_K = 20.0 + KELVIN_OFFSET
FASTEST_MS = 120.0
"""End of the tables over speed."""

NEGLIGIBLE = 1e-6
"""Least strength; below it a part would be singular and is as good as absent.
"""

RELEASED = Table(0.0, 1.0, (1.0, 0.0))
"""1 with the brake off, 0 with it on, over ``brake_on``."""


def over_speed(share: Callable[[float], float]) -> Factor:
    """Return a factor *share* of the speed [m/s], tabulated."""
    return value("speed_ms", Table.from_function(share, 0.0, FASTEST_MS, 481))


def rising_with_speed(still: float, rise: float) -> Factor:
    """Return a factor *still* at rest and *rise* more for each m/s."""
    ends = (still, still + FASTEST_MS * rise)
    return value("speed_ms", Table(0.0, FASTEST_MS, ends))


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
