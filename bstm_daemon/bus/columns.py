"""A chunk of a log into samples, by the same plan as a live frame.

The samples come out in file order: frame after frame, and within a frame in
the order of the message's outputs. That is the order in which the decoder
gives them live, so time stamps that run backwards stay where they are.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from bstm_daemon.bus.candump_line import EXTENDED_MAX
from bstm_daemon.bus.column_plan import ColumnPlan, column_plan
from bstm_daemon.bus.compiled import LogExtension, extension
from bstm_daemon.bus.frame_chunk import FrameChunk
from bstm_daemon.bus.plan_tables import STANDARD_IDS
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.bus.signal_map import SignalMap

_FRAME_REASONS = (
    Refusal.UNKNOWN_INTERFACE,
    Refusal.UNKNOWN_ID,
    Refusal.WRONG_LENGTH,
)
_SAMPLE_REASONS = (
    Refusal.NOT_A_NUMBER,
    Refusal.OUT_OF_RANGE,
    Refusal.NOT_AVAILABLE,
)


@dataclass(frozen=True, slots=True)
class Events:
    """Samples in file order, *n* of them; ``counts`` as in the decoder."""

    time_us: npt.NDArray[np.int64]
    role: npt.NDArray[np.int32]
    value: npt.NDArray[np.float64]
    counts: Counter[Refusal]

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.time_us)


def decode_chunk(
    signal_map: SignalMap, chunk: FrameChunk, bus_of_channel: Sequence[int]
) -> Events:
    """Return the samples of *chunk*.

    ``bus_of_channel`` gives the bus number of each of the reader's
    interfaces, -1 for one that is not read. Values, order and counts are
    those of :class:`~bstm_daemon.bus.decoder.Decoder`, frame by frame.
    """
    plan = column_plan(signal_map)
    rows = plan.rows(bus_of_channel)
    compiled = extension()
    if compiled is None:
        return _with_numpy(plan, chunk, rows)
    return _with_extension(compiled, plan, chunk, rows)


@dataclass(frozen=True, slots=True)
class _Slots:
    """Room for samples; those without a sample are dropped at last."""

    times: npt.NDArray[np.int64]
    roles: npt.NDArray[np.int32]
    values: npt.NDArray[np.float64]
    kept: npt.NDArray[np.bool_]

    def events(self, counts: Counter[Refusal], *, all_kept: bool) -> Events:
        if all_kept:
            return Events(self.times, self.roles, self.values, counts)
        kept = self.kept
        return Events(
            self.times[kept], self.roles[kept], self.values[kept], counts
        )


def _with_extension(
    compiled: LogExtension,
    plan: ColumnPlan,
    chunk: FrameChunk,
    rows: npt.NDArray[np.int64],
) -> Events:
    message = np.empty(len(chunk), np.int32)
    frame_counts = np.zeros(len(_FRAME_REASONS), np.int64)
    count = compiled.place(
        *(chunk.channel, chunk.can_id, chunk.extended, chunk.length),
        *(rows, plan.standard, plan.extended, plan.extended_message),
        *(plan.lengths, plan.sizes, message, frame_counts),
    )
    slots = _Slots(
        np.empty(count, np.int64),
        np.empty(count, np.int32),
        np.empty(count, np.float64),
        np.empty(count, np.bool_),
    )
    sample_counts = np.zeros(len(_SAMPLE_REASONS), np.int64)
    compiled.extract(
        *(message, chunk.time_us, np.ascontiguousarray(chunk.data)),
        *(chunk.data.shape[1], plan.sizes, *plan.compiled),
        *(slots.times, slots.roles, slots.values, slots.kept, sample_counts),
    )
    counts = _named(_FRAME_REASONS, frame_counts)
    counts += _named(_SAMPLE_REASONS, sample_counts)
    all_kept = not sample_counts.any()
    if plan.foreign and count:
        places = np.cumsum(plan.sizes[message]) - plan.sizes[message]
        for number in plan.foreign:
            frames = np.flatnonzero(message == number)
            all_kept &= _fill(
                (plan, number),
                _items(chunk.data)[frames],
                places[frames],
                slots,
                counts,
            )
    return slots.events(counts, all_kept=all_kept)


def _with_numpy(
    plan: ColumnPlan, chunk: FrameChunk, rows: npt.NDArray[np.int64]
) -> Events:
    counts: Counter[Refusal] = Counter()
    message = _messages(plan, chunk, rows, counts)
    sizes = plan.sizes.take(message)
    ends = np.cumsum(sizes)
    count = int(ends[-1]) if len(ends) else 0
    slots = _Slots(
        np.repeat(chunk.time_us, sizes),
        np.empty(count, np.int32),
        np.empty(count, np.float64),
        np.ones(count, np.bool_),
    )
    all_kept = True
    if count:
        # frames by message, in file order; the unread ones come first
        order = np.argsort(message, kind="stable")
        payloads = _items(chunk.data)[order]
        places = (ends - sizes).take(order)
        bounds = np.searchsorted(
            message.take(order), np.arange(len(plan.messages) + 1)
        ).tolist()
        for number in range(len(plan.messages)):
            group = slice(bounds[number], bounds[number + 1])
            all_kept &= _fill(
                (plan, number), payloads[group], places[group], slots, counts
            )
    return slots.events(counts, all_kept=all_kept)


def _messages(
    plan: ColumnPlan,
    chunk: FrameChunk,
    rows: npt.NDArray[np.int64],
    counts: Counter[Refusal],
) -> npt.NDArray[np.signedinteger]:
    """Return each frame's position in the plan's messages, or -1."""
    # of an unread interface: counted from the end, where no message is
    place = (rows * STANDARD_IDS).take(chunk.channel)
    place += chunk.can_id & np.uint32(STANDARD_IDS - 1)
    message = plan.standard.ravel().take(place)
    if chunk.extended.any():
        extended = np.flatnonzero(chunk.extended)
        message[extended] = -1
        if plan.extended.size:
            keys = rows[chunk.channel[extended]] * (EXTENDED_MAX + 1)
            keys += chunk.can_id[extended]
            found = np.searchsorted(plan.extended, keys)
            found[found == len(plan.extended)] = 0
            hit = plan.extended[found] == keys
            message[extended[hit]] = plan.extended_message[found[hit]]
    unread = 0
    if (rows[:-1] < 0).any():
        unread = int(np.count_nonzero(rows[chunk.channel] < 0))
    lost = int(np.count_nonzero(message < 0))
    wrong = chunk.length != plan.lengths.take(message)
    if lost:
        wrong &= message >= 0
    wrong_count = int(np.count_nonzero(wrong))
    if wrong_count:
        message[wrong] = -1
    counts += _named(_FRAME_REASONS, (unread, lost - unread, wrong_count))
    # sorted much faster than wider numbers; a bus has 2048 ids and then some
    return message if len(plan.messages) >> 15 else message.astype(np.int16)


def _fill(
    message: tuple[ColumnPlan, int],
    payloads: npt.NDArray[np.void],
    places: npt.NDArray[np.int64],
    slots: _Slots,
    counts: Counter[Refusal],
) -> bool:
    """Write the samples of one message's frames; whether all are some."""
    plan, number = message
    if not len(payloads) or not plan.sizes[number]:
        return True
    columns = plan.messages[number]
    found = columns.decode(payloads, counts)
    # a frame's samples stand side by side: all in one item
    _runs(slots.values, len(columns.roles))[places] = _items(found.values)
    _runs(slots.roles, len(columns.roles))[places] = _items(
        columns.roles[np.newaxis]
    )
    if found.kept is None:
        return True
    _runs(slots.kept, len(columns.roles))[places] = _items(found.kept)
    return False


def _items(rows: npt.NDArray[Any]) -> npt.NDArray[np.void]:
    """Return the rows of a contiguous table, each as one item."""
    size = rows.shape[1] * rows.itemsize
    items: npt.NDArray[np.void] = np.ascontiguousarray(rows).view(
        np.dtype((np.void, size))
    )[:, 0]
    return items


def _runs(column: npt.NDArray[Any], count: int) -> npt.NDArray[np.void]:
    """Return the *count* entries from each place of *column* as an item."""
    size = column.itemsize
    return np.ndarray(
        (len(column) - count + 1,),
        np.dtype((np.void, count * size)),
        column.data,
        0,
        (size,),
    )


def _named(
    reasons: Sequence[Refusal], numbers: Sequence[int] | npt.NDArray[np.int64]
) -> Counter[Refusal]:
    return Counter(
        {
            reason: int(number)
            for reason, number in zip(reasons, numbers, strict=True)
            if number
        }
    )
