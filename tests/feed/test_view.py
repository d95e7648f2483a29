"""The page: what its server refuses, and what a real browser shows."""

import asyncio
import http.client
import json
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from bstm_daemon.config.sections import Config
from bstm_daemon.errors import UsageError
from bstm_daemon.estimate import Estimate
from bstm_daemon.feed import view as view_module
from bstm_daemon.feed.live import Live
from bstm_daemon.feed.record import RecordWriter
from bstm_daemon.feed.view import FILES, Guard, serve

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None
)
TOKEN = "correct-horse-battery"  # noqa: S105
HOSTILE = "</title><img src=x onerror=\"document.title='taken'\">"
LIMIT_S = 60.0

Make = Callable[[int], Estimate]


class Served:
    """A page on a free port, filled by the test."""

    def __init__(
        self, host: str = "127.0.0.1", token: str | None = None
    ) -> None:
        self.live = Live("the test")
        self._token = token
        self._host = host
        self._ready = threading.Event()
        self._open: list[
            tuple[http.client.HTTPConnection, http.client.HTTPResponse]
        ] = []
        self._thread = threading.Thread(
            target=lambda: asyncio.run(self._serve()), daemon=True
        )
        self._thread.start()
        assert self._ready.wait(30.0)

    async def _serve(self) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()

        def ready(port: int) -> None:
            self.port = port
            self._ready.set()

        guard = Guard(self._host, 0, self._token)
        await serve(self.live, guard, self._stop, ready)

    def close(self) -> None:
        for connection, answer in self._open:
            answer.close()
            connection.close()
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(30.0)
        assert not self._thread.is_alive()

    def get(
        self, path: str, method: str = "GET", **headers: str
    ) -> http.client.HTTPResponse:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, 30)
        connection.putrequest(method, path, skip_host=True)
        own = {"Host": f"127.0.0.1:{self.port}"}
        for name, value in (own | headers).items():
            connection.putheader(name, value)
        connection.endheaders()
        answer = connection.getresponse()
        self._open.append((connection, answer))
        if path != "/events" or answer.status != 200:
            answer.read()
        return answer

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"


@pytest.fixture
def served() -> Iterator[Served]:
    made = Served()
    yield made
    made.close()


@pytest.fixture
def guarded() -> Iterator[Served]:
    made = Served("0.0.0.0", TOKEN)  # noqa: S104  (the token guards it)
    yield made
    made.close()


def test_every_answer_has_a_strict_policy(served: Served) -> None:
    for path in (*FILES, "/missing", "/../pyproject.toml"):
        answer = served.get(path)
        assert answer.status == (200 if path in FILES else 404), path
        policy = answer.headers["Content-Security-Policy"]
        assert policy.startswith("default-src 'none'; script-src 'self';")
        assert "unsafe" not in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Server"] is None


def test_the_page_takes_nothing_from_elsewhere() -> None:
    own = {"index.html", "page.css", "page.js"}
    for name, _ in FILES.values():
        text = (view_module.FOLDER / name).read_text("utf-8")
        if name in own:
            assert "http" not in text.replace("http-equiv", ""), name
    assert (view_module.FOLDER / "uplot" / "LICENSE").is_file()


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH"])
def test_it_only_reads(served: Served, method: str) -> None:
    assert served.get("/", method).status == 405


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("localhost:8080", 200),
        ("[::1]", 200),
        ("127.0.0.1", 200),
        ("evil.example", 403),
        ("localhost.evil.example", 403),
        ("192.0.2.1", 403),
        ("", 403),
        ("[", 403),
    ],
)
def test_a_name_that_is_not_this_computers_is_refused(
    served: Served, host: str, status: int
) -> None:
    for path in ("/", "/events") if status == 403 else ("/",):
        assert served.get(path, Host=host).status == status


def test_beyond_loopback_every_request_needs_the_token(
    guarded: Served,
) -> None:
    for path in (*FILES, "/events", "/missing"):
        assert guarded.get(path).status == 401, path
    assert guarded.get("/?token=wrong").status == 401
    assert guarded.get("/", Cookie="bstm_view=wrong").status == 401

    answer = guarded.get(f"/?token={TOKEN}")
    assert (answer.status, answer.headers["Location"]) == (302, "/")
    cookie = answer.headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    pair = cookie.split(";")[0]
    assert guarded.get("/", Cookie=pair).status == 200
    assert guarded.get("/events", Cookie=pair).status == 200
    assert guarded.get("/", Cookie=pair, Host="evil.example").status == 403
    assert guarded.get("/", Cookie=pair, Host="192.0.2.1").status == 200


def listening(port: int) -> set[str]:
    """Return the local addresses of the TCP sockets that listen on *port*."""
    found = set()
    for name in ("tcp", "tcp6"):
        lines = Path("/proc/net", name).read_text("ascii").splitlines()[1:]
        for words in map(str.split, lines):
            address, _, hexadecimal = words[1].partition(":")
            if words[3] == "0A" and int(hexadecimal, 16) == port:
                found.add(address)
    return found


