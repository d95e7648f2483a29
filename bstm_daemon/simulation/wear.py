"""One-way changes of the linings: pyrolysis and wear.

Both run once a step, explicitly; both return the heat that left the corner.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.simulation import materials

if TYPE_CHECKING:
    from bstm_daemon.simulation.lanes import Lanes, State
    from bstm_daemon.simulation.materials import Array

_PYROLYSIS_J_KG = 2.0e5
_PYROLYSIS_RATE_S = 2.0e5
_PYROLYSIS_ACTIVATION_K = 1.15e4

# what the rivets and the warning plate leave
_LAST_M = 1.0e-3
_WEAR_M_PER_J = 1e-3 / 6.0e7
_WEAR_RISE_K = 120.0
_WEAR_RISE_FROM_K = 593.15


def pyrolyse(lanes: Lanes, state: State, dt: float) -> Array:
    """Char the linings for *dt*; returns the heat taken up [J], (lanes,).

    First-order Arrhenius reaction of the binder, in place.
    """
    pad = lanes.pad
    rate = _PYROLYSIS_RATE_S * np.exp(
        -_PYROLYSIS_ACTIVATION_K / state.chain_k[pad]
    )
    reacted = -(1.0 - state.char) * np.expm1(-rate * dt)
    reacted = np.where(lanes.p.pad_pyrolysis > 0, reacted, 0.0)
    taken = (
        lanes.p.pad_pyrolysis * _PYROLYSIS_J_KG * lanes.pad_kg(state) * reacted
    )
    state.char = state.char + reacted
    state.chain_j[pad] -= taken
    state.chain_k[pad] -= taken / lanes.chain_capacity(state)[pad]
    total: Array = taken.sum(axis=(0, 1))
    return total


def wear_pads(lanes: Lanes, state: State, friction_j: Array) -> Array:
    """Wear the linings by *friction_j* [J]; returns heat with the dust [J].

    Wear per joule is constant below 320 degC and rises steeply above. The
    nodes move with the surface: material passes from node to node towards
    the front with its enthalpy, and the front's leaves.
    """
    p = lanes.p
    pad = lanes.pad
    front_k = state.chain_k[lanes.surface - 1]
    hot = np.exp(
        np.minimum(np.maximum(front_k - _WEAR_RISE_FROM_K, 0.0), 400.0)
        / _WEAR_RISE_K
    )
    loss_m = np.minimum(
        p.pad_wear * _WEAR_M_PER_J * friction_j * hot,
        np.maximum(state.pad_m - _LAST_M, 0.0),
    )
    kg_per_m = p.pad_density_kg_m3 * p.pad_area_m2
    faces = np.arange(lanes.mesh.pad_nodes) + 0.5
    faces[-1] = lanes.mesh.pad_nodes - 1
    share = (faces / (lanes.mesh.pad_nodes - 1))[:, None, None]
    specific = state.chain_j[pad] / lanes.pad_kg(state)
    carried = share * kg_per_m * loss_m * specific
    state.chain_j[pad] -= carried
    state.chain_j[pad.start + 1 : pad.stop] += carried[:-1]
    state.pad_m = state.pad_m - loss_m
    mean = state.chain_j[pad] / lanes.pad_kg(state)
    if lanes.variable_pad:
        state.chain_k[pad] = materials.lining_temperature(
            mean,
            state.chain_k[pad],
            p.pad_heat_capacity_j_kgk,
            p.pad_capacity,
        )
    else:
        state.chain_k[pad] = (
            materials.REFERENCE_K + mean / p.pad_heat_capacity_j_kgk
        )
    total: Array = carried[-1].sum(axis=0)
    return total
