"""Reads a feed, and connects again whenever it ends."""

import json
import socket
from collections.abc import Iterator
from pathlib import Path
from threading import Event
from typing import Any, Final

from bstm_daemon.errors import UsageError
from bstm_daemon.feed.record import SCHEMA, VERSION

DEFAULT_SOCKET: Final = "/run/bstm/feed.sock"
SILENT_S: Final = 1.5
"""Without a line for as long, nothing is known: the service sends ten a
second."""

RETRY_S: Final = 0.5
LONGEST: Final = 65536
"""Bytes of a line; more is no feed."""

Record = dict[str, Any]


def records(path: Path, stop: Event) -> Iterator[Record | None]:
    """Read the feed at *path* until *stop* is set.

    Yields:
        Each line as it comes, and None whenever there has been none for
        ``SILENT_S`` or the connection ended.

    Raises:
        UsageError: what is sent there is no feed of this version.
    """
    while not stop.is_set():
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(SILENT_S)
            if connection.connect_ex(str(path)) == 0:
                yield from _lines(connection, stop)
        yield None
        stop.wait(RETRY_S)


def _lines(connection: socket.socket, stop: Event) -> Iterator[Record | None]:
    rest = b""
    while not stop.is_set():
        try:
            received = connection.recv(LONGEST)
        except TimeoutError:
            yield None
            continue
        except OSError:
            return
        if not received:
            return
        *lines, rest = (rest + received).split(b"\n")
        if len(rest) > LONGEST:
            lines.append(rest)  # which is refused
        yield from map(parsed, lines)


def parsed(line: bytes) -> Record:
    """Return the record that *line* is.

    Raises:
        UsageError: it is none, or of another version.
    """
    try:
        record: Record = json.loads(line)
        found = record["schema"], record["version"]
    except (ValueError, KeyError, TypeError) as error:
        msg = f"not a feed of bstm: {line[:60]!r}"
        raise UsageError(msg) from error
    if found != (SCHEMA, VERSION):
        msg = (
            f"the feed is {found[0]} version {found[1]}, this program reads "
            f"{SCHEMA} version {VERSION}: install the same version"
        )
        raise UsageError(msg)
    return record
