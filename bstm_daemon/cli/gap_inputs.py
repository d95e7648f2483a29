"""Whether recorded drives have what ``bstm gap`` forms its heat from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.heat import needs

if TYPE_CHECKING:
    from collections.abc import Iterable

    from bstm_daemon.gap.recording import Recording


def check_heat_inputs(recordings: Iterable[Recording], heat_mode: str) -> None:
    """Refuse a drive without a sample of what *heat_mode* needs.

    Raises:
        LogError: roles of an input are mapped, and the log has none of them.
    """
    for one in recordings:
        needs.check_heat_inputs(one.name, _seen(one), one.present, heat_mode)


def check_force_inputs(recordings: Iterable[Recording]) -> None:
    """Refuse a drive without a sample of pressure or of motion.

    Raises:
        LogError: roles of an input are mapped, and the log has none of them.
    """
    for one in recordings:
        needs.check_inputs(
            one.name,
            _seen(one),
            one.present,
            needs.INPUTS["ff"],
            "pressure against motion",
        )


def _seen(recording: Recording) -> set[int]:
    return set(np.unique(recording.events.role).tolist())
