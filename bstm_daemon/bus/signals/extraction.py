"""The extraction plan: where a value lies in a frame and what it means in SI.

Plain data without NumPy and without cantools. A live frame
(:mod:`~bstm_daemon.bus.signals.decoder`) and a column of frames
(:mod:`~bstm_daemon.bus.signals.columns`) are decoded from this same plan.

Order of operations, the same for both, so that both give the same bits::

    physical = raw * scale + offset       # the DBC's, as cantools computes it
    si       = gain * physical + bias     # the unit and the configuration
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

from bstm_daemon.bus.signals.expression import Expression

STANDARD_MAX: Final = 0x7FF
EXTENDED_MAX: Final = 0x1FFFFFFF
"""Largest ids of 11 and of 29 bits."""

FD_LENGTHS: Final[tuple[int, ...]] = (*range(9), 12, 16, 20, 24, 32, 48, 64)
"""Payload lengths in bytes that a CAN FD frame can have."""

INT64_REACH: Final = 1 << 63
"""Whole numbers below it, of either sign, are computed in 64 bits."""


class FrameKey(NamedTuple):
    """The identity of a message: a standard and an extended 0x100 differ."""

    bus: int
    can_id: int
    extended: bool


class Condition(NamedTuple):
    """A multiplexer: ``signals[signal]`` must have one of *values*."""

    signal: int
    values: frozenset[int]


@dataclass(frozen=True, slots=True)
class RawSignal:
    """One signal of a message.

    ``start`` counts bits from the start of the payload: for little endian
    the least significant bit of the signal, least significant bit of a byte
    first; for big endian its most significant bit, most significant first.
    ``scale`` and ``offset`` are ``int`` where the DBC's are whole numbers:
    then the physical value is exact before it becomes a float.
    ``unavailable`` are raw values, as unsigned numbers, that stand for no
    value at all.
    """

    name: str
    start: int
    length: int
    big_endian: bool
    signed: bool
    floating: bool
    scale: float
    offset: float
    unavailable: frozenset[int] = frozenset()

    @property
    def identity(self) -> bool:
        """Whether the raw value is the physical value."""
        return self.scale == 1 and self.offset == 0

    @property
    def raw_limits(self) -> tuple[int, int]:
        """Lowest and highest raw value of an integer signal."""
        if self.signed:
            half = 1 << (self.length - 1)
            return -half, half - 1
        return 0, (1 << self.length) - 1


@dataclass(frozen=True, slots=True)
class Output:
    """One role out of a message.

    The value is ``signals[index]`` or, where ``expression`` is given, that.
    A frame in which a condition does not hold gives no sample; neither does
    a value outside ``low .. high`` (SI, both inclusive). ``flag`` makes 1.0
    of anything but zero.
    """

    role: int
    index: int
    expression: Expression | None
    conditions: tuple[Condition, ...]
    gain: float
    bias: float
    low: float
    high: float
    flag: bool


@dataclass(frozen=True, slots=True)
class MessagePlan:
    """How to decode one message; ``length`` is that of its frames [byte]."""

    key: FrameKey
    name: str
    length: int
    is_fd: bool
    signals: tuple[RawSignal, ...]
    outputs: tuple[Output, ...]


def frame_length(message_length: int) -> int:
    """Return the bytes of the frame that carries *message_length* bytes.

    CAN FD pads to its next length code (ISO 11898-1).
    """
    fitting = [length for length in FD_LENGTHS if length >= message_length]
    return fitting[0]
