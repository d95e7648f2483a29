"""Candump text into columns by the compiled scan (``_candump.c``).

The scan reads plain lines with a classic frame. It stops where Python has to
decide: at an interface it does not know, and at an id for which nobody has
said yet whether it is wanted. Lines of any other form it leaves pending, for
:mod:`~bstm_daemon.bus.candump_layout`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from bstm_daemon.bus.candump_layout import Text
from bstm_daemon.bus.candump_line import EXTENDED_MAX
from bstm_daemon.bus.frame_chunk import FrameChunk

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bstm_daemon.bus.candump_layout import Channel
    from bstm_daemon.bus.compiled import LogExtension

_NAMES_LIMIT: Final = 64
_KEY_SLOTS: Final = 2048
_KEYS_LIMIT: Final = _KEY_SLOTS // 2
_BYTES_PER_LINE: Final = 32
"""Room for a chunk of lines this long; of shorter ones it takes more calls."""

# state of the scan, as in _candump.c
_POSITION, _LINE, _FRAMES, _PENDING, _A, _B, _NAMES_FULL, _KEYS_FULL = range(8)
_DONE, _NEW_NAME, _NEW_KEY = range(3)
_KEY, _VERDICT, _COUNT = range(3)


class Key(NamedTuple):
    """An (interface, id, extended) of which frames are wanted, or not."""

    channel: Channel
    can_id: int
    extended: bool
    wanted: bool


class Scanned(NamedTuple):
    """What the scan made of a text of so many ``lines``.

    ``settled`` counts lines by key; ``pending`` has the lines it left.
    """

    lines: int
    parts: list[FrameChunk]
    settled: list[tuple[Key, int]]
    pending: Text


class CandumpScan:
    """The compiled scan with its tables of interfaces and ids."""

    def __init__(
        self,
        extension: LogExtension,
        channels: Mapping[bytes, Channel],
        register: Callable[[bytes], Channel],
        chunk_bytes: int,
    ) -> None:
        """Prepare columns for *chunk_bytes* of text.

        *register* adds an interface to *channels*, which holds them in the
        order of their numbers.
        """
        room = chunk_bytes // _BYTES_PER_LINE + 1
        self._scan = extension.scan
        self._channels = channels
        self._register = register
        self._names = b""
        self._keys = np.zeros((_KEY_SLOTS, 3), np.int64)
        self._key_of_slot: dict[int, Key] = {}
        self._state = np.zeros(8, np.int64)
        self._pending = np.empty((room, 3), np.int64)
        self._frames = FrameChunk(
            time_us=np.empty(room, np.int64),
            line=np.empty(room, np.int64),
            channel=np.empty(room, np.int16),
            can_id=np.empty(room, np.uint32),
            extended=np.empty(room, np.bool_),
            length=np.empty(room, np.uint8),
            data=np.empty((room, 8), np.uint8),
        )

    def read(self, store: bytearray, end: int, first_line: int) -> Scanned:
        """Read the whole lines in *store* up to *end*."""
        state = self._state
        state[_POSITION] = 0
        state[_LINE] = first_line
        parts = []
        pending = []
        stop = -1
        while stop != _DONE:
            stop = self._step(store, end)
            if stop == _NEW_NAME:
                start = int(state[_A])
                self._add_name(bytes(store[start : start + int(state[_B])]))
            elif stop == _NEW_KEY:
                self._decide(int(state[_A]))
            else:
                frames, left = int(state[_FRAMES]), int(state[_PENDING])
                state[_FRAMES] = state[_PENDING] = 0
                if frames:
                    parts.append(self._copied(frames))
                if left:
                    pending.append(self._pending[:left].copy())
        left_over = np.concatenate(pending or [self._pending[:0]])
        return Scanned(
            int(state[_LINE]) - first_line,
            parts,
            self._settled(),
            Text(
                np.frombuffer(store, np.uint8),
                left_over[:, 0].copy(),
                left_over[:, 1].copy(),
                left_over[:, 2].copy(),
            ),
        )

    def _step(self, store: bytearray, end: int) -> int:
        frames = self._frames
        return self._scan(
            store,
            end,
            self._names,
            self._keys,
            self._state,
            frames.time_us,
            frames.line,
            frames.channel,
            frames.can_id,
            frames.extended,
            frames.length,
            frames.data,
            self._pending,
        )

    def _copied(self, count: int) -> FrameChunk:
        frames = self._frames
        return FrameChunk(
            time_us=frames.time_us[:count].copy(),
            line=frames.line[:count].copy(),
            channel=frames.channel[:count].copy(),
            can_id=frames.can_id[:count].copy(),
            extended=frames.extended[:count].copy(),
            length=frames.length[:count].copy(),
            data=frames.data[:count].copy(),
        )

    def _add_name(self, interface: bytes) -> None:
        self._register(interface)
        self._names += interface + b"\n"
        full = len(self._channels) >= _NAMES_LIMIT
        self._state[_NAMES_FULL] = full

    def _decide(self, slot: int) -> None:
        packed = int(self._keys[slot, _KEY])
        channel = list(self._channels.values())[(packed >> 32) - 1]
        can_id, extended = packed & EXTENDED_MAX, bool(packed >> 31 & 1)
        wanted = channel.known and channel.wants(can_id, extended)
        self._key_of_slot[slot] = Key(channel, can_id, extended, wanted)
        self._keys[slot, _VERDICT] = wanted
        self._state[_KEYS_FULL] = len(self._key_of_slot) >= _KEYS_LIMIT

    def _settled(self) -> list[tuple[Key, int]]:
        counts = self._keys[:, _COUNT]
        slots = np.flatnonzero(counts)
        keys = [self._key_of_slot[slot] for slot in slots.tolist()]
        settled = list(zip(keys, counts[slots].tolist(), strict=True))
        counts[:] = 0
        return settled
