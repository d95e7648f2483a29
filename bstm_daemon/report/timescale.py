"""Times as a reader of a drive wants them: 1:30, 25:04, 1:25:00."""

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Final

HOUR_S: Final = 3600
DAY_S: Final = 86_400

EARLIEST_STAMP_S: Final = 1e9
"""Log times from here on are seconds since 1970 (here: 2001-09-09), not
seconds since the recorder started."""


@dataclass(frozen=True, slots=True)
class TimeAxis:
    """Title and d3 time formats of an elapsed-time axis."""

    title: str
    coarse: str
    fine: str
    finest: str


def clock(seconds: float, *, with_hours: bool | None = None) -> str:
    """Return *seconds* as ``min:s``, or ``h:min:s`` from an hour on.

    *with_hours* settles it where a column of times should look alike.
    """
    total = round(abs(seconds))
    sign = "-" if seconds < 0 and total else ""
    if with_hours is None:
        with_hours = total >= HOUR_S
    minutes, rest_s = divmod(total, 60)
    if not with_hours:
        return f"{sign}{minutes}:{rest_s:02d}"
    hours, minutes = divmod(minutes, 60)
    return f"{sign}{hours}:{minutes:02d}:{rest_s:02d}"


def duration(seconds: float) -> str:
    """Return *seconds* in words of units: ``90 s``, ``25 min 4 s``."""
    total = round(seconds)
    if total < 2 * 60:
        return f"{total} s"
    minutes, rest_s = divmod(total, 60)
    if total < HOUR_S:
        return f"{minutes} min {rest_s} s" if rest_s else f"{minutes} min"
    hours, minutes = divmod(round(total / 60), 60)
    return f"{hours} h {minutes} min" if minutes else f"{hours} h"


def start_text(start_s: float) -> str | None:
    """Return a log's first stamp as UTC date and time, None if relative."""
    if start_s < EARLIEST_STAMP_S:
        return None
    try:
        start = datetime.fromtimestamp(start_s, UTC)
    except (OverflowError, ValueError, OSError):
        return None
    return start.strftime("%Y-%m-%d %H:%M:%S UTC")


def time_axis(duration_s: float) -> TimeAxis:
    """Return the labels of an axis over *duration_s*.

    Two figures always mean the same on one axis: minutes and seconds on a
    short drive, hours and minutes on a long one.
    """
    if duration_s < HOUR_S:
        return TimeAxis("time [min:s]", "%-M:%S", "%-M:%S", "%-M:%S.%1f")
    if duration_s < DAY_S:
        return TimeAxis("time [h:min]", "%-H:%M", "%-H:%M:%S", "%-H:%M:%S.%1f")
    return TimeAxis(
        "time [day, h:min]",
        "%-j, %-H:%M",
        "%-j, %-H:%M:%S",
        "%-j, %-H:%M:%S.%1f",
    )
