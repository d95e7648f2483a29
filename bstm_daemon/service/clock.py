"""Steady time axis of a drive, and the time the car stood parked.

Frames are stamped by the kernel in wall time, which jumps when NTP or a
person *sets* it. The time since boot never does, and runs on through suspend.
Slewing affects both alike. Their difference is therefore constant except for
steps.

The brakes may cool for no longer than the car stood: time that is not proven
keeps them hot. Within one boot of the computer the time since boot proves it,
which nobody sets. Over a power cut there are two proofs: the uptime since, and
the wall clock if it was synchronised at both ends.
"""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

Clock = Callable[[], int]
"""A reading [ns]."""

STEP_US: Final = 10_000
"""A change of wall time against boot time above this is a step."""

_STEP_NS: Final = STEP_US * 1000
_NARROW_NS: Final = 50_000
_TRIES: Final = 5

BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")

_STA_UNSYNC: Final = 0x40


class _Timex(ctypes.Structure):
    """The beginning of ``struct timex``, adjtimex(2), and room for the rest.

    With ``modes`` 0 the call only reads.
    """

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 256),
    )


_LIBC: Final = ctypes.CDLL(None)


# no Python functions: they are called six times a drain
wall_clock_ns: Final[Clock] = partial(
    time.clock_gettime_ns, time.CLOCK_REALTIME
)
"""As the kernel stamps frames."""

boot_clock_ns: Final[Clock] = partial(
    time.clock_gettime_ns, time.CLOCK_BOOTTIME
)
"""It counts suspend and is never set."""


def kernel_error_us() -> int | None:
    """Return how far the wall clock may be from the true time (us).

    It is the bound that whatever synchronises the clock (chrony, ntpd,
    systemd-timesyncd, phc2sys) keeps in the kernel. None if nothing has
    synchronised it since the start or since it was set by hand, or if the
    system does not report it.
    """
    timex = _Timex()
    if _LIBC.adjtimex(ctypes.byref(timex)) < 0 or timex.status & _STA_UNSYNC:
        return None
    return int(timex.maxerror)


class SteadyAxis:
    """Microseconds that equal wall time at the start and never step.

    :meth:`read` at every drain, before the sockets are read; then
    :meth:`of_stamp` for each frame. As long as the wall clock is not set, the
    axis is the stamp itself, to the microsecond.
    """

    # read after every sleep, when the caches are cold
    __slots__ = (
        *(
            "_boot_ns",
            "_error_us",
            "_kept",
            "_now_us",
            "_offset_ns",
            "_shifts",
        ),
        *("_since_us", "_start_offset_ns", "_wall_ns"),
        *("last_step_us", "steps"),
    )

    def __init__(
        self,
        wall_ns: Clock = wall_clock_ns,
        boot_ns: Clock = boot_clock_ns,
        error_us: Callable[[], int | None] = kernel_error_us,
    ) -> None:
        """Measure the offset of *wall_ns* from *boot_ns*.

        *error_us* says how far *wall_ns* may be from the true time.
        """
        self._error_us = error_us
        self._wall_ns = wall_ns
        self._boot_ns = boot_ns
        before, wall, after = boot_ns(), wall_ns(), boot_ns()
        wall, before, after = self._narrower(wall, before, after)
        self._start_offset_ns = (wall - after + wall - before) // 2
        self._offset_ns = self._start_offset_ns
        self._shifts: tuple[int, ...] = (0,)
        """What to take off wall time in us: the shift in effect, and before
        it those that frames still to be read may have been stamped under."""
        self._kept = 1
        self._since_us = self._now_us = wall // 1000
        self.steps = 0
        """How often the wall clock was stepped."""
        self.last_step_us = 0
        """The last step; positive where the wall clock was put forward."""

    @property
    def now_us(self) -> int:
        """The time (us) that was read last."""
        return self._now_us

    def read(self) -> int:
        """Return the time now (us); notices a step since the last call."""
        # a step was found during a drain: buses drained earlier may still
        # hold frames stamped before it
        if len(self._shifts) > 1:
            self._shifts = self._shifts[-self._kept :]
        self._kept = 1
        self._since_us = self._now_us
        return self._advance()

    def of_stamp(self, stamp_ns: int) -> int:
        """Return the axis time (us) of a frame that was read just now.

        The frame arrived after the :meth:`read` before the last one. If the
        clock was stepped meanwhile, this bound shows on which side of the
        step the stamp was made; an ambiguous one counts as before it.
        """
        cut_us = stamp_ns // 1000
        low_us = self._since_us - STEP_US
        high_us = self._now_us + STEP_US
        for shift_us in self._shifts:
            if low_us <= cut_us - shift_us <= high_us:
                return cut_us - shift_us
        return self._outlying(cut_us)

    def window(self) -> tuple[int, int, int] | None:
        """Return what to take off a stamp (us), and for which times.

        While a stamp less the first lies between the second and the third,
        that difference is what :meth:`of_stamp` returns. None during a step,
        where every stamp has to be examined.
        """
        if len(self._shifts) > 1:
            return None
        return (
            self._shifts[0],
            self._since_us - STEP_US,
            self._now_us + STEP_US,
        )

    def read_again(self) -> int:
        """Return the time now (us) within a drain."""
        known = len(self._shifts)
        now_us = self._advance()
        self._kept += len(self._shifts) - known
        return now_us

    def wall_of(self, axis_us: int) -> int:
        """Return the wall time (us since 1970), as of today, of *axis_us*."""
        return axis_us + self._shifts[-1]

    def wall_error_us(self) -> int | None:
        """Return how far :meth:`wall_of` is from the true time at most (us).

        None if the wall clock is not synchronised. The time is read as by
        :meth:`read_again`, between two queries of the error, so that a step
        before the reading is noticed.
        """
        before_us = self._error_us()
        self.read_again()
        after_us = self._error_us()
        if before_us is None or after_us is None:
            return None
        return max(before_us, after_us) + STEP_US

    def boot_of(self, axis_us: int) -> int:
        """Return the time since boot (us), suspend included, of *axis_us*."""
        return axis_us - self._start_offset_ns // 1000

    def _outlying(self, cut_us: int) -> int:
        """Place a stamp that fits no shift known so far.

        It may reveal a step after the last :meth:`read`. With a step, a stamp
        that still fits nowhere was made between two steps and is clamped to
        the interval in which the frame arrived. Without one it is accepted.
        """
        high_us = self.read_again()
        low_us = self._since_us
        if len(self._shifts) == 1:
            return cut_us - self._shifts[0]
        nearest_us = min(
            (cut_us - shift_us for shift_us in self._shifts),
            key=lambda us: max(low_us - us, us - high_us, 0),
        )
        if low_us - STEP_US <= nearest_us <= high_us + STEP_US:
            return nearest_us
        return min(max(nearest_us, low_us), high_us)

    def _advance(self) -> int:
        """Read the clocks, take over a step, return the time now (us)."""
        boot_ns = self._boot_ns
        before = boot_ns()
        wall = self._wall_ns()
        after = boot_ns()
        if after - before > _NARROW_NS:
            wall, before, after = self._narrower(wall, before, after)
        low, high = wall - after, wall - before
        # a slow reading is uncertain by its duration: that is no step
        if not low - _STEP_NS <= self._offset_ns <= high + _STEP_NS:
            offset_ns = (low + high) // 2
            self.steps += 1
            self.last_step_us = (offset_ns - self._offset_ns) // 1000
            self._offset_ns = offset_ns
            # relative to the start, so that reading errors do not add up
            shift_us = (offset_ns - self._start_offset_ns) // 1000
            self._shifts = (*self._shifts, shift_us)
        now_us = wall // 1000 - self._shifts[-1]
        self._now_us = max(self._now_us, now_us)
        return self._now_us

    def _narrower(
        self, wall: int, before: int, after: int
    ) -> tuple[int, int, int]:
        """Return wall time and those between whose boot times it was read.

        Read again a few times, as the process was held up in between; the
        narrowest counts.
        """
        for _ in range(_TRIES - 1):
            if after - before <= _NARROW_NS:
                break
            began = self._boot_ns()
            now = self._wall_ns()
            ended = self._boot_ns()
            if ended - began < after - before:
                wall, before, after = now, began, ended
        return wall, before, after


