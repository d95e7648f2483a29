"""Changes of the linings: friction, pyrolysis and wear.

The forms of friction are an S-shaped fade with temperature, falls with speed
and pressure that level off, and a bedding that runs out hyperbolically with
the friction energy. Pyrolysis and wear are one-way: both run once a step,
explicitly, and return the heat that left the corner.
"""

import numpy as np

from bstm_daemon.simulation import sizes
from bstm_daemon.simulation.lanes import Lanes, State
from bstm_daemon.simulation.materials import Array


def friction_factor(
    lanes: Lanes, state: State, speed_ms: Array, pressure_pa: Array
) -> Array:
    """Return mu over its nominal value, shape (lanes,)."""
    p = lanes.p
    surfaces = state.chain_k[lanes.surface - 1 : lanes.surface + 1]
    t = surfaces.mean(axis=(0, 1))
    fade = 1.0 - sizes.FADE_DEPTH * p.friction_fade / (
        1.0 + np.exp((sizes.FADE_CENTRE_K - t) / sizes.FADE_WIDTH_K)
    )
    v = (speed_ms - sizes.REFERENCE_SPEED_MS) / (
        speed_ms + sizes.REFERENCE_SPEED_MS
    )
    pressure = (pressure_pa - sizes.REFERENCE_PRESSURE_PA) / (
        pressure_pa + 2 * sizes.REFERENCE_PRESSURE_PA
    )
    bedded = state.friction_j / (state.friction_j + sizes.BEDDING_J)
    factor = (
        fade
        * (1.0 - sizes.SPEED_FALL * p.friction_speed * v)
        * (1.0 - sizes.PRESSURE_FALL * p.friction_pressure * pressure)
        * (1.0 - sizes.BEDDING_FALL * p.friction_history * bedded)
    )
    least: Array = np.maximum(factor, sizes.LEAST_FACTOR)
    return least


def pyrolyse(lanes: Lanes, state: State, dt: float) -> Array:
    """Char the linings for *dt*; returns the heat taken up [J], (lanes,).

    First-order Arrhenius reaction of the binder, in place.
    """
    pad = lanes.pad
    rate = sizes.PYROLYSIS_RATE_S * np.exp(
        -sizes.PYROLYSIS_ACTIVATION_K / state.chain_k[pad]
    )
    reacted = -(1.0 - state.char) * np.expm1(-rate * dt)
    reacted = np.where(lanes.p.pad_pyrolysis > 0, reacted, 0.0)
    taken = (
        lanes.p.pad_pyrolysis
        * sizes.PYROLYSIS_J_KG
        * lanes.pad_kg(state)
        * reacted
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
        np.minimum(
            np.maximum(front_k - sizes.WEAR_RISE_FROM_K, 0.0),
            sizes.WEAR_RISE_MOST_K,
        )
        / sizes.WEAR_RISE_K
    )
    loss_m = np.minimum(
        p.pad_wear * sizes.WEAR_M_PER_J * friction_j * hot,
        np.maximum(state.pad_m - sizes.LAST_M, 0.0),
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
    state.chain_k[pad] = lanes.lining_temperature(mean, state.chain_k[pad])
    total: Array = carried[-1].sum(axis=0)
    return total
