"""Interface of estimator and wear: reads doses, installs worn networks."""

from __future__ import annotations

from array import array
from math import isfinite
from typing import TYPE_CHECKING

from bstm_daemon.model.thermal.regrid import follow_wear, heat_above_j
from bstm_daemon.model.wear.dose import DISTANCE, DOSE
from bstm_daemon.model.wear.pads import Change

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.model.thermal.kernel import Batch
    from bstm_daemon.model.thermal.program import Program


def exchange(
    batch: Batch, member: int, program: Program, change: Change, air_k: float
) -> float:
    """Replace the network of *member* of *batch* by *program*, after *change*.

    Worn material leaves with its heat; new linings are at air temperature; a
    corrected estimate of wear moves no heat. NaN temperatures stay NaN: such
    an estimate is invalid and will be reset.

    Returns:
        The heat above *air_k* [K] that left the corner [J].
    """
    old = batch.programs[member].network
    first = member * batch.width
    last = first + len(old.nodes)
    before = batch.state[first:last]
    batch.replace(member, program)
    if change is Change.CORRECTED or not isfinite(sum(before)):
        return 0.0
    if change is Change.FITTED:
        after = [
            air_k if node.name.startswith("pad_") else kelvin
            for node, kelvin in zip(old.nodes, before, strict=True)
        ]
    else:
        after = follow_wear(old, program.network, before)
    batch.state[first:last] = array("d", after)
    return heat_above_j(old, before, air_k) - heat_above_j(
        program.network, after, air_k
    )


def keep_totals(
    fresh: array[float], names: Sequence[str], state: Sequence[float]
) -> None:
    """Put the doses of *state* into *fresh*, a start of the same *names*.

    The dose is kept even if temperatures are unknown.
    """
    for key in (DOSE, DISTANCE):
        at = names.index(key)
        if state[at] >= 0.0:  # nan is not
            fresh[at] = state[at]
