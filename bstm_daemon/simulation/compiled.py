"""The reality's march in C, where the extension could be built.

Same maths as :func:`bstm_daemon.simulation.reality.march_numpy`, agreeing
with it to rounding; some 70 times as fast for the corners of one car.
"""

from __future__ import annotations

import os
from dataclasses import fields
from typing import TYPE_CHECKING, Final, cast

import numpy as np

from bstm_daemon.native.loader import VARIABLE, load_module
from bstm_daemon.simulation.lanes import LUMPS, PARAMETER_NAMES, PATH_NAMES
from bstm_daemon.simulation.march import INPUT_NAMES, March, empty_march
from bstm_daemon.simulation.parameters import DRAWN

if TYPE_CHECKING:
    from types import ModuleType

    from bstm_daemon.simulation.lanes import Lanes, State
    from bstm_daemon.simulation.march import LaneInputs

MAX_NODES: Final = 128
"""Nodes of a chain in the compiled form."""

CORNER: Final = np.dtype(
    [
        ("table", np.float64, len(PARAMETER_NAMES)),
        ("drawn", np.float64, (DRAWN, len(PATH_NAMES))),
        ("cheek_kg", np.float64, MAX_NODES),
        ("gap_m", np.float64, MAX_NODES),
        ("centre_kg", np.float64),
        ("backplate_j_k", np.float64),
        ("lump_j_k", np.float64, len(LUMPS)),
        *((name, np.int32) for name in ("pads", "cheeks", "nodes", "surface")),
    ]
)
STATE: Final = np.dtype(
    [
        ("chain_k", np.float64, (2, MAX_NODES)),
        ("lump_k", np.float64, len(LUMPS)),
        ("chain_j", np.float64, (2, MAX_NODES)),
        ("lump_j", np.float64, len(LUMPS)),
        ("pad_m", np.float64, 2),
        ("char", np.float64, (2, MAX_NODES)),
        ("friction_j", np.float64),
    ]
)
"""``Corner`` and ``State`` of ``_reality_paths.h``, named as in ``lanes``."""


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
    if found is not None and found.PARAMETERS.split() != [*PARAMETER_NAMES]:
        return None
    return found


def march_compiled(
    reality: ModuleType, lanes: Lanes, state: State, inputs: LaneInputs
) -> March:
    """March *lanes* from *state* under *inputs* with the extension *reality*.

    Raises :class:`ValueError` for a mesh beyond the compiled limit.
    """
    if lanes.chain_nodes > MAX_NODES:
        msg = f"a mesh has at most {MAX_NODES} nodes a side"
        raise ValueError(msg)
    march = empty_march(lanes, state, inputs)
    steps, count = len(inputs.step_s), lanes.count
    rows = np.empty((steps, len(INPUT_NAMES), count))
    for index, name in enumerate(INPUT_NAMES):
        rows[:, index] = getattr(inputs, name)
    packed = np.zeros(count, STATE)
    members = [getattr(state, field.name) for field in fields(state)]
    places = [
        packed[field.name][..., : len(member)]
        for field, member in zip(fields(state), members, strict=True)
    ]
    for place, member in zip(places, members, strict=True):
        place[...] = member.T
    record = np.empty((len(march.chain_k), count, lanes.nodes))
    ledger = np.zeros((2, count))
    reality.march(
        _corners(lanes).view(np.uint8),
        np.ascontiguousarray(inputs.step_s, dtype=np.float64),
        np.ascontiguousarray(inputs.keep, dtype=np.uint8),
        rows,
        packed.view(np.uint8),
        record,
        march.power_w,
        march.friction,
        ledger,
        lanes.friction_varies,
        inputs.corners_per_car,
    )
    chain = record[:, :, : lanes.first_lump].reshape(len(record), count, 2, -1)
    march.chain_k = chain.transpose(0, 3, 2, 1)
    march.lump_k = record[:, :, lanes.first_lump :].transpose(0, 2, 1)
    march.heat_in_j, march.heat_out_j = ledger
    march.state = type(state)(*(place.T.copy() for place in places))
    return march


def _corners(lanes: Lanes) -> np.ndarray[tuple[int], np.dtype[np.void]]:
    """Return the constant data of each lane as C has it."""
    found = np.zeros(lanes.count, CORNER)
    cheeks = len(lanes.mesh.cheek_depths)
    found["table"] = lanes.table.T
    found["drawn"] = lanes.drawn
    found["cheek_kg"][:, :cheeks] = lanes.cheek_kg[:, 0].T
    found["gap_m"][:, :cheeks] = lanes.cheek_gap_m[:, 0].T
    found["centre_kg"] = lanes.centre_kg
    found["backplate_j_k"] = lanes.backplate_j_k
    found["lump_j_k"] = lanes.lump_j_k.T
    found["pads"], found["cheeks"] = lanes.mesh.pad_nodes, cheeks
    found["nodes"], found["surface"] = lanes.chain_nodes, lanes.surface
    return found
