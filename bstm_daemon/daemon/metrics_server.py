"""The metrics as a page on the loopback interface, in a thread of its own.

Only started on request, and imported only then: a page costs a socket family
that the sandbox of the service otherwise forbids.
"""

from __future__ import annotations

import threading
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, HTTPServer
from socket import AF_INET, AF_INET6
from typing import TYPE_CHECKING, Final

from bstm_daemon.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

LOOPBACK: Final = {"127.0.0.1": AF_INET, "::1": AF_INET6}
"""Hosts that the page may be served on; it has neither password nor TLS."""

METRICS_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
PLAIN_TYPE: Final = "text/plain; charset=utf-8"
STALE_S: Final = 30.0
REQUEST_TIMEOUT_S: Final = 2.0
"""One request at a time: a client that says nothing is left after this."""


class MetricsServer:
    """Serves ``/metrics`` and ``/healthz`` between start and close.

    ``/healthz`` is 200 while :meth:`update` is called, and 503 before the
    first call and once the last is *stale_s* old: it tells of work done, not
    of a thread that is alive.
    """

    def __init__(
        self,
        port: int,
        host: str = "127.0.0.1",
        *,
        stale_s: float = STALE_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare a server on *port* of *host*; port 0 takes a free one.

        Raises :class:`~bstm_daemon.errors.UsageError` for a host that is not
        127.0.0.1 or ::1.
        """
        if host not in LOOPBACK:
            msg = (
                f"metrics are served on {' or '.join(LOOPBACK)} only, not on "
                f"{host!r}"
            )
            raise UsageError(msg)
        self._host = host
        self._asked_port = port
        self._stale_s = stale_s
        self._clock = clock
        self._page: tuple[bytes, float] | None = None
        self._server: HTTPServer | None = None
        self._thread: threading.Thread | None = None

    @property
    def port(self) -> int:
        """The port that is listened on, once started."""
        if self._server is None:
            return self._asked_port
        return int(self._server.server_address[1])

    def start(self) -> None:
        """Listen and serve.

        Raises :class:`~bstm_daemon.errors.UsageError` where the port is
        taken or not allowed.
        """
        handler = type("Handler", (_Handler,), {"answer": self._answer})
        family = LOOPBACK[self._host]
        server = type("Server", (_Server,), {"address_family": family})
        try:
            self._server = server((self._host, self._asked_port), handler)
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or error
            msg = (
                f"--metrics-port {self._asked_port}: cannot listen on "
                f"{self._host}: {reason}"
            )
            raise UsageError(msg) from error
        self._thread = threading.Thread(
            target=self._server.serve_forever, name="metrics", daemon=True
        )
        self._thread.start()

    def update(self, text: str) -> None:
        """Serve *text* from now on; never blocks."""
        self._page = (text.encode(), self._clock())

    def close(self) -> None:
        """Stop serving and free the port; twice is once."""
        server, self._server = self._server, None
        if server is None or self._thread is None:
            return
        server.shutdown()
        self._thread.join()
        server.server_close()

    def _answer(self, path: str) -> tuple[HTTPStatus, str, bytes]:
        page = self._page
        if path == "/metrics":
            if page is None:
                return HTTPStatus.SERVICE_UNAVAILABLE, PLAIN_TYPE, b""
            return HTTPStatus.OK, METRICS_TYPE, page[0]
        if path != "/healthz":
            return HTTPStatus.NOT_FOUND, PLAIN_TYPE, b"not found\n"
        if page is None:
            return HTTPStatus.SERVICE_UNAVAILABLE, PLAIN_TYPE, b"starting\n"
        age_s = self._clock() - page[1]
        if age_s > self._stale_s:
            text = f"no status for {age_s:.0f} s\n".encode()
            return HTTPStatus.SERVICE_UNAVAILABLE, PLAIN_TYPE, text
        return HTTPStatus.OK, PLAIN_TYPE, b"ok\n"


class _Server(HTTPServer):
    """Looks up no names and says nothing of broken connections."""

    def server_bind(self) -> None:
        # HTTPServer asks the resolver for the host's name here
        super(HTTPServer, self).server_bind()
        self.server_name, self.server_port = "localhost", 0

    def handle_error(self, request: object, client_address: object) -> None:
        """Leave a client that went away or never spoke."""


class _Handler(BaseHTTPRequestHandler):
    """Answers GET and HEAD."""

    answer: Callable[[str], tuple[HTTPStatus, str, bytes]]
    timeout = REQUEST_TIMEOUT_S
    server_version = "bstm"
    sys_version = ""

    def do_GET(self) -> None:
        """Send the page."""
        self.wfile.write(self._head())

    def do_HEAD(self) -> None:
        """Send what comes before the page."""
        self._head()

    def _head(self) -> bytes:
        status, kind, body = self.answer(self.path.partition("?")[0])
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        return body

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Log no requests: a scraper comes every few seconds."""
