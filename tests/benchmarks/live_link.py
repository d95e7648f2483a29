"""A bus without a bus: SocketCAN's code over one end of a socket pair.

A pair of ``SOCK_SEQPACKET`` sockets keeps messages apart and stamps them as a
raw CAN socket does, so ``can_frame`` structures come and go by the very same
calls. What the kernel does for CAN itself (filters, error frames) is missing.
"""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING

from bstm_daemon.bus.live.link import LinkState
from bstm_daemon.bus.live.receiver import EXTENDED_FLAG, FrameReceiver
from bstm_daemon.bus.live.socketcan import SocketcanLink

if TYPE_CHECKING:
    from bstm_daemon.bus.live.link import Wanted
    from bstm_daemon.config.sections import BusConfig


def pair() -> tuple[socket.socket, socket.socket]:
    """Return the two ends of a bus."""
    ends = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    for end in ends:
        # room for what comes between two drains: here the sender's counts
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 2**19)
    return ends


class PairLink(SocketcanLink):
    """The link of the daemon, on *end* instead of an interface."""

    def __init__(
        self,
        end: socket.socket,
        bus: BusConfig,
        wanted: Wanted = None,
        receive_buffer_bytes: int = 2**22,
    ) -> None:
        """Read *end*; without a kernel that filters, filter as it would."""
        super().__init__(bus, wanted, receive_buffer_bytes)
        self._end = end

    def open(self) -> bool:
        """Begin receiving, as on an interface of more ids than filters."""
        receiver = FrameReceiver(self._end, self.counts)
        if self._wanted is not None:
            receiver.let_through(
                [
                    can_id | (EXTENDED_FLAG if extended else 0)
                    for can_id, extended in self._wanted
                ]
            )
        self._receiver = receiver
        self._enter(LinkState.UP, "")
        return True

    def _look(self, receiver: FrameReceiver) -> None:
        """There is no interface to look at."""
