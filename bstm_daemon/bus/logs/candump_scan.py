"""Candump text into columns by the compiled scan (``candump.c``).

The scan reads plain lines. It stops where Python has to decide: at an
interface that is new, at an id for which it is not yet known whether it is
wanted, and at the first CAN FD frame, which needs wider payloads. Lines that
are not plain it leaves for :mod:`~bstm_daemon.bus.logs.candump_line`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from bstm_daemon.bus.signals.extraction import EXTENDED_MAX
from bstm_daemon.bus.signals.frame_chunk import (
    FrameChunk,
    columns_for,
    columns_of,
    rows_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.bus.signals.reject_reason import RejectReason
    from bstm_daemon.native.loader import LogExtension

_NAMES_LIMIT: Final = 64
_KEY_SLOTS: Final = 2048
_KEYS_LIMIT: Final = _KEY_SLOTS // 2
_BYTES_PER_LINE: Final = 32
"""Room for a chunk of lines this long; of shorter ones it takes more calls."""

# state of the scan, as in candump.c
_POSITION, _LINE, _FRAMES, _PENDING, _A, _B, _NAMES_FULL, _KEYS_FULL = range(8)
_DONE, _NEW_NAME, _NEW_KEY, _NO_ROOM, _NEED_WIDE = range(5)
_KEY, _VERDICT, _COUNT = range(3)

Key = tuple[int, int, bool]
"""Channel, id, extended."""


class Scanned(NamedTuple):
    """What the scan made of a text of so many ``lines``.

    ``counts`` has the lines of each key that were read, and why they are not
    wanted, if so. ``pending`` are the lines left: start, end, line number.
    """

    lines: int
    parts: list[FrameChunk]
    counts: list[tuple[Key, RejectReason | None, int]]
    pending: list[tuple[int, int, int]]


class CandumpScan:
    """The compiled scan with its tables of interfaces and ids."""

    def __init__(
        self,
        extension: LogExtension,
        number_of: Callable[[bytes], int],
        why_unwanted: Callable[[int, int, bool], RejectReason | None],
        chunk_bytes: int,
    ) -> None:
        """Prepare columns for *chunk_bytes* of text.

        Args:
            extension: The compiled module.
            number_of: Gives the number of an interface; new ones get the
                next.
            why_unwanted: Why frames of (channel, id, extended) are not read.
            chunk_bytes: The longest text to be read [byte].
        """
        room = chunk_bytes // _BYTES_PER_LINE + 1
        self._scan = extension.scan
        self._number_of = number_of
        self._why_unwanted = why_unwanted
        self._names = b""
        self._keys = np.zeros((_KEY_SLOTS, 3), np.int64)
        self._key_of_slot: dict[int, tuple[Key, RejectReason | None]] = {}
        self._state = np.zeros(8, np.int64)
        self._pending = np.empty((room, 3), np.int64)
        self._frames = columns_for(room)

    def read(self, store: bytearray, end: int, first_line: int) -> Scanned:
        """Read the whole lines in *store* up to *end*."""
        state = self._state
        state[_POSITION] = 0
        state[_LINE] = first_line
        parts: list[FrameChunk] = []
        pending: list[tuple[int, int, int]] = []
        stop = -1
        while stop != _DONE:
            stop = self._scan(
                *(store, end, self._names, self._keys, state),
                *(*columns_of(self._frames), self._pending),
            )
            if stop == _NEW_NAME:
                start = int(state[_A])
                self._add_name(bytes(store[start : start + int(state[_B])]))
            elif stop == _NEW_KEY:
                self._decide(int(state[_A]))
            else:
                parts.append(self._copied(int(state[_FRAMES])))
                left = int(state[_PENDING])
                pending += map(tuple, self._pending[:left].tolist())
                state[_FRAMES] = state[_PENDING] = 0
                if stop == _NEED_WIDE:
                    self._frames = columns_for(len(self._pending), 64)
        return Scanned(
            int(state[_LINE]) - first_line, parts, self._counted(), pending
        )

    def _copied(self, count: int) -> FrameChunk:
        found = rows_of(self._frames, slice(count))
        width = 8 if found.length.max(initial=0) <= 8 else 64
        found = replace(found, data=found.data[:, :width])
        return FrameChunk(*(column.copy() for column in columns_of(found)))

    def _add_name(self, interface: bytes) -> None:
        number = self._number_of(interface)
        self._names += interface + b"\n"
        self._state[_NAMES_FULL] = number + 1 >= _NAMES_LIMIT

    def _decide(self, slot: int) -> None:
        packed = int(self._keys[slot, _KEY])
        key = (packed >> 32) - 1, packed & EXTENDED_MAX, bool(packed >> 31 & 1)
        reason = self._why_unwanted(*key)
        self._key_of_slot[slot] = key, reason
        self._keys[slot, _VERDICT] = reason is None
        self._state[_KEYS_FULL] = len(self._key_of_slot) >= _KEYS_LIMIT

    def _counted(self) -> list[tuple[Key, RejectReason | None, int]]:
        counts = self._keys[:, _COUNT]
        counted = [
            (*self._key_of_slot[slot], int(counts[slot]))
            for slot in np.flatnonzero(counts).tolist()
        ]
        counts[:] = 0
        return counted
