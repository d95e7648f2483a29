"""The extraction plan as tables of numbers, for the compiled passes.

The live service decodes by them too, and does without NumPy. What a compiled
pass does not know is left to the other form: a message with an output that
has an expression or a condition on a scaled value, a 16-bit float, or whole
numbers beyond 64 bits.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.bus.signals.extraction import (
    INT64_REACH,
    MessagePlan,
    Output,
    RawSignal,
)
from bstm_daemon.bus.signals.reject_reason import RejectReason

if TYPE_CHECKING:
    from collections.abc import Collection

    # it reads DBC files, which a link alone does not need
    from bstm_daemon.bus.signals.signal_map import SignalMap

STANDARD_IDS: Final = 1 << 11

OUTPUT_FIELDS: Final = 15
"""Whole numbers of an output's row, as ``plan.h`` has them."""

FACTORS: Final = 6
"""Real numbers of an output's row."""

SAMPLE_REASONS: Final = (
    RejectReason.NOT_A_NUMBER,
    RejectReason.OUT_OF_RANGE,
    RejectReason.NOT_AVAILABLE,
)
"""Why a value is no sample, in the order of ``plan.h``."""

_UNSIGNED, _SIGNED, _FLOATING = range(3)
_NO_SCALING, _WHOLE, _REAL = range(3)
_FLOAT_LENGTHS: Final = (32, 64)
_WINDOW_BYTES: Final = 8


@dataclass(frozen=True, slots=True)
class PlanTables:
    """A signal map as flat tables, named as in ``plan.h``.

    Attributes:
        standard: For each bus, 2048 ids: the position of the message, or -1.
        keys: Extended ids (bus * 2 ** 29 + id), rising.
        messages: The position of the message of each of *keys*.
        lengths: Bytes of a frame of each message.
        starts: Where each message's rows begin in *outputs* and *factors*,
            and the end.
        outputs: Rows of ``OUTPUT_FIELDS``.
        factors: Rows of ``FACTORS``.
        gaps: Raw values that stand for no value; an output's row has the
            places of its own.
        conditions: Rows like those of *outputs*, whose *gaps* are the raw
            values that a multiplexer must have; an output's row has the
            places of its own.
        by_hand: Of each message, whether it has no rows: then the decoder has
            to do.
    """

    standard: array[int]
    keys: array[int]
    messages: array[int]
    lengths: array[int]
    starts: array[int]
    outputs: array[int]
    factors: array[float]
    gaps: array[int]
    conditions: array[int]
    by_hand: bytearray

    def buffers(self) -> tuple[Any, ...]:
        """Return all tables in the order of ``plan.h``."""
        return tuple(getattr(self, field.name) for field in fields(self))


def plan_tables(signal_map: SignalMap) -> PlanTables:
    """Return the tables of *signal_map*."""
    plans = list(signal_map.messages.values())
    standard = array("i", [-1]) * (len(signal_map.buses) * STANDARD_IDS)
    extended = []
    for number, plan in enumerate(plans):
        if plan.key.extended:
            extended.append((plan.key.bus << 29 | plan.key.can_id, number))
        else:
            standard[plan.key.bus * STANDARD_IDS + plan.key.can_id] = number
    extended.sort()
    tables = PlanTables(
        standard=standard,
        keys=array("q", [key for key, _ in extended]),
        messages=array("i", [number for _, number in extended]),
        lengths=array("q", [plan.length for plan in plans]),
        starts=array("q", [0]),
        outputs=array("q"),
        factors=array("d"),
        gaps=array("Q"),
        conditions=array("q"),
        by_hand=bytearray(
            None in [_known(plan, output) for output in plan.outputs]
            for plan in plans
        ),
    )
    for plan, by_hand in zip(plans, tables.by_hand, strict=True):
        if not by_hand:
            for output in plan.outputs:
                _add_row(tables, plan, output)
        tables.starts.append(len(tables.factors) // FACTORS)
    return tables


def _add_row(tables: PlanTables, plan: MessagePlan, output: Output) -> None:
    signal = plan.signals[output.index]
    scaling = _known(plan, output) or 0
    line, no_line = (signal.scale, signal.offset), (0, 0)
    whole, real = (line, no_line) if scaling == _WHOLE else (no_line, line)
    first = len(tables.conditions) // OUTPUT_FIELDS
    for number, values in output.conditions:
        switch = plan.signals[number]
        mask = (1 << switch.length) - 1
        low, high = switch.raw_limits
        allowed = [one & mask for one in values if low <= one <= high]
        tables.conditions.extend((-1, *_bits(plan, switch), *(0, 0, 0, 0)))
        tables.conditions.extend((*_gaps(tables, allowed), *(0, 0)))
    tables.outputs.extend(
        (
            *(output.role, *_bits(plan, signal), scaling, output.flag),
            *map(int, whole),
            *_gaps(tables, signal.unavailable),
            *(first, len(tables.conditions) // OUTPUT_FIELDS),
        )
    )
    tables.factors.extend(
        (*real, output.gain, output.bias, output.low, output.high)
    )


def _bits(plan: MessagePlan, signal: RawSignal) -> tuple[int, ...]:
    """Return where the bits of *signal* are, and what they are."""
    raw = _SIGNED if signal.signed else _UNSIGNED
    if signal.floating:
        raw = _FLOATING
    # a window of 8 bytes within the frame, or within 8 bytes where it is
    # shorter, holds all bits but those in the one byte behind it
    last = max(plan.length, _WINDOW_BYTES) - _WINDOW_BYTES
    base = min(signal.start // 8, last)
    lowest = signal.start - 8 * base
    beyond = lowest + signal.length - 8 * _WINDOW_BYTES
    return (
        base,
        max(-beyond, 0) if signal.big_endian else lowest,
        max(beyond, 0),
        signal.big_endian,
        signal.length,
        raw,
    )


def _gaps(tables: PlanTables, values: Collection[int]) -> tuple[int, int]:
    """Add raw *values* to the gaps, and return where they are."""
    first = len(tables.gaps)
    tables.gaps.extend(sorted(values))
    return first, len(tables.gaps)


def _known(plan: MessagePlan, output: Output) -> int | None:
    """Return how raw values become physical ones, if the pass knows it."""
    switches = [plan.signals[one.signal] for one in output.conditions]
    if output.expression is not None or any(
        one.floating or not one.identity for one in switches
    ):
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
