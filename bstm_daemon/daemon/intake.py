"""From the links to the engine: frames of all buses in order of time."""

from __future__ import annotations

from operator import itemgetter
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.bus.link import Frame, Link
    from bstm_daemon.daemon.clock import SteadyAxis

GUARD_US: Final = 2_000
"""How long a frame may take from its stamp into the socket: what is stamped
later than this before the drain waits for the next one, so that frames of
several buses come in order and no grid line is passed too early."""

Arrival = tuple[int, int, "Frame"]
"""Time on the steady axis [us], bus number, frame."""

_TIME: Final = itemgetter(0)


class Intake:
    """Drains the links and holds back what may not be in order yet."""

    def __init__(self, links: Sequence[Link], axis: SteadyAxis) -> None:
        """Read *links*, whose numbers are those of their buses."""
        self.links = list(links)
        self._axis = axis
        self._held: list[Arrival] = []
        self._passed_us: int | None = None
        self.frames = [0] * len(self.links)
        self.late = 0
        """Frames read after their time had been passed."""

    def read(self, now_us: int) -> tuple[int, list[Arrival]]:
        """Drain all links at *now_us*, read from the axis just before.

        Returns:
            (time up to which everything has come, the frames up to it,
            oldest first).
        """
        until_us = now_us - GUARD_US
        of_stamp = self._axis.of_stamp
        passed_us = self._passed_us
        latest_us = now_us
        arrivals = self._held
        for bus, link in enumerate(self.links):
            frames = link.drain()
            self.frames[bus] += len(frames)
            for frame in frames:
                time_us = of_stamp(frame.stamp_ns)
                if time_us > latest_us:
                    # the drain was held up; but what is here, is not of the
                    # future
                    latest_us = self._axis.read_again()
                    time_us = min(time_us, latest_us)
                if passed_us is not None and time_us < passed_us:
                    time_us = passed_us
                    self.late += 1
                arrivals.append((time_us, bus, frame))
        # stable: frames of one bus with one stamp stay as they came
        arrivals.sort(key=_TIME)
        ready = len(arrivals)
        while ready and arrivals[ready - 1][0] > until_us:
            ready -= 1
        self._held = arrivals[ready:]
        self._passed_us = until_us
        return until_us, arrivals[:ready]

    def replace(self, links: Sequence[Link]) -> None:
        """Go on with other *links*; what is held goes with the old ones."""
        self.close()
        self.links = list(links)
        self._held = []
        self.frames = [0] * len(self.links)

    def close(self) -> None:
        """Close every link."""
        for link in self.links:
            link.close()
