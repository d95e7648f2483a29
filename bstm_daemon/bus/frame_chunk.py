"""Frames of a log as columns."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt


def _prefix_masks(size: int) -> npt.NDArray[np.uint64]:
    kept = np.arange(size) < np.arange(size + 1)[:, np.newaxis]
    return np.where(kept, 0xFF, 0).astype(np.uint8).view("<u8")


PREFIX_MASKS: Final = {size: _prefix_masks(size) for size in (8, 64)}
"""By the columns of a payload: row k keeps its first k bytes."""


@dataclass(frozen=True, slots=True)
class FrameChunk:
    """Data frames in file order, *n* of them.

    ``time_us`` is the log's stamp in microseconds, ``line`` the line number
    (the first is 1), ``channel`` the position in the reader's list of
    interface names. ``data`` has 8 columns, or 64 where a longer frame is
    among them; bytes beyond ``length`` are zero.
    """

    time_us: npt.NDArray[np.int64]
    line: npt.NDArray[np.int64]
    channel: npt.NDArray[np.int16]
    can_id: npt.NDArray[np.uint32]
    extended: npt.NDArray[np.bool_]
    length: npt.NDArray[np.uint8]
    data: npt.NDArray[np.uint8]

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.time_us)


def rows_of(chunk: FrameChunk, kept: npt.NDArray[np.bool_]) -> FrameChunk:
    """Return the frames of *chunk* where *kept*, (n,), is true."""
    rows = np.flatnonzero(kept)
    return FrameChunk(
        time_us=chunk.time_us.take(rows),
        line=chunk.line.take(rows),
        channel=chunk.channel.take(rows),
        can_id=chunk.can_id.take(rows),
        extended=chunk.extended.take(rows),
        length=chunk.length.take(rows),
        data=chunk.data.take(rows, axis=0),
    )


def join_in_file_order(parts: list[FrameChunk]) -> FrameChunk:
    """Return all frames of *parts* (each in file order) as one chunk."""
    if len(parts) == 1:
        return parts[0]
    order = np.argsort(
        np.concatenate([part.line for part in parts]), kind="stable"
    )
    width = max(part.data.shape[1] for part in parts)
    return FrameChunk(
        time_us=np.concatenate([part.time_us for part in parts])[order],
        line=np.concatenate([part.line for part in parts])[order],
        channel=np.concatenate([part.channel for part in parts])[order],
        can_id=np.concatenate([part.can_id for part in parts])[order],
        extended=np.concatenate([part.extended for part in parts])[order],
        length=np.concatenate([part.length for part in parts])[order],
        data=np.concatenate(
            [
                np.pad(part.data, ((0, 0), (0, width - part.data.shape[1])))
                for part in parts
            ]
        )[order],
    )


def empty_chunk() -> FrameChunk:
    """Return a chunk without frames."""
    return FrameChunk(
        time_us=np.empty(0, np.int64),
        line=np.empty(0, np.int64),
        channel=np.empty(0, np.int16),
        can_id=np.empty(0, np.uint32),
        extended=np.empty(0, np.bool_),
        length=np.empty(0, np.uint8),
        data=np.empty((0, 8), np.uint8),
    )
