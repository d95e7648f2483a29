"""Settling time: how long an unknown start affects a brake."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from bstm_daemon.model.thermal.kernel import Batch

if TYPE_CHECKING:
    from array import array
    from collections.abc import Iterable

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
    longest_s = 0.0
    for program in programs:
        batch = Batch([program], air_k + HOT_START_K, [0], kernel, 1)
        nodes = len(program.network.nodes)
        elapsed_s = 0.0
        while elapsed_s < LONGEST_SETTLING_S:
            batch.march(parked, 1, STEP_S)
            elapsed_s += STEP_S
            if max(batch.state[:nodes]) < air_k + SETTLED_K:
                break
        longest_s = max(longest_s, elapsed_s)
    return longest_s
