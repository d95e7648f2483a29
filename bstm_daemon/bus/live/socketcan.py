"""A bus as a SocketCAN interface of the Linux kernel (``net/can/raw.c``).

An interface that is switched off gives ENETDOWN once; the socket stays bound
and receives again afterwards. An interface that is removed gives ENODEV once
and the socket never recovers: it is closed, and a new one is opened as soon
as an interface of that name is there.
"""

import errno
import fcntl
import os
import socket
import struct
from collections import Counter
from collections.abc import Callable
from typing import Final

from bstm_daemon.bus.live.frame_records import FrameRecords
from bstm_daemon.bus.live.link import (
    DRAIN_LIMIT,
    Frame,
    LinkEvent,
    LinkState,
    SendResult,
    Wanted,
    require_classic,
)
from bstm_daemon.bus.live.receiver import (
    ERROR_CLASSES,
    EXTENDED_FLAG,
    FrameReceiver,
    kernel_filters,
)
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.errors import ConfigError

# linux/can.h, linux/can/raw.h, asm-generic/socket.h, linux/sockios.h,
# linux/if.h: what Python's socket module lacks, or has negative on 32 bits
_CAN_RAW_ERR_FILTER: Final = 2
_SO_RCVBUFFORCE: Final = 33
_SIOCGIFFLAGS: Final = 0x8913
_SIOCGIFINDEX: Final = 0x8933
_IFF_UP: Final = 0x1
_IFF_RUNNING: Final = 0x40
_NAME_BYTES: Final = 15

FILTER_LIMIT: Final = 512
"""Filters that a raw socket takes (``CAN_RAW_FILTER_MAX``)."""

_CLASSIC: Final = struct.Struct("=IB3x8s")
_REQUEST: Final = struct.Struct("16s24x")  # ifreq
_INDEX: Final = struct.Struct("16xi20x")
_FLAGS: Final = struct.Struct("16xH22x")

_DRAINED: Final = (errno.EAGAIN, 0)
"""Normal ends of a reading; 0 is the limit."""

_LINK_FAULTS: Final = (errno.ENETDOWN, errno.ENODEV, errno.ENXIO)


