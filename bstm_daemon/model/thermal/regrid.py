"""Node temperatures of a corner whose lining or disc has become thinner.

The pads are a fixed number of slabs that become thinner as the lining wears
(thesis section 4.5, Fig 4.13). When the network is built anew for another
thickness, the temperatures must follow the material: what is worn leaves from
the friction face with its heat, and the rest keeps every joule.
"""

from collections.abc import Sequence
from typing import Final

from bstm_daemon.model.thermal.network import Network, Node
from bstm_daemon.model.thermal.table import Table

FRONT: Final = "pad_front"
BACK: Final = "pad_back"

NEWTON_STEPS: Final = 50
CLOSE: Final = 1e-14


def heat_above_j(
    network: Network, temperatures_k: Sequence[float], reference_k: float
) -> float:
    """Heat of all nodes above *reference_k* [J]; boundaries hold none."""
    return sum(
        node.capacity_j_k
        * (
            _specific(node.capacity_table, kelvin)
            - _specific(node.capacity_table, reference_k)
        )
        for node, kelvin in zip(network.nodes, temperatures_k, strict=False)
        if node.boundary_input is None
    )


def follow_wear(
    old: Network, new: Network, temperatures_k: Sequence[float]
) -> list[float]:
    """Temperatures [K] of the nodes of *new*, worn from *old*.

    Where the lining became thinner, its slabs are cut anew over the material
    that is left: each takes its share of the old slabs' heat. Other nodes
    keep their temperature, so that mass they lose leaves with its heat.
    Both networks have the same nodes.
    """
    found = list(temperatures_k[: len(old.nodes)])
    chain = _lining(old)
    old_sizes = [old.nodes[i].capacity_j_k for i in chain]
    new_sizes = [new.nodes[i].capacity_j_k for i in chain]
    worn = sum(old_sizes) - sum(new_sizes)
    if len(chain) < 2 or worn <= 0.0:
        return found
    heats = [
        _specific(old.nodes[i].capacity_table, temperatures_k[i])
        for i in chain
    ]
    begin = worn
    for i, size in zip(chain, new_sizes, strict=True):
        heat = _mean(old_sizes, heats, begin, begin + size)
        found[i] = _temperature(old.nodes[i].capacity_table, heat, found[i])
        begin += size
    return found


def _lining(network: Network) -> list[int]:
    """Places of the slabs from the friction face to the back.

    Empty where they are no plain slabs: another builder's pads, or an effect
    whose heat capacity is no function of the temperature alone.
    """
    names = [node.name for node in network.nodes]
    if FRONT not in names or BACK not in names:
        return []
    slabs = [name for name in names if _is_slab(name)]
    inner = sorted(slabs, key=lambda name: int(name.removeprefix("pad_")))
    chain = [names.index(name) for name in (FRONT, *inner, BACK)]
    nodes = [network.nodes[i] for i in chain]
    return chain if all(_is_plain(node, nodes[0]) for node in nodes) else []


def _is_slab(name: str) -> bool:
    return name.startswith("pad_") and name.removeprefix("pad_").isdigit()


def _is_plain(node: Node, first: Node) -> bool:
    return (
        not node.factors
        and node.boundary_input is None
        and node.capacity_j_k > 0.0
        and node.capacity_table == first.capacity_table
    )


def _mean(
    sizes: Sequence[float], heats: Sequence[float], begin: float, end: float
) -> float:
    """Mean of *heats* over a stretch of cells of *sizes* laid end to end."""
    total = covered = edge = 0.0
    for size, heat in zip(sizes, heats, strict=True):
        overlap = min(end, edge + size) - max(begin, edge)
        if overlap > 0.0:
            total += overlap * heat
            covered += overlap
        edge += size
    # rounding at the far end may leave a sliver uncovered
    return total / covered if covered else heats[-1]


def _specific(table: Table | None, kelvin: float) -> float:
    """Heat per unit of a node's constant, of any fixed zero."""
    return kelvin if table is None else table.integral(kelvin)


def _temperature(table: Table | None, heat: float, near_k: float) -> float:
    """Inverse of :func:`_specific`; the table is positive, so it exists."""
    if table is None:
        return heat
    kelvin = near_k
    for _ in range(NEWTON_STEPS):
        step = (heat - table.integral(kelvin)) / table(kelvin)
        kelvin += step
        if abs(step) <= CLOSE * kelvin:
            break
    return kelvin
