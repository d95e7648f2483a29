"""The frames of a chunk past the guard of the end-to-end protection."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.bus.frame_chunk import rows_of

if TYPE_CHECKING:
    from collections import Counter
    from collections.abc import Sequence

    from bstm_daemon.bus.e2e_guard import E2eGuard
    from bstm_daemon.bus.frame_chunk import FrameChunk
    from bstm_daemon.bus.refusal import Refusal


def accepted_frames(
    guard: E2eGuard,
    chunk: FrameChunk,
    bus_of_channel: Sequence[int],
    counts: Counter[Refusal],
) -> FrameChunk:
    """Return *chunk* without the frames that *guard* refuses.

    ``bus_of_channel`` gives the bus number of each of the reader's
    interfaces; *counts* takes the refused frames by reason. The chunks of a
    log must come in file order.
    """
    if not guard.keys or not len(chunk):
        return chunk
    kept = np.ones(len(chunk), np.bool_)
    bus = np.array(bus_of_channel, np.int64)[chunk.channel]
    for key in guard.keys:
        own = (chunk.can_id == key.can_id) & (bus == key.bus)
        for row in np.flatnonzero(own & (chunk.extended == key.extended)):
            data = chunk.data[row, : chunk.length[row]].tobytes()
            refusal = guard.refusal(*key, data)
            if refusal is not None:
                counts[refusal] += 1
                kept[row] = False
    return chunk if kept.all() else rows_of(chunk, kept)
