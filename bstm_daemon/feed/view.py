"""The page in a browser: a server that only reads, on loopback by default.

Beyond loopback a token is asked for, and everywhere a Host header that is
this computer's: a name that a stranger's site has pointed here is refused.
"""

from __future__ import annotations

import asyncio
import hmac
import socket
from collections.abc import Callable
from ipaddress import ip_address
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler

from bstm_daemon.errors import UsageError
from bstm_daemon.feed.live import Live

FOLDER: Final = Path(__file__).parent / "page"
FILES: Final = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
    "/uplot.css": ("uplot/uPlot.min.css", "text/css; charset=utf-8"),
    "/uplot.js": ("uplot/uPlot.iife.min.js", "text/javascript; charset=utf-8"),
}
HEADERS: Final = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; "
    "style-src 'self'; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
COOKIE: Final = "bstm_view"
EVENT_S: Final = 0.25
"""Between two events for a page; it is stale 1.5 s after the last one."""

MOST_PAGES: Final = 16


class Guard(NamedTuple):
    """Where the page is served, and who may read it."""

    host: str
    port: int
    token: str | None = None

    @classmethod
    def of(cls, text: str, token: str | None) -> Guard:
        """Return that of the address *text*, such as ``127.0.0.1:8080``.

        Raises:
            UsageError: it is no address, or one beyond loopback and there is
                no *token*.
        """
        try:
            parts = urlsplit(f"//{text}")
            guard = cls(parts.hostname or "", parts.port or 0, token)
            is_own = ip_address(guard.host).is_loopback
        except ValueError as error:
            msg = f"--listen {text}: must be ADDRESS:PORT, 127.0.0.1:8080"
            raise UsageError(msg) from error
        if not is_own and token is None:
            msg = (
                f"--listen {text}: others could read the page, give them a "
                "token by --token FILE"
            )
            raise UsageError(msg)
        return guard

    def is_meant(self, host: str) -> bool:
        """Return whether a request for *host* is meant for this page.

        A number is: a site that points its name here is called by its name.
        """
        try:
            address = ip_address(urlsplit(f"//{host}").hostname or "")
        except ValueError:
            return host.partition(":")[0].lower() == "localhost"
        return address.is_loopback or not ip_address(self.host).is_loopback

    def accepts(self, given: str | None) -> bool:
        """Return whether *given* is the token, in a time that tells none."""
        return self.token is None or hmac.compare_digest(
            (given or "").encode(), self.token.encode()
        )


class _Handler(RequestHandler):
    """Refuses whoever may not read the page."""

    def initialize(self, guard: Guard, live: Live, pages: set[Any]) -> None:
        self._guard, self._live, self._pages = guard, live, pages

    def set_default_headers(self) -> None:
        self.clear_header("Server")
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        if not self._guard.is_meant(self.request.host):
            raise HTTPError(403, reason="Host is not this computer")
        given = self.get_query_argument("token", None)
        if self._guard.token is None or self._guard.accepts(
            self.get_cookie(COOKIE)
        ):
            return
        if given is None or not self._guard.accepts(given):
            raise HTTPError(401, reason="Token missing: open /?token=...")
        self.set_cookie(COOKIE, given, httponly=True, samesite="Strict")
        self.redirect(self.request.path)  # the address shows it no more

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code} {self._reason}\n")

    async def get(self) -> None:
        if self.request.path not in FILES:
            raise HTTPError(404)
        name, kind = FILES[self.request.path]
        self.set_header("Content-Type", kind)
        self.finish((FOLDER / name).read_bytes())


class _Events(_Handler):
    """Server-sent events: the newest, as often as the client takes one."""

    async def get(self) -> None:
        if len(self._pages) >= MOST_PAGES:
            raise HTTPError(503, reason="Too many pages are open")
        self.set_header("Content-Type", "text/event-stream")
        seen = self.request.headers.get("Last-Event-ID", "")
        self._pages.add(self)
        try:
            while True:
                event = self._live.event(seen)
                if event is not None:
                    seen = event[0]
                    self.write(f"id: {seen}\ndata: {event[1]}\n\n")
                else:
                    self.write(":\n\n")
                # until it is sent: a stalled client holds one event
                await self.flush()
                await asyncio.sleep(EVENT_S)
        except StreamClosedError:
            pass
        finally:
            self._pages.remove(self)


async def serve(
    live: Live, guard: Guard, stop: asyncio.Event, ready: Callable[[int], None]
) -> None:
    """Serve *live* until *stop* is set.

    Args:
        live: what the page shows.
        guard: address, port (0 takes a free one) and token.
        stop: ends it.
        ready: called with the port once the page is there.

    Raises:
        UsageError: the address is taken or not ours.
    """
    pages: set[Any] = set()
    given = {"guard": guard, "live": live, "pages": pages}
    application = Application(
        [("/events", _Events, given), ("/.*", _Handler, given)],
        log_function=lambda _: None,
    )
    server = HTTPServer(application, idle_connection_timeout=60.0)
    family = socket.AF_INET6 if ":" in guard.host else socket.AF_INET
    try:
        own = socket.create_server((guard.host, guard.port), family=family)
    except OSError as error:
        msg = f"--listen {guard.host}:{guard.port}: {error.strerror}"
        raise UsageError(msg) from error
    own.setblocking(False)
    server.add_socket(own)
    ready(own.getsockname()[1])
    await stop.wait()
    server.stop()
    await server.close_all_connections()
    while pages:  # noqa: ASYNC110  (each ends as it writes)
        await asyncio.sleep(EVENT_S / 10)
