"""Frames off a SocketCAN socket: one by one, or compiled by the batch.

The layouts are those of ``linux/can.h`` (``can_frame``, ``canfd_frame``), the
error classes those of ``linux/can/error.h``.
"""

import errno
import socket
import struct
import time
from array import array
from collections import Counter
from collections.abc import Collection
from typing import Final

from bstm_daemon.bus.extraction import FD_LENGTHS
from bstm_daemon.bus.frame_records import FrameRecords
from bstm_daemon.bus.link import (
    CLASSIC_BYTES,
    DRAIN_LIMIT,
    Frame,
    LinkEvent,
)

EXTENDED_FLAG: Final = 0x80000000
_REMOTE: Final = 0x40000000
_ERROR: Final = 0x20000000
_EXTENDED_MASK: Final = 0x1FFFFFFF
_STANDARD_MASK: Final = 0x7FF
# asm-generic/socket.h: Python's socket module has no names for them
_SO_TIMESTAMPNS: Final = 35
_SO_RXQ_OVFL: Final = 40

_HEAD: Final = struct.Struct("=IB")
_FILTER: Final = struct.Struct("=II")
_TIMESPEC: Final = struct.Struct("@ll")
_DROPS: Final = struct.Struct("=I")
_CLASSIC_SIZE: Final = 16
_FD_SIZE: Final = 72
_HEAD_SIZE: Final = 8
_READ_SIZE: Final = _FD_SIZE + 1  # a longer frame shows as too long
_ANCILLARY_SIZE: Final = socket.CMSG_SPACE(_TIMESPEC.size) + socket.CMSG_SPACE(
    _DROPS.size
)

_TX_TIMEOUT: Final = 0x001
_CONTROLLER: Final = 0x004
_TRANSCEIVER: Final = 0x010
_BUS_OFF: Final = 0x040
_RESTARTED: Final = 0x100
ERROR_CLASSES: Final = (
    _TX_TIMEOUT | _CONTROLLER | _TRANSCEIVER | _BUS_OFF | _RESTARTED
)
"""The error classes to receive: changes of condition, which are rare.

Lost arbitration (2), protocol violations (8), missing acknowledgement (0x20)
and bus errors (0x80) come once per frame or faster on a disturbed bus, and
would fill the receive buffer just when it is needed; what follows from them
(warning, passive, bus-off) is reported by the classes taken.
"""

_BY_CLASS: Final = (
    (_BUS_OFF, LinkEvent.BUS_OFF),
    (_RESTARTED, LinkEvent.RESTARTED),
    (_TX_TIMEOUT, LinkEvent.TX_TIMEOUT),
    (_TRANSCEIVER, LinkEvent.TRANSCEIVER),
)
_BY_CONTROLLER_BIT: Final = (
    (0x01, LinkEvent.OVERRUN),
    (0x0C, LinkEvent.WARNING),
    (0x30, LinkEvent.PASSIVE),
)
"""Bits of ``data[1]`` of an error frame of the class controller; either
direction counts."""


