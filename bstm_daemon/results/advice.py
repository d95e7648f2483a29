"""Columns of advice and requests from what was told at publications."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy.typing as npt

    from bstm_daemon.bus.publication_slow import AdviceSnapshot

    Column = npt.NDArray[np.float64]

ADVICE_COLUMNS: Final = (
    "advice_message",
    "advice_waiting_s",
    "advice_shift",
    "advice_gearbox",
    "advice_pedal_feel",
    "advice_isolation",
    "advice_assist",
    "advice_intervention",
)


def advice_columns(records: Iterable[AdviceSnapshot]) -> dict[str, Column]:
    """Return the columns of *records*, one a row; codes as in the frame."""
    rows = [
        (
            one.message,
            one.waiting_s,
            one.shift_advice,
            one.gearbox_request,
            one.pedal_feel,
            one.front_isolation,
            one.emergency_assist,
            one.intervention,
        )
        for one in records
    ]
    table = np.array(rows, np.float64)
    return dict(zip(ADVICE_COLUMNS, table.T, strict=True))
