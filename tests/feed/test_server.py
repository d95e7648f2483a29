"""The feed on a real socket: newest wins, nobody is waited for."""

import os
import socket
import stat
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from bstm_daemon.errors import FileAccessError
from bstm_daemon.feed.server import MOST_READERS, FeedServer


@pytest.fixture
def server(socket_path: Path) -> Iterator[FeedServer]:
    made = FeedServer(socket_path)
    yield made
    made.close()


def connected(path: Path) -> socket.socket:
    reader = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    reader.settimeout(10.0)
    reader.connect(str(path))
    return reader


def line(number: int) -> bytes:
    return b"%d " % number + b"x" * 2000 + b"\n"


def numbers(received: bytes) -> list[int]:
    assert received.endswith(b"\n")
    lines = received.splitlines(keepends=True)
    found = [int(one.split()[0]) for one in lines]
    assert lines == [line(number) for number in found], "a torn line"
    return found


def drained(reader: socket.socket) -> bytes:
    received = b""
    reader.setblocking(False)
    try:
        while part := reader.recv(65536):
            received += part
    except BlockingIOError:
        pass
    return received


def test_every_reader_gets_every_line(server: FeedServer) -> None:
    with connected(server.path) as one, connected(server.path) as other:
        for number in range(3):
            assert server.has_readers
            server.send(line(number))

        assert numbers(drained(one)) == [0, 1, 2]
        assert numbers(drained(other)) == [0, 1, 2]


def test_without_readers_there_is_nothing_to_write(
    server: FeedServer,
) -> None:
    assert not server.has_readers
    with connected(server.path):
        assert server.has_readers
    server.send(line(0))
    assert not server.has_readers, "the one that has gone is still there"


def test_a_stalled_reader_loses_lines_and_then_has_the_newest(
    server: FeedServer,
) -> None:
    """No line is torn, and a few old ones are all that it must read first."""
    with connected(server.path) as stalled, connected(server.path) as sound:
        assert server.has_readers
        heard = b""
        for number in range(500):
            server.send(line(number))
            heard += drained(sound)
        assert numbers(heard) == list(range(500))

        received = drained(stalled)
        server.send(line(500))
        received += drained(stalled)
        server.send(line(501))
        received += drained(stalled)

        found = numbers(received)
        assert found == sorted(found)
        assert found[-2:] == [500, 501]
        assert len(found) < 30


def test_fifty_stalled_readers_are_passed_without_waiting(
    server: FeedServer,
) -> None:
    """A send that waited for one of them would never return."""
    stalled = [connected(server.path) for _ in range(50)]
    try:
        with connected(server.path) as sound:
            assert server.has_readers

            def work() -> None:
                for number in range(200):
                    server.send(line(number))
                    assert numbers(drained(sound)) == [number]

            thread = threading.Thread(target=work, daemon=True)
            thread.start()
            thread.join(60.0)
            assert not thread.is_alive()
    finally:
        for reader in stalled:
            reader.close()


def test_with_one_more_the_longest_stalled_is_disconnected(
    server: FeedServer,
) -> None:
    stalled = connected(server.path)
    assert server.has_readers
    for number in range(50):
        server.send(line(number))
    others = [connected(server.path) for _ in range(MOST_READERS)]
    try:
        assert server.has_readers
        server.send(line(50))
        for reader in others:
            assert numbers(drained(reader)) == [50]
        received = b"".join(iter(lambda: stalled.recv(65536), b""))
        assert line(0) in received, "what it had is still there, then the end"
    finally:
        for reader in (stalled, *others):
            reader.close()


def test_owner_and_group_may_connect(server: FeedServer) -> None:
    mode = server.path.stat().st_mode
    assert stat.S_IMODE(mode) == 0o660


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives files away")
def test_the_group_of_the_configuration_owns_the_socket(
    socket_path: Path,
) -> None:
    server = FeedServer(socket_path, "daemon")
    try:
        assert socket_path.group() == "daemon"
    finally:
        server.close()


def test_a_socket_that_was_left_is_replaced(socket_path: Path) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as left:
        left.bind(str(socket_path))
    server = FeedServer(socket_path)
    with connected(socket_path):
        assert server.has_readers
    server.close()
    assert not socket_path.exists()


def test_a_file_another_service_and_a_missing_group_are_refused(
    socket_path: Path, tmp_path: Path
) -> None:
    file = tmp_path / "file"
    file.write_text("kept")
    with pytest.raises(FileAccessError, match="no socket"):
        FeedServer(file)
    assert file.read_text() == "kept"

    server = FeedServer(socket_path)
    with pytest.raises(FileAccessError, match="another service"):
        FeedServer(socket_path)
    server.close()

    with pytest.raises(FileAccessError, match="no-such-group"):
        FeedServer(socket_path, "no-such-group")
    with pytest.raises(FileAccessError, match="No such file"):
        FeedServer(tmp_path / "missing" / "feed.sock")
