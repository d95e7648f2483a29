"""Records of live frames into samples, compiled, by the extraction plan.

Plain frames only: what the compiled pass does not know (:mod:`plan_tables`),
must be protected end to end, or is no data frame of a message, is left to
:class:`~bstm_daemon.bus.signals.decoder.Decoder`, which gives the same values.
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Final

from bstm_daemon.bus.signals.plan_tables import SAMPLE_REASONS, plan_tables
from bstm_daemon.roles import ROLES

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Mapping

    from bstm_daemon.bus.live.frame_records import FrameRecords
    from bstm_daemon.bus.signals.reject_reason import RejectReason
    from bstm_daemon.bus.signals.signal_map import SignalMap

_ROOM: Final = 4096
"""Room for samples of one pass; the rest comes with the next pass."""


class RecordDecoder:
    """Decodes runs of records of a :class:`SignalMap`.

    After :meth:`decode`, ``count`` samples stand in ``times_us``, ``roles``
    and ``values``.
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
