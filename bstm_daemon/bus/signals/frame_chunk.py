"""Frames of a log as columns."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Final

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

    def payloads(self) -> Iterator[bytes]:
        """Yield the payload of each frame."""
        joined = self.data.tobytes()
        starts = range(0, len(joined), self.data.shape[1])
        for start, length in zip(starts, self.length.tolist(), strict=True):
            yield joined[start : start + length]


COLUMNS: Final = tuple(field.name for field in fields(FrameChunk))


def rows_of(
    chunk: FrameChunk, rows: npt.NDArray[np.bool_] | slice
) -> FrameChunk:
    """Return some frames of *chunk*: where a mask (n,) is true, or a run."""
    if isinstance(rows, slice):
        return FrameChunk(*(column[rows] for column in columns_of(chunk)))
    places = np.flatnonzero(rows)
    return FrameChunk(
        *(column.take(places, axis=0) for column in columns_of(chunk))
    )


def columns_of(chunk: FrameChunk) -> tuple[npt.NDArray[Any], ...]:
    """Return the columns of *chunk* in the order of their declaration."""
    return tuple(getattr(chunk, name) for name in COLUMNS)


def join_in_file_order(parts: list[FrameChunk]) -> FrameChunk:
    """Return all frames of *parts* (each in file order) as one chunk."""
    if len(parts) == 1:
        return parts[0]
    width = max(part.data.shape[1] for part in parts)
    padded = [
        replace(
            part,
            data=np.pad(part.data, ((0, 0), (0, width - part.data.shape[1]))),
        )
        for part in parts
    ]
    joined = FrameChunk(
        *map(np.concatenate, zip(*map(columns_of, padded), strict=True))
    )
    order = np.argsort(joined.line, kind="stable")
    return FrameChunk(*(column[order] for column in columns_of(joined)))


def columns_for(room: int, width: int = 8) -> FrameChunk:
    """Return columns without content for *room* frames of *width* bytes."""
    return FrameChunk(
        time_us=np.empty(room, np.int64),
        line=np.empty(room, np.int64),
        channel=np.empty(room, np.int16),
        can_id=np.empty(room, np.uint32),
        extended=np.empty(room, np.bool_),
        length=np.empty(room, np.uint8),
        data=np.empty((room, width), np.uint8),
    )
