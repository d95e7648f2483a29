"""Friction of the reality: how far mu departs from its nominal value.

The forms are an S-shaped fade with temperature, falls with speed and pressure
that level off, and a bedding that runs out hyperbolically with the friction
energy.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from bstm_daemon.simulation.lanes import Lanes, State
    from bstm_daemon.simulation.materials import Array


_FADE_DEPTH = 0.30
_FADE_CENTRE_K = 703.15
_FADE_WIDTH_K = 45.0
_SPEED_FALL = 0.18
_PRESSURE_FALL = 0.15
_REFERENCE_SPEED_MS = 10.0
_REFERENCE_PRESSURE_PA = 1.0e6
_BEDDING_FALL = 0.25
_BEDDING_J = 4.0e6
_LEAST_FACTOR = 0.05


def friction_factor(
    lanes: Lanes, state: State, speed_ms: Array, pressure_pa: Array
) -> Array:
    """Return mu over its nominal value, shape (lanes,)."""
    p = lanes.p
    surfaces = state.chain_k[lanes.surface - 1 : lanes.surface + 1]
    t = surfaces.mean(axis=(0, 1))
    fade = 1.0 - _FADE_DEPTH * p.friction_fade / (
        1.0 + np.exp((_FADE_CENTRE_K - t) / _FADE_WIDTH_K)
    )
    v = (speed_ms - _REFERENCE_SPEED_MS) / (speed_ms + _REFERENCE_SPEED_MS)
    pressure = (pressure_pa - _REFERENCE_PRESSURE_PA) / (
        pressure_pa + 2 * _REFERENCE_PRESSURE_PA
    )
    bedded = state.friction_j / (state.friction_j + _BEDDING_J)
    factor = (
        fade
        * (1.0 - _SPEED_FALL * p.friction_speed * v)
        * (1.0 - _PRESSURE_FALL * p.friction_pressure * pressure)
        * (1.0 - _BEDDING_FALL * p.friction_history * bedded)
    )
    least: Array = np.maximum(factor, _LEAST_FACTOR)
    return least
