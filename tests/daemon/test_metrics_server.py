"""The page on the loopback interface."""

from __future__ import annotations

import http.client
import socket
import threading
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.daemon.metrics_server import MetricsServer
from bstm_daemon.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator


class Clock:
    """A clock that is set by hand [s]."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        """Return the time."""
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    """Return a clock."""
    return Clock()


@pytest.fixture
def server(clock: Clock) -> Iterator[MetricsServer]:
    """Return a server on a free port."""
    server = MetricsServer(0, stale_s=30.0, clock=clock)
    server.start()
    yield server
    server.close()


def ask(
    server: MetricsServer,
    path: str,
    method: str = "GET",
    host: str = "127.0.0.1",
) -> tuple[int, str, str]:
    """Return status, content type and body."""
    connection = http.client.HTTPConnection(host, server.port, timeout=10)
    connection.request(method, path)
    answer = connection.getresponse()
    body = answer.read().decode()
    connection.close()
    return answer.status, answer.headers["Content-Type"], body


def test_metrics(server: MetricsServer) -> None:
    server.update("bstm_state 1\n")
    server.update("bstm_state 2\n")

    assert ask(server, "/metrics") == (
        200,
        "text/plain; version=0.0.4; charset=utf-8",
        "bstm_state 2\n",
    )


def test_head_has_no_body(server: MetricsServer) -> None:
    server.update("bstm_state 1\n")

    status, _, body = ask(server, "/metrics", "HEAD")

    assert (status, body) == (200, "")


def test_health_follows_the_updates(
    server: MetricsServer, clock: Clock
) -> None:
    assert ask(server, "/healthz")[::2] == (503, "starting\n")
    assert ask(server, "/metrics")[0] == 503

    server.update("")
    clock.now_s += 30.0
    assert ask(server, "/healthz")[::2] == (200, "ok\n")
    clock.now_s += 1.0
    assert ask(server, "/healthz")[::2] == (503, "no status for 31 s\n")


@pytest.mark.parametrize("path", ["/", "/metrics/", "/../etc/passwd"])
def test_no_other_page(server: MetricsServer, path: str) -> None:
    server.update("bstm_state 1\n")

    assert ask(server, path)[::2] == (404, "not found\n")


def test_only_reading(server: MetricsServer) -> None:
    assert ask(server, "/metrics", "POST")[0] == 501


@pytest.mark.parametrize(
    "host",
    ["", "0.0.0.0", "localhost", "::", "192.0.2.1"],  # noqa: S104
)
def test_no_other_host(host: str) -> None:
    with pytest.raises(UsageError, match=r"127\.0\.0\.1 or ::1 only"):
        MetricsServer(0, host)


def test_the_other_loopback() -> None:
    server = MetricsServer(0, "::1")
    try:
        server.start()
    except UsageError as error:
        pytest.skip(f"no IPv6 here: {error}")
    server.update("x 1\n")
    try:
        assert ask(server, "/metrics", host="::1")[2] == "x 1\n"
    finally:
        server.close()


@pytest.mark.parametrize("port", [-1, 70_000])
def test_no_such_port(port: int) -> None:
    with pytest.raises(UsageError, match=f"--metrics-port {port}"):
        MetricsServer(port).start()


def test_a_port_in_use(server: MetricsServer) -> None:
    with pytest.raises(UsageError, match="in use"):
        MetricsServer(server.port).start()


def test_closing_frees_the_port_and_ends_the_thread(
    server: MetricsServer,
) -> None:
    port = server.port
    server.close()
    server.close()

    assert not [t for t in threading.enumerate() if t.name == "metrics"]
    again = MetricsServer(port)
    again.start()
    again.close()


def test_a_broken_request_disturbs_nobody(
    server: MetricsServer, capsys: pytest.CaptureFixture[str]
) -> None:
    server.update("x 1\n")
    for text in (b"\xff\xfe\r\n\r\n", b"GET\r\n\r\n", b"GET / HT"):
        with socket.create_connection(("127.0.0.1", server.port)) as client:
            client.sendall(text)

    assert ask(server, "/metrics")[2] == "x 1\n"
    assert capsys.readouterr().err == ""
