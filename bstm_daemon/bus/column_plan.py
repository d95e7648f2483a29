"""The extraction plan as flat arrays, for the compiled pass over columns.

What the pass does not know is left to :mod:`~bstm_daemon.bus.columns`: a
message with an output that has conditions or an expression, a 16-bit float,
or whole numbers beyond 64 bits.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from bstm_daemon.bus.compiled import LogExtension
    from bstm_daemon.bus.extraction import MessagePlan, Output, RawSignal

INT64_REACH: Final = 1 << 63

_UNSIGNED, _SIGNED, _FLOATING = range(3)
_NO_SCALING, _WHOLE, _REAL = range(3)
_OUTPUT_FIELDS: Final = 9
_FACTORS: Final = 6
_FLOAT_LENGTHS: Final = (32, 64)


@dataclass(frozen=True, slots=True)
class ColumnPlan:
    """Outputs of the messages that the compiled pass knows.

    ``starts`` (messages + 1) is where each message's rows begin in
    ``outputs`` (n, 9) and ``factors`` (n, 6), as ``_extract.c`` has them;
    ``taken`` has the positions of the messages that have rows.
    """

    starts: npt.NDArray[np.int64]
    outputs: npt.NDArray[np.int64]
    factors: npt.NDArray[np.float64]
    taken: frozenset[int]


@dataclass(frozen=True, slots=True)
class Slots:
    """Where samples are written: *n* slots, ``kept`` 0 where there is none."""

    values: npt.NDArray[np.float64]
    roles: npt.NDArray[np.int32]
    kept: npt.NDArray[np.bool_]


def column_plan(plans: Sequence[MessagePlan]) -> ColumnPlan:
    """Return the rows of all *plans* that the compiled pass knows."""
    starts = [0]
    outputs: list[tuple[int, ...]] = []
    factors: list[tuple[float, ...]] = []
    taken = set()
    for position, plan in enumerate(plans):
        rows = [_row(plan, output) for output in plan.outputs]
        known = [row for row in rows if row is not None]
        if known and len(known) == len(rows):
            outputs += [row[0] for row in known]
            factors += [row[1] for row in known]
            taken.add(position)
        starts.append(len(outputs))
    return ColumnPlan(
        np.array(starts, np.int64),
        np.array(outputs, np.int64).reshape(-1, _OUTPUT_FIELDS),
        np.array(factors, np.float64).reshape(-1, _FACTORS),
        frozenset(taken),
    )


def extract(
    extension: LogExtension,
    plan: ColumnPlan,
    frames: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]],
    data: npt.NDArray[np.uint8],
    slots: Slots,
) -> tuple[int, int]:
    """Write the samples of the messages that *plan* has into *slots*.

    *frames* are the plan and the first slot of each frame, *data* its bytes
    (n, 8 or 64). Returns how many samples are not a number and how many out
    of range.
    """
    counts = np.zeros(2, np.int64)
    extension.extract(
        *frames,
        np.ascontiguousarray(data),
        data.shape[1],
        plan.starts,
        plan.outputs,
        plan.factors,
        slots.values,
        slots.roles,
        slots.kept,
        counts,
    )
    return int(counts[0]), int(counts[1])


def _row(
    plan: MessagePlan, output: Output
) -> tuple[tuple[int, ...], tuple[float, ...]] | None:
    """Return the integers and factors of *output*, if it is known."""
    if output.expression is not None or output.conditions:
        return None
    signal = plan.signals[output.index]
    scaling = _scaling(signal)
    if scaling is None:
        return None
    raw = _SIGNED if signal.signed else _UNSIGNED
    if signal.floating:
        raw = _FLOATING
    whole = scaling == _WHOLE
    integers = (
        output.role,
        signal.start,
        signal.length,
        int(signal.big_endian),
        raw,
        scaling,
        int(output.flag),
        int(signal.scale) if whole else 0,
        int(signal.offset) if whole else 0,
    )
    factors = (
        0.0 if whole else float(signal.scale),
        0.0 if whole else float(signal.offset),
        output.gain,
        output.bias,
        output.low,
        output.high,
    )
    return integers, factors


def _scaling(signal: RawSignal) -> int | None:
    """Return how raw values become physical ones, if the pass knows it."""
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
