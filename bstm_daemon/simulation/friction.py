"""Friction of the reality: how far mu departs from its nominal value.

The forms are an S-shaped fade with temperature, a power law in speed and
pressure (Rhee 1974) and a bedding that saturates with the friction energy.
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
_SPEED_EXPONENT = -0.08
_PRESSURE_EXPONENT = -0.06
_REFERENCE_SPEED_MS = 10.0
_REFERENCE_PRESSURE_PA = 1.0e6
_BEDDING_GAIN = 0.15
_BEDDING_J = 6.0e6


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
    v = np.maximum(speed_ms, 0.5) / _REFERENCE_SPEED_MS
    pressure = np.maximum(pressure_pa, 5e4) / _REFERENCE_PRESSURE_PA
    bedded = -np.expm1(-state.friction_j / _BEDDING_J)
    factor: Array = (
        fade
        * v ** (_SPEED_EXPONENT * p.friction_speed)
        * pressure ** (_PRESSURE_EXPONENT * p.friction_pressure)
        * (1.0 + _BEDDING_GAIN * p.friction_history * bedded)
    )
    return factor
