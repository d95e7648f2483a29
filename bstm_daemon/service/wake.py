"""Waits for time to pass or for a signal."""

import select
import signal
import socket
from contextlib import suppress
from typing import Final, Self

STOP: Final = frozenset({signal.SIGTERM, signal.SIGINT})
RELOAD: Final = signal.SIGHUP
KEEP: Final = signal.SIGUSR1


class SignalWaiter:
    """Waits for time to pass or for a signal of the service.

    The interpreter writes each signal's number into a socket that the wait
    polls, so no signal is lost between a check and a sleep. Waits are rounded
    up to milliseconds.
    """

    def __enter__(self) -> Self:
        """Take over the signals."""
        self._reader, writer = socket.socketpair()
        self._writer = writer
        self._reader.setblocking(False)
        writer.setblocking(False)
        self._poll = select.poll()
        self._poll.register(self._reader, select.POLLIN)
        self._before_fd = signal.set_wakeup_fd(
            writer.fileno(), warn_on_full_buffer=False
        )
        self._before = {
            # through to the wake-up socket only
            number: signal.signal(number, lambda *_: None)
            for number in (*STOP, RELOAD, KEEP)
        }
        return self

    def __exit__(self, *error: object) -> None:
        """Give the signals back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        signal.set_wakeup_fd(self._before_fd)
        self._reader.close()
        self._writer.close()

    def wait(self, seconds: float) -> frozenset[int]:
        """Return the signals that came, after *seconds* at the latest."""
        if not self._poll.poll(max(seconds, 0.0) * 1e3):
            return frozenset()
        numbers: set[int] = set()
        with suppress(BlockingIOError):
            while chunk := self._reader.recv(64):
                numbers.update(chunk)
        return frozenset(numbers)
