"""The reality: marching brake corners through time.

Linearly implicit Euler in the nodes' energies with one Richardson
extrapolation (two half steps against one whole step): second order, damping
stiff cells fully at any step. Conductances are frozen at the start of each
Euler step and every flow is booked on both of its ends, so the energy balance
closes to rounding whatever the step.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.simulation import compiled, materials
from bstm_daemon.simulation.lanes import (
    CENTRE,
    FLUID,
    HAT,
    Lanes,
    State,
    start_state,
)
from bstm_daemon.simulation.linings import friction_factor, pyrolyse, wear_pads
from bstm_daemon.simulation.march import (
    Inputs,
    LaneInputs,
    LaneResult,
    March,
    empty_march,
    lane_result,
    total_energy,
)
from bstm_daemon.simulation.network import Paths, paths
from bstm_daemon.simulation.parameters import DEFAULT_MESH

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.simulation.materials import Array
    from bstm_daemon.simulation.parameters import (
        CornerParameters,
        Effects,
        Mesh,
    )


def march_lanes(
    corners: Sequence[CornerParameters],
    effects: Sequence[Effects],
    inputs: LaneInputs,
    *,
    start_k: Array,
    mesh: Mesh = DEFAULT_MESH,
) -> LaneResult:
    """March *corners*, one a lane, under *inputs* from *start_k* (lanes,).

    Runs compiled where the extension is, with NumPy otherwise.
    """
    lanes = Lanes(corners, effects, mesh)
    state = start_state(lanes, start_k)
    before_j = total_energy(state)
    reality = compiled.extension()
    if reality is None:
        march = march_numpy(lanes, state, inputs)
    else:
        march = compiled.march_compiled(reality, lanes, state, inputs)
    return lane_result(lanes, march, inputs, before_j)


def march_numpy(lanes: Lanes, state: State, inputs: LaneInputs) -> March:
    """March *lanes* from *state* under *inputs* with whole-array steps."""
    march = empty_march(lanes, state, inputs)
    varies = lanes.friction_varies
    row_kept = 0
    for i, dt in enumerate(inputs.step_s.tolist()):
        row = inputs.at(i)
        factor = np.ones(lanes.count)
        if varies:
            factor = friction_factor(
                lanes, state, row.speed_ms, row.pressure_pa
            )
            row = _with_friction(row, factor, inputs.corners_per_car)
        march.friction[i] = factor
        march.power_w[i] = row.power_w
        state, gained, lost = _step(lanes, state, row, dt)
        march.heat_in_j += gained
        march.heat_out_j += lost
        if inputs.keep[i]:
            march.chain_k[row_kept] = state.chain_k
            march.lump_k[row_kept] = state.lump_k
            row_kept += 1
    march.state = state
    return march


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
        lost += pyrolyse(lanes, after, dt)
    if lanes.wears:
        lost += wear_pads(lanes, after, gained)
    return after, gained, lost


def _euler(
    lanes: Lanes, state: State, here: Paths, inputs: Inputs, dt: float
) -> tuple[State, Array]:
    """One linearly implicit step; returns state and heat out [J]."""
    excess = lanes.joined(state.chain_k, state.lump_k)
    excess -= inputs.ambient_k[:, None]
    gain_w = here.source_w - (here.conductance @ excess[:, :, None])[:, :, 0]
    matrix = dt * here.conductance
    own = np.arange(lanes.nodes)
    matrix[:, own, own] += here.capacity_j_k
    found = np.linalg.solve(matrix, dt * gain_w[:, :, None])
    rise = np.asarray(found[:, :, 0], np.float64)

    chain_rise, lump_rise = lanes.split(rise)
    chain_gain, lump_gain = lanes.split(here.capacity_j_k * rise)
    settled = _settle(
        lanes,
        replace(
            state,
            chain_k=state.chain_k + chain_rise,
            lump_k=state.lump_k + lump_rise,
        ),
        state.chain_j + chain_gain,
        state.lump_j + lump_gain,
    )
    # heat of other parts is a loss below 0: friction is all that comes in
    lost = (here.to_ambient * (excess + rise) - here.source_w).sum(axis=1)
    return settled, dt * (lost + here.heat_in_w)


def _settle(lanes: Lanes, near: State, chain_j: Array, lump_j: Array) -> State:
    """Return the state with these energies; *near* starts the iteration.

    Two Newton steps: the start is already within a step's curvature, and
    the energies stay the truth.
    """
    chain_k = materials.REFERENCE_K + chain_j / lanes.backplate_j_k
    pad_j_kg = chain_j[lanes.pad] / lanes.pad_kg(near)
    chain_k[lanes.pad] = lanes.lining_temperature(
        pad_j_kg, near.chain_k[lanes.pad]
    )
    chain_k[lanes.cheek] = materials.iron_temperature(
        chain_j[lanes.cheek] / lanes.cheek_kg,
        near.chain_k[lanes.cheek],
        *lanes.iron,
    )
    lump_k = near.lump_k.copy()
    lump_k[HAT:] = materials.REFERENCE_K + lump_j[HAT:] / lanes.lump_j_k[HAT:]
    lump_k[CENTRE] = materials.iron_temperature(
        lump_j[CENTRE] / lanes.centre_kg, near.lump_k[CENTRE], *lanes.iron
    )
    if lanes.boils:
        lump_k[FLUID] = lanes.fluid_temperature(
            lump_j[FLUID], near.lump_k[FLUID]
        )
    return replace(
        near, chain_k=chain_k, lump_k=lump_k, chain_j=chain_j, lump_j=lump_j
    )