def test_only_loopback_listens(served: Served) -> None:
    assert listening(served.port) == {"0100007F"}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0.0.0.0:8080", "--token"),
        ("[::]:8080", "--token"),
        ("192.0.2.1:80", "--token"),
        ("localhost:8080", "ADDRESS:PORT"),
        ("127.0.0.1:x", "ADDRESS:PORT"),
        ("127.0.0.1:99999", "ADDRESS:PORT"),
        ("", "ADDRESS:PORT"),
    ],
)
def test_addresses_that_are_refused(text: str, words: str) -> None:
    with pytest.raises(UsageError, match=words):
        Guard.of(text, None)


def test_addresses_that_are_taken() -> None:
    assert Guard.of("127.0.0.1:8080", None)[:2] == ("127.0.0.1", 8080)
    assert Guard.of("[::1]:80", None)[:2] == ("::1", 80)
    assert Guard.of("0.0.0.0:8080", TOKEN)[:2] == ("0.0.0.0", 8080)  # noqa: S104


def test_a_port_that_is_taken_is_said() -> None:
    with socket.create_server(("127.0.0.1", 0)) as other:
        guard = Guard(*other.getsockname())

        async def main() -> None:
            stop = asyncio.Event()
            await serve(Live(""), guard, stop, lambda _: None)

        with pytest.raises(UsageError, match="Address already in use"):
            asyncio.run(main())


def test_too_many_pages_are_refused(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view_module, "MOST_PAGES", 1)
    served.live.take(RECORD)
    first = served.get("/events")
    assert first.readline().startswith(b"id: ")
    assert served.get("/events").status == 503


RECORD: dict[str, Any] = {"time_s": 1e9, "corners": {}}


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    if CHROMIUM is None:
        pytest.skip("no chromium on PATH: the page is not shown")
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as play:
        made = play.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox"]
        )
        yield made
        made.close()


class Shown:
    """The page in the browser, fed by the test."""

    def __init__(self, served: Served, config: Config, tab: Any) -> None:
        self.served = served
        self.tab = tab
        self.wrong: list[str] = []
        self.asked: list[str] = []
        tab.set_default_timeout(1000 * LIMIT_S)
        tab.on("console", lambda one: self.wrong.append(one.text))
        tab.on("pageerror", lambda one: self.wrong.append(str(one)))
        tab.on("request", lambda one: self.asked.append(one.url))
        self._writer = RecordWriter(config)

    def take(self, estimate: Estimate) -> None:
        self.served.live.take(json.loads(self._writer.line(estimate)))

    def text(self, selector: str) -> str:
        return str(self.tab.locator(selector).inner_text())

    def wait(self, expression: str) -> None:
        """Wait in steps: the page's policy lets nothing evaluate there."""
        end_s = time.monotonic() + LIMIT_S
        while not self.tab.evaluate(expression):
            assert time.monotonic() < end_s, expression
            self.tab.wait_for_timeout(20)


@pytest.fixture
def shown(
    served: Served, config: Config, browser: Any
) -> Iterator[Callable[..., Shown]]:
    contexts = []

    def show(vehicle: str | None = None, **options: Any) -> Shown:
        contexts.append(browser.new_context(**options))
        used = config
        if vehicle is not None:
            named = config.vehicle.model_copy(update={"id": vehicle})
            used = config.model_copy(update={"vehicle": named})
        return Shown(served, used, contexts[-1].new_page())

    yield show
    for context in contexts:
        context.close()


FRESH = "!document.body.classList.contains('stale')"
STALE = "document.body.classList.contains('stale')"


@pytest.mark.slow
def test_the_page_shows_what_is_valid_and_hides_what_is_not(
    shown: Callable[..., Shown], estimate: Make
) -> None:
    page = shown()
    page.take(estimate(0))
    page.tab.goto(page.served.url)
    page.wait("document.querySelectorAll('canvas').length === 2")
    page.wait("document.getElementById('margin').textContent === '55 K'")

    assert page.text("#peak") == "127 °C"
    assert "FL" in page.text("#margin-of")
    # two of four are not known: what is shown is the least of the others
    assert "of the corners that are known" in page.text("#margin-of")
    assert page.text(".corner-FL .disc_c") == "300 °C"
    assert page.text(".corner-FL .level") == (
        "risk elevated, peak in 10 min if parked"
    )
    assert page.text(".corner-FR .validity") == "degraded"
    assert page.text(".corner-FR .reasons") == "input missing, unverified"
    for corner, word in (("RL", "invalid"), ("RR", "not available")):
        card = f".corner-{corner}"
        assert page.text(f"{card} .validity") == word
        for key in ("disc_c", "pad_front_c", "fluid_c", "margin_k", "peak_c"):
            assert page.text(f"{card} .{key}") == "\u2013"
        assert page.text(f"{card} .level") == "risk unknown"
        assert page.tab.locator(f"#wheel-{corner}").get_attribute("class") in (
            "wheel",
            "wheel ",
        )
    assert page.text("#advice") == (
        "brakes hot, shift down, wait longer than the forecast"
    )
    assert page.wrong == []
    assert {one.split("?")[0] for one in page.asked} == {
        page.served.url[:-1] + path for path in (*FILES, "/events")
    }


