"""The energy ledger of a march: what came in, what left, what is stored."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.model.thermal.program import Program


@dataclass(frozen=True, slots=True)
class Ledger:
    """Energies [J] of one member since its start.

    ``sources`` and ``links`` by name (a link's from a to b); ``given_off``
    per boundary node, sources into it included; ``stored`` is the rise of
    the enthalpy of the free nodes.
    """

    sources: dict[str, float]
    links: dict[str, float]
    given_off: dict[str, float]
    stored: float

    @property
    def generated(self) -> float:
        """Heat of all sources [J]."""
        return sum(self.sources.values())

    @property
    def residual(self) -> float:
        """What does not balance [J]: generated - given off - stored."""
        return self.generated - sum(self.given_off.values()) - self.stored


def read_ledger(
    program: Program,
    energies: Sequence[float],
    start: Sequence[float],
    end: Sequence[float],
) -> Ledger:
    """Balance one member of a batch.

    Args:
        program: the member's program; its capacities have no factors.
        energies: the member's row of ``Batch.ledger``.
        start: the member's state when its ledger was zero.
        end: the member's state now.

    Raises:
        ValueError: a capacity depends on more than its own temperature, so
            that stored heat is not a function of the state.
    """
    net = program.network
    links = dict(zip((k.name for k in net.links), energies, strict=False))
    sources = dict(
        zip(
            (s.name for s in net.sources),
            energies[len(net.links) :],
            strict=True,
        )
    )
    boundary = {n.name for n in net.nodes if n.boundary_input is not None}
    given_off = dict.fromkeys(sorted(boundary), 0.0)
    for link in net.links:
        if link.b in boundary:
            given_off[link.b] += links[link.name]
        if link.a in boundary:
            given_off[link.a] -= links[link.name]
    for source in net.sources:
        if source.node in boundary:
            given_off[source.node] += sources[source.name]
    stored = 0.0
    for i, node in enumerate(net.nodes):
        if node.name in boundary:
            continue
        if node.factors:
            msg = f"node {node.name!r}: its stored heat depends on drivers"
            raise ValueError(msg)
        if node.capacity_table is None:
            rise = end[i] - start[i]
        else:
            table = node.capacity_table
            rise = table.integral(end[i]) - table.integral(start[i])
        stored += node.capacity_j_k * rise
    return Ledger(sources, links, given_off, stored)
