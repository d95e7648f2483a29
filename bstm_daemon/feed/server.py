"""The feed: a Unix socket on which every reader gets the newest line.

Called from the cycle of the live service, after the frames are sent. It never
waits: what a reader does not take is lost for this reader, except that the
rest of a line that was begun is sent first.
"""

import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

from bstm_daemon.config.sections import Config
from bstm_daemon.estimate import Estimate
from bstm_daemon.feed.record import RecordWriter

SOCKET_MODE: Final = 0o660
"""Owner and group connect; nobody else learns how the car is driven."""

MOST_READERS: Final = 64
"""With one more, the one that has been stalled longest is disconnected."""

BUFFER_BYTES: Final = 8192
"""Asked of the kernel for each reader: some lines, so that one that comes
back after a stall soon has the newest."""

RETRY_US: Final = 1_000_000
"""Time between attempts to open the socket."""


class _Reader:
    """A connection, and the rest of the line that it has not taken yet."""

    def __init__(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        connection.setsockopt(
            socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES
        )
        self.connection = connection
        self.stalled = 0
        """Lines in a row that it did not take."""
        self._rest = b""

    def send(self, line: bytes) -> bool:
        """Send the rest of the last line, then *line*; whether it is there."""
        self.stalled += 1
        try:
            if self._rest:
                self._rest = self._rest[self.connection.send(self._rest) :]
            if not self._rest:
                self._rest = line[self.connection.send(line) :]
                self.stalled = 0
        except BlockingIOError:
            pass
        except OSError:  # it has gone
            return False
        return True


class FeedServer:
    """Publishes on the socket of ``[feed]``, where there is one.

    A folder that is missing and a path that is taken are reported and tried
    again: neither ends the service.
    """

    def __init__(self, failed: Callable[[str], None]) -> None:
        """Report to *failed* why the socket can not be opened."""
        self._failed = failed
        self._path: Path | None = None
        self._socket: socket.socket | None = None
        self._readers: list[_Reader] = []
        self._retry_us = self._seq = 0

    def begin(self, config: Config, folder: Path) -> None:
        """Apply *config*, whose path is relative to *folder*.

        Readers stay connected where the socket is the same.
        """
        self._writer = RecordWriter(config)
        name = config.feed.socket
        path = None if name is None else folder / name
        if path != self._path:
            self.close()
            self._path, self._retry_us = path, 0

    def publish(self, estimate: Estimate | None, now_us: int) -> None:
        """Send *estimate* to the readers there are at *now_us*."""
        if self._path is None or estimate is None:
            return
        if self._socket is None and now_us >= self._retry_us:
            self._retry_us = now_us + RETRY_US
            try:
                self._socket = _listening(self._path)
            except OSError as error:
                self._failed(f"{self._path}: {error.strerror or error}")
        if self._socket is not None and self._accepted(self._socket):
            self._seq += 1
            line = self._writer.line(estimate, self._seq)
            for reader in [*self._readers]:
                if not reader.send(line):
                    self._drop(reader)

    def close(self) -> None:
        """Disconnect all and remove the socket."""
        for reader in [*self._readers]:
            self._drop(reader)
        if self._socket is not None and self._path is not None:
            self._socket.close()
            self._socket = None
            with suppress(OSError):  # a folder that went away or read-only
                self._path.unlink(missing_ok=True)

    def _accepted(self, own: socket.socket) -> bool:
        """Take who is waiting; whether there is any reader."""
        with suppress(OSError):  # nobody more, or no more descriptors
            while True:
                self._readers.append(_Reader(own.accept()[0]))
        while len(self._readers) > MOST_READERS:
            self._drop(max(self._readers, key=lambda one: one.stalled))
        return bool(self._readers)

    def _drop(self, reader: _Reader) -> None:
        self._readers.remove(reader)
        reader.connection.close()


def _listening(path: Path) -> socket.socket:
    """Return a socket at *path*, in place of one that a dead service left.

    Raises:
        OSError: the folder is missing or not writable, or a file or another
            service is there.
    """
    if path.is_socket():
        with socket.socket(socket.AF_UNIX) as probe:
            if probe.connect_ex(str(path)) == 0:
                msg = "another service listens there"
                raise FileExistsError(msg)
        path.unlink()
    own = socket.socket(socket.AF_UNIX)
    try:
        own.setblocking(False)
        own.bind(str(path))
        path.chmod(SOCKET_MODE)
        own.listen(MOST_READERS)
    except OSError:
        own.close()
        raise
    return own