class FrameReceiver:
    """Takes frames off a socket that carries ``can_frame`` structures.

    A raw CAN socket, or any socket that keeps messages apart. The stamp is
    the kernel's; a message without one gets the time of its reading.
    """

    __slots__ = (
        *("_counts", "_fd", "_last_drops", "_only", "_only_rising"),
        *("_receive", "bus_off", "dropped", "source"),
    )

    def __init__(
        self, source: socket.socket, counts: Counter[LinkEvent]
    ) -> None:
        """Read *source*, set not to block; count into *counts*."""
        source.setblocking(False)
        source.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        source.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
        self.source: Final = source
        self._fd = source.fileno()
        self._receive = source.recvmsg
        self._counts = counts
        self._last_drops = 0
        self.dropped = 0
        """Frames that found the receive buffer full."""
        self.bus_off = False
        """Whether the last word of the controller was that it is off."""
        self._only: frozenset[int] | None = None
        self._only_rising: array[int] | None = None

    @property
    def only(self) -> frozenset[int] | None:
        """Ids with their flag bits to let through; None for all."""
        return self._only

    @only.setter
    def only(self, words: frozenset[int] | None) -> None:
        self._only = words
        self._only_rising = (
            None if words is None else array("I", sorted(words))
        )

    def receive_records(
        self, records: FrameRecords, bus: int, limit: int
    ) -> int:
        """Fill *records* with what waits on bus number *bus*.

        Frames, counts and result are those of :meth:`receive`, of *limit*
        messages at most.
        """
        first = records.filled
        room = records.room - first
        frames, fault, malformed, errors, drops = records.extension.receive(
            self._fd,
            records.store,
            first,
            min(limit, room),
            bus,
            self._only_rising,
        )
        records.filled = first + frames
        if malformed:
            self._counts[LinkEvent.MALFORMED] += malformed
        if drops >= 0:
            self.note_drops(drops)
        if errors:
            for index in range(first, records.filled):
                _, _, frame = records.at(index)
                if frame.is_error:
                    self._note_error(frame.can_id, frame.data)
        return fault

    def receive(self, frames: list[Frame]) -> int:
        """Append what waits, up to ``DRAIN_LIMIT`` frames in *frames*.

        Returns 0 at the limit, else the ``errno`` that ended the reading:
        ``EAGAIN`` where nothing is left. After any other one the socket may
        still hold frames that came before.
        """
        receive = self._receive
        only = self.only
        append = frames.append
        unpack_head, unpack_stamp = _HEAD.unpack_from, _TIMESPEC.unpack
        for _ in range(DRAIN_LIMIT - len(frames)):
            try:
                message, ancillary, _, _ = receive(_READ_SIZE, _ANCILLARY_SIZE)
            except OSError as error:
                return error.errno or errno.EIO
            if (
                len(ancillary) == 1
                and ancillary[0][1] == _SO_TIMESTAMPNS
                and len(ancillary[0][2]) == _TIMESPEC.size
            ):
                # nothing but the stamp, as long as no frame was ever lost
                seconds, nanoseconds = unpack_stamp(ancillary[0][2])
                stamp_ns = seconds * 1_000_000_000 + nanoseconds
            else:
                stamp_ns = self._stamp_ns(ancillary)
            size = len(message)
            if size == _CLASSIC_SIZE:
                word, length = unpack_head(message)
                fits = length <= CLASSIC_BYTES
            elif size == _FD_SIZE:
                word, length = unpack_head(message)
                fits = length in FD_LENGTHS and not word & (_REMOTE | _ERROR)
            else:
                fits = False
            if not fits:
                self._counts[LinkEvent.MALFORMED] += 1
                continue
            if word & (_ERROR | _REMOTE):
                data = message[_HEAD_SIZE : _HEAD_SIZE + length]
                append(self._special(stamp_ns, word, data))
            elif only is None or word in only:
                data = message[_HEAD_SIZE : _HEAD_SIZE + length]
                extended = word & EXTENDED_FLAG != 0
                mask = _EXTENDED_MASK if extended else _STANDARD_MASK
                append(
                    Frame(stamp_ns, word & mask, extended, data, False, False)
                )
        return 0

    def _stamp_ns(self, ancillary: list[tuple[int, int, bytes]]) -> int:
        """Return the stamp; note the count of drops where there is one."""
        stamp_ns = 0
        for _, kind, content in ancillary:
            if kind == _SO_TIMESTAMPNS and len(content) == _TIMESPEC.size:
                seconds, nanoseconds = _TIMESPEC.unpack(content)
                stamp_ns = seconds * 1_000_000_000 + nanoseconds
            elif kind == _SO_RXQ_OVFL and len(content) == _DROPS.size:
                self.note_drops(*_DROPS.unpack(content))
        return stamp_ns or time.time_ns()

    def note_drops(self, total: int) -> None:
        """Take over *total*, the kernel's count of 32 bits, which wraps."""
        self.dropped += (total - self._last_drops) & 0xFFFFFFFF
        self._last_drops = total

    def _special(self, stamp_ns: int, word: int, data: bytes) -> Frame:
        """Return a remote or an error frame, the latter also counted."""
        if not word & _ERROR:
            extended = word & EXTENDED_FLAG != 0
            mask = _EXTENDED_MASK if extended else _STANDARD_MASK
            # its length is that of the frame it asks for; it has no data
            return Frame(stamp_ns, word & mask, extended, b"", False, True)
        classes = word & _EXTENDED_MASK
        self._note_error(classes, data)
        return Frame(stamp_ns, classes, False, data, True, False)

    def _note_error(self, classes: int, data: bytes) -> None:
        """Count what an error frame of these *classes* reports."""
        self._counts[LinkEvent.ERROR_FRAME] += 1
        for bit, event in _BY_CLASS:
            if classes & bit:
                self._counts[event] += 1
        if classes & _CONTROLLER and len(data) > 1:
            for bits, event in _BY_CONTROLLER_BIT:
                if data[1] & bits:
                    self._counts[event] += 1
        if classes & (_BUS_OFF | _RESTARTED):
            self.bus_off = not classes & _RESTARTED


def kernel_filters(wanted: Collection[tuple[int, bool]]) -> bytes:
    """Return *wanted* as ``can_filter`` structures.

    Each names one id with every bit and flag: those the kernel looks up in a
    table, whereas other masks are walked one by one for every frame. A remote
    frame of the id is not wanted.
    """
    return b"".join(
        _FILTER.pack(
            can_id | (EXTENDED_FLAG if extended else 0),
            EXTENDED_FLAG
            | _REMOTE
            | (_EXTENDED_MASK if extended else _STANDARD_MASK),
        )
        for can_id, extended in sorted(set(wanted))
    )
