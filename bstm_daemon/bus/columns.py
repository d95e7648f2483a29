"""A chunk of a log into samples, by the same plan as a live frame.

The samples come out in file order: frame after frame, and within a frame in
the order of the message's outputs. That is the order in which the decoder
gives them live, so time stamps that run backwards stay where they are.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.bus.column_plan import (
    INT64_REACH,
    Slots,
    column_plan,
    extract,
)
from bstm_daemon.bus.compiled import extension
from bstm_daemon.bus.expression import evaluate
from bstm_daemon.bus.extraction import MessagePlan, Output, RawSignal
from bstm_daemon.bus.frame_chunk import FrameChunk
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.bus.signal_map import SignalMap

Column = npt.NDArray[np.float64]

_FLOAT_TYPES: Final = {16: "<f2", 32: "<f4", 64: "<f8"}
_WINDOW_BITS: Final = 64
_STANDARD_IDS: Final = 1 << 11


@dataclass(frozen=True, slots=True)
class Events:
    """Samples in file order, *n* of them; ``counts`` as in the decoder."""

    time_us: npt.NDArray[np.int64]
    role: npt.NDArray[np.int32]
    value: Column
    counts: Counter[Refusal]

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.time_us)


def decode_chunk(
    signal_map: SignalMap, chunk: FrameChunk, bus_of_channel: Sequence[int]
) -> Events:
    """Return the samples of *chunk*.

    ``bus_of_channel`` gives the bus number of each of the reader's
    interfaces, -1 for one that is not read. Values, order and counts are
    those of :class:`~bstm_daemon.bus.decoder.Decoder`, frame by frame.
    """
    counts: Counter[Refusal] = Counter()
    plans, plan_of_frame = _plan_of_frames(signal_map, chunk, bus_of_channel)
    unread = np.isin(chunk.channel, np.flatnonzero(np.less(bus_of_channel, 0)))
    _count(counts, Refusal.UNKNOWN_INTERFACE, unread)
    _count(counts, Refusal.UNKNOWN_ID, ~unread & (plan_of_frame < 0))
    lengths = np.array([plan.length for plan in plans] + [0])
    wrong = (plan_of_frame >= 0) & (chunk.length != lengths[plan_of_frame])
    _count(counts, Refusal.WRONG_LENGTH, wrong)
    plan_of_frame[wrong] = -1

    # one slot a frame and output; slots without a sample are dropped at last
    outputs = np.array([len(plan.outputs) for plan in plans] + [0])
    per_frame = outputs[plan_of_frame]
    ends = np.cumsum(per_frame)
    slots = int(ends[-1]) if len(ends) else 0
    values = np.empty(slots, np.float64)
    roles = np.empty(slots, np.int32)
    kept = np.ones(slots, np.bool_)
    done = _extract_compiled(
        plans,
        (plan_of_frame, ends - per_frame),
        chunk,
        Slots(values, roles, kept),
        counts,
    )
    # one payload as one item: rows are then copied whole
    payloads = chunk.data.view(np.dtype((np.void, chunk.data.shape[1])))[:, 0]
    for number, plan in enumerate(plans):
        if number in done:
            continue
        frames = np.flatnonzero(plan_of_frame == number)
        if not frames.size:
            continue
        first = ends[frames] - per_frame[frames]
        with np.errstate(all="ignore"):
            samples = _decode(plan, payloads[frames], counts)
        for position, (output, value, good) in enumerate(samples):
            values[first + position] = value
            roles[first + position] = output.role
            if good is not None:
                kept[(first + position)[~good]] = False
    times = np.repeat(chunk.time_us, per_frame)
    if not kept.all():
        times, roles, values = times[kept], roles[kept], values[kept]
    return Events(times, roles, values, counts)


def _extract_compiled(
    plans: Sequence[MessagePlan],
    frames: tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]],
    chunk: FrameChunk,
    slots: Slots,
    counts: Counter[Refusal],
) -> frozenset[int]:
    """Write what the compiled pass knows; returns the plans it has done.

    *frames* are the plan and the first slot of each frame.
    """
    compiled = extension()
    if compiled is None or not len(slots.values):
        return frozenset()
    plan = column_plan(plans)
    unreal, outside = extract(compiled, plan, frames, chunk.data, slots)
    for reason, number in (
        (Refusal.NOT_A_NUMBER, unreal),
        (Refusal.OUT_OF_RANGE, outside),
    ):
        if number:
            counts[reason] += number
    return plan.taken


def _plan_of_frames(
    signal_map: SignalMap, chunk: FrameChunk, bus_of_channel: Sequence[int]
) -> tuple[list[MessagePlan], npt.NDArray[np.int64]]:
    """Return the plans and each frame's position among them, or -1."""
    plans = list(signal_map.messages.values())
    buses = len(signal_map.buses)
    # a row a bus; the last one stands for an interface that is not read: -1
    table = np.full((buses + 1, _STANDARD_IDS), -1, np.int64)
    for number, plan in enumerate(plans):
        if not plan.key.extended:
            table[plan.key.bus, plan.key.can_id] = number
    bus = np.array([*bus_of_channel, -1], np.int64)
    row = (bus * _STANDARD_IDS)[chunk.channel]
    found = table.ravel()[row + (chunk.can_id & (_STANDARD_IDS - 1))]
    if chunk.extended.any():
        found[chunk.extended] = -1
        for number, plan in enumerate(plans):
            if plan.key.extended:
                hit = chunk.extended & (chunk.can_id == plan.key.can_id)
                found[hit & (bus[chunk.channel] == plan.key.bus)] = number
    return plans, found


