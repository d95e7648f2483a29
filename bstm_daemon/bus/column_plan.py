"""The extraction plan as tables: what frame is whose, and where samples lie.

Made once of a :class:`~bstm_daemon.bus.signal_map.SignalMap`, for both forms
of :mod:`~bstm_daemon.bus.columns`: :mod:`~bstm_daemon.bus.plan_tables` as
NumPy's arrays. What the compiled pass does not know is left to NumPy.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from bstm_daemon.bus.column_values import MessageColumns
from bstm_daemon.bus.plan_tables import (
    FACTORS,
    OUTPUT_FIELDS,
    STANDARD_IDS,
    plan_tables,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from bstm_daemon.bus.signal_map import SignalMap

_MAPS_KEPT: Final = 8


class CompiledPlan(NamedTuple):
    """Outputs of the messages that the compiled pass knows.

    ``starts`` (messages + 1) is where each message's rows begin in
    ``outputs`` (n, 13) and ``factors`` (n, 6), as ``_extract.c`` has them;
    ``gaps`` are the raw values that an output's row says are no value.
    """

    starts: npt.NDArray[np.int64]
    outputs: npt.NDArray[np.int64]
    factors: npt.NDArray[np.float64]
    gaps: npt.NDArray[np.uint64]


@dataclass(frozen=True, slots=True)
class ColumnPlan:
    """A signal map as tables.

    ``standard`` has a row of 2048 ids for each bus and one without messages:
    the position of the message in ``messages``, or -1. ``extended`` are the
    rising keys (row * 2 ** 29 + id) of the messages ``extended_message``.
    ``lengths`` and ``sizes`` (the outputs) have one entry a message and a
    last one, 0. ``foreign`` are the messages that ``compiled`` has no rows
    for.
    """

    messages: tuple[MessageColumns, ...]
    standard: npt.NDArray[np.int32]
    extended: npt.NDArray[np.int64]
    extended_message: npt.NDArray[np.int32]
    lengths: npt.NDArray[np.int64]
    sizes: npt.NDArray[np.int64]
    compiled: CompiledPlan
    foreign: tuple[int, ...]

    def rows(self, bus_of_channel: Sequence[int]) -> npt.NDArray[np.int64]:
        """Return the row in ``standard`` of each channel, -1: not read."""
        return np.array([*bus_of_channel, -1], np.int64)


_made: Final[deque[tuple[SignalMap, ColumnPlan]]] = deque(maxlen=_MAPS_KEPT)


def column_plan(signal_map: SignalMap) -> ColumnPlan:
    """Return the tables of *signal_map*, those of the last few kept.

    A kept one holds its map, so that no other can take its identity.
    """
    for known, plan in _made:
        if known is signal_map:
            return plan
    made = _column_plan(signal_map)
    _made.append((signal_map, made))
    return made


def _column_plan(signal_map: SignalMap) -> ColumnPlan:
    tables = plan_tables(signal_map)
    return ColumnPlan(
        messages=tuple(
            MessageColumns(plan) for plan in signal_map.messages.values()
        ),
        standard=np.array(tables.standard, np.int32).reshape(-1, STANDARD_IDS),
        extended=np.array(tables.extended, np.int64),
        extended_message=np.array(tables.extended_message, np.int32),
        lengths=np.array(tables.lengths, np.int64),
        sizes=np.array(tables.sizes, np.int64),
        compiled=CompiledPlan(
            np.array(tables.starts, np.int64),
            np.array(tables.outputs, np.int64).reshape(-1, OUTPUT_FIELDS),
            np.array(tables.factors, np.float64).reshape(-1, FACTORS),
            np.array(tables.gaps, np.uint64),
        ),
        foreign=tables.foreign,
    )