def boot_id(path: Path = BOOT_ID) -> str | None:
    """Return the id of this boot of the kernel, None where unknown."""
    try:
        return path.read_text(encoding="ascii").strip() or None
    except (OSError, UnicodeDecodeError):
        return None


@dataclass(frozen=True, slots=True)
class Moment:
    """An instant by every clock of the computer.

    ``wall_error_us`` is how far the wall clock may be from the true time;
    None if it is not synchronised. ``boot_id`` is None where the system
    does not name its boots.
    """

    boot_id: str | None
    boot_us: int
    wall_us: int
    wall_error_us: int | None

    @classmethod
    def saved(cls, document: Mapping[str, Any]) -> Moment | None:
        """Return the moment in a state file's *document*, None without."""
        boot_us, wall_us = document.get("boot_us"), document.get("wall_us")
        if not (isinstance(boot_us, int) and isinstance(wall_us, int)):
            return None
        boot_id = document.get("boot_id")
        error_us = document.get("wall_error_us")
        return cls(
            boot_id if isinstance(boot_id, str) else None,
            boot_us,
            wall_us,
            error_us if isinstance(error_us, int) and error_us >= 0 else None,
        )


class ParkedTime(NamedTuple):
    """The shortest time [us] that the clocks allow; whether it is exact."""

    us: int
    exact: bool


def parked_time(saved: Moment | None, start: Moment) -> ParkedTime:
    """Return how long the car stood at least from *saved* to *start*."""
    if saved is None:
        return ParkedTime(0, exact=False)
    if saved.boot_id is None or start.boot_id is None:
        up_us = 0
    elif saved.boot_id == start.boot_id:
        return ParkedTime(max(start.boot_us - saved.boot_us, 0), exact=True)
    else:
        up_us = max(start.boot_us, 0)
    if saved.wall_error_us is None or start.wall_error_us is None:
        return ParkedTime(up_us, exact=False)
    error_us = saved.wall_error_us + start.wall_error_us
    wall_us = start.wall_us - saved.wall_us - error_us
    return ParkedTime(max(up_us, wall_us), exact=True)