def _decode(
    plan: MessagePlan,
    payloads: npt.NDArray[np.void],
    counts: Counter[Refusal],
) -> list[tuple[Output, Column, npt.NDArray[np.bool_] | None]]:
    """Return each output's values, one a frame, and which are samples.

    ``None`` stands for: all of them.
    """
    windows = _Windows(payloads)
    physical = [_physical(signal, windows) for signal in plan.signals]
    names = [signal.name for signal in plan.signals]
    samples = []
    for output in plan.outputs:
        if output.expression is None:
            column = physical[output.index]
        else:
            by_name = dict(zip(names, physical, strict=True))
            column = evaluate(output.expression, by_name, OPERATIONS)
        value = output.gain * column
        value += output.bias
        present = _present(output, physical)
        good = present
        # false for a nan, too
        if not (value.min() >= output.low and value.max() <= output.high):
            good = (output.low <= value) & (value <= output.high)
            here = np.bool_(True) if present is None else present
            unreal = np.isnan(value)
            _count(counts, Refusal.NOT_A_NUMBER, here & unreal)
            _count(counts, Refusal.OUT_OF_RANGE, here & ~unreal & ~good)
            good &= here
        if output.flag:
            value = (value != 0).astype(np.float64)
        samples.append((output, value, good))
    return samples


def _present(
    output: Output, physical: Sequence[Column]
) -> npt.NDArray[np.bool_] | None:
    """Return in which frames the multiplexers hold; ``None``: in all."""
    if not output.conditions:
        return None
    held = [
        np.isin(np.trunc(physical[signal]), list(allowed))
        for signal, allowed in output.conditions
    ]
    together: npt.NDArray[np.bool_] = np.logical_and.reduce(held)
    return together


class _Windows:
    """Runs of 8 bytes of each payload (8 or 64 bytes) as numbers."""

    def __init__(self, payloads: npt.NDArray[np.void]) -> None:
        width = payloads.dtype.itemsize
        self.data = payloads.view(np.uint8).reshape(len(payloads), width)
        self.last = width - 8
        self._read: dict[tuple[int, str], npt.NDArray[np.uint64]] = {}

    def read(self, base: int, kind: str) -> npt.NDArray[np.uint64]:
        """Return bytes ``base .. base + 7`` of each row as a number."""
        if (base, kind) not in self._read:
            rows: npt.NDArray[np.uint64] = np.ndarray(
                (len(self.data),),
                kind,
                self.data.data,
                base,
                (self.data.shape[1],),
            )
            self._read[base, kind] = rows.astype(np.uint64)
        return self._read[base, kind]


def _physical(signal: RawSignal, windows: _Windows) -> Column:
    """Return ``raw * scale + offset`` with the rounding of Python numbers."""
    raw = _raw(signal, windows)
    if signal.identity:
        return raw.astype(np.float64)
    scale, offset = signal.scale, signal.offset
    if signal.floating or isinstance(scale, float):
        product = raw.astype(np.float64) * float(scale) + float(offset)
        return np.asarray(product, np.float64)
    # whole numbers: exact up to the one rounding at the end
    farthest = max(map(abs, signal.raw_limits))
    whole: npt.NDArray[Any]
    if farthest * max(abs(scale), 1) + abs(offset) < INT64_REACH:
        whole = raw.astype(np.int64) * scale
    else:
        whole = raw.astype(object) * scale
    return (whole + offset).astype(np.float64)


def _raw(signal: RawSignal, windows: _Windows) -> npt.NDArray[Any]:
    """Return raw values: float, signed or unsigned 64-bit integers."""
    bits = _bits(signal, windows)
    if signal.floating:
        size = signal.length // 8
        kind = _FLOAT_TYPES[signal.length]
        return bits.astype(f"<u{size}").view(kind).astype(np.float64)
    if signal.signed:
        sign = np.uint64(1 << (signal.length - 1))
        return ((bits ^ sign) - sign).view(np.int64)
    return bits


def _bits(signal: RawSignal, windows: _Windows) -> npt.NDArray[np.uint64]:
    """Return the bits of *signal* as unsigned numbers.

    A window of 8 bytes holds all of them, or all but those in the one byte
    behind it.
    """
    base = min(signal.start // 8, windows.last)
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


def _count(
    counts: Counter[Refusal], reason: Refusal, which: npt.NDArray[np.bool_]
) -> None:
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
