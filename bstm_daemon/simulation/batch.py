"""Marching a batch of brake corners: the entry for lanes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bstm_daemon.simulation import compiled
from bstm_daemon.simulation.lanes import Lanes, start_state
from bstm_daemon.simulation.march import lane_result, total_energy
from bstm_daemon.simulation.parameters import (
    DEFAULT_MESH,
    CornerParameters,
    Effects,
    Mesh,
)
from bstm_daemon.simulation.reality import march_numpy

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.simulation.march import LaneInputs, LaneResult
    from bstm_daemon.simulation.materials import Array


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
