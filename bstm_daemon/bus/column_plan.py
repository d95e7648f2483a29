"""The extraction plan as tables: what frame is whose, and where samples lie.

Made once of a :class:`~bstm_daemon.bus.signal_map.SignalMap`, for both forms
of :mod:`~bstm_daemon.bus.columns`. What the compiled pass does not know is
left to NumPy: a message with an output that has conditions or an expression,
a 16-bit float, or whole numbers beyond 64 bits.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from bstm_daemon.bus.column_values import MessageColumns
from bstm_daemon.bus.extraction import INT64_REACH

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from bstm_daemon.bus.extraction import MessagePlan, Output, RawSignal
    from bstm_daemon.bus.signal_map import SignalMap

STANDARD_IDS: Final = 1 << 11

_UNSIGNED, _SIGNED, _FLOATING = range(3)
_NO_SCALING, _WHOLE, _REAL = range(3)
_OUTPUT_FIELDS: Final = 13
_FACTORS: Final = 6
_FLOAT_LENGTHS: Final = (32, 64)
_WINDOW_BYTES: Final = 8
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
    plans = list(signal_map.messages.values())
    standard = np.full((len(signal_map.buses) + 1, STANDARD_IDS), -1, np.int32)
    extended = []
    for number, plan in enumerate(plans):
        if plan.key.extended:
            extended.append((plan.key.bus << 29 | plan.key.can_id, number))
        else:
            standard[plan.key.bus, plan.key.can_id] = number
    extended.sort()
    compiled, foreign = _compiled_plan(plans)
    return ColumnPlan(
        messages=tuple(MessageColumns(plan) for plan in plans),
        standard=standard,
        extended=np.array([key for key, _ in extended], np.int64),
        extended_message=np.array([one for _, one in extended], np.int32),
        lengths=np.array([*(plan.length for plan in plans), 0], np.int64),
        sizes=np.array([*(len(p.outputs) for p in plans), 0], np.int64),
        compiled=compiled,
        foreign=foreign,
    )


def _compiled_plan(
    plans: Sequence[MessagePlan],
) -> tuple[CompiledPlan, tuple[int, ...]]:
    """Return the rows of all *plans* that the compiled pass knows."""
    starts = [0]
    outputs: list[tuple[int, ...]] = []
    factors: list[tuple[float, ...]] = []
    gaps: list[int] = []
    foreign = []
    for position, plan in enumerate(plans):
        scalings = [_known(plan, output) for output in plan.outputs]
        if None in scalings:
            foreign.append(position)
        else:
            for output, scaling in zip(plan.outputs, scalings, strict=True):
                signal = plan.signals[output.index]
                row = _integers(plan, output, scaling or 0)
                first = len(gaps)
                gaps += sorted(signal.unavailable)
                outputs.append((*row, first, len(gaps)))
                factors.append(_reals(signal, output, scaling or 0))
        starts.append(len(outputs))
    compiled = CompiledPlan(
        np.array(starts, np.int64),
        np.array(outputs, np.int64).reshape(-1, _OUTPUT_FIELDS),
        np.array(factors, np.float64).reshape(-1, _FACTORS),
        np.array(gaps, np.uint64),
    )
    return compiled, tuple(foreign)


def _integers(
    plan: MessagePlan, output: Output, scaling: int
) -> tuple[int, ...]:
    """Return the whole numbers of a row, up to those of its gaps."""
    signal = plan.signals[output.index]
    raw = _SIGNED if signal.signed else _UNSIGNED
    if signal.floating:
        raw = _FLOATING
    # a window of 8 bytes within the frame, or within 8 bytes where it is
    # shorter, holds all bits but those in the one byte behind it
    last = max(plan.length, _WINDOW_BYTES) - _WINDOW_BYTES
    base = min(signal.start // 8, last)
    lowest = signal.start - 8 * base
    beyond = lowest + signal.length - 8 * _WINDOW_BYTES
    whole = scaling == _WHOLE
    return (
        output.role,
        base,
        max(-beyond, 0) if signal.big_endian else lowest,
        max(beyond, 0),
        int(signal.big_endian),
        signal.length,
        raw,
        scaling,
        int(output.flag),
        int(signal.scale) if whole else 0,
        int(signal.offset) if whole else 0,
    )


def _reals(
    signal: RawSignal, output: Output, scaling: int
) -> tuple[float, ...]:
    whole = scaling == _WHOLE
    return (
        0.0 if whole else float(signal.scale),
        0.0 if whole else float(signal.offset),
        output.gain,
        output.bias,
        output.low,
        output.high,
    )


def _known(plan: MessagePlan, output: Output) -> int | None:
    """Return how raw values become physical ones, if the pass knows it."""
    if output.expression is not None or output.conditions:
        return None
    signal = plan.signals[output.index]
    scale, offset = signal.scale, signal.offset
    if signal.floating and signal.length not in _FLOAT_LENGTHS:
        return None
    if signal.identity:
        return _NO_SCALING
    if signal.floating or isinstance(scale, float):
        return _REAL
    if isinstance(offset, float):
        return None
    farthest = max(map(abs, signal.raw_limits))
    fits = farthest * max(abs(scale), 1) + abs(offset) < INT64_REACH
    return _WHOLE if fits else None
