"""The feed: a Unix socket on which every reader gets the newest line.

Called from the cycle of the live service, after the frames are sent. It never
waits: what a reader does not take is lost for this reader, except that the
rest of a line that was begun is sent first.
"""

from __future__ import annotations

import grp
import os
import socket
import stat
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from bstm_daemon.errors import FileAccessError

if TYPE_CHECKING:
    from pathlib import Path

SOCKET_MODE: Final = 0o660
"""Owner and group connect; nobody else learns where the car is."""

MOST_READERS: Final = 64
"""With one more, the one that has been stalled longest is disconnected."""

BUFFER_BYTES: Final = 8192
"""Asked of the kernel for each reader: some lines, so that one that comes
back after a stall soon has the newest."""


class _Reader:
    """A connection, and the rest of the line that it has not taken yet."""

    def __init__(self, connection: socket.socket) -> None:
        self.connection = connection
        self._rest = b""
        self.stalled = 0
        """Lines in a row that it did not take."""

    def send(self, line: bytes) -> bool:
        """Send the rest of the last line, then *line*; whether it is there."""
        try:
            if self._rest:
                self._rest = self._rest[self.connection.send(self._rest) :]
            if self._rest:
                self.stalled += 1
                return True
            self._rest = line[self.connection.send(line) :]
            self.stalled = 0
        except BlockingIOError:
            self.stalled += 1
        except OSError:  # it has gone
            return False
        return True


class FeedServer:
    """Listens at a path until closed."""

    def __init__(self, path: Path, group: str | None = None) -> None:
        """Listen at *path*, for the members of *group* as well.

        Raises:
            FileAccessError: the folder is missing or not writable, another
                file or process is at *path*, or the group is none of ours.
        """
        self.path = path
        self._readers: list[_Reader] = []
        self._socket = socket.socket(
            socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_NONBLOCK
        )
        try:
            _remove_left(path)
            self._socket.bind(str(path))
            path.chmod(SOCKET_MODE)
            if group is not None:
                os.chown(path, -1, grp.getgrnam(group).gr_gid)
            self._socket.listen(MOST_READERS)
        except (OSError, KeyError) as error:
            self._socket.close()
            reason = getattr(error, "strerror", None) or error
            msg = f"[feed] socket = {path}: {reason}"
            raise FileAccessError(msg) from error

    @property
    def has_readers(self) -> bool:
        """Whether a line would reach anybody; takes who is waiting."""
        with suppress(OSError):  # nobody more, or no more descriptors
            while True:
                connection, _ = self._socket.accept()
                connection.setblocking(False)
                connection.setsockopt(
                    socket.SOL_SOCKET, socket.SO_SNDBUF, BUFFER_BYTES
                )
                self._readers.append(_Reader(connection))
        while len(self._readers) > MOST_READERS:
            worst = max(self._readers, key=lambda reader: reader.stalled)
            self._drop(worst)
        return bool(self._readers)

    def send(self, line: bytes) -> None:
        """Send *line* to every reader that takes it; never waits."""
        for reader in [*self._readers]:
            if not reader.send(line):
                self._drop(reader)

    def close(self) -> None:
        """Disconnect all and remove the socket."""
        for reader in [*self._readers]:
            self._drop(reader)
        self._socket.close()
        with suppress(OSError):  # a folder that went away or read-only
            self.path.unlink(missing_ok=True)

    def _drop(self, reader: _Reader) -> None:
        self._readers.remove(reader)
        reader.connection.close()


def _remove_left(path: Path) -> None:
    """Remove the socket of a service that did not end in order.

    Raises:
        FileExistsError: something listens there, or it is no socket.
    """
    with suppress(FileNotFoundError):
        if not stat.S_ISSOCK(path.lstat().st_mode):
            msg = "a file is there that is no socket"
            raise FileExistsError(msg)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()
            else:
                msg = "another service listens there"
                raise FileExistsError(msg)
