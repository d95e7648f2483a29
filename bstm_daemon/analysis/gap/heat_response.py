"""What heat at a node changes at the thermocouples, by the model's response.

Linear about measured temperatures, so that thousands of heats cost one march.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.residual_heat import measured_nodes
from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.matching.march import march
from bstm_daemon.analysis.matching.thermocouples import InPad, lagged
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.estimator.corner_model import compiled_model
from bstm_daemon.model.effects.composed import Term
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.thermal.network import Factor, Link, Node, value

BLOCK: Final = 10
"""Steps of the grid that responses are marched by: 5 s."""

FOLLOWS: Final = 1e-9
"""Size of a mass that takes no heat."""


class Response:
    """What heats change at the thermocouples of one corner over one drive."""

    def __init__(
        self, model: CornerModel, drive: Drive, terms: Sequence[Term]
    ) -> None:
        """March *model* over *drive* once, measured nodes as measured.

        What the memories and masses of *terms* do is marched too.
        """
        self.model = whole = model
        looking_back = {
            (one.memories(), one.masses()): replace(one, size=FOLLOWS)
            for one in terms
        }
        for one in looking_back.values():
            if one.memories() or one.masses():
                whole = one.edit(whole)
        net = whole.network
        corner = model.spec.name
        self.placed = drive.placed.get(corner, {})
        found = march(
            [compiled_model(whole)],
            drive,
            corner,
            forced=measured_nodes(drive, corner, compiled_model(model)),
            memories=[one.name for one in net.memories],
        )
        self.count = len(drive) // BLOCK
        columns = {name: column[:, 0] for name, column in found.items()}
        columns |= {one: drive.channel(corner, one) for one in net.inputs}
        self.slots = {
            name: column[: self.count * BLOCK].reshape(-1, BLOCK).mean(axis=1)
            for name, column in columns.items()
        }
        free = [
            one
            for one in model.network.nodes
            if one.boundary_input is None or one.capacity_j_k > 0.0
        ]
        self.place = {node.name: i for i, node in enumerate(free)}
        self._solve(free)

    def _solve(self, free: Sequence[Node]) -> None:
        """Invert the implicit step of each block."""
        size = len(free)
        self.capacity = np.zeros((self.count, size))
        for i, node in enumerate(free):
            own = value(node.name, node.capacity_table)
            factors = () if node.capacity_table is None else (own,)
            shape = self._product((*node.factors, *factors))
            self.capacity[:, i] = node.capacity_j_k * shape / (BLOCK * GRID_S)
        matrix = self.capacity[:, :, None] * np.eye(size)
        for link in self.model.network.links:
            g = link.conductance_w_k * self._product(link.factors)
            ends = [self.place[n] for n in (link.a, link.b) if n in self.place]
            for i in ends:
                matrix[:, i, i] += g
            if len(ends) == 2:
                matrix[:, ends[0], ends[1]] -= g
                matrix[:, ends[1], ends[0]] -= g
        self.inverse = np.linalg.inv(matrix)

    def _product(self, factors: Sequence[Factor]) -> Column:
        found = np.ones(self.count)
        for one in factors:
            driver = one.driver(self.slots[one.a], self.slots[one.b or one.a])
            if one.table is not None:
                values = one.table.values
                x = one.table.x0 + one.table.dx * np.arange(len(values))
                driver = np.interp(driver, x, values)
            found *= driver
        return found

    def of(
        self, terms: Sequence[Term], nodes: Sequence[str]
    ) -> dict[str, Column]:
        """Return the change [K] of *nodes* by each term, (blocks, terms)."""
        heats, into, term_of = [], [], []
        for number, term in enumerate(terms):
            for flow in term.flows(self.model):
                if isinstance(flow, Link):
                    apart = self.slots[flow.a] - self.slots[flow.b]
                    heat = flow.conductance_w_k * apart
                    ends = [(flow.a, -1.0), (flow.b, 1.0)]
                else:
                    heat, ends = flow.gain, [(flow.node, 1.0)]
                heat = heat * self._product(flow.factors)
                own = [end for end in ends if end[0] in self.place]
                heats += [sign * heat for _, sign in own]
                into += [self.place[node] for node, _ in own]
                term_of += [number] * len(own)
        heat_w = np.array(heats).T
        state = np.zeros((len(self.place), len(terms)))
        flat = np.array(into) * len(terms) + np.array(term_of)
        shown = self._shown(nodes)
        found = np.empty((len(nodes), self.count, len(terms)))
        for block in range(self.count):
            right = np.bincount(flat, heat_w[block], state.size)
            right = right.reshape(state.shape)
            right += self.capacity[block][:, None] * state
            state = self.inverse[block] @ right
            found[:, block] = shown @ state
        return {
            node: lagged(
                change_k, self.model.lag_s.get(node, 0.0), BLOCK * GRID_S
            )
            for node, change_k in zip(nodes, found, strict=True)
        }

    def _shown(self, nodes: Sequence[str]) -> Column:
        """Return the share that each node has in what thermocouples read.

        Those of *nodes*, (thermocouples, nodes).
        """
        shown = np.zeros((len(nodes), len(self.place)))
        for row, node in zip(shown, nodes, strict=True):
            place = self.placed.get(node)
            shares = (
                place.shares(self.model.network)
                if isinstance(place, InPad)
                else {node: 1.0}
            )
            for name, share in shares.items():
                row[self.place[name]] = share
        return shown
