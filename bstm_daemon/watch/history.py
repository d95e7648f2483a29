"""The last minutes of one value, and their sparkline."""

from __future__ import annotations

from collections import deque
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

HISTORY_S: Final = 300
"""Five minutes, about the time constant of a cooling disc."""

SECOND_US: Final = 1_000_000

BARS: Final = "▁▂▃▄▅▆▇█"
ASCII_BARS: Final = "_.-~=+*#"
"""For terminals without block elements."""

LEAST_SPAN: Final = 20.0
"""Values within 20 K are drawn as a flat line: no noise is magnified."""


class History:
    """The largest finite value of each of the last seconds.

    A time [us] before the last one empties the history, since the older
    values belong to another time axis.
    """

    def __init__(self) -> None:
        """Begin empty."""
        self._bins: deque[tuple[int, float]] = deque(maxlen=HISTORY_S)

    def add(self, time_us: int, value: float) -> None:
        """Take *value* at *time_us*; one that is not finite leaves a gap."""
        second = time_us // SECOND_US
        if self._bins and second < self._bins[-1][0]:
            self._bins.clear()
        if not isfinite(value):
            return
        if self._bins and second == self._bins[-1][0]:
            value = max(value, self._bins.pop()[1])
        self._bins.append((second, value))

    def columns(self, now_us: int, count: int) -> list[float]:
        """Return the largest value in each of *count* spans up to *now_us*.

        The last span ends now; NaN where nothing was received.
        """
        columns = [nan] * count
        now = now_us // SECOND_US
        for second, value in self._bins:
            age = now - second
            if 0 <= age < HISTORY_S:
                place = count - 1 - age * count // HISTORY_S
                if not value <= columns[place]:
                    columns[place] = value
        return columns


def sparkline(values: Sequence[float], bars: str = BARS) -> str:
    """Return one character of *bars* per value, blank for NaN.

    The scale runs from the least value to the largest, at least
    :data:`LEAST_SPAN` wide.
    """
    known = [value for value in values if isfinite(value)]
    if not known:
        return " " * len(values)
    bottom = min(known)
    span = max(max(known) - bottom, LEAST_SPAN)
    top = len(bars) - 1
    return "".join(
        bars[round((value - bottom) / span * top)] if isfinite(value) else " "
        for value in values
    )
