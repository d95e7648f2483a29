"""The reality's march in C, where the extension could be built.

Same maths as :func:`bstm_daemon.simulation.reality.march_numpy`, agreeing
with it to rounding; about a hundred times as fast for the corners of one car.
"""

from __future__ import annotations

import os
from dataclasses import fields
from typing import TYPE_CHECKING, cast

import numpy as np

from bstm_daemon.native.loader import VARIABLE, load_module
from bstm_daemon.simulation.lanes import LUMPS, PARAMETER_NAMES
from bstm_daemon.simulation.march import INPUT_NAMES, March, empty_march

if TYPE_CHECKING:
    from types import ModuleType

    from bstm_daemon.simulation.lanes import Lanes, State
    from bstm_daemon.simulation.march import LaneInputs
    from bstm_daemon.simulation.materials import Array


def extension() -> ModuleType | None:
    """Return the compiled march, None where NumPy has to do.

    That is where it is not built, and with ``BSTM_KERNEL=reference``.

    Raises:
        UsageError: it was built from other sources than these.
    """
    if os.environ.get(VARIABLE) == "reference":
        return None
    found = cast("ModuleType | None", load_module("simulation._reality"))
    # the table's rows are named on both sides
    if found is not None and found.parameter_names() != PARAMETER_NAMES:
        return None
    return found


def march_compiled(
    reality: ModuleType, lanes: Lanes, state: State, inputs: LaneInputs
) -> March:
    """March *lanes* from *state* under *inputs* with the extension *reality*.

    Raises :class:`ValueError` for a mesh beyond the compiled limit.
    """
    march = empty_march(lanes, state, inputs)
    steps, count = len(inputs.step_s), lanes.count
    rows = np.empty((steps, len(INPUT_NAMES), count))
    for index, name in enumerate(INPUT_NAMES):
        rows[:, index] = getattr(inputs, name)
    packed = _pack(state, count)
    nodes = 2 * lanes.chain_nodes
    record = np.empty((len(march.chain_k), count, nodes + len(LUMPS)))
    ledger = np.zeros((2, count))
    reality.march(
        np.ascontiguousarray(lanes.table),
        np.array(lanes.mesh.cheek_depths),
        np.ascontiguousarray(inputs.step_s, dtype=np.float64),
        np.ascontiguousarray(inputs.keep, dtype=np.uint8),
        rows,
        packed,
        record,
        march.power_w,
        march.friction,
        ledger,
        lanes.mesh.pad_nodes,
        inputs.corners_per_car,
    )
    chain = record[:, :, :nodes].reshape(len(record), count, 2, -1)
    march.chain_k = chain.transpose(0, 3, 2, 1)
    march.lump_k = record[:, :, nodes:].transpose(0, 2, 1)
    march.heat_in_j, march.heat_out_j = ledger
    march.state = _unpack(packed, state)
    return march


def _members(state: State) -> list[Array]:
    """Members of *state* in the order of a packed row."""
    return [getattr(state, field.name) for field in fields(state)]


def _pack(state: State, count: int) -> Array:
    """Return *state* lane by lane: (lanes, values)."""
    return np.ascontiguousarray(
        np.concatenate(
            [member.T.reshape(count, -1) for member in _members(state)],
            axis=1,
        )
    )


def _unpack(packed: Array, like: State) -> State:
    """Return the state that :func:`_pack` packed, shaped as *like*."""
    members, start = [], 0
    for member in _members(like):
        size = member.size // len(packed)
        part = packed[:, start : start + size]
        members.append(part.reshape(member.T.shape).T.copy())
        start += size
    return type(like)(*members)
