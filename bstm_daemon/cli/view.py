"""``bstm view``: the estimates live, as a page in a browser."""

from __future__ import annotations

import asyncio
import json
import signal
import threading
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from bstm_daemon.cli.arguments import add_bus_map, add_config, add_path
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.reading import load_config
from bstm_daemon.errors import BstmError, UsageError, require_packages
from bstm_daemon.feed.live import Live
from bstm_daemon.feed.reader import DEFAULT_SOCKET, records
from bstm_daemon.feed.record import RecordWriter
from bstm_daemon.files import read_secret
from bstm_daemon.replay.frames import publications
from bstm_daemon.watch.replay_view import Pace

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from bstm_daemon.engine import Engine
    from bstm_daemon.feed.reader import Record
    from bstm_daemon.replay.columns import StartState

ADDRESS = "127.0.0.1:8080"
SHORTEST_TOKEN = 16


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is shown and where."""
    what = "socket of the live service (default: that of CONFIG, or "
    add_path(parser, "--feed", "SOCKET", f"{what}{DEFAULT_SOCKET})")
    what = "configuration of the vehicle, for its [feed] or for --log"
    add_config(parser, what, required=False)
    add_path(parser, "--log", "LOG", "replay a recorded log instead")
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        metavar="X",
        help="with --log: seconds of the log per second (default: 1)",
    )
    parser.add_argument(
        "--start",
        choices=("cold", "unknown"),
        default="unknown",
        help="with --log: the brakes at its beginning",
    )
    parser.add_argument(
        "--listen",
        default=ADDRESS,
        metavar="ADDRESS:PORT",
        help=f"where the page is served (default: {ADDRESS})",
    )
    what = "file with the token that a page beyond this computer must give"
    add_path(parser, "--token", "FILE", what)
    add_bus_map(parser)


def run(args: argparse.Namespace) -> int:
    """Serve the page until SIGTERM or SIGINT."""
    require_packages("tornado", extra="view", purpose="bstm view")
    from bstm_daemon.feed.view import Listen, serve  # noqa: PLC0415  (extra)

    if args.log is not None and args.config is None:
        msg = "view: --log needs the configuration of its car, -c FILE"
        raise UsageError(msg)
    token = None if args.token is None else _token(args.token)
    listen = Listen.of(args.listen, token)
    stop = threading.Event()
    source = _log(args, stop) if args.log else records(_socket(args), stop)
    live = Live(str(args.log or _socket(args)))
    failed: list[BstmError] = []

    async def main() -> None:
        loop, end = asyncio.get_running_loop(), asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, end.set)

        def read() -> None:
            try:
                _fill(live, source)
            except BstmError as error:
                failed.append(error)
                loop.call_soon_threadsafe(end.set)

        def ready(port: int) -> None:
            host = f"[{listen.host}]" if ":" in listen.host else listen.host
            print(f"page: http://{host}:{port}/", flush=True)
            threading.Thread(target=read, name="feed", daemon=True).start()

        await serve(live, listen, token, end, ready)

    try:
        asyncio.run(main())
    finally:
        stop.set()
    if failed:
        raise failed[0]
    return 0


def _fill(live: Live, source: Iterator[Record | None]) -> None:
    with closing(source):  # type: ignore[type-var]
        for record in source:
            if record is not None:
                live.take(record)


def _socket(args: argparse.Namespace) -> Path:
    """Return the socket: argument, then CONFIG, then the usual one."""
    if args.feed is not None:
        return Path(args.feed)
    if args.config is None:
        return Path(DEFAULT_SOCKET)
    name = load_config(args.config).feed.socket
    if name is None:
        msg = f"{args.config}: has no [feed] socket to view"
        raise UsageError(msg)
    return Path(args.config.parent / name)


def _log(
    args: argparse.Namespace, stop: threading.Event
) -> Iterator[Record | None]:
    """Yield the records of a log, at the pace that was asked for."""
    config, signal_map = load_vehicle(args.config)
    writer = RecordWriter(config)
    pace = Pace(args.speed, stop.wait)
    start: StartState = "cold" if args.start == "cold" else None
    engines: list[Engine] = []
    for published in publications(
        *(config, signal_map, args.log, dict(args.map), start),
        built=engines.append,
    ):
        estimate = engines[0].estimate
        if not published or estimate is None:
            continue
        pace.wait(estimate.time_us)
        if stop.is_set():
            return
        yield json.loads(writer.line(estimate))


def _token(path: Path) -> str:
    token = read_secret(path).strip()
    if len(token) < SHORTEST_TOKEN:
        msg = f"{path}: a token has at least {SHORTEST_TOKEN} characters"
        raise UsageError(msg)
    return token
