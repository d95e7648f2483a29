"""Which signals the compiled pass computes, and which the decoder."""

from math import inf

import pytest

from bstm_daemon.bus.signals.extraction import (
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
