"""The reality: marching brake corners through time.

Linearly implicit Euler in the nodes' energies with one Richardson
extrapolation (two half steps against one whole step): second order, damping
stiff cells fully at any step. Conductances are frozen at the start of each
Euler step and every flow is booked on both of its ends, so the energy balance
closes to rounding whatever the step.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.simulation import materials, wear
from bstm_daemon.simulation.friction import friction_factor
from bstm_daemon.simulation.lanes import (
    AIR,
    BODY,
    CENTRE,
    FLUID,
    HAT,
    LUMPS,
    Lanes,
    State,
    start_state,
)
from bstm_daemon.simulation.network import Inputs, Paths, paths
from bstm_daemon.simulation.parameters import (
    DEFAULT_MESH,
    CornerParameters,
    Effects,
    Mesh,
)
from bstm_daemon.simulation.solver import Arrow, solve_arrow

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.simulation.materials import Array

# the measured layer of a cheek: thermocouples sit 1.5 mm under the surface
_MEASURED_DEPTH = 0.15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaneInputs:
    """What acts on a batch, constant over each of n steps.

    Shapes: ``step_s`` (n,), ``keep`` (n,) bool, the rest (n, lanes) or
    (n, 1). ``power_w`` is the friction power at nominal mu. With
    ``corners_per_car`` k > 0 the lanes come in cars of k and each car's total
    power is what its driver demands: where mu falls the pressure rises and
    the corners share anew. With 0 the pressure is given and power follows mu.
    """

    step_s: Array
    keep: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    speed_ms: Array
    power_w: Array
    pressure_pa: Array
    contact: Array
    ambient_k: Array
    wetness: Array
    pumping_pa_s: Array
    corners_per_car: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class LaneResult:
    """Outcome of a march.

    ``time_s`` (m,) are the ends of the kept steps; ``nodes`` name to
    temperature [K] (m, lanes); ``power_w`` and ``friction`` (n, lanes) the
    friction power and mu over nominal of every step. ``stored_j``,
    ``heat_in_j``, ``heat_out_j`` (lanes,) over the whole march.
    """

    time_s: Array
    nodes: Mapping[str, Array]
    power_w: Array
    friction: Array
    stored_j: Array
    heat_in_j: Array
    heat_out_j: Array
    state: State

    @property
    def balance_residual(self) -> Array:
        """Energy not accounted for over energy put in, (lanes,)."""
        missing = self.heat_in_j - self.heat_out_j - self.stored_j
        scale = np.maximum(np.abs(self.heat_in_j), np.abs(self.stored_j))
        return missing / np.maximum(scale, 1.0)


def march_lanes(
    corners: Sequence[CornerParameters],
    effects: Sequence[Effects],
    inputs: LaneInputs,
    *,
    start_k: Array,
    mesh: Mesh = DEFAULT_MESH,
) -> LaneResult:
    """March *corners*, one a lane, under *inputs* from *start_k* (lanes,)."""
    lanes = Lanes(corners, effects, mesh)
    state = start_state(lanes, start_k)
    before = _total(state)
    steps = len(inputs.step_s)
    kept = int(inputs.keep.sum())
    record = _Record(lanes, kept)
    power = np.empty((steps, lanes.count))
    friction = np.empty((steps, lanes.count))
    heat_in = np.zeros(lanes.count)
    heat_out = np.zeros(lanes.count)
    ones = np.ones(lanes.count)
    varies = _friction_varies(effects)
    for i, dt in enumerate(inputs.step_s.tolist()):
        row = _row(inputs, i)
        factor = ones
        if varies:
            factor = friction_factor(
                lanes, state, row.speed_ms, row.pressure_pa
            )
            row = _with_friction(row, factor, inputs.corners_per_car)
        friction[i] = factor
        power[i] = row.power_w
        state, gained, lost = _step(lanes, state, row, dt)
        heat_in += gained
        heat_out += lost
        if inputs.keep[i]:
            record.add(state)
    return LaneResult(
        np.cumsum(inputs.step_s)[inputs.keep],
        record.nodes(),
        power,
        friction,
        _total(state) - before,
        heat_in,
        heat_out,
        state,
    )


def _friction_varies(effects: Sequence[Effects]) -> bool:
    return any(
        e.friction_fade
        or e.friction_speed
        or e.friction_pressure
        or e.friction_history
        for e in effects
    )


def _total(state: State) -> Array:
    total: Array = state.chain_j.sum(axis=(0, 1)) + state.lump_j.sum(axis=0)
    return total


def _row(inputs: LaneInputs, i: int) -> Inputs:
    return Inputs(
        inputs.speed_ms[i],
        inputs.power_w[i],
        inputs.pressure_pa[i],
        inputs.contact[i],
        inputs.ambient_k[i],
        inputs.wetness[i],
        inputs.pumping_pa_s[i],
    )


def _with_friction(row: Inputs, factor: Array, per_car: int) -> Inputs:
    actual = row.power_w * factor
    if not per_car:
        return replace(row, power_w=actual)
    nominal = np.broadcast_to(row.power_w, factor.shape)
    demanded = nominal.reshape(-1, per_car).sum(axis=1)
    reached = actual.reshape(-1, per_car).sum(axis=1)
    raised = np.divide(
        demanded, reached, out=np.ones_like(demanded), where=reached > 0
    )
    scale = np.repeat(raised, per_car)
    return replace(
        row, power_w=actual * scale, pressure_pa=row.pressure_pa * scale
    )


def _step(
    lanes: Lanes, state: State, inputs: Inputs, dt: float
) -> tuple[State, Array, Array]:
    """One extrapolated step; returns state, heat in and heat out [J]."""
    here = paths(lanes, state, inputs)
    whole, out_whole = _euler(lanes, state, here, inputs, dt)
    half, out_first = _euler(lanes, state, here, inputs, dt / 2)
    there = paths(lanes, half, inputs)
    fine, out_second = _euler(lanes, half, there, inputs, dt / 2)
    chain_j = 2 * fine.chain_j - whole.chain_j
    lump_j = 2 * fine.lump_j - whole.lump_j
    after = _settle(lanes, fine, chain_j, lump_j)
    lost = 2 * (out_first + out_second) - out_whole
    gained = dt * there.heat_in_w
    after.friction_j = state.friction_j + gained
    if lanes.chars:
        lost += wear.pyrolyse(lanes, after, dt)
    if lanes.wears:
        lost += wear.wear_pads(lanes, after, gained)
    return after, gained, lost


def _euler(
    lanes: Lanes, state: State, here: Paths, inputs: Inputs, dt: float
) -> tuple[State, Array]:
    """One linearly implicit step; returns state and heat out [J]."""
    chain_k, lump_k = state.chain_k, state.lump_k
    ambient = inputs.ambient_k
    surface = lanes.surface
    at_ports = chain_k[lanes.ports].transpose(2, 1, 0).reshape(-1, 6)
    lumps_first = lump_k.T
    to_lumps = here.coupling.sum(axis=2)
    from_ports = here.coupling.sum(axis=1)

    flow = here.link * (chain_k[1:] - chain_k[:-1])
    gain = here.chain_source.copy()
    gain[:-1] += flow
    gain[1:] -= flow
    port_gain = (here.coupling @ lumps_first[:, :, None])[:, :, 0]
    port_gain -= to_lumps * at_ports
    gain[lanes.ports] += port_gain.reshape(-1, 2, 3).T
    gain[surface] -= here.surface_out * (chain_k[surface] - ambient)
    lump_gain = (at_ports[:, None, :] @ here.coupling)[:, 0, :]
    lump_gain -= from_ports * lumps_first
    lump_gain -= (here.between @ lumps_first[:, :, None])[:, :, 0]
    lump_gain = lump_gain.T - here.lump_out * (lump_k - ambient)

    capacity, lump_capacity = here.chain_capacity, here.lump_capacity
    diagonal = capacity.copy()
    diagonal[:-1] += dt * here.link
    diagonal[1:] += dt * here.link
    diagonal[lanes.ports] += dt * to_lumps.reshape(-1, 2, 3).T
    diagonal[surface] += dt * here.surface_out
    matrix = dt * here.between
    index = np.arange(len(LUMPS))
    matrix[:, index, index] += (
        lump_capacity + dt * here.lump_out
    ).T + dt * from_ports
    rise, lump_rise = solve_arrow(
        Arrow(
            diagonal,
            dt * here.link,
            dt * here.coupling,
            matrix,
            lanes.ports,
        ),
        dt * gain,
        dt * lump_gain,
    )
    settled = _settle(
        lanes,
        replace(state, chain_k=chain_k + rise, lump_k=lump_k + lump_rise),
        state.chain_j + capacity * rise,
        state.lump_j + lump_capacity * lump_rise,
    )
    out = here.surface_out * (chain_k[surface] + rise[surface] - ambient)
    lump_out = here.lump_out * (lump_k + lump_rise - ambient)
    lost = out.sum(axis=0) + lump_out.sum(axis=0) + here.heat_in_w
    lost -= here.chain_source.sum(axis=(0, 1))
    return settled, dt * lost


def _settle(lanes: Lanes, near: State, chain_j: Array, lump_j: Array) -> State:
    """Return the state with these energies; *near* starts the iteration.

    Two Newton steps: the start is already within a step's curvature, and
    the energies stay the truth.
    """
    p = lanes.p
    chain_k = materials.REFERENCE_K + chain_j / lanes.backplate_j_k
    pad_j_kg = chain_j[lanes.pad] / lanes.pad_kg(near)
    if lanes.variable_pad:
        chain_k[lanes.pad] = materials.lining_temperature(
            pad_j_kg,
            near.chain_k[lanes.pad],
            p.pad_heat_capacity_j_kgk,
            p.pad_capacity,
        )
    else:
        chain_k[lanes.pad] = (
            materials.REFERENCE_K + pad_j_kg / p.pad_heat_capacity_j_kgk
        )
    chain_k[lanes.cheek] = materials.iron_temperature(
        chain_j[lanes.cheek] / lanes.cheek_kg,
        near.chain_k[lanes.cheek],
        lanes.bump,
    )
    lump_k = near.lump_k.copy()
    lump_k[HAT:] = materials.REFERENCE_K + lump_j[HAT:] / lanes.lump_j_k[HAT:]
    lump_k[CENTRE] = materials.iron_temperature(
        lump_j[CENTRE] / lanes.centre_kg, near.lump_k[CENTRE], lanes.bump
    )
    if lanes.boils:
        lump_k[FLUID] = lanes.fluid_temperature(
            lump_j[FLUID], near.lump_k[FLUID]
        )
    return replace(
        near, chain_k=chain_k, lump_k=lump_k, chain_j=chain_j, lump_j=lump_j
    )


class _Record:
    """Kept temperatures of a march."""

    def __init__(self, lanes: Lanes, kept: int) -> None:
        self._lanes = lanes
        self._chain = np.empty((kept, lanes.chain_nodes, 2, lanes.count))
        self._lumps = np.empty((kept, len(LUMPS), lanes.count))
        self._row = 0

    def add(self, state: State) -> None:
        self._chain[self._row] = state.chain_k
        self._lumps[self._row] = state.lump_k
        self._row += 1

    def nodes(self) -> dict[str, Array]:
        lanes = self._lanes
        cheek = self._chain[:, lanes.cheek]
        ring_kg = lanes.cheek_kg.sum(axis=0) * 2 + lanes.centre_kg
        mean = (cheek * lanes.cheek_kg).sum(axis=(1, 2))
        mean += self._lumps[:, CENTRE] * lanes.centre_kg
        depths = np.array(lanes.mesh.cheek_depths)
        layer = int(np.argmin(np.abs(depths - _MEASURED_DEPTH)))
        nodes = {
            "disc": cheek[:, layer, 1],
            "disc_2": cheek[:, layer, 0],
            "disc_mean": mean / ring_kg,
            "disc_surface": cheek[:, 0, 1],
            "pad_front": self._chain[:, lanes.surface - 1, 0],
            "pad_back": self._chain[:, 1, 0],
            "pad_front_outer": self._chain[:, lanes.surface - 1, 1],
            "pad_back_outer": self._chain[:, 1, 1],
            "backplate": self._chain[:, 0, 0],
            "fluid": self._lumps[:, FLUID],
            "caliper": self._lumps[:, BODY],
        }
        for index, name in enumerate(LUMPS):
            if index not in (FLUID, BODY, AIR):
                nodes[name] = self._lumps[:, index]
        nodes["air"] = self._lumps[:, AIR]
        return nodes
