"""The reader of a feed: follows it over ends, silence and strangers."""

import json
import threading
from collections.abc import Callable
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


def next_line(server: FeedServer, feed: object, line: bytes) -> object:
    """Send *line* once the reader is there, and return what it yields."""
    found: list[object] = []
    thread = threading.Thread(target=lambda: found.append(next(feed)))  # type: ignore[call-overload]
    thread.start()
    while not server.has_readers:
        thread.join(0.01)
    server.send(line)
    thread.join(10.0)
    return found[0]


def test_records_come_again_after_the_service_has_restarted(
    config: Config,
    estimate: Make,
    socket_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reader_module, "RETRY_S", (0.01, 0.02))
    writer = RecordWriter(config)
    feed = records(socket_path, threading.Event())
    assert next(feed) is None, "there is no service"

    for _ in range(2):
        server = FeedServer(socket_path)
        line = writer.line(estimate(1))
        while (found := next_line(server, feed, line)) is None:
            pass
        assert found == json.loads(line)
        server.close()
        assert next(feed) is None, "it has ended"


def test_silence_is_reported(
    socket_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reader_module, "SILENT_S", 0.01)
    server = FeedServer(socket_path)
    feed = records(socket_path, threading.Event())

    assert [next(feed), next(feed)] == [None, None]

    assert server.has_readers, "it stays connected"
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
    server = FeedServer(socket_path)
    feed = records(socket_path, threading.Event())
    failed: list[BaseException] = []

    def read() -> None:
        try:
            next(feed)
        except UsageError as error:
            failed.append(error)

    thread = threading.Thread(target=read)
    thread.start()
    while thread.is_alive():
        if server.has_readers:
            server.send(b"x" * 4096)
        thread.join(0.001)
    server.close()
    assert len(failed) == 1
