"""Brake hydraulics: from the driver's demand to the wheels and back.

Two circuits cross the car: FL and RR are on the primary piston, FR and RL on
the secondary one, which the primary pushes and which therefore lags.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.simulation.profile import SAMPLE_S

if TYPE_CHECKING:
    from bstm_daemon.simulation.materials import Array
    from bstm_daemon.simulation.parameters import Effects

SECONDARY: Final = np.array([False, True, True, False])
"""Corners on the secondary circuit: FR and RL."""

MODULATION_HZ: Final = 4.0
"""Cycles of the anti-lock system; whole ones in a step of the reality."""

# typical size of the effects that act here
_PUSHOUT_PA = 1.0e5
_LAG_S = 0.15


def wheel_pressures(
    demand_pa: Array, gains: Array, effects: Effects, *, modulation: Array
) -> Array:
    """Return the pressures [Pa] that press the pads, (n, 4).

    Whatever the circuits and the anti-lock system do, the four together brake
    as *demand_pa* (n,) at every wheel would. *gains* [N/Pa] (4,).
    """
    pressures = np.repeat(demand_pa[:, None], len(gains), axis=1)
    if effects.hydraulic_lag > 0:
        late = _second_circuit(demand_pa, gains, effects.hydraulic_lag)
        force = demand_pa * gains.sum() - late * gains[SECONDARY].sum()
        early = force / gains[~SECONDARY].sum()
        pressures = np.where(SECONDARY, late[:, None], early[:, None])
    if modulation.any():
        phase = (
            2 * np.pi * MODULATION_HZ * SAMPLE_S * np.arange(len(demand_pa))
        )
        swing = modulation * np.sin(phase)
        sides = np.array([1.0, -1.0, 1.0, -1.0])
        pressures = pressures * (1.0 + swing[:, None] * sides)
        total = pressures @ gains
        wanted = demand_pa * gains.sum()
        pressures *= np.divide(
            wanted, total, out=np.ones_like(total), where=total > 0
        )[:, None]
    return pressures


def _second_circuit(demand_pa: Array, gains: Array, strength: float) -> Array:
    """Return the secondary circuit's pressure behind the primary's.

    It follows the primary with a lag while the force of both is given; on
    release both end together.
    """
    primary = gains[~SECONDARY].sum() / gains.sum()
    decay = np.exp(-SAMPLE_S / (_LAG_S * strength * primary))
    late = np.empty_like(demand_pa)
    last = float(demand_pa[0])
    most = 1.0 / (1.0 - primary)
    for index, demand in enumerate(demand_pa.tolist()):
        last = min(demand + (last - demand) * decay, demand * most)
        late[index] = last
    return late


def line_pressure(clamp_pa: Array, effects: Effects) -> Array:
    """Return the primary pressure [Pa] in front of the clamping pressure.

    Push-out has to be overcome before pads are pressed: the seals give way
    bit by bit. With hydraulic lag the pads follow the line, so it leads.
    """
    line = clamp_pa
    if effects.pushout_pressure > 0:
        most = _PUSHOUT_PA * effects.pushout_pressure
        line = line - most * np.expm1(-clamp_pa / (0.5 * most))
    if effects.hydraulic_lag > 0:
        lead = np.gradient(clamp_pa, SAMPLE_S)
        line = line + _LAG_S * effects.hydraulic_lag * lead
    return np.maximum(line, 0.0)
