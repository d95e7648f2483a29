"""Where a drive begins: measured nodes as measured, others beside them."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.heat.sample_plan import CHANNELS
from bstm_daemon.native import load_kernel
from bstm_daemon.thermal.kernel import Batch
from bstm_daemon.thermal.program import Program, compile_network

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

SETTLING_STEP_S: Final = 20.0
SETTLING_STEPS: Final = 60
"""Measured nodes are held so long for the others to follow."""


def settled(
    program: Program, held_k: Mapping[str, float], ambient_k: float
) -> dict[str, float]:
    """Return every node's temperature [K] as it settles in a parked car.

    Args:
        program: the corner.
        held_k: temperatures [K] of nodes that are known.
        ambient_k: of the air.
    """
    network = program.network
    nodes = [node.name for node in network.nodes]
    held = {node: k for node, k in held_k.items() if node in nodes}
    for node in held:
        network = network.with_forced(node)
    rows = np.zeros((SETTLING_STEPS, len(CHANNELS) + len(held)))
    rows[:, CHANNELS.index("ambient_k")] = ambient_k
    rows[:, len(CHANNELS) :] = list(held.values())
    batch = Batch(
        [compile_network(network)], ambient_k, kernel=load_kernel(), sets=1
    )
    batch.march(flat(rows), SETTLING_STEPS, SETTLING_STEP_S)
    return dict(zip(nodes, batch.state, strict=False))


def flat(rows: npt.NDArray[np.float64]) -> array[float]:
    """Return *rows* as the kernel takes them."""
    numbers = array("d")
    numbers.frombytes(rows.tobytes())
    return numbers
