"""One live frame into samples, by the extraction plan.

Whole frames only: length and kind are checked before anything is decoded.
"""

import math
import struct
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final

from bstm_daemon.bus.expression import (
    SCALAR_OPERATIONS,
    evaluate,
)
from bstm_daemon.bus.extraction import (
    Condition,
    FrameKey,
    MessagePlan,
    Output,
    RawSignal,
)
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.bus.signal_map import SignalMap

Payload = bytes | bytearray | memoryview
Sample = tuple[int, float]
"""Role number and value in SI."""

_FLOAT_CODES: Final = {16: "<e", 32: "<f", 64: "<d"}


class Decoder:
    """Decodes frames of a :class:`SignalMap` and counts what it refuses.

    ``counts`` holds frames by reason, and samples for the reasons
    ``not_a_number`` and ``out_of_range``.
    """

    def __init__(self, signal_map: SignalMap) -> None:
        """Resolve every message of *signal_map*."""
        self._messages = {
            key: _MessageDecoder(plan)
            for key, plan in signal_map.messages.items()
        }
        self.counts: Counter[Refusal] = Counter()

    def decode(
        self,
        bus: int,
        can_id: int,
        extended: bool,  # noqa: FBT001  (the third part of a frame's key)
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
            reason = Refusal.ERROR_FRAME if is_error else Refusal.REMOTE_FRAME
            self.counts[reason] += 1
            return ()
        message = self._messages.get(FrameKey(bus, can_id, extended))
        if message is None:
            self.counts[Refusal.UNKNOWN_ID] += 1
            return ()
        if len(data) != message.length:
            self.counts[Refusal.WRONG_LENGTH] += 1
            return ()
        return message.decode(data, self.counts)


class _MessageDecoder:
    """A message plan with its readers resolved."""

    __slots__ = ("_names", "_outputs", "_readers", "length")

    def __init__(self, plan: MessagePlan) -> None:
        self.length = plan.length
        self._names = [signal.name for signal in plan.signals]
        self._readers = [
            _physical_reader(signal, 8 * plan.length)
            for signal in plan.signals
        ]
        self._outputs = plan.outputs

    def decode(
        self, data: Payload, counts: Counter[Refusal]
    ) -> Sequence[Sample]:
        little = int.from_bytes(data, "little")
        big = int.from_bytes(data, "big")
        values = [read(little, big) for read in self._readers]
        samples = []
        for output in self._outputs:
            if output.conditions and not _holds(output.conditions, values):
                continue
            if output.expression is None:
                physical = values[output.index]
            else:
                physical = evaluate(
                    output.expression,
                    dict(zip(self._names, map(float, values), strict=True)),
                    SCALAR_OPERATIONS,
                )
            value = output.gain * physical + output.bias
            if output.low <= value <= output.high:
                samples.append((output.role, _flagged(output, value)))
            else:
                unreal = math.isnan(value)
                counts[
                    Refusal.NOT_A_NUMBER if unreal else Refusal.OUT_OF_RANGE
                ] += 1
        return samples


def _flagged(output: Output, value: float) -> float:
    return float(value != 0) if output.flag else value


def _holds(conditions: Sequence[Condition], values: Sequence[float]) -> bool:
    return all(
        math.isfinite(values[index]) and int(values[index]) in allowed
        for index, allowed in conditions
    )


def _physical_reader(
    signal: RawSignal, frame_bits: int
) -> Callable[[int, int], float]:
    """Return the function of (payload as little, as big endian number)."""
    read_raw = _raw_reader(signal, frame_bits)
    if signal.identity:
        return read_raw
    scale, offset = signal.scale, signal.offset
    return lambda little, big: read_raw(little, big) * scale + offset


def _raw_reader(
    signal: RawSignal, frame_bits: int
) -> Callable[[int, int], float]:
    bits = _bits_reader(signal, frame_bits)
    if signal.floating:
        unpack = struct.Struct(_FLOAT_CODES[signal.length]).unpack
        size = signal.length // 8
        return lambda little, big: float(
            unpack(bits(little, big).to_bytes(size, "little"))[0]
        )
    if signal.signed:
        sign = 1 << (signal.length - 1)
        return lambda little, big: (bits(little, big) ^ sign) - sign
    return bits


def _bits_reader(
    signal: RawSignal, frame_bits: int
) -> Callable[[int, int], int]:
    mask = (1 << signal.length) - 1
    if signal.big_endian:
        shift = frame_bits - signal.start - signal.length
        return lambda _little, big: (big >> shift) & mask
    shift = signal.start
    return lambda little, _big: (little >> shift) & mask
