"""Advice and requests as bars on the time line of a replay."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from bstm_daemon.bus.output_layout import (
    Assist,
    Downshift,
    Intervention,
    Isolation,
    Message,
)
from bstm_daemon.report.spans import Buckets, validity_spans

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

SOFTER_PEDAL: Final = 0.995
"""A pedal factor below it is one that the frame can tell from 1."""


class Bar(NamedTuple):
    """Stretches [s] in which something was told, and its words and colour."""

    label: str
    colour: str
    stretches_s: list[tuple[float, float]]


class _Kind(NamedTuple):
    label: str
    colour: str
    column: str
    code: int


# Okabe & Ito 2008, as the curves
_KINDS: Final = (
    _Kind(
        "wait before departure",
        "#d55e00",
        "advice_message",
        Message.WAIT_BEFORE_DEPARTURE,
    ),
    _Kind("brakes hot", "#cc79a7", "advice_message", Message.BRAKES_HOT),
    _Kind(
        "driver: lower gear", "#0072b2", "advice_shift", Downshift.SHIFT_DOWN
    ),
    _Kind(
        "gearbox: lower gear",
        "#56b4e9",
        "advice_gearbox",
        Downshift.SHIFT_DOWN,
    ),
    _Kind("softer pedal", "#e69f00", "advice_pedal_feel", 1),
    _Kind(
        "front brakes isolated",
        "#009e73",
        "advice_isolation",
        Isolation.REQUESTED,
    ),
    _Kind(
        "emergency assist ready", "#8c959f", "advice_assist", Assist.STANDBY
    ),
    _Kind("brakes do not answer", "#1f2328", "advice_assist", Assist.DETECTED),
    *(
        _Kind(label, colour, "advice_intervention", code)
        for label, colour, code in (
            ("maximum pressure", "#a32c00", Intervention.MAXIMUM_PRESSURE),
            ("park brake", "#5a3d8a", Intervention.PARK_BRAKE),
            ("isolate front", "#00573f", Intervention.ISOLATE_FRONT),
        )
    ),
)
"""From the top; those to the driver first."""


class AdviceLines:
    """Gathers the bars of a growing drive in a bounded memory."""

    def __init__(self) -> None:
        """Begin without rows."""
        self._told = [Buckets(np.maximum) for _ in _KINDS]

    def add(self, columns: Mapping[str, Column]) -> None:
        """Add rows; columns may be missing."""
        for kind, told in zip(_KINDS, self._told, strict=True):
            values = columns.get(kind.column)
            if values is None:
                continue
            if kind.column == "advice_pedal_feel":
                told.add((values < SOFTER_PEDAL).astype(float))
            else:
                told.add((values == kind.code).astype(float))

    def bars(self, starts_s: Column) -> list[Bar]:
        """Return what was told of at least once, from the top.

        Args:
            starts_s: start [s] of each bucket of rows.
        """
        found = []
        for kind, told in zip(_KINDS, self._told, strict=True):
            if told.values.any():
                spans = validity_spans(starts_s, told.values)
                stretches = [(start, end) for _, start, end in spans]
                found.append(Bar(kind.label, kind.colour, stretches))
        return found
