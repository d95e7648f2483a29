"""Settling time: how long an unknown start affects a brake."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from typing import Final

from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.program import Program
from bstm_daemon.native.loader import Kernel

HOT_START_K: Final = 150.0
SETTLED_K: Final = 5.0
"""An unknown start has no effect any more once a parked brake that began
``HOT_START_K`` above the air would be within ``SETTLED_K`` of it."""

STEP_S: Final = 60.0
LONGEST_SETTLING_S: Final = 24 * 3600.0
"""Limit of the settling time: the march in coarse steps ends after a day."""


def settling_time_s(
    programs: Iterable[Program],
    parked: array[float],
    air_k: float,
    kernel: Kernel | None,
) -> float:
    """Return how long the slowest of *programs* remembers a hot start [s].

    Args:
        programs: one per corner.
        parked: a row of channels of a parked corner.
        air_k: ambient temperature [K].
        kernel: the compiled one; None runs the reference.
    """
    return max(
        (
            cooling_time_s(
                Batch([program], air_k + HOT_START_K, [0], kernel, 1),
                parked,
                air_k,
            )
            for program in programs
        ),
        default=0.0,
    )


def cooling_time_s(batch: Batch, parked: array[float], air_k: float) -> float:
    """Return how long *batch* takes to be within ``SETTLED_K`` of the air [s].

    It is as if parked meanwhile; its state is as before.

    Args:
        batch: brakes.
        parked: a row of channels of a parked corner.
        air_k: ambient temperature [K].
    """
    state, ledger = batch.state[:], batch.ledger[:]
    elapsed_s = 0.0
    while (
        elapsed_s < LONGEST_SETTLING_S
        and _hottest_k(batch) >= air_k + SETTLED_K
    ):
        batch.march(parked * batch.sets, 1, STEP_S)
        elapsed_s += STEP_S
    batch.state[:], batch.ledger[:] = state, ledger
    return elapsed_s


def _hottest_k(batch: Batch) -> float:
    return max(
        max(batch.state[batch.part(member)][: len(program.network.nodes)])
        for member, program in enumerate(batch.programs)
    )
