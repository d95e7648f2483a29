"""The time of a signal table: unit, dates, clocks, laps that begin at zero."""

import re
from datetime import UTC, datetime, timedelta
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.bus.tables.source import Booleans, Floats, numbers, texts

Integers = npt.NDArray[np.int64]

NEAR_ZERO_US: Final = 1_000_000
"""A lap begins at most this late; it ends more than this later."""

_DAY_US: Final = 86_400_000_000
_CLOCK: Final = re.compile(r"\d\d?:\d\d:\d\d(\.\d*)?")
_PER_UNIT_US: Final = {"s": 1e6, "ms": 1e3, "us": 1.0}
_LARGEST_US: Final = 2**62
_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_MICROSECOND: Final = timedelta(microseconds=1)
_NAMES: Final = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "millis", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "µs", "usec", "micros", "microseconds"), "us"),
}
_EPOCHS: Final = (("us", 1e14), ("ms", 1e11), ("s", 1e8))
"""Counts since 1970 from 1973 on, by unit."""
_STEPS: Final = (("us", 2000.0), ("ms", 5.0))
"""Shortest usual step from row to row; a drive has more than a row in 5 s."""


class TimeAxis:
    """Turns the cells of a time column into microseconds, chunk by chunk.

    A clock (``hhmmss``) goes on after midnight.
    ``unit`` is the configured or found one, ``found_by`` says how it was
    found, or is empty; ``laps_joined`` counts the times it began anew.
    """

    def __init__(self, unit: str | None, column: str, stated: str) -> None:
        """Expect *unit*, or what the table has *stated*.

        If neither is known, it is found out from the name and the first cells
        of *column*.
        """
        self.unit = unit
        self._stated = stated
        self.found_by = ""
        self.laps_joined = 0
        self._column = column
        self._last_raw_us: int | None = None
        self._offset_us = 0
        self._step_us = 0

    def stamps(
        self, cells: list[str] | npt.NDArray[Any]
    ) -> tuple[Integers, Booleans]:
        """Return the stamps [us] and which of them are readable."""
        if not isinstance(cells, list) and cells.dtype.kind == "M":
            if self.unit is None:
                self._find("iso8601", "its type")
            whole = cells.astype("datetime64[us]")
            return whole.astype(np.int64), ~np.isnat(whole)
        unit = self.unit or self._found_unit(cells)
        if unit == "iso8601":
            return _dates(texts(cells))
        with np.errstate(all="ignore"):
            is_clock = unit == "hhmmss"
            if is_clock:
                us = _clock_us(cells)
            else:
                us = numbers(cells).value * _PER_UNIT_US[unit]
            good = np.abs(us) < _LARGEST_US
            stamps = np.where(good, np.round(us), 0).astype(np.int64)
        if good.any():
            stamps[good] = self._joined(stamps[good], is_clock=is_clock)
        return stamps, good

    def _found_unit(self, cells: list[str] | npt.NDArray[Any]) -> str:
        stated = self._stated.lower().strip("[]")
        if stated == "hhmmss" or stated in _NAMES:
            return self._find(_NAMES.get(stated, stated), "the table's unit")
        found = numbers(cells)
        real = found.value[np.isfinite(found.value)]
        if np.count_nonzero(found.unreadable) > len(real):
            is_clock = any(map(_CLOCK.fullmatch, texts(cells)))
            return self._find("hhmmss" if is_clock else "iso8601", "its cells")
        words = re.split(r"[^0-9A-Za-zµ]+", self._column)
        for word in words:
            if word.lower() in _NAMES:
                return self._find(_NAMES[word.lower()], "its name")
        steps = np.diff(real)
        steps = steps[steps > 0]
        middle = float(np.median(real)) if len(real) else 0.0
        step = float(np.median(steps)) if len(steps) else 0.0
        for unit, least in _EPOCHS:
            if middle >= least:
                return self._find(unit, "its numbers since 1970")
        for unit, least in _STEPS:
            if step >= least:
                return self._find(unit, f"its step of {step:g}")
        return self._find("s", f"its step of {step:g}")

    def _find(self, unit: str, reason: str) -> str:
        self.unit, self.found_by = unit, reason
        return unit

    def _joined(self, raw_us: Integers, *, is_clock: bool) -> Integers:
        """Return *raw_us* as one time: past midnight, or from lap to lap."""
        last = raw_us[0] if self._last_raw_us is None else self._last_raw_us
        before = np.concatenate([[last], raw_us[:-1]])
        if is_clock:
            offsets = _DAY_US * (raw_us - before < -_DAY_US // 2)
        else:
            offsets = self._lap_offsets(raw_us, before)
        along: Integers = self._offset_us + np.cumsum(offsets)
        self._offset_us = int(along[-1])
        self._last_raw_us = int(raw_us[-1])
        return raw_us + along

    def _lap_offsets(self, raw_us: Integers, before: Integers) -> Integers:
        """Return what sets each new lap behind the one before it."""
        forward = np.diff(raw_us)
        forward = forward[forward > 0]
        if not self._step_us and len(forward):
            self._step_us = int(np.median(forward))
        # the zero of a lap is the last stamp before it; a lap that begins at
        # zero itself follows one usual step behind
        anew = (raw_us <= NEAR_ZERO_US) & (before - raw_us > NEAR_ZERO_US)
        offsets = np.zeros(len(raw_us), np.int64)
        for place in np.flatnonzero(anew).tolist():
            own = int(raw_us[place])
            gap = own if own > 0 else self._step_us
            offsets[place] = int(before[place]) - own + gap
        self.laps_joined += int(np.count_nonzero(anew))
        return offsets


def _clock_us(cells: list[str] | npt.NDArray[Any]) -> Floats:
    """Return times of day, 095237.60 or 09:52:37.60, in us."""
    if isinstance(cells, list):
        cells = [cell.replace(":", "") for cell in cells]
    clock = numbers(cells).value
    minutes, second = np.divmod(clock, 100.0)
    hour, minute = np.divmod(minutes, 100.0)
    good = (clock >= 0) & (hour < 24) & (minute < 60) & (second < 61)
    whole = 3600.0 * hour + 60.0 * minute + second
    return np.where(good, whole * 1e6, np.nan)


def _dates(cells: list[str]) -> tuple[Integers, Booleans]:
    """Return ISO 8601 dates; one without a zone is taken as UTC."""
    stamps = np.zeros(len(cells), np.int64)
    good = np.zeros(len(cells), np.bool_)
    for place, cell in enumerate(cells):
        try:
            moment = datetime.fromisoformat(cell)
            if moment.tzinfo is None:
                moment = moment.replace(tzinfo=UTC)
            stamps[place] = (moment - _EPOCH) // _MICROSECOND
        except (ValueError, OverflowError):
            continue
        good[place] = True
    return stamps, good
