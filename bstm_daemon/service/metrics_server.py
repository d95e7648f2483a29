"""The metrics as a page on the loopback interface, in threads of its own.

Imported only on request: a page needs a socket family that the sandbox of the
service otherwise forbids.
"""

import threading
from collections.abc import Iterable
from contextlib import suppress
from http import HTTPStatus
from socket import SHUT_RDWR, socket
from socketserver import TCPServer, ThreadingMixIn
from typing import Any, Final
from wsgiref.simple_server import WSGIRequestHandler, WSGIServer
from wsgiref.types import StartResponse, WSGIApplication, WSGIEnvironment

from prometheus_client import make_wsgi_app

from bstm_daemon.errors import UsageError
from bstm_daemon.service.metrics import StatusMetrics

HOST: Final = "127.0.0.1"
"""Loopback only: the page has neither password nor TLS."""

STALE_S: Final = 30.0
SILENCE_S: Final = 2.0
"""A client that sends or takes nothing for this long is disconnected."""
MOST_CONNECTIONS: Final = 16
"""With one more, the oldest connection ends: slow clients block nobody."""


class MetricsServer:
    """Serves ``/metrics`` and ``/healthz`` until closed.

    ``/healthz`` is 200 while the metrics are updated, and 503 before the
    first update and once the last is ``STALE_S`` old: it reports work done,
    not a thread that is alive.
    """

    def __init__(self, port: int, metrics: StatusMetrics) -> None:
        """Serve *metrics* on *port*; port 0 takes a free one.

        Raises:
            UsageError: the port is taken or not allowed.
        """
        self._metrics = metrics
        self._page: WSGIApplication = make_wsgi_app(metrics.registry)
        try:
            self._server = _Server((HOST, port), _Handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            msg = f"--metrics-port {port}: cannot listen on {HOST}: {reason}"
            raise UsageError(msg) from error
        self._server.set_app(self._answer)
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="metrics", daemon=True
        )
        self._thread.start()

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return self._server.server_port

    def close(self) -> None:
        """Stop serving and free the port, whatever clients still do."""
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def _answer(
        self, environ: WSGIEnvironment, start_response: StartResponse
    ) -> Iterable[bytes]:
        path = environ["PATH_INFO"]
        age_s = self._metrics.age_s()
        if path == "/metrics" and age_s is not None:
            return self._page(environ, start_response)
        status, text = _health(age_s)
        if path not in {"/metrics", "/healthz"}:
            status, text = HTTPStatus.NOT_FOUND, "not found"
        body = f"{text}\n".encode()
        start_response(
            f"{status.value} {status.phrase}",
            [
                ("Content-Type", "text/plain; charset=utf-8"),
                ("Content-Length", f"{len(body)}"),
            ],
        )
        return [] if environ["REQUEST_METHOD"] == "HEAD" else [body]


def _health(age_s: float | None) -> tuple[HTTPStatus, str]:
    if age_s is None:
        return HTTPStatus.SERVICE_UNAVAILABLE, "starting"
    if age_s > STALE_S:
        return HTTPStatus.SERVICE_UNAVAILABLE, f"no status for {age_s:.0f} s"
    return HTTPStatus.OK, "ok"


class _Server(ThreadingMixIn, WSGIServer):
    """One thread a connection, of which it ends the oldest when too many."""

    daemon_threads = True  # closing waits for no client

    def __init__(self, *args: Any) -> None:
        self._open: dict[socket, None] = {}
        self._changing = threading.Lock()
        super().__init__(*args)

    def server_bind(self) -> None:
        # HTTPServer asks the resolver for the host's name here
        TCPServer.server_bind(self)
        self.server_name, self.server_port = HOST, self.server_address[1]
        self.setup_environ()

    def process_request(self, request: Any, client_address: Any) -> None:
        with self._changing:
            self._open[request] = None
            if len(self._open) > MOST_CONNECTIONS:
                oldest = next(iter(self._open))
                del self._open[oldest]
                with suppress(OSError):
                    oldest.shutdown(SHUT_RDWR)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        with self._changing:
            self._open.pop(request, None)
        super().shutdown_request(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore a client that went away or stayed silent."""


class _Handler(WSGIRequestHandler):
    timeout = SILENCE_S

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Log no requests: a scraper comes every few seconds."""
