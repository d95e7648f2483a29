"""The page in a browser: a server that only reads, on loopback by default.

Beyond loopback a token is asked for, and everywhere a Host header that is
this computer's: a name that a stranger's site has pointed here is refused.
"""

from __future__ import annotations

import asyncio
import hmac
import socket
from ipaddress import ip_address
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.iostream import StreamClosedError
from tornado.web import Application, HTTPError, RequestHandler

from bstm_daemon.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

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
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

COOKIE: Final = "bstm_view"
EVENT_S: Final = 0.25
"""Between two events for a page; it is stale 1.5 s after the last one."""

MOST_PAGES: Final = 16
REQUEST_BYTES: Final = 65536
"""A request has no body, and no header is longer."""


class Listen(NamedTuple):
    """Where the page is served."""

    host: str
    port: int

    @classmethod
    def of(cls, text: str, token: str | None) -> Listen:
        """Return the address *text*, such as ``127.0.0.1:8080``.

        Raises:
            UsageError: it is no address, or one beyond loopback and there is
                no *token*.
        """
        parts = urlsplit(f"//{text}")
        try:
            listen = cls(parts.hostname or "", parts.port or 0)
            is_own = ip_address(listen.host).is_loopback
        except ValueError as error:
            msg = f"--listen {text}: must be ADDRESS:PORT, 127.0.0.1:8080"
            raise UsageError(msg) from error
        if not is_own and token is None:
            msg = (
                f"--listen {text}: others could read the page, give them a "
                "token by --token FILE"
            )
            raise UsageError(msg)
        return listen

    def accepts(self, host: str) -> bool:
        """Return whether a request for *host* is meant for this page.

        A number is: a site that points its name here is called by its name.
        """
        try:
            name = urlsplit(f"//{host}").hostname or ""
            address = ip_address(name)
        except ValueError:
            return host.partition(":")[0].lower() == "localhost"
        return address.is_loopback or not ip_address(self.host).is_loopback


class _Handler(RequestHandler):
    """Refuses whoever may not read the page."""

    def initialize(self, listen: Listen, token: str | None) -> None:
        self._listen = listen
        self._token = token

    def set_default_headers(self) -> None:
        self.clear_header("Server")
        for name, value in HEADERS.items():
            self.set_header(name, value)

    def prepare(self) -> None:
        if not self._listen.accepts(self.request.host):
            raise HTTPError(403, reason="Host is not this computer")
        if self._token is None:
            return
        given = self.get_query_argument("token", "")
        if _equal(given, self._token):
            self.set_cookie(COOKIE, given, httponly=True, samesite="Strict")
            self.redirect(self.request.path)  # the address shows it no more
        elif not _equal(self.get_cookie(COOKIE) or "", self._token):
            raise HTTPError(401, reason="Token missing: open /?token=...")

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code} {self._reason}\n")


class _File(_Handler):
    """A file of the page."""

    async def get(self) -> None:
        name, kind = FILES[self.request.path]
        self.set_header("Content-Type", kind)
        self.finish((FOLDER / name).read_bytes())

    head = get


class _Events(_Handler):
    """Server-sent events: the newest, as often as the client takes one."""

    async def get(self) -> None:
        pages: set[_Events] = self.settings["pages"]
        if len(pages) >= MOST_PAGES:
            raise HTTPError(503, reason="Too many pages are open")
        live: Live = self.settings["live"]
        self.set_header("Content-Type", "text/event-stream")
        seen = self.request.headers.get("Last-Event-ID", "")
        pages.add(self)
        try:
            while True:
                event = live.event(seen)
                if event is not None:
                    seen, text = event
                    self.write(f"id: {seen}\ndata: {text}\n\n")
                else:
                    self.write(":\n\n")
                # until it is sent: a stalled client holds one event
                await self.flush()
                await asyncio.sleep(EVENT_S)
        except StreamClosedError:
            pass
        finally:
            pages.remove(self)


class _Missing(_Handler):
    async def get(self) -> None:
        raise HTTPError(404)


async def serve(
    live: Live,
    listen: Listen,
    token: str | None,
    stop: asyncio.Event,
    ready: Callable[[int], None],
) -> None:
    """Serve *live* at *listen* until *stop* is set.

    Args:
        live: what the page shows.
        listen: address and port; port 0 takes a free one.
        token: asked of every request, unless None.
        stop: ends it.
        ready: called with the port once the page is there.

    Raises:
        UsageError: the address is taken or not ours.
    """
    pages: set[_Events] = set()
    guard = {"listen": listen, "token": token}
    application = Application(
        [
            *((path.replace(".", "[.]"), _File, guard) for path in FILES),
            ("/events", _Events, guard),
        ],
        default_handler_class=_Missing,
        default_handler_args=guard,
        live=live,
        pages=pages,
        log_function=lambda _: None,
    )
    server = HTTPServer(
        application,
        max_body_size=REQUEST_BYTES,
        max_header_size=REQUEST_BYTES,
        idle_connection_timeout=60.0,
    )
    try:
        own = socket.create_server(
            listen,
            family=socket.AF_INET6 if ":" in listen.host else socket.AF_INET,
        )
    except OSError as error:
        msg = f"--listen {listen.host}:{listen.port}: {error.strerror}"
        raise UsageError(msg) from error
    own.setblocking(False)
    server.add_socket(own)
    ready(own.getsockname()[1])
    await stop.wait()
    server.stop()
    await server.close_all_connections()
    while pages:  # noqa: ASYNC110  (each ends as it writes)
        await asyncio.sleep(EVENT_S / 10)


def _equal(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())
