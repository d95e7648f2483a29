"""The reader of a feed: follows it over ends, silence and strangers."""

import json
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from bstm_daemon.config.sections import Config
from bstm_daemon.errors import UsageError
from bstm_daemon.estimate import Estimate
from bstm_daemon.feed import reader as reader_module
from bstm_daemon.feed.reader import LONGEST, parsed, records
from bstm_daemon.feed.record import RecordWriter
from bstm_daemon.feed.server import FeedServer

Make = Callable[[int], Estimate]


def opened(config: Config, path: Path) -> FeedServer:
    feed = config.feed.model_copy(update={"socket": str(path)})
    server = FeedServer(pytest.fail)
    server.begin(config.model_copy(update={"feed": feed}), path.parent)
    return server


def next_line(server: FeedServer, feed: object, estimate: Estimate) -> object:
    """Publish *estimate* once the reader is there, and return what it has."""
    found: list[object] = []
    thread = threading.Thread(target=lambda: found.append(next(feed)))  # type: ignore[call-overload]
    thread.start()
    while not server._readers:
        server._accepted(server._socket)  # type: ignore[arg-type]
        thread.join(0.01)
    server.publish(estimate, 0)
    thread.join(10.0)
    return found[0]


def test_records_come_again_after_the_service_has_restarted(
    config: Config,
    estimate: Make,
    socket_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reader_module, "RETRY_S", 0.01)
    feed = records(socket_path, threading.Event())
    assert next(feed) is None, "there is no service"

    for _ in range(2):
        server = opened(config, socket_path)
        server.publish(estimate(1), 0)
        while (found := next_line(server, feed, estimate(1))) is None:
            pass
        assert isinstance(found, dict)
        line = RecordWriter(config).line(estimate(1), found["seq"])
        assert found == json.loads(line)
        server.close()
        assert next(feed) is None, "it has ended"


def test_silence_is_reported(
    config: Config,
    estimate: Make,
    socket_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reader_module, "SILENT_S", 0.01)
    server = opened(config, socket_path)
    server.publish(estimate(0), 0)
    feed = records(socket_path, threading.Event())

    assert [next(feed), next(feed)] == [None, None]

    assert server._accepted(server._socket), "it stays connected"  # type: ignore[arg-type]
    server.close()


def test_a_stop_ends_it(socket_path: Path) -> None:
    stop = threading.Event()
    feed = records(socket_path, stop)
    assert next(feed) is None
    stop.set()
    assert list(feed) == []


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (b"GET / HTTP/1.1", "not a feed"),
        (b"[1]", "not a feed"),
        (b'{"schema":"bstm.feed"}', "not a feed"),
        (b"x" * (LONGEST + 1), "not a feed"),
        (b'{"schema":"bstm.feed","version":99}', "version 99.*same version"),
    ],
)
def test_what_is_no_feed_of_this_version_is_refused(
    line: bytes, words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        parsed(line)


def test_an_endless_line_is_no_feed(socket_path: Path) -> None:
    feed = records(socket_path, threading.Event())
    with socket.socket(socket.AF_UNIX) as stranger:
        stranger.bind(str(socket_path))
        stranger.listen()

        def send() -> None:
            connection, _ = stranger.accept()
            with connection, suppress(OSError):
                while True:
                    connection.sendall(b"x" * 4096)

        thread = threading.Thread(target=send)
        thread.start()
        with pytest.raises(UsageError, match="not a feed"):
            next(feed)
        feed.close()  # type: ignore[attr-defined]
        thread.join(10.0)
