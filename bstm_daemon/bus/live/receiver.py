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

from bstm_daemon.bus.live import link
from bstm_daemon.bus.live.frame_records import FrameRecords
from bstm_daemon.bus.signals.extraction import FD_LENGTHS

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
    (_BUS_OFF, link.LinkEvent.BUS_OFF),
    (_RESTARTED, link.LinkEvent.RESTARTED),
    (_TX_TIMEOUT, link.LinkEvent.TX_TIMEOUT),
    (_TRANSCEIVER, link.LinkEvent.TRANSCEIVER),
)
_BY_CONTROLLER_BIT: Final = (
    (0x01, link.LinkEvent.OVERRUN),
    (0x0C, link.LinkEvent.WARNING),
    (0x30, link.LinkEvent.PASSIVE),
)
"""Bits of ``data[1]`` of an error frame of the class controller; either
direction counts."""


class FrameReceiver:
    """Takes frames off a socket that carries ``can_frame`` structures.

    A raw CAN socket, or any other socket of datagrams. The stamp is
    the kernel's; a message without one gets the time of its reading.
    """

    __slots__ = (
        *("_counts", "_fd", "_last_drops", "_only", "_only_rising"),
        *("_receive", "bus_off", "dropped", "source"),
    )

    def __init__(
        self, source: socket.socket, counts: Counter[link.LinkEvent]
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

    def let_through(self, words: Collection[int]) -> None:
        """Drop all data frames but those with these ids and flag bits."""
        self._only = frozenset(words)
        self._only_rising = array("I", sorted(self._only))

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
            self._counts[link.LinkEvent.MALFORMED] += malformed
        if drops >= 0:
            self.note_drops(drops)
        if errors:
            for index in range(first, records.filled):
                _, _, frame = records.at(index)
                if frame.is_error:
                    self._note_error(frame.can_id, frame.data)
        return fault

    def receive(self, frames: list[link.Frame]) -> int:
        """Append what waits, up to ``DRAIN_LIMIT`` frames in *frames*.

        Returns 0 at the limit, else the ``errno`` that ended the reading:
        ``EAGAIN`` where nothing is left. After any other one the socket may
        still hold frames that came before.
        """
        for _ in range(link.DRAIN_LIMIT - len(frames)):
            try:
                message, ancillary, _, _ = self._receive(
                    _READ_SIZE, _ANCILLARY_SIZE
                )
            except OSError as error:
                return error.errno or errno.EIO
            frame = self._frame(message, self._stamp_ns(ancillary))
            if frame is not None:
                frames.append(frame)
        return 0

    def _frame(self, message: bytes, stamp_ns: int) -> link.Frame | None:
        """Return the frame in *message*; None where it is none, or unwanted.

        Malformed messages and error frames are counted.
        """
        size = len(message)
        word = length = 0
        fits = False
        if size in (_CLASSIC_SIZE, _FD_SIZE):
            word, length = _HEAD.unpack_from(message)
            fits = (
                length <= link.CLASSIC_BYTES
                if size == _CLASSIC_SIZE
                else length in FD_LENGTHS and not word & (_REMOTE | _ERROR)
            )
        if not fits:
            self._counts[link.LinkEvent.MALFORMED] += 1
            return None
        data = message[_HEAD_SIZE : _HEAD_SIZE + length]
        if word & _ERROR:
            classes = word & _EXTENDED_MASK
            self._note_error(classes, data)
            return link.Frame(stamp_ns, classes, False, data, True, False)
        extended = word & EXTENDED_FLAG != 0
        can_id = word & (_EXTENDED_MASK if extended else _STANDARD_MASK)
        if word & _REMOTE:
            # its length is that of the frame it asks for; it has no data
            return link.Frame(stamp_ns, can_id, extended, b"", False, True)
        if self._only is not None and word not in self._only:
            return None
        return link.Frame(stamp_ns, can_id, extended, data, False, False)

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

    def _note_error(self, classes: int, data: bytes) -> None:
        """Count what an error frame of these *classes* reports."""
        self._counts[link.LinkEvent.ERROR_FRAME] += 1
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
