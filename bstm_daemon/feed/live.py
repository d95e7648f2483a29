"""What the page shows: the newest record and the last hour, bounded."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from itertools import takewhile
from math import inf
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from bstm_daemon.feed.reader import Record

HISTORY_S: Final = 3600
BIN_S: Final = 2
"""Width of a point of the curves: a screen has no more than 1800 of them."""

CURVES: Final = ("disc_c", "fluid_c")
CORNERS: Final = ("FL", "FR", "RL", "RR")

Point = list[float | None]
"""Start of the bin, then each corner of each curve."""


class Live:
    """Filled by one thread, read by others."""

    def __init__(self, source: str) -> None:
        """Hold nothing yet; *source* says where the records come from."""
        self._source = source
        self._lock = threading.Lock()
        self._record: Record | None = None
        self._points: deque[Point] = deque(maxlen=HISTORY_S // BIN_S)
        self._epoch = 0
        self._count = 0
        self._taken_s = 0.0

    def take(self, record: Record) -> None:
        """Show *record* from now on.

        One from before the last point begins a new hour: the older ones
        belong to another time axis.
        """
        begin_s = record["time_s"] // BIN_S * BIN_S
        values = [
            corner[curve] if corner and corner["validity"] in _SHOWN else None
            for curve in CURVES
            for corner in map(record["corners"].get, CORNERS)
        ]
        with self._lock:
            self._record = record
            self._count += 1
            self._taken_s = time.monotonic()
            if self._points and begin_s < (self._points[-1][0] or 0.0):
                self._points.clear()
                self._epoch += 1
            if self._points and begin_s == self._points[-1][0]:
                last = self._points[-1]
                last[1:] = map(_hotter, last[1:], values)
            else:
                self._points.append([begin_s, *values])

    def event(self, seen: str) -> tuple[str, str] | None:
        """Return the next event for a client that has *seen* one, as JSON.

        Args:
            seen: the id of its last event; empty, or anything, for none.

        Returns:
            The id and the text, with the points since; None if nothing came.
        """
        epoch, _, rest = seen.partition(":")
        since, _, count = rest.partition(":")
        with self._lock:
            if self._count and count == str(self._count):
                return None
            goes_on = epoch == str(self._epoch) and since.isdigit()
            since_s = float(since) if goes_on else -inf
            newest = takewhile(
                lambda point: (point[0] or 0.0) >= since_s,
                reversed(self._points),
            )
            points = [*newest][::-1]
            last_s = int(points[-1][0] or 0) if points else 0
            text = json.dumps(
                {
                    "source": self._source,
                    "record": self._record,
                    "age_s": round(time.monotonic() - self._taken_s, 2),
                    "points": points,
                    "reset": not goes_on,
                }
            )
            return f"{self._epoch}:{last_s}:{self._count}", text


_SHOWN: Final = ("valid", "degraded")


def _hotter(one: float | None, other: float | None) -> float | None:
    if one is None or other is None:
        return one if other is None else other
    return max(one, other)
