"""One live frame into samples, by the extraction plan.

Whole frames only: length and kind are checked before anything is decoded.
"""

import math
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final

from bstm_daemon.bus.signals import extraction
from bstm_daemon.bus.signals.expression import evaluate, signal_names
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.signals.signal_map import SignalMap

Payload = bytes | bytearray | memoryview
Sample = tuple[int, float]
"""Role number and value in SI."""

_FLOAT_CODES: Final = {16: "<e", 32: "<f", 64: "<d"}


class Decoder:
    """Decodes frames of a :class:`SignalMap` and counts what it refuses.

    ``counts`` holds frames by reason, and samples for the reasons
    ``not_a_number``, ``out_of_range`` and ``not_available``.
    """

    def __init__(self, signal_map: SignalMap) -> None:
        """Resolve every message of *signal_map*."""
        # looked up with plain tuples, which equal the keys and cost less
        self._messages: dict[tuple[int, int, bool], _MessageDecoder] = {
            key: _MessageDecoder(plan)
            for key, plan in signal_map.messages.items()
        }
        self.counts: Counter[RejectReason] = Counter()
        self.rejected = 0
        """Frames refused whole, but those of an unwanted id."""

    def decode(
        self,
        bus: int,
        can_id: int,
        extended: bool,  # noqa: FBT001  (part of a frame's key)
        data: Payload,
        *,
        is_error: bool = False,
        is_remote: bool = False,
    ) -> Sequence[Sample]:
        """Return the samples of one frame, in the order of the plan.

        An error frame's id is a set of error bits and a remote frame has no
        data: both are counted and give nothing, whatever their id.
        """
        if is_error or is_remote:
            reason = (
                RejectReason.ERROR_FRAME
                if is_error
                else RejectReason.REMOTE_FRAME
            )
            self.counts[reason] += 1
            self.rejected += 1
            return ()
        message = self._messages.get((bus, can_id, extended))
        if message is None:
            self.counts[RejectReason.UNKNOWN_ID] += 1
            return ()
        if len(data) != message.length:
            self.counts[RejectReason.WRONG_LENGTH] += 1
            self.rejected += 1
            return ()
        return message.decode(data, self.counts)


class _MessageDecoder:
    """A message plan laid out so that a frame costs few look-ups."""

    __slots__ = ("_gaps", "_names", "_outputs", "_signals", "length")

    def __init__(self, plan: extraction.MessagePlan) -> None:
        self.length = plan.length
        self._names = [signal.name for signal in plan.signals]
        self._signals = [
            (
                signal.big_endian,
                _shift(signal, 8 * plan.length),
                (1 << signal.length) - 1,
                1 << (signal.length - 1) if signal.signed else 0,
                _float_reader(signal) if signal.floating else None,
                None if signal.identity else signal.scale,
                signal.offset,
            )
            for signal in plan.signals
        ]
        # where a raw value may stand for none, and then which
        self._gaps = [
            (index, *self._signals[index][:3], signal.unavailable)
            for index, signal in enumerate(plan.signals)
            if signal.unavailable
        ]
        self._outputs = [
            (
                (output.role, output.flag),
                self._sources(output),
                output.index,
                output.expression,
                output.conditions,
                (output.gain, output.bias),
                (output.low, output.high),
            )
            for output in plan.outputs
        ]

    def decode(
        self, data: Payload, counts: Counter[RejectReason]
    ) -> Sequence[Sample]:
        values = self._physical(data)
        missing = self._missing(data) if self._gaps else ()
        samples = []
        for (
            target,
            sources,
            index,
            tree,
            conditions,
            line,
            limits,
        ) in self._outputs:
            if conditions and not _holds(conditions, values):
                continue
            if missing and not sources.isdisjoint(missing):
                counts[RejectReason.NOT_AVAILABLE] += 1
                continue
            physical = values[index]
            if tree is not None:
                named = zip(self._names, map(float, values), strict=True)
                physical = evaluate(tree, dict(named))
            gain, bias = line
            low, high = limits
            value = gain * physical + bias
            if low <= value <= high:
                role, flag = target
                samples.append((role, float(value != 0) if flag else value))
            elif math.isnan(value):
                counts[RejectReason.NOT_A_NUMBER] += 1
            else:
                counts[RejectReason.OUT_OF_RANGE] += 1
        return samples

    def _sources(self, output: extraction.Output) -> frozenset[int]:
        """Return the positions of the signals that *output* is made of."""
        if output.expression is None:
            return frozenset({output.index})
        names = signal_names(output.expression)
        return frozenset(self._names.index(name) for name in names)

    def _missing(self, data: Payload) -> Sequence[int]:
        """Return the positions of the signals that have no value."""
        little = int.from_bytes(data, "little")
        big = int.from_bytes(data, "big")
        return [
            index
            for index, is_big, shift, mask, unavailable in self._gaps
            if ((big if is_big else little) >> shift) & mask in unavailable
        ]

    def _physical(self, data: Payload) -> list[float]:
        """Return the physical value of each signal, as cantools has it."""
        little = int.from_bytes(data, "little")
        big = int.from_bytes(data, "big")
        values: list[float] = []
        for is_big, shift, mask, sign, real, scale, offset in self._signals:
            bits = ((big if is_big else little) >> shift) & mask
            raw: float = bits
            if real is not None:
                raw = real(bits)
            elif sign:
                raw = (bits ^ sign) - sign
            values.append(raw if scale is None else raw * scale + offset)
        return values


def _holds(
    conditions: Sequence[extraction.Condition], values: Sequence[float]
) -> bool:
    for signal, allowed in conditions:
        value = values[signal]
        if not (math.isfinite(value) and int(value) in allowed):
            return False
    return True


def _shift(signal: extraction.RawSignal, frame_bits: int) -> int:
    if signal.big_endian:
        return frame_bits - signal.start - signal.length
    return signal.start


def _float_reader(signal: extraction.RawSignal) -> Callable[[int], float]:
    unpack = struct.Struct(_FLOAT_CODES[signal.length]).unpack
    size = signal.length // 8
    return lambda bits: float(unpack(bits.to_bytes(size, "little"))[0])
