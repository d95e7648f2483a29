"""The feed on a real socket: newest wins, nobody is waited for."""

import json
import socket
import stat
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bstm_daemon.config.sections import Config
from bstm_daemon.estimate import Estimate
from bstm_daemon.feed.server import MOST_READERS, RETRY_US, FeedServer

Make = Callable[[int], Estimate]


class Feed:
    """A server at a path, and what it could not do."""

    def __init__(self, config: Config, make: Make, path: Path | None) -> None:
        self._config, self._make = config, make
        self.failed: list[str] = []
        self.server = FeedServer(self.failed.append)
        self.begin(path)

    def begin(self, path: Path | None) -> None:
        self.path = path
        name = None if path is None else path.name
        feed = self._config.feed.model_copy(update={"socket": name})
        config = self._config.model_copy(update={"feed": feed})
        folder = Path() if path is None else path.parent
        self.server.begin(config, folder)

    def publish(self, number: int = 0, now_us: int = 0) -> None:
        self.server.publish(self._make(number), now_us)

    def connected(self) -> socket.socket:
        reader = socket.socket(socket.AF_UNIX)
        reader.settimeout(10.0)
        reader.connect(str(self.path))
        return reader


@pytest.fixture
def feed(config: Config, estimate: Make, socket_path: Path) -> Iterator[Feed]:
    made = Feed(config, estimate, socket_path)
    made.publish()
    yield made
    made.server.close()
    assert made.failed == []


def numbers(received: bytes) -> list[int]:
    """Return the sequence numbers of whole lines."""
    assert received.endswith(b"\n")
    return [json.loads(line)["seq"] for line in received.splitlines()]


def drained(reader: socket.socket) -> bytes:
    received = b""
    reader.setblocking(False)
    try:
        while part := reader.recv(65536):
            received += part
    except BlockingIOError:
        pass
    return received


def test_every_reader_gets_every_line(feed: Feed) -> None:
    with feed.connected() as one, feed.connected() as other:
        for number in range(3):
            feed.publish(number)

        assert numbers(drained(one)) == [1, 2, 3]
        assert numbers(drained(other)) == [1, 2, 3]


def test_without_readers_no_line_is_made(feed: Feed) -> None:
    for _ in range(5):
        feed.publish()
    with feed.connected() as reader:
        feed.publish()
        assert numbers(drained(reader)) == [1]
    feed.publish()
    assert feed.server._readers == [], "the one that has gone is still there"


def test_a_stalled_reader_loses_lines_and_then_has_the_newest(
    feed: Feed,
) -> None:
    """No line is torn, and a few old ones are all that it must read first."""
    with feed.connected() as stalled, feed.connected() as sound:
        heard = b""
        for _ in range(500):
            feed.publish()
            heard += drained(sound)
        assert numbers(heard) == list(range(1, 501))

        received = drained(stalled)
        for _ in range(2):
            feed.publish()
            received += drained(stalled)

        found = numbers(received)
        assert found == sorted(found)
        assert found[-2:] == [501, 502]
        assert len(found) < 30


def test_fifty_stalled_readers_are_passed_without_waiting(feed: Feed) -> None:
    """A send that waited for one of them would never return."""
    stalled = [feed.connected() for _ in range(50)]
    with feed.connected() as sound:

        def work() -> None:
            for number in range(1, 201):
                feed.publish()
                assert numbers(drained(sound)) == [number]

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        thread.join(60.0)
        assert not thread.is_alive()
    for reader in stalled:
        reader.close()


def test_with_one_more_the_longest_stalled_is_disconnected(
    feed: Feed,
) -> None:
    stalled = feed.connected()
    for _ in range(50):
        feed.publish()
    others = [feed.connected() for _ in range(MOST_READERS)]
    feed.publish()
    for reader in others:
        assert numbers(drained(reader)) == [51]
    received = b"".join(iter(lambda: stalled.recv(65536), b""))
    first, _, _ = received.partition(b"\n")
    assert json.loads(first)["seq"] == 1, "what it had is still there"
    for reader in (stalled, *others):
        reader.close()


def test_owner_and_group_may_connect(feed: Feed) -> None:
    assert feed.path is not None
    assert stat.S_IMODE(feed.path.stat().st_mode) == 0o660


def test_a_socket_that_was_left_is_replaced(
    config: Config, estimate: Make, socket_path: Path
) -> None:
    with socket.socket(socket.AF_UNIX) as left:
        left.bind(str(socket_path))
    feed = Feed(config, estimate, socket_path)
    feed.publish()
    feed.connected().close()
    feed.server.close()
    assert feed.failed == []
    assert not socket_path.exists()


def test_what_can_not_be_opened_is_said_and_tried_again(
    config: Config, estimate: Make, tmp_path: Path, socket_path: Path
) -> None:
    file = tmp_path / "file"
    file.write_text("kept")
    feed = Feed(config, estimate, file)
    feed.publish()
    feed.publish(now_us=RETRY_US - 1)
    assert feed.failed == [f"{file}: Address already in use"]
    assert file.read_text() == "kept"
    feed.publish(now_us=RETRY_US)
    assert len(feed.failed) == 2
    file.unlink()
    feed.publish(now_us=2 * RETRY_US)
    feed.connected().close()

    other = Feed(config, estimate, file)
    other.publish()
    assert other.failed == [f"{file}: another service listens there"]
    other.server.close()
    feed.server.close()

    missing = Feed(config, estimate, tmp_path / "missing" / "feed.sock")
    missing.publish()
    assert "No such file" in missing.failed[0]


def test_a_reload_keeps_the_readers_unless_the_socket_changes(
    feed: Feed, socket_path: Path
) -> None:
    with feed.connected() as reader:
        feed.publish()
        feed.begin(socket_path)
        feed.publish()
        assert numbers(drained(reader)) == [1, 2]

        feed.begin(socket_path.with_name("other.sock"))
        assert drained(reader) == b""
        assert not socket_path.exists()
        feed.publish()
        feed.connected().close()

        feed.begin(None)
        feed.publish()
        assert not socket_path.with_name("other.sock").exists()
