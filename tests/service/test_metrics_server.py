"""The page on the loopback interface, with clients of every manner."""

from __future__ import annotations

import http.client
import socket
import threading
import time
from contextlib import ExitStack
from typing import TYPE_CHECKING

import pytest
from prometheus_client.parser import text_string_to_metric_families

from bstm_daemon.errors import UsageError
from bstm_daemon.service.metrics import StatusMetrics
from bstm_daemon.service.metrics_server import MOST_CONNECTIONS, MetricsServer
from bstm_daemon.service.status import LoopStatus, ServiceStatus

if TYPE_CHECKING:
    from collections.abc import Iterator

STATUS = ServiceStatus(
    "1.2.3", compiled_kernel=True, late_samples=7, loop=LoopStatus(uptime_s=8)
)
STOP_LIMIT_S = 2.0


class Clock:
    """A clock that is set by hand [s]."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        """Return the time."""
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def metrics(clock: Clock) -> StatusMetrics:
    return StatusMetrics(clock)


@pytest.fixture
def server(metrics: StatusMetrics) -> Iterator[MetricsServer]:
    """Return a server on a free port."""
    server = MetricsServer(0, metrics)
    yield server
    server.close()


def ask(
    server: MetricsServer,
    path: str,
    method: str = "GET",
    headers: dict[str, str] | None = None,
) -> tuple[int, str, str]:
    """Return status, content type and body."""
    connection = http.client.HTTPConnection(
        "127.0.0.1", server.port, timeout=STOP_LIMIT_S
    )
    connection.request(method, path, headers=headers or {})
    answer = connection.getresponse()
    body = answer.read().decode()
    connection.close()
    return answer.status, answer.headers["Content-Type"], body


def connect(server: MetricsServer) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.port), timeout=10)


def values(text: str) -> dict[str, float]:
    return {
        sample.name: sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_the_page_has_the_newest_status(
    server: MetricsServer, metrics: StatusMetrics
) -> None:
    metrics.update(ServiceStatus("1", compiled_kernel=True))
    metrics.update(STATUS)

    status, kind, text = ask(server, "/metrics")

    assert (status, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
    assert text == metrics.text().decode()
    found = values(text)
    assert found["bstm_late_samples_total"] == 7
    assert found["bstm_uptime_seconds"] == 8


def test_a_scraper_may_ask_for_openmetrics(
    server: MetricsServer, metrics: StatusMetrics
) -> None:
    metrics.update(STATUS)

    accept = {"Accept": "application/openmetrics-text; version=1.0.0"}
    _, kind, text = ask(server, "/metrics", headers=accept)

    assert kind.startswith("application/openmetrics-text")
    assert text.endswith("# EOF\n")
    assert "bstm_late_samples_total 7.0" in text


def test_health_follows_the_updates(
    server: MetricsServer, metrics: StatusMetrics, clock: Clock
) -> None:
    assert ask(server, "/healthz")[::2] == (503, "starting\n")
    assert ask(server, "/metrics")[0] == 503

    metrics.update(STATUS)
    clock.now_s += 30.0
    assert ask(server, "/healthz")[::2] == (200, "ok\n")
    assert ask(server, "/healthz", "HEAD")[::2] == (200, "")
    clock.now_s += 1.0
    assert ask(server, "/healthz")[::2] == (503, "no status for 31 s\n")


@pytest.mark.parametrize("path", ["/", "/metrics/", "/../etc/passwd"])
def test_no_other_page(
    server: MetricsServer, metrics: StatusMetrics, path: str
) -> None:
    metrics.update(STATUS)

    assert ask(server, path)[::2] == (404, "not found\n")


@pytest.mark.parametrize("port", [-1, 70_000])
def test_no_such_port(metrics: StatusMetrics, port: int) -> None:
    with pytest.raises(UsageError, match=f"--metrics-port {port}"):
        MetricsServer(port, metrics)


def test_a_port_in_use(server: MetricsServer, metrics: StatusMetrics) -> None:
    with pytest.raises(UsageError, match="in use"):
        MetricsServer(server.port, metrics)


def test_only_the_loopback_interface(server: MetricsServer) -> None:
    assert server._server.server_address[0] == "127.0.0.1"


@pytest.mark.slow
def test_closing_frees_the_port_and_ends_the_thread(
    metrics: StatusMetrics,
) -> None:
    server = MetricsServer(0, metrics)
    port = server.port
    server.close()

    assert not [t for t in threading.enumerate() if t.name == "metrics"]
    MetricsServer(port, metrics).close()


def test_a_broken_request_disturbs_nobody(
    server: MetricsServer,
    metrics: StatusMetrics,
    capsys: pytest.CaptureFixture[str],
) -> None:
    metrics.update(STATUS)
    for text in (b"\xff\xfe\r\n\r\n", b"GET\r\n\r\n", b"GET / HT"):
        with connect(server) as client:
            client.sendall(text)

    assert ask(server, "/metrics")[0] == 200
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_a_client_of_a_byte_every_half_second_holds_up_nobody(
    metrics: StatusMetrics,
) -> None:
    """Neither another client nor the stop."""
    server = MetricsServer(0, metrics)
    metrics.update(STATUS)
    sent, over = threading.Event(), threading.Event()

    def dribble() -> None:
        with connect(server) as client:
            for byte in b"GET /metrics HTTP/1.1\r\n":
                client.send(bytes([byte]))
                sent.set()
                if over.wait(0.5):
                    return

    slow = threading.Thread(target=dribble)
    slow.start()
    assert sent.wait(10)
    begin_s = time.monotonic()
    assert ask(server, "/metrics")[0] == 200
    assert time.monotonic() - begin_s < 1.0
    time.sleep(1.0)
    assert ask(server, "/healthz")[0] == 200

    begin_s = time.monotonic()
    server.close()
    assert time.monotonic() - begin_s < STOP_LIMIT_S
    assert slow.is_alive()
    over.set()
    slow.join()


@pytest.mark.slow
def test_fifty_idle_connections_keep_nobody_out(
    metrics: StatusMetrics,
) -> None:
    """The oldest give way; threads stay few and all end."""
    server = MetricsServer(0, metrics)
    metrics.update(STATUS)
    before = threading.active_count()
    with ExitStack() as clients:
        idle = [clients.enter_context(connect(server)) for _ in range(50)]
        assert ask(server, "/metrics")[0] == 200
        for oldest in idle[: 50 - MOST_CONNECTIONS]:
            assert oldest.recv(1) == b""
        assert threading.active_count() <= before + MOST_CONNECTIONS + 2
        begin_s = time.monotonic()
        server.close()
        assert time.monotonic() - begin_s < STOP_LIMIT_S
