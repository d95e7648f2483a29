"""Which signals the compiled pass computes, and which the decoder."""

from math import inf

import pytest

from bstm_daemon.bus.signals.extraction import (
    Condition,
    FrameKey,
    MessagePlan,
    Output,
    RawSignal,
)
from bstm_daemon.bus.signals.plan_tables import plan_tables
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.sections import BusConfig


@pytest.mark.parametrize(
    ("length", "signed", "scale", "offset", "by_hand"),
    [
        (16, False, 3, -5, False),
        # 2 (2^62 - 1) + 1 is the largest of 64 bits, one more is not
        (62, False, 2, 1, False),
        (62, False, 2, 2, True),
        (62, False, -2, -2, True),
        (63, True, 1, 0, False),
        (63, True, 2, 0, True),
        # a real scale needs no whole numbers
        (64, False, 0.5, 0.0, False),
        (16, False, 1, 0.5, True),
    ],
)
def test_whole_numbers_of_64_bits_are_computed_in_the_pass(
    length: int,
    signed: bool,  # noqa: FBT001
    scale: float,
    offset: float,
    by_hand: bool,  # noqa: FBT001
) -> None:
    signal = RawSignal(
        *("one", 0, length), False, signed, False, scale, offset
    )
    output = Output(0, 0, None, (), 1.0, 0.0, -inf, inf, flag=False)
    key = FrameKey(0, 0x100, extended=False)
    plan = MessagePlan(key, "M", 8, False, (signal,), (output,))

    bus = BusConfig(name="a", dbc="car.dbc", channel="can0")

    tables = plan_tables(SignalMap((bus,), {key: plan}, ()))

    assert tables.by_hand == bytearray([by_hand])
    assert len(tables.starts) == 2
    assert bool(tables.outputs) is not by_hand


@pytest.mark.parametrize(
    ("signed", "scale", "values", "allowed"),
    [
        (False, 1, {9, 3}, [3, 9]),
        # as the bits are; -9 and 16 are no value of four of them
        (True, 1, {-1, 7, -9, 16}, [7, 15]),
        (False, 2, {3}, None),
    ],
)
def test_conditions_are_raw_values_of_a_plain_multiplexer(
    signed: bool,  # noqa: FBT001
    scale: float,
    values: set[int],
    allowed: list[int] | None,
) -> None:
    switch = RawSignal("page", *(4, 4), False, signed, False, scale, 0)
    signal = RawSignal("one", *(8, 16), False, False, False, 1, 0)
    condition = Condition(0, frozenset(values))
    output = Output(0, 1, None, (condition,), 1.0, 0.0, -inf, inf, flag=False)
    key = FrameKey(0, 0x100, extended=False)
    plan = MessagePlan(key, "M", 8, False, (switch, signal), (output,))
    bus = BusConfig(name="a", dbc="car.dbc", channel="can0")

    tables = plan_tables(SignalMap((bus,), {key: plan}, ()))

    assert tables.by_hand == bytearray([allowed is None])
    assert list(tables.gaps) == (allowed or [])
