"""Intake of frames: merges those of all links in time order."""

from collections.abc import Sequence
from operator import itemgetter
from typing import Final

from bstm_daemon.bus.live.frame_records import FrameRecords
from bstm_daemon.bus.live.link import Frame, Link
from bstm_daemon.bus.live.socketcan import SocketcanLink
from bstm_daemon.native.loader import live_extension
from bstm_daemon.service.clock import SteadyAxis

GUARD_US: Final = 2_000
"""Longest delay from a frame's stamp to the socket. Frames stamped less than
this before a drain wait for the next one, so that frames of several buses
stay in order and no grid line is passed too early."""

Arrival = tuple[int, int, "Frame"]
"""Time on the steady axis [us], bus number, frame."""

Arrivals = list[Arrival] | FrameRecords
"""Both support iteration, ``len`` and indexing."""

_TIME: Final = itemgetter(0)
_EVER_US: Final = -(2**63)


class Intake:
    """Drains the links and holds back frames that may not be in order yet.

    Where all links are SocketCAN interfaces and the compiled form is
    available, frames stay C records until one has to be examined.
    """

    def __init__(self, links: Sequence[Link], axis: SteadyAxis) -> None:
        """Read *links*, whose numbers are those of their buses."""
        self._axis = axis
        self._passed_us: int | None = None
        self.late = 0
        """Frames read after their time had been passed."""
        self._begin(links)

    def _begin(self, links: Sequence[Link]) -> None:
        self.links = list(links)
        self.frames = [0] * len(self.links)
        self._held: list[Arrival] = []
        self._records: FrameRecords | None = None
        self._interfaces: list[SocketcanLink] = [
            link for link in self.links if isinstance(link, SocketcanLink)
        ]
        extension = live_extension()
        if extension is not None and len(self._interfaces) == len(links):
            self._records = FrameRecords(extension, len(links))

    def read(self, now_us: int) -> tuple[int, Arrivals]:
        """Drain all links at *now_us*, read from the axis just before.

        Returns:
            (time up to which everything has come, the frames up to it,
            oldest first: a list, or records which hold until the next read).
        """
        until_us = now_us - GUARD_US
        arrivals: Arrivals
        if self._records is None:
            arrivals = self._read_frames(now_us, until_us)
        else:
            arrivals = self._read_records(self._records, now_us, until_us)
        self._passed_us = until_us
        return until_us, arrivals

    def _read_frames(self, now_us: int, until_us: int) -> list[Arrival]:
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
                    # the drain was delayed; a received frame cannot be newer
                    # than now
                    latest_us = self._axis.read_again()
                    time_us = min(time_us, latest_us)
                if passed_us is not None and time_us < passed_us:
                    time_us = passed_us
                    self.late += 1
                arrivals.append((time_us, bus, frame))
        # stable: frames of one bus with equal stamps keep their order
        arrivals.sort(key=_TIME)
        ready = len(arrivals)
        while ready and arrivals[ready - 1][0] > until_us:
            ready -= 1
        self._held = arrivals[ready:]
        return arrivals[:ready]

    def _read_records(
        self, records: FrameRecords, now_us: int, until_us: int
    ) -> FrameRecords:
        """Read as :meth:`_read_frames` does, with the same result."""
        records.drop_ready()
        latest_us = now_us
        for bus, link in enumerate(self._interfaces):
            first = records.filled
            link.drain_records(records, bus)
            self.frames[bus] += records.filled - first
            latest_us = self._place_in_time(records, first, latest_us)
        records.sort(until_us)
        return records

    def _place_in_time(
        self, records: FrameRecords, first: int, latest_us: int
    ) -> int:
        """Set the times of the records from *first* on; return the latest.

        Only a record whose stamp must be examined becomes a frame here.
        """
        axis = self._axis
        passed_us = _EVER_US if self._passed_us is None else self._passed_us
        while first < records.filled:
            window = axis.window()
            if window is not None:
                first, late = records.extension.place_in_time(
                    *(records.store, first, records.filled),
                    *(*window, latest_us, passed_us),
                )
                self.late += late
                if first == records.filled:
                    break
            _, _, frame = records.at(first)
            time_us = axis.of_stamp(frame.stamp_ns)
            if time_us > latest_us:
                latest_us = axis.read_again()
                time_us = min(time_us, latest_us)
            if time_us < passed_us:
                time_us = passed_us
                self.late += 1
            records.set_time(first, time_us)
            first += 1
        return latest_us

    def replace(self, links: Sequence[Link]) -> None:
        """Continue with other *links*; frames still held are dropped."""
        self.close()
        self._begin(links)

    def close(self) -> None:
        """Close every link."""
        for link in self.links:
            link.close()
