"""What every reader of a CAN log offers, and the ledger behind it.

One protocol, :class:`FrameReader`, for the candump reader and for those of
all other formats; the latter keep their accounts in a :class:`FrameLedger`.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from bstm_daemon.bus.candump_line import EXTENDED_MAX, STANDARD_MAX
from bstm_daemon.bus.extraction import FD_LENGTHS
from bstm_daemon.bus.frame_chunk import FrameChunk, empty_chunk, rows_of
from bstm_daemon.bus.refusal import Refusal

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from pathlib import Path

    from bstm_daemon.bus.candump import Wanted

LINES_KEPT: Final = 5
"""First line numbers kept of each reason."""

_EXTENDED: Final = 1 << 29
_CHANNEL: Final = 1 << 30
_IS_LENGTH: Final = np.isin(np.arange(256), FD_LENGTHS)


class FrameReader(Protocol):
    """Reads one CAN log, once, as chunks of columns.

    ``lines`` counts the lines read (of a binary log: its objects or
    records), ``frames`` the data frames handed out and ``refused`` the rest
    by reason, so that they add up. ``first_refused`` keeps the first line
    numbers of each reason; ``seen`` counts frames by (channel, id, extended)
    whether wanted or not; ``interfaces`` lists the interface names in order
    of appearance; ``truncated`` tells of a log without its end.
    """

    path: Path
    interfaces: list[str]
    lines: int
    frames: int
    refused: Counter[Refusal]
    first_refused: dict[Refusal, list[int]]
    seen: Counter[tuple[int, int, bool]]
    truncated: bool

    def chunks(self) -> Iterator[FrameChunk]:
        """Yield the wanted data frames in file order.

        Raises :class:`~bstm_daemon.errors.FileAccessError` and, for a
        damaged log, :class:`~bstm_daemon.errors.LogError`.
        """


class FrameLedger:
    """The accounts of a :class:`FrameReader`; ``share`` of the file is read.

    ``share`` runs from 0 to 1.
    """

    def __init__(self, path: Path, wanted: Wanted | None = None) -> None:
        """Open the accounts of *path*, every id wanted by default."""
        self.path = path
        self.interfaces: list[str] = []
        self.lines = 0
        self.frames = 0
        self.refused: Counter[Refusal] = Counter()
        self.first_refused: dict[Refusal, list[int]] = {}
        self.seen: Counter[tuple[int, int, bool]] = Counter()
        self.truncated = False
        self.share = 0.0
        self._wanted = wanted
        self._channels: dict[str, int] = {}
        self._ids: list[Collection[tuple[int, bool]] | None] = []

    def channel(self, name: str) -> int:
        """Return the number of the interface *name*, entered when new."""
        number = self._channels.get(name)
        if number is None:
            number = self._channels[name] = len(self.interfaces)
            self.interfaces.append(name)
            self._ids.append(self._wanted(name) if self._wanted else None)
        return number

    def refuse(self, reason: Refusal, line: int) -> None:
        """Count the *line* as refused for *reason*."""
        self.refused[reason] += 1
        first = self.first_refused.setdefault(reason, [])
        if len(first) < LINES_KEPT:
            first.append(line)

    def settle(self, chunk: FrameChunk) -> FrameChunk:
        """Return the wanted frames of *chunk*; count the others.

        A frame whose id or length no CAN frame can have is malformed.
        """
        limits = np.array([STANDARD_MAX, EXTENDED_MAX], np.uint32)
        sound = chunk.can_id <= limits[chunk.extended.view(np.uint8)]
        sound &= _IS_LENGTH[chunk.length]
        for line in chunk.line[~sound].tolist():
            self.refuse(Refusal.MALFORMED, line)
        # without extended ids the keys are few enough to be counted in place
        few = not chunk.extended.any()
        keys = chunk.channel.astype(np.int64)
        keys *= STANDARD_MAX + 1 if few else _CHANNEL
        keys += chunk.can_id
        keys[~sound] = 0
        if few:
            counts = np.bincount(keys[sound])
            unique = np.flatnonzero(counts)
            counts = counts[unique]
        else:
            keys[chunk.extended] += _EXTENDED
            unique, counts = np.unique(keys[sound], return_counts=True)
        width = STANDARD_MAX + 1 if few else _CHANNEL
        accepted = [
            self._judge(*divmod(key, width), count)
            for key, count in zip(
                unique.tolist(), counts.tolist(), strict=True
            )
        ]
        if few:
            verdict = np.zeros(int(keys.max(initial=0)) + 1, np.bool_)
            verdict[unique] = accepted
            kept = sound & verdict[keys]
        else:
            kept = sound & np.isin(keys, unique[np.array(accepted, bool)])
        self.frames += int(np.count_nonzero(kept))
        return chunk if kept.all() else rows_of(chunk, kept)

    def _judge(self, channel: int, rest: int, count: int) -> bool:
        extended, can_id = divmod(rest, _EXTENDED)
        self.seen[channel, can_id, bool(extended)] += count
        ids = self._ids[channel]
        if self._wanted is None:
            return True
        if ids is None:
            self.refused[Refusal.UNKNOWN_INTERFACE] += count
        elif (can_id, bool(extended)) not in ids:
            self.refused[Refusal.UNKNOWN_ID] += count
        else:
            return True
        return False


def frame_chunk(
    time_us: Sequence[int],
    line: Sequence[int],
    channel: Sequence[int],
    can_id: Sequence[int],
    extended: Sequence[bool],
    data: Sequence[bytes],
) -> FrameChunk:
    """Return frames given as equally long lists, *data* up to 64 bytes."""
    if not data:
        return empty_chunk()
    width = 8 if max(map(len, data)) <= 8 else 64
    payload = b"".join(one.ljust(width, b"\0") for one in data)
    return FrameChunk(
        time_us=np.array(time_us, np.int64),
        line=np.array(line, np.int64),
        channel=np.array(channel, np.int16),
        can_id=np.array(can_id, np.uint32),
        extended=np.array(extended, np.bool_),
        length=np.array([len(one) for one in data], np.uint8),
        data=np.frombuffer(payload, np.uint8).reshape(len(data), width),
    )
