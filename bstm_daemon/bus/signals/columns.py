"""A chunk of a log into samples, by the same plan as a live frame.

The samples come out in file order: frame after frame, and within a frame in
the order of the message's outputs. That is the order in which the decoder
gives them live, so time stamps that run backwards stay where they are.

Two forms with the same bits: :class:`~bstm_daemon.bus.signals.decoder.Decoder`
frame by frame, and the compiled pass (``extract.c``) over the tables of
:mod:`~bstm_daemon.bus.signals.plan_tables`, which leaves to the decoder the
messages that the tables cannot hold.
"""

from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.e2e_guard import E2eGuard
from bstm_daemon.bus.signals.frame_chunk import FrameChunk, rows_of
from bstm_daemon.bus.signals.plan_tables import SAMPLE_REASONS, plan_tables
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.native.loader import BusExtension, extension

_FRAME_REASONS: Final = (
    RejectReason.UNKNOWN_INTERFACE,
    RejectReason.UNKNOWN_ID,
    RejectReason.WRONG_LENGTH,
)


@dataclass(frozen=True, slots=True)
class Events:
    """Samples in file order, *n* of them.

    Attributes:
        time_us: Stamps [us], (n,).
        role: Numbers of the roles, (n,).
        value: Values in SI, (n,).
        counts: Frames and values that gave no sample, by reason.
    """

    time_us: npt.NDArray[np.int64]
    role: npt.NDArray[np.int32]
    value: npt.NDArray[np.float64]
    counts: Counter[RejectReason] = field(default_factory=Counter)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.time_us)


class ChunkDecoder:
    """Decodes the chunks of one log, in file order, by a :class:`SignalMap`.

    Frames that must be protected end to end and are not give no sample.
    """

    def __init__(self, signal_map: SignalMap) -> None:
        """Lay out the plan of *signal_map* for whichever form there is."""
        self._decoder = Decoder(signal_map)
        self._guard = E2eGuard(signal_map)
        self._compiled = extension()
        if self._compiled is not None:
            self._plan = plan_tables(signal_map).buffers()
            sizes = (len(one.outputs) for one in signal_map.messages.values())
            self._most = max(sizes, default=0)

    def decode(
        self, chunk: FrameChunk, bus_of_channel: Sequence[int]
    ) -> Events:
        """Return the samples of *chunk*.

        Args:
            chunk: Frames in file order.
            bus_of_channel: The bus number of each of the reader's
                interfaces, -1 for one that is not read.

        Returns:
            What the decoder gives frame by frame: the same values, bit for
            bit, the same order, the same counts.
        """
        self._decoder.counts = Counter()
        if self._guard.keys:
            chunk = self._guarded(chunk, bus_of_channel)
        if self._compiled is None:
            return self._frame_by_frame(chunk, bus_of_channel)
        return self._compiled_runs(self._compiled, chunk, bus_of_channel)

    def _guarded(
        self, chunk: FrameChunk, bus_of_channel: Sequence[int]
    ) -> FrameChunk:
        """Return *chunk* without the frames that the guard refuses."""
        kept = np.ones(len(chunk), np.bool_)
        bus = np.array(bus_of_channel, np.int64)[chunk.channel]
        for key in self._guard.keys:
            own = (chunk.can_id == key.can_id) & (bus == key.bus)
            for row in np.flatnonzero(own & (chunk.extended == key.extended)):
                data = chunk.data[row, : chunk.length[row]].tobytes()
                reason = self._guard.refusal(*key, data)
                if reason is not None:
                    self._decoder.counts[reason] += 1
                    kept[row] = False
        return chunk if kept.all() else rows_of(chunk, kept)

    def _frame_by_frame(
        self, chunk: FrameChunk, bus_of_channel: Sequence[int]
    ) -> Events:
        decoder = self._decoder
        times, roles, values = array("q"), array("i"), array("d")
        for time_us, channel, can_id, extended, data in zip(
            chunk.time_us.tolist(),
            chunk.channel.tolist(),
            chunk.can_id.tolist(),
            chunk.extended.tolist(),
            chunk.payloads(),
            strict=True,
        ):
            bus = bus_of_channel[channel]
            if bus < 0:
                decoder.counts[RejectReason.UNKNOWN_INTERFACE] += 1
                continue
            for role, value in decoder.decode(bus, can_id, extended, data):
                times.append(time_us)
                roles.append(role)
                values.append(value)
        return Events(
            np.array(times, np.int64),
            np.array(roles, np.int32),
            np.array(values, np.float64),
            decoder.counts,
        )

    def _compiled_runs(
        self,
        compiled: BusExtension,
        chunk: FrameChunk,
        bus_of_channel: Sequence[int],
    ) -> Events:
        """Decode runs of frames compiled, those between them by themselves."""
        room = len(chunk) * self._most
        times = np.empty(room, np.int64)
        roles = np.empty(room, np.int32)
        values = np.empty(room, np.float64)
        frame_counts = array("q", bytes(8 * len(_FRAME_REASONS)))
        sample_counts = array("q", bytes(8 * len(SAMPLE_REASONS)))
        arguments = (
            *(chunk.channel, chunk.can_id, chunk.extended, chunk.length),
            *(chunk.time_us, np.ascontiguousarray(chunk.data)),
            *(array("q", bus_of_channel), times, roles, values),
            *(frame_counts, sample_counts),
        )
        at = count = 0
        while at < len(chunk):
            at, count = compiled.extract(self._plan, at, count, *arguments)
            if at < len(chunk):
                for role, value in self._decoder.decode(
                    bus_of_channel[chunk.channel[at]],
                    int(chunk.can_id[at]),
                    bool(chunk.extended[at]),
                    chunk.data[at, : chunk.length[at]].tobytes(),
                ):
                    times[count] = chunk.time_us[at]
                    roles[count] = role
                    values[count] = value
                    count += 1
                at += 1
        counts = self._decoder.counts
        for reason, number in zip(
            (*_FRAME_REASONS, *SAMPLE_REASONS),
            (*frame_counts, *sample_counts),
            strict=True,
        ):
            if number:
                counts[reason] += number
        return Events(times[:count], roles[:count], values[:count], counts)
