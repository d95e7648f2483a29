"""The view of a recorded log: what the service would have published."""

from __future__ import annotations

import time
from contextlib import suppress
from itertools import chain
from math import inf
from typing import TYPE_CHECKING, Final

from bstm_daemon.replay.frames import replayed
from bstm_daemon.watch.board import Board

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from typing import Any

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.watch.lines import LineView

DEFAULT_SPEED: Final = 60.0
"""A minute of the drive in a second: a descent lasts half a minute."""

LONGEST_WAIT_S: Final = 1.0
"""Longer gaps, such as a parked hour, are skipped."""


def watch_log(  # noqa: PLR0913  (all but the log are about the view)
    config: Config,
    signal_map: SignalMap,
    path: Path,
    overrides: Mapping[str, str] | None = None,
    *,
    view: LineView,
    speed: float = DEFAULT_SPEED,
    state: Mapping[str, Any] | None = None,
    forecast: bool = True,
) -> None:
    """Show the frames that the engine publishes over the log *path*.

    Returns at the end of the log or once the user leaves; on a terminal the
    last picture stays until then.

    Args:
        config: the vehicle.
        signal_map: its extraction plan.
        path: a log of CAN frames.
        overrides: log interface name to bus name.
        view: where to show it.
        speed: seconds of the log per second; 0 is as fast as it goes.
        state: a state file's document; without it the history is unknown.
        forecast: whether to publish risk and forecast.

    Raises:
        LogError: the log is unusable, or a signal table.
        FileAccessError: it can not be read.
    """
    board = Board(
        config.publish.id_base, [corner.name for corner in config.corner]
    )
    ticks = replayed(
        config, signal_map, path, overrides, state, forecast=forecast
    )
    # fail on an unreadable log before the screen is taken over
    ahead = next(ticks)
    pace = _Pace(speed, view)
    factor = f"{speed:g}x" if speed else "full speed"
    first_us: int | None = None
    now_us = 0
    source = path.name
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
                source = f"{path.name}  {at}  {factor}"
                board.frame(frame.can_id, frame.data, time_us)
        view.show(board, now_us, f"{source}  end", at_once=True)
        view.linger()


class _Pace:
    """Holds the log to a multiple of real time, by absolute deadlines."""

    def __init__(self, speed: float, view: LineView) -> None:
        self._speed = speed
        self._view = view
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
        self._view.pause(ahead_s)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return (
        f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
    )
