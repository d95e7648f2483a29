"""What the page shows: the newest record and the last hour, bounded."""

import json
import threading
import time
from collections import deque
from math import inf
from typing import Final

from bstm_daemon.feed.reader import Record
from bstm_daemon.feed.vss import USABLE
from bstm_daemon.roles import CORNERS

BIN_S: Final = 2
"""Width of a point of the curves; an hour of them is a screen's width."""

CURVES: Final = ("disc_c", "fluid_c")


class Live:
    """Filled by one thread, read by others."""

    def __init__(self, source: str) -> None:
        """Hold nothing yet; *source* says where the records come from."""
        self._source = source
        self._lock = threading.Lock()
        self._record: Record | None = None
        self._points: deque[tuple[float, list[float | None]]] = deque(
            maxlen=3600 // BIN_S
        )
        """Start of each bin, and the corners of each curve."""
        self._epoch = self._count = 0
        self._taken_s = 0.0

    def take(self, record: Record) -> None:
        """Show *record* from now on.

        One from before the last point begins a new hour: the older ones
        belong to another time axis.
        """
        begin_s = record["time_s"] // BIN_S * BIN_S
        values = [
            corner[curve] if corner and corner["validity"] in USABLE else None
            for curve in CURVES
            for corner in map(record["corners"].get, CORNERS)
        ]
        with self._lock:
            self._record, self._taken_s = record, time.monotonic()
            self._count += 1
            last_s, last = self._points[-1] if self._points else (-inf, [])
            if begin_s == last_s:
                self._points.pop()
                values = [*map(_hotter, last, values)]
            elif begin_s < last_s:
                self._points.clear()
                self._epoch += 1
            self._points.append((begin_s, values))

    def event(self, seen: str) -> tuple[str, str] | None:
        """Return the next event for a client that has *seen* one.

        Args:
            seen: the id of its last event; empty, or anything, for none.

        Returns:
            The id and the text, JSON with the points since; None if nothing
            came.
        """
        epoch, _, rest = seen.partition(":")
        since, _, count = rest.partition(":")
        with self._lock:
            if self._count and count == str(self._count):
                return None
            goes_on = epoch == str(self._epoch) and since.isdigit()
            since_s = float(since) if goes_on else -inf
            event = {
                "source": self._source,
                "record": self._record,
                "age_s": round(time.monotonic() - self._taken_s, 2),
                "points": [
                    [at_s, *values]
                    for at_s, values in self._points
                    if at_s >= since_s
                ],
                "reset": not goes_on,
            }
            last_s = self._points[-1][0] if self._points else 0.0
            found = f"{self._epoch}:{last_s:.0f}:{self._count}"
        return found, json.dumps(event)


def _hotter(one: float | None, other: float | None) -> float | None:
    if one is None or other is None:
        return one if other is None else other
    return max(one, other)
