"""Reports to the service manager, by the protocol of sd_notify(3).

Datagrams of ``NAME=value`` lines to the socket in ``$NOTIFY_SOCKET``; no
library is needed. Without the variable every call does nothing, and a call
that fails never disturbs the daemon: it only sets ``problem``.
"""

import os
import re
import socket
from collections.abc import MutableMapping
from typing import Final, Self

PATIENCE_S: Final = 1.0
"""How long a change of the unit's state waits for a busy service manager."""

STATUS_LIMIT: Final = 1000
"""Characters of a status; a datagram beyond 4096 bytes is ignored."""


class Notifier:
    """The daemon's side of the notification socket.

    ``enabled``: there is a socket. ``watchdog_interval_s``: send
    :meth:`watchdog` at least this often, half the time the service manager
    allows (sd_watchdog_enabled(3)); None where it does not watch.
    ``problem``: why the newest message was not delivered, None if it was.
    """

    def __init__(
        self,
        address: str | None = None,
        watchdog_interval_s: float | None = None,
    ) -> None:
        """Send to *address*, a path or ``@name``; to nobody without one."""
        self.problem: str | None = None
        self._address: bytes | None = None
        if address and address[0] in "/@":
            self._address = os.fsencode(address)
            if address[0] == "@":
                self._address = b"\0" + self._address[1:]
        elif address:
            self.problem = (
                f"NOTIFY_SOCKET={address}: neither a path nor @name; the "
                "service manager gets no reports"
            )
        self.watchdog_interval_s = (
            watchdog_interval_s if self.enabled else None
        )

    @classmethod
    def from_environment(cls, environ: MutableMapping[str, str]) -> Self:
        """Take the service manager's variables out of *environ*.

        ``NOTIFY_SOCKET``, ``WATCHDOG_USEC`` and ``WATCHDOG_PID`` are removed:
        a child process must not report for the daemon.
        """
        address = environ.pop("NOTIFY_SOCKET", None)
        allowed_us = environ.pop("WATCHDOG_USEC", "")
        watched = environ.pop("WATCHDOG_PID", "")
        interval_s = None
        if watched in ("", str(os.getpid())):
            interval_s = _half_s(allowed_us)
        return cls(address, interval_s)

    @property
    def enabled(self) -> bool:
        """Whether there is a socket to send to."""
        return self._address is not None

    def ready(self) -> None:
        """Report that start-up is over."""
        self._send("READY=1", PATIENCE_S)

    def status(self, text: str) -> None:
        """Show *text* in ``systemctl status``, as one line."""
        line = "".join(c if c.isprintable() else " " for c in text)
        self._send(f"STATUS={line[:STATUS_LIMIT]}")

    def watchdog(self) -> None:
        """Report that the daemon is alive."""
        self._send("WATCHDOG=1")

    def stopping(self) -> None:
        """Report that the daemon is stopping."""
        self._send("STOPPING=1", PATIENCE_S)

    def _send(self, message: str, patience_s: float = 0.0) -> None:
        """Send *message*; wait at most *patience_s* for room in the queue."""
        if self._address is None:
            return
        try:
            # a socket a message: the service manager may have been restarted
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as channel:
                channel.settimeout(patience_s)
                channel.connect(self._address)
                channel.send(message.encode())
        except OSError as error:
            self.problem = (
                f"{message.partition('=')[0]} not sent to the service "
                f"manager: {error.strerror or error}"
            )
        else:
            self.problem = None


def _half_s(allowed_us: str) -> float | None:
    """Half of *allowed_us*, a positive whole number, in s; else None."""
    if not re.fullmatch("[0-9]{1,20}", allowed_us):  # 64 bits
        return None
    return int(allowed_us) / 2e6 or None
