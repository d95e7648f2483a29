"""Received frames in one block of memory, and their samples, compiled.

The compiled code (``bus.h``) fills the records, puts them in order and takes
their samples; a frame becomes a Python object only on demand.
"""

from __future__ import annotations

import mmap
import struct
from array import array
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.live.link import DRAIN_LIMIT, Frame
from bstm_daemon.bus.signals.plan_tables import SAMPLE_REASONS, plan_tables
from bstm_daemon.roles import ROLES

if TYPE_CHECKING:
    from collections import Counter

    from bstm_daemon.bus.signals.reject_reason import RejectReason
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.native.loader import BusExtension

_HEAD: Final = struct.Struct("=qqIi4B4x")
"""Stamp [ns], time [us], id, bus; extended, length, error, remote."""

_TIME: Final = struct.Struct("=q")
_TIME_OFFSET: Final = 8
_DATA_BYTES: Final = 64
RECORD_BYTES: Final = _HEAD.size + _DATA_BYTES
_ROOM: Final = 4096
"""Room for samples of one pass; the rest comes with the next pass."""


class FrameRecords:
    """The frames of some buses: the first ``ready`` in order, others held.

    ``store`` is the memory, of which ``filled`` records are in use. As a
    sequence it has the ready ones: time [us], bus number, frame.
    """

    __slots__ = ("extension", "filled", "ready", "room", "store")

    def __init__(self, extension: BusExtension, buses: int) -> None:
        """Make room for a drain of each of *buses* and what it holds back."""
        self.extension: Final = extension
        self.room: Final = 2 * buses * DRAIN_LIMIT
        # untouched pages take no memory
        self.store: Final = mmap.mmap(
            -1,
            self.room * RECORD_BYTES,
            flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS,
        )
        self.filled = 0
        self.ready = 0

    def __len__(self) -> int:
        """Return the number of ready frames."""
        return self.ready

    def __getitem__(self, index: int) -> tuple[int, int, Frame]:
        """Return time [us], bus number and frame of a ready one."""
        if not 0 <= index < self.ready:
            raise IndexError(index)
        return self.at(index)

    def __iter__(self) -> Iterator[tuple[int, int, Frame]]:
        """Yield the ready ones."""
        return map(self.at, range(self.ready))

    def at(self, index: int) -> tuple[int, int, Frame]:
        """Return any filled record as time [us], bus number, frame."""
        start = index * RECORD_BYTES
        stamp_ns, time_us, can_id, bus, extended, length, error, remote = (
            _HEAD.unpack_from(self.store, start)
        )
        start += _HEAD.size
        data = bytes(self.store[start : start + length])
        frame = Frame(
            stamp_ns, can_id, extended != 0, data, error != 0, remote != 0
        )
        return time_us, bus, frame

    def set_time(self, index: int, time_us: int) -> None:
        """Put a record on the axis at *time_us*."""
        start = index * RECORD_BYTES + _TIME_OFFSET
        _TIME.pack_into(self.store, start, time_us)

    def sort(self, until_us: int) -> None:
        """Put all in order; what is not after *until_us* becomes ready."""
        self.ready = self.extension.sort(self.store, self.filled, until_us)

    def drop_ready(self) -> None:
        """Forget the ready frames; those held come first from now on."""
        begin, end = self.ready * RECORD_BYTES, self.filled * RECORD_BYTES
        self.filled -= self.ready
        if self.ready and self.filled:
            self.store[: end - begin] = self.store[begin:end]
        self.ready = 0


class RecordDecoder:
    """Decodes runs of records of a :class:`SignalMap`, plain frames only.

    What the compiled pass does not know (:mod:`plan_tables`), must be
    protected end to end, or is no data frame of a message, is left to
    :class:`~bstm_daemon.bus.signals.decoder.Decoder`, which gives the same
    values. After :meth:`decode`, ``count`` samples stand in ``times_us``,
    ``roles`` and ``values``.
    """

    def __init__(self, signal_map: SignalMap, held: Mapping[int, str]) -> None:
        """Prepare the tables of *signal_map*.

        Samples of the role numbers *held* are handed out once more, as
        objects, under their name.
        """
        plan = plan_tables(signal_map)
        for number, key in enumerate(signal_map.messages):
            plan.by_hand[number] |= key in signal_map.protected
        room = max(
            _ROOM, *(len(one.outputs) for one in signal_map.messages.values())
        )
        self.times_us = array("q", bytes(8 * room))
        self.roles = array("i", bytes(4 * room))
        self.values = array("d", bytes(8 * room))
        self.count = 0
        self._refused = array("q", bytes(8 * len(SAMPLE_REASONS)))
        self._arguments = (
            plan.buffers(),
            *(self.times_us, self.roles, self.values, self._refused),
            tuple(held.get(number) for number in range(len(ROLES))),
        )

    def decode(
        self,
        records: FrameRecords,
        first: int,
        counts: Counter[RejectReason],
        held: list[tuple[int, str, float]],
    ) -> int:
        """Decode ready frames from *first* on; refused samples are counted.

        Time [us], name and value of each held sample go to *held*.

        Returns:
            The first frame that was not decoded: one to decode by itself, or
            one for which there was no room any more.
        """
        position, self.count = records.extension.take(
            records.store, first, records.ready, *self._arguments, held
        )
        for place, count in enumerate(self._refused):
            if count:
                counts[SAMPLE_REASONS[place]] += count
                self._refused[place] = 0
        return position