class SocketcanLink:
    """A bus read and written through one raw CAN socket.

    Own frames do not come back; frames that other programs of this computer
    send are input like any other.
    """

    def __init__(
        self,
        bus: BusConfig,
        wanted: Wanted = None,
        receive_buffer_bytes: int = 2**22,
    ) -> None:
        """Prepare the link of *bus*; nothing is opened yet.

        Args:
            bus: The section of the configuration.
            wanted: The frames to receive; None for all.
            receive_buffer_bytes: What to ask the kernel for.

        Raises:
            ConfigError: No interface can have that name.
        """
        name = os.fsencode(bus.channel)
        if not _is_interface_name(name):
            problem = (
                f"[[bus]] {bus.name!r}: 'channel' = {bus.channel!r} is no "
                f"name of an interface: at most {_NAME_BYTES} bytes without "
                "blanks, as 'ip link' shows it"
            )
            raise ConfigError([problem])
        self.channel = bus.channel
        self.state = LinkState.GONE
        self.receive_buffer_bytes: int | None = None
        self.counts: Counter[LinkEvent] = Counter()
        self._wanted = None if wanted is None else frozenset(wanted)
        self._fd = bus.fd
        self._buffer_bytes = receive_buffer_bytes
        self._request = _REQUEST.pack(name)
        self._receiver: FrameReceiver | None = None
        self._index = 0
        self._dropped_before = 0
        self._trouble = "not opened yet"
        self._send_fault = 0

    @property
    def reason(self) -> str:
        """Why nothing can come in or go out; empty if all is well."""
        if self._trouble:
            return self._trouble
        if self._receiver and self._receiver.bus_off:
            return (
                f"{self.channel} is bus-off; it recovers by itself where "
                "restart-ms is set (ip link)"
            )
        if self._send_fault:
            fault = os.strerror(self._send_fault)
            return f"{self.channel} takes no frames: {fault}"
        return ""

    @property
    def dropped(self) -> int:
        """Frames that found the receive buffer full, since the start.

        The kernel reports them with the next frame that it delivers.
        """
        now = self._receiver.dropped if self._receiver else 0
        return self._dropped_before + now

    def open(self) -> bool:
        """Try to begin receiving; False, with ``reason``, where it fails."""
        self._release()
        try:
            raw = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        except OSError as error:
            self._enter(LinkState.GONE, _no_socket(error))
            return False
        missing = f"there is no interface {self.channel}"
        try:
            receiver = self._prepare(raw)
            self._index = self._ask(raw, _SIOCGIFINDEX, _INDEX)
            missing = f"{self.channel} is no CAN interface, or just vanished"
            raw.bind((self.channel,))
            # clears the pending notice that the interface is down
            raw.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        except OSError as error:
            raw.close()
            absent = error.errno == errno.ENODEV
            self._enter(
                LinkState.GONE,
                missing if absent else f"{self.channel}: {error.strerror}",
            )
            return False
        self._receiver = receiver
        self._look(receiver)
        if self.state is LinkState.GONE:
            self._release()
        return self._receiver is not None

    def _prepare(self, raw: socket.socket) -> FrameReceiver:
        """Set the options, before the first frame can arrive."""
        receiver = FrameReceiver(raw, self.counts)
        if self._wanted is not None:
            if len(self._wanted) <= FILTER_LIMIT:
                raw.setsockopt(
                    socket.SOL_CAN_RAW,
                    socket.CAN_RAW_FILTER,
                    kernel_filters(self._wanted),
                )
            else:
                receiver.let_through(
                    [
                        can_id | (EXTENDED_FLAG if extended else 0)
                        for can_id, extended in self._wanted
                    ]
                )
        raw.setsockopt(socket.SOL_CAN_RAW, _CAN_RAW_ERR_FILTER, ERROR_CLASSES)
        if self._fd:
            raw.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)
        size_bytes = self._buffer_bytes
        try:
            # beyond net.core.rmem_max; needs the capability CAP_NET_ADMIN
            raw.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, size_bytes)
        except PermissionError:
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, size_bytes)
        self.receive_buffer_bytes = raw.getsockopt(
            socket.SOL_SOCKET, socket.SO_RCVBUF
        )
        return receiver

    def drain(self) -> list[Frame]:
        """Return the frames that wait, at most ``DRAIN_LIMIT``."""
        frames: list[Frame] = []
        receiver = self._receiver
        if receiver is not None:
            self._drain(
                receiver, lambda: receiver.receive(frames), lambda: len(frames)
            )
        return frames

    def drain_records(self, records: FrameRecords, bus: int) -> None:
        """Fill *records* with the frames that wait, as :meth:`drain`.

        *bus* is the number that they get.
        """
        receiver = self._receiver
        if receiver is None:
            return
        before = records.filled
        end = before + DRAIN_LIMIT
        self._drain(
            receiver,
            lambda: receiver.receive_records(
                records, bus, end - records.filled
            ),
            lambda: records.filled - before,
        )

    def _drain(
        self,
        receiver: FrameReceiver,
        read: Callable[[], int],
        count: Callable[[], int],
    ) -> None:
        """Read, and draw conclusions from each fault that ends the reading.

        *count* gives the number of frames so far.
        """
        fault = read()
        if self.state is LinkState.UP and fault in _DRAINED:
            return
        was_up = self.state is LinkState.UP
        last = 0
        # an error overtakes the frames that came before it: read on
        while fault not in _DRAINED:
            if fault == last:
                self._enter(
                    LinkState.GONE, f"{self.channel}: {os.strerror(fault)}"
                )
                break
            self._note_fault(receiver, fault)
            last = fault
            fault = read()
        if self.state is not LinkState.GONE:
            if count() and not was_up:
                self._look(receiver)
        elif fault:
            self._release()

    def poll(self) -> None:
        """Open what is closed; notice an interface that was replaced."""
        if self._receiver is not None and self.state is not LinkState.GONE:
            self._look(self._receiver)
        if self.state is LinkState.GONE:
            self.open()

    def send(
        self,
        can_id: int,
        extended: bool,  # noqa: FBT001  (part of a frame's key)
        data: bytes,
    ) -> SendResult:
        """Send a classic frame now or never, as :class:`Link` says.

        A controller that is bus-off gets none: the kernel would take it and
        lose it in silence.
        """
        require_classic(data)
        receiver = self._receiver
        if receiver is None or receiver.bus_off:
            return SendResult.LOST
        if self.state is LinkState.GONE:
            return SendResult.LOST
        word = can_id | (EXTENDED_FLAG if extended else 0)
        content = _CLASSIC.pack(word, len(data), data)
        fault = _try_send(receiver.source, content)
        if fault in _LINK_FAULTS:
            self._note_fault(receiver, fault)
            if self.state is LinkState.UP:
                # it was the notice of an outage that is over
                fault = _try_send(receiver.source, content)
        self._send_fault = fault
        return SendResult.LOST if fault else SendResult.OK

    def close(self) -> None:
        """End receiving; may be opened again."""
        self._release()
        self.state = LinkState.GONE
        self._trouble = "closed"

    def _release(self) -> None:
        """Close the socket, keep the counts."""
        self._dropped_before = self.dropped
        if self._receiver is not None:
            self._receiver.source.close()
        self._receiver = None
        self._send_fault = 0

    def _enter(self, state: LinkState, trouble: str) -> None:
        """Take over *state*; leaving a better one counts."""
        if state is not self.state:
            self._send_fault = 0
            if state is LinkState.GONE:
                self.counts[LinkEvent.WENT_GONE] += 1
            elif state is LinkState.DOWN and self.state is LinkState.UP:
                self.counts[LinkEvent.WENT_DOWN] += 1
        self.state = state
        self._trouble = trouble

    def _note_fault(self, receiver: FrameReceiver, fault: int) -> None:
        """Draw the conclusion from an error of the socket."""
        if fault == errno.ENETDOWN:
            was_up = self.state is LinkState.UP
            self._look(receiver)
            if was_up and self.state is LinkState.UP:
                self.counts[LinkEvent.WENT_DOWN] += 1
        elif fault in _LINK_FAULTS:
            self._enter(LinkState.GONE, f"{self.channel} was removed")

    def _look(self, receiver: FrameReceiver) -> None:
        """Compare the socket with the interface that has the name now."""
        raw = receiver.source
        try:
            index = self._ask(raw, _SIOCGIFINDEX, _INDEX)
            flags = self._ask(raw, _SIOCGIFFLAGS, _FLAGS)
        except OSError:
            self._enter(LinkState.GONE, f"{self.channel} was removed")
            return
        if index != self._index:
            self._enter(LinkState.GONE, f"{self.channel} was replaced")
        elif not flags & _IFF_UP:
            self._enter(
                LinkState.DOWN,
                f"{self.channel} is down (ip link set {self.channel} up)",
            )
        else:
            self._enter(LinkState.UP, "")
            # a driver takes the carrier away while its controller is off
            receiver.bus_off = not flags & _IFF_RUNNING

    def _ask(
        self, raw: socket.socket, request: int, layout: struct.Struct
    ) -> int:
        """Ask the kernel about the interface of that name.

        Through the socket itself, so that no other address family is needed.
        """
        answer = fcntl.ioctl(raw, request, self._request)
        number: int = layout.unpack_from(answer)[0]
        return number


def _try_send(raw: socket.socket, content: bytes) -> int:
    """Return the ``errno`` of sending *content*, 0 where it was taken."""
    try:
        raw.send(content)
    except OSError as error:
        return error.errno or errno.EIO
    return 0


def _no_socket(error: OSError) -> str:
    """Word why there is no raw CAN socket."""
    if error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
        return (
            "the kernel offers no raw CAN sockets here: modprobe can_raw; in "
            "a systemd unit RestrictAddressFamilies= must name AF_CAN"
        )
    return f"no raw CAN socket: {error.strerror}"


def _is_interface_name(name: bytes) -> bool:
    """Whether the kernel would take *name* (``dev_valid_name``)."""
    return (
        0 < len(name) <= _NAME_BYTES
        and name not in (b".", b"..")
        and not set(name) & set(b"/: \0\t\n\v\f\r\xa0")
    )
