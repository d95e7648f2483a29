"""Whether a recorded drive has what ``bstm gap`` forms its heat from.

The estimator goes on without speed or pressure, as a car must: it takes what
it can get and calls the result degraded. A search for what the model lacks
would take the difference for an effect.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.errors import LogError
from bstm_daemon.report.gaps import INPUTS
from bstm_daemon.roles import ROLES

if TYPE_CHECKING:
    from collections.abc import Iterable

    from bstm_daemon.gap.recording import Recording


def check_heat_inputs(recordings: Iterable[Recording], heat_mode: str) -> None:
    """Refuse a drive without a sample of what *heat_mode* needs.

    Raises:
        LogError: roles of an input are mapped, and the log has none of them.
    """
    _check(recordings, INPUTS[heat_mode], f'heat mode "{heat_mode}"')


def check_force_inputs(recordings: Iterable[Recording]) -> None:
    """Refuse a drive without a sample of pressure or of motion.

    Raises:
        LogError: roles of an input are mapped, and the log has none of them.
    """
    _check(recordings, INPUTS["ff"], "pressure against motion")


def _check(
    recordings: Iterable[Recording], names: Iterable[str], user: str
) -> None:
    for one in recordings:
        seen = set(np.unique(one.events.role).tolist())
        for name in names:
            mapped = [n for n in one.present if name in ROLES[n].quantities]
            if mapped and seen.isdisjoint(mapped):
                roles = ", ".join(ROLES[n].name for n in sorted(mapped))
                msg = (
                    f"{one.name}: no {name} in this log (roles {roles}), "
                    f"which {user} needs"
                )
                raise LogError(msg)
