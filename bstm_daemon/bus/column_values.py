"""The values of one message in many frames at once, with NumPy.

The same operations in the same order as
:class:`~bstm_daemon.bus.decoder.Decoder` has for one frame. Most messages
have plain outputs only: whole numbers in a window of 8 bytes, with a linear
conversion that 64-bit floats compute exactly as Python does. Those are
computed side by side, a row an output; all others one by one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from bstm_daemon.bus.expression import evaluate, signal_names
from bstm_daemon.bus.extraction import INT64_REACH
from bstm_daemon.bus.refusal import Refusal

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Callable, Mapping, Sequence

    from bstm_daemon.bus.extraction import MessagePlan, Output, RawSignal

Column = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Words = npt.NDArray[np.uint64]

_FLOAT_TYPES: Final = {16: "<f2", 32: "<f4", 64: "<f8"}
_WINDOW_BITS: Final = 64
_EXACT_FLOAT: Final = 1 << 53


class Samples(NamedTuple):
    """Values of frames (rows) by output; ``kept`` None: all are samples."""

    values: Column
    kept: Flags | None


class MessageColumns:
    """A message plan, prepared for columns of payloads."""

    def __init__(self, plan: MessagePlan) -> None:
        """Lay out the outputs of *plan*."""
        self.roles = np.array([one.role for one in plan.outputs], np.int32)
        self._plan = plan
        names = [signal.name for signal in plan.signals]
        self._used = [
            [output.index]
            if output.expression is None
            else [
                names.index(name) for name in signal_names(output.expression)
            ]
            for output in plan.outputs
        ]
        self._side_by_side = (
            _SideBySide(plan)
            if plan.outputs
            and all(_is_plain(plan, output) for output in plan.outputs)
            else None
        )

    def decode(
        self, payloads: npt.NDArray[np.void], counts: Counter[Refusal]
    ) -> Samples:
        """Return the samples of frames that all have the right length.

        *payloads* (n) are items of 8 or 64 bytes; *counts* gets the reasons
        of what is no sample.
        """
        windows = _Windows(payloads)
        if self._side_by_side is not None:
            return self._side_by_side.decode(windows, counts)
        with np.errstate(all="ignore"):
            return self._one_by_one(windows, counts)

    def _one_by_one(
        self, windows: _Windows, counts: Counter[Refusal]
    ) -> Samples:
        plan = self._plan
        raws = [_Raw(signal, windows) for signal in plan.signals]
        physical = [_physical(raw) for raw in raws]
        names = [signal.name for signal in plan.signals]
        count = len(windows.data)
        values = np.empty((count, len(plan.outputs)))
        kept = np.ones(values.shape, np.bool_)
        for position, output in enumerate(plan.outputs):
            if output.expression is None:
                column = physical[output.index]
            else:
                by_name = dict(zip(names, physical, strict=True))
                column = evaluate(output.expression, by_name, OPERATIONS)
            value = output.gain * column
            value += output.bias
            here = _present(output, physical, count)
            for index in self._used[position]:
                if plan.signals[index].unavailable:
                    gap = _is_gap(raws[index].bits, plan.signals[index])
                    _count(counts, Refusal.NOT_AVAILABLE, here & gap)
                    here &= ~gap
            kept[:, position] = _judged(output, value, here, counts)
            values[:, position] = (value != 0) if output.flag else value
        return Samples(values, None if kept.all() else kept)


def _is_plain(plan: MessagePlan, output: Output) -> bool:
    """Whether *output* is one of those that are computed side by side."""
    signal = plan.signals[output.index]
    if output.expression is not None or output.conditions or signal.floating:
        return False
    base = _base(signal, max(plan.length, 8))
    if signal.start + signal.length - 8 * base > _WINDOW_BITS:
        return False
    if signal.length == _WINDOW_BITS and not signal.signed:
        return False
    if isinstance(signal.scale, float):
        return True
    farthest = max(map(abs, signal.raw_limits))
    return (
        signal.identity
        or farthest * max(abs(signal.scale), 1) + abs(signal.offset)
        < _EXACT_FLOAT
    )


def _base(signal: RawSignal, width: int) -> int:
    """Return the first byte of a window on *signal* in *width* bytes."""
    return min(signal.start // 8, width - 8)


class _SideBySide:
    """Plain outputs, a row each; the parameters are columns (outputs, 1)."""

    def __init__(self, plan: MessagePlan) -> None:
        outputs = plan.outputs
        signals = [plan.signals[output.index] for output in outputs]
        bases = [_base(signal, max(plan.length, 8)) for signal in signals]
        ends = [s.start + s.length for s in signals]
        shifts = [
            _WINDOW_BITS - (end - 8 * base)
            if signal.big_endian
            else signal.start - 8 * base
            for signal, base, end in zip(signals, bases, ends, strict=True)
        ]
        rows: dict[tuple[int, str], list[int]] = {}
        for row, (signal, base) in enumerate(zip(signals, bases, strict=True)):
            kind = ">u8" if signal.big_endian else "<u8"
            rows.setdefault((base, kind), []).append(row)
        self._rows = {window: np.array(one) for window, one in rows.items()}
        self._shifts = _as_column(shifts, np.uint64)
        masks = [(1 << signal.length) - 1 for signal in signals]
        self._masks = _as_column(masks, np.uint64)
        signs = [
            1 << (signal.length - 1) if signal.signed else 0
            for signal in signals
        ]
        self._signs = _as_column(signs, np.uint64) if any(signs) else None
        self._scales = _as_column([s.scale for s in signals], np.float64)
        self._offsets = _as_column([s.offset for s in signals], np.float64)
        self._gains = _as_column([o.gain for o in outputs], np.float64)
        self._biases = _as_column([o.bias for o in outputs], np.float64)
        self._lows = np.array([output.low for output in outputs])
        self._highs = np.array([output.high for output in outputs])
        self._flags = [n for n, output in enumerate(outputs) if output.flag]
        self._gaps = [
            n for n, signal in enumerate(signals) if signal.unavailable
        ]
        self._signals = signals
        self._outputs = outputs

    def decode(self, windows: _Windows, counts: Counter[Refusal]) -> Samples:
        bits = np.empty((len(self._outputs), len(windows.data)), np.uint64)
        for window, rows in self._rows.items():
            word = windows.read(*window)
            if len(self._rows) == 1:
                np.right_shift(word, self._shifts, out=bits)
            else:
                bits[rows] = word >> self._shifts[rows]
        bits &= self._masks
        gaps = {n: _is_gap(bits[n], self._signals[n]) for n in self._gaps}
        if self._signs is not None:
            bits ^= self._signs
            bits -= self._signs
        # no number here reaches the sign bit without being signed
        value = bits.view(np.int64).astype(np.float64)
        value *= self._scales
        value += self._offsets
        value *= self._gains
        value += self._biases
        kept = self._kept(value, gaps, counts)
        for row in self._flags:
            value[row] = value[row] != 0
        return Samples(np.ascontiguousarray(value.T), kept)

    def _kept(
        self, value: Column, gaps: dict[int, Flags], counts: Counter[Refusal]
    ) -> Flags | None:
        # false for a nan, too
        inside = (value.min(axis=1) >= self._lows) & (
            value.max(axis=1) <= self._highs
        )
        gaps = {row: gap for row, gap in gaps.items() if gap.any()}
        if inside.all() and not gaps:
            return None
        kept = np.ones(value.shape, np.bool_)
        for row, gap in gaps.items():
            _count(counts, Refusal.NOT_AVAILABLE, gap)
            kept[row] = ~gap
        for row in np.flatnonzero(~inside).tolist():
            kept[row] = _judged(
                self._outputs[row], value[row], kept[row], counts
            )
        return np.ascontiguousarray(kept.T)


def _as_column(values: Sequence[float], kind: Any) -> npt.NDArray[Any]:
    return np.array(values, kind)[:, np.newaxis]


def _is_gap(bits: Words, signal: RawSignal) -> Flags:
    """Return which of the raw values *bits* stand for no value."""
    gap = np.zeros(len(bits), np.bool_)
    for raw in signal.unavailable:
        gap |= bits == np.uint64(raw)
    return gap


def _judged(
    output: Output, value: Column, here: Flags, counts: Counter[Refusal]
) -> Flags:
    """Return which values are samples, of those that are *here*."""
    good: Flags = (output.low <= value) & (value <= output.high)
    unreal = np.isnan(value)
    _count(counts, Refusal.NOT_A_NUMBER, here & unreal)
    _count(counts, Refusal.OUT_OF_RANGE, here & ~unreal & ~good)
    return good & here


def _present(output: Output, physical: Sequence[Column], count: int) -> Flags:
    """Return in which of *count* frames the multiplexers hold."""
    together = np.ones(count, np.bool_)
    for signal, allowed in output.conditions:
        together &= np.isin(np.trunc(physical[signal]), list(allowed))
    return together


class _Windows:
    """Runs of 8 bytes of each payload (8 or 64 bytes) as numbers."""

    def __init__(self, payloads: npt.NDArray[np.void]) -> None:
        width = payloads.dtype.itemsize
        self.data = payloads.view(np.uint8).reshape(len(payloads), width)
        self._read: dict[tuple[int, str], Words] = {}

    def read(self, base: int, kind: str) -> Words:
        """Return bytes ``base .. base + 7`` of each row as a number."""
        if (base, kind) not in self._read:
            rows: Words = np.ndarray(
                (len(self.data),),
                kind,
                self.data.data,
                base,
                (self.data.shape[1],),
            )
            self._read[base, kind] = rows.astype(np.uint64)
        return self._read[base, kind]


class _Raw:
    """A signal with its bits as unsigned numbers."""

    def __init__(self, signal: RawSignal, windows: _Windows) -> None:
        self.signal = signal
        self.bits = _bits(signal, windows)

    def values(self) -> npt.NDArray[Any]:
        """Return raw values: float, signed or unsigned 64-bit integers."""
        signal = self.signal
        if signal.floating:
            size = signal.length // 8
            kind = _FLOAT_TYPES[signal.length]
            reals = self.bits.astype(f"<u{size}").view(kind)
            return reals.astype(np.float64)
        if signal.signed:
            sign = np.uint64(1 << (signal.length - 1))
            return ((self.bits ^ sign) - sign).view(np.int64)
        return self.bits


def _physical(raw: _Raw) -> Column:
    """Return ``raw * scale + offset`` with the rounding of Python numbers."""
    signal, values = raw.signal, raw.values()
    if signal.identity:
        return values.astype(np.float64)
    scale, offset = signal.scale, signal.offset
    if signal.floating or isinstance(scale, float):
        product = values.astype(np.float64) * float(scale) + float(offset)
        return np.asarray(product, np.float64)
    # whole numbers: exact up to the one rounding at the end
    farthest = max(map(abs, signal.raw_limits))
    whole: npt.NDArray[Any]
    if farthest * max(abs(scale), 1) + abs(offset) < INT64_REACH:
        whole = values.astype(np.int64) * scale
    else:
        whole = values.astype(object) * scale
    return (whole + offset).astype(np.float64)


def _bits(signal: RawSignal, windows: _Windows) -> Words:
    """Return the bits of *signal* as unsigned numbers.

    A window of 8 bytes holds all of them, or all but those in the one byte
    behind it.
    """
    base = _base(signal, windows.data.shape[1])
    beyond = signal.start + signal.length - 8 * base - _WINDOW_BITS
    window = windows.read(base, ">u8" if signal.big_endian else "<u8")
    shift = -beyond if signal.big_endian else signal.start - 8 * base
    if beyond <= 0:
        bits = window >> np.uint64(shift)
    else:
        behind = windows.data[:, base + 8].astype(np.uint64)
        if signal.big_endian:
            bits = window << np.uint64(beyond)
            bits |= behind >> np.uint64(8 - beyond)
        else:
            bits = window >> np.uint64(shift)
            bits |= behind << np.uint64(_WINDOW_BITS - shift)
    bits &= np.uint64((1 << signal.length) - 1)
    return bits


def _count(counts: Counter[Refusal], reason: Refusal, which: Flags) -> None:
    number = np.count_nonzero(which)
    if number:
        counts[reason] += int(number)


def _divide(numerator: Column, denominator: Column) -> Column:
    quotient = np.divide(numerator, denominator)
    return np.where(np.equal(denominator, 0), np.nan, quotient)


def _least(first: Column, *others: Column) -> Column:
    for other in others:
        unreal = np.isnan(first) | np.isnan(other)
        first = np.where(
            unreal, np.nan, np.where(np.less(other, first), other, first)
        )
    return first


def _greatest(first: Column, *others: Column) -> Column:
    for other in others:
        unreal = np.isnan(first) | np.isnan(other)
        first = np.where(
            unreal, np.nan, np.where(np.greater(other, first), other, first)
        )
    return first


OPERATIONS: Final[Mapping[str, Callable[..., Any]]] = {
    "+": np.add,
    "-": np.subtract,
    "*": np.multiply,
    "/": _divide,
    "negate": np.negative,
    "abs": np.abs,
    "min": _least,
    "max": _greatest,
}
"""The operations of an expression on columns, in the scalar ones' order."""