@pytest.mark.slow
def test_a_bound_is_called_one_while_the_start_is_unknown(
    shown: Callable[..., Shown], estimate: Make
) -> None:
    page = shown()
    made = estimate(0)
    status = replace(made.status, history_known=False)
    page.take(replace(made, status=status))
    page.tab.goto(page.served.url)
    page.wait("document.getElementById('margin').textContent === '55 K'")
    assert page.text("#margin-of").endswith("start unknown")
    assert page.text(".corner-FL .level").startswith("risk at most elevated")


@pytest.mark.slow
def test_silence_is_stale_within_two_seconds(
    shown: Callable[..., Shown], estimate: Make
) -> None:
    page = shown()
    page.tab.goto(page.served.url)
    page.wait(STALE)
    assert page.text("#notice") == "Waiting for data"
    # the page's own clock, so that a slow machine is no slow page
    page.tab.evaluate(
        "new MutationObserver(() => { if (!document.body.classList.contains("
        "'stale')) window.freshAt = performance.now();"
        " else if (window.freshAt) window.staleAt ??= performance.now(); })"
        ".observe(document.body, { attributes: true })"
    )
    page.take(estimate(0))
    page.wait("window.staleAt")
    after_ms = page.tab.evaluate("window.staleAt - window.freshAt")
    assert 500 < after_ms < 2000
    assert page.tab.evaluate(
        "getComputedStyle(document.getElementById('car')).filter"
    ) == ("grayscale(1)")
    assert "No data for" in page.text("#notice")

    page.take(estimate(1))
    page.wait(FRESH)


@pytest.mark.slow
def test_a_page_opened_late_does_not_take_old_data_for_new(
    shown: Callable[..., Shown], estimate: Make
) -> None:
    page = shown()
    page.take(estimate(0))
    page.served.live._taken_s -= 60.0
    page.tab.goto(page.served.url)
    page.wait("document.getElementById('margin').textContent === '55 K'")
    assert page.tab.evaluate(STALE)
    assert page.text("#notice").startswith("No data for 6")


@pytest.mark.slow
def test_names_stay_text(shown: Callable[..., Shown], estimate: Make) -> None:
    page = shown(HOSTILE)
    page.take(estimate(0))
    page.tab.goto(page.served.url)
    page.wait("document.getElementById('margin').textContent === '55 K'")
    assert page.text("#vehicle") == HOSTILE
    assert page.tab.locator("img").count() == 0
    assert page.wrong == []


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [400, 1400])
def test_it_fits_and_follows_the_light(
    shown: Callable[..., Shown], estimate: Make, width: int, scheme: str
) -> None:
    page = shown(viewport={"width": width, "height": 900}, color_scheme=scheme)
    page.take(estimate(0))
    page.tab.goto(page.served.url)
    page.wait("document.getElementById('margin').textContent === '55 K'")
    assert page.tab.evaluate("document.documentElement.scrollWidth") == width
    sizes = page.tab.evaluate(
        "[...document.querySelectorAll('body *')].map((one) =>"
        " [one.id, parseFloat(getComputedStyle(one).fontSize)])"
    )
    largest = max(size for _, size in sizes)
    assert {one for one, size in sizes if size == largest} == {
        "margin",
        "peak",
    }
    back = "getComputedStyle(document.body).backgroundColor"
    dark, light = "rgb(11, 13, 16)", "rgb(246, 248, 250)"
    assert page.tab.evaluate(back) == (dark if scheme == "dark" else light)
    page.tab.locator("#night").click()
    assert page.tab.evaluate(back) == (light if scheme == "dark" else dark)


@pytest.mark.slow
def test_eight_hours_of_page_in_bounded_memory(
    shown: Callable[..., Shown], estimate: Make
) -> None:
    """Virtual time: a record a second, handed over in ten minutes at once."""
    page = shown()
    page.tab.goto(page.served.url)
    session = page.tab.context.new_cdp_session(page.tab)

    def heap_bytes() -> int:
        session.send("HeapProfiler.collectGarbage")
        used = session.send("Runtime.getHeapUsage")
        return int(used["usedSize"])

    sizes = []
    for hour in range(8):
        for begin_s in range(0, 3600, 600):
            for second in range(begin_s, begin_s + 600):
                page.take(estimate(10 * (3600 * hour + second)))
            last_s, _ = page.served.live._points[-1]
            page.wait(f"columns[0].at(-1) === {last_s}")
        sizes.append(heap_bytes())
        assert page.tab.evaluate("columns[0].length") == min(
            1800 * (hour + 1), 1800
        )
    print("heap after each hour [kB]:", [size // 1000 for size in sizes])  # noqa: T201
    assert max(sizes[1:]) < 1.2 * sizes[1]
    assert page.wrong == []
