"""The view of a recorded log: what the service would have published."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import chain
from math import inf
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from bstm_daemon.engine import Published
    from bstm_daemon.watch.board import Board
    from bstm_daemon.watch.lines import LineView

DEFAULT_SPEED: Final = 60.0
"""A minute of the drive in a second: a descent lasts half a minute."""

LONGEST_WAIT_S: Final = 1.0
"""Longer gaps, such as a parked hour, are skipped."""


def watch_log(
    ticks: Iterator[list[Published]],
    board: Board,
    name: str,
    view: LineView,
    speed: float = DEFAULT_SPEED,
) -> None:
    """Show what is published over a log, tick by tick.

    Returns at the end of the log or once the user leaves; on a terminal the
    last picture stays until then.

    Args:
        ticks: what becomes due, of
            :func:`~bstm_daemon.replay.frames.publications`.
        board: takes the frames.
        name: of the log.
        view: where to show it.
        speed: seconds of the log per second; 0 is as fast as it goes.

    Raises:
        BstmError: what *ticks* raises.
    """
    # fail on an unreadable log before the screen is taken over
    ahead = next(ticks)
    pace = Pace(speed, view.pause)
    factor = f"{speed:g}x" if speed else "full speed"
    first_us: int | None = None
    now_us = 0
    source = name
    with suppress(KeyboardInterrupt), view:
        for published in chain([ahead], ticks):
            for time_us, frame in published:
                if time_us != now_us and first_us is not None:
                    view.show(board, now_us, source)
                    pace.wait(time_us)
                    if view.has_left:
                        return
                first_us = time_us if first_us is None else first_us
                now_us = time_us
                at = _clock((now_us - first_us) * 1e-6)
                source = f"{name}  {at}  {factor}"
                board.frame(frame.can_id, frame.data, time_us)
        view.show(board, now_us, f"{source}  end", at_once=True)
        view.linger()


class Pace:
    """Holds the log to a multiple of real time, by absolute deadlines."""

    def __init__(self, speed: float, pause: Callable[[float], object]) -> None:
        """Let *pause* wait; *speed* 0 is as fast as it goes."""
        self._speed = speed
        self._pause = pause
        self._shift_s = -inf

    def wait(self, time_us: int) -> None:
        """Wait until *time_us* of the log is due.

        Where the log jumps or the computer falls behind, the deadlines are
        shifted instead of caught up with.
        """
        if not self._speed:
            return
        now_s = time.monotonic()
        log_s = time_us * 1e-6 / self._speed
        ahead_s = log_s + self._shift_s - now_s
        if not 0.0 <= ahead_s <= LONGEST_WAIT_S:
            ahead_s = LONGEST_WAIT_S if 0.0 < ahead_s < inf else 0.0
            self._shift_s = now_s + ahead_s - log_s
        self._pause(ahead_s)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (
        f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
    )
