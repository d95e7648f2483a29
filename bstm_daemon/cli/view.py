"""``bstm view``: the estimates live, as a page in a browser."""

import argparse
import asyncio
import json
import signal
import threading
import webbrowser
from collections.abc import Iterator
from pathlib import Path

from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.cli.arguments import add_config, number, option, shared
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import Config
from bstm_daemon.engine import Engine
from bstm_daemon.errors import BstmError, UsageError, require_packages
from bstm_daemon.feed.live import Live
from bstm_daemon.feed.reader import DEFAULT_SOCKET, Record, records
from bstm_daemon.feed.record import RecordWriter
from bstm_daemon.files import read_secret
from bstm_daemon.replay.frames import publications
from bstm_daemon.watch.replay_view import Pace

ADDRESS = "127.0.0.1:8080"
SHORTEST_TOKEN = 16


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is shown and where."""
    what = f"socket of the live service (default: {DEFAULT_SOCKET})"
    option(parser, "--feed SOCKET", what, Path)
    add_config(
        parser, "configuration of the vehicle, for its [feed] or for --log"
    )
    option(parser, "--log LOG", "replay a recorded log instead", Path)
    what = "with --log: seconds of the log per second (default: 1)"
    option(parser, "--speed", what, number(0.0), default=1.0)
    what = "with --log: the brakes at its beginning (default: unknown)"
    option(parser, "--start", what, choices=("cold", "unknown"))
    what = f"ADDRESS:PORT where the page is served (default: {ADDRESS})"
    option(parser, "--listen", what, default=ADDRESS)
    option(parser, "--open", "open the page in this computer's browser")
    what = "file with the token that a page beyond this computer must give"
    option(parser, "--token FILE", what, Path)
    shared(parser, "map")


def run(args: argparse.Namespace) -> int:
    """Serve the page until SIGTERM or SIGINT."""
    require_packages("tornado", extra="view", purpose="bstm view")
    from bstm_daemon.feed.view import Guard, serve  # noqa: PLC0415  (extra)

    guard = Guard.of(args.listen, args.token and _token(args.token))
    stop = threading.Event()
    place = args.log or _socket(args)
    source = _source(args, place, stop)
    live = Live(str(place))
    failed: list[BstmError] = []

    async def main() -> None:
        loop, end = asyncio.get_running_loop(), asyncio.Event()
        for one in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(one, end.set)

        def read() -> None:
            try:
                for record in source:
                    if record is not None:
                        live.take(record)
            except BstmError as error:
                failed.append(error)
                loop.call_soon_threadsafe(end.set)

        def ready(port: int) -> None:
            host = f"[{guard.host}]" if ":" in guard.host else guard.host
            print(f"page: http://{host}:{port}/", flush=True)
            if args.open:
                webbrowser.open(f"http://{host}:{port}/")
            threading.Thread(target=read, name="feed", daemon=True).start()

        await serve(live, guard, end, ready)

    asyncio.run(main())
    stop.set()
    if failed:
        raise failed[0]
    return 0


def _token(path: Path) -> str:
    token = read_secret(path).strip()
    if len(token) < SHORTEST_TOKEN:
        msg = f"{path}: a token has at least {SHORTEST_TOKEN} characters"
        raise UsageError(msg)
    return token


def _socket(args: argparse.Namespace) -> Path:
    """Return the socket: argument, then CONFIG, then the usual one."""
    if args.feed is not None or args.config is None:
        return Path(args.feed or DEFAULT_SOCKET)
    name = load_config(args.config).feed.socket
    if name is None:
        msg = f"{args.config}: has no [feed] socket to view"
        raise UsageError(msg)
    return Path(args.config.parent / name)


def _source(
    args: argparse.Namespace, place: Path, stop: threading.Event
) -> Iterator[Record | None]:
    """Return the records of the log or socket *place*, before any page."""
    if args.log is None:
        return records(place, stop)
    if args.config is None:
        msg = "view: --log needs the configuration of its car, -c FILE"
        raise UsageError(msg)
    place.open("rb").close()
    return _replayed(args, load_vehicle(args.config), stop)


def _replayed(
    args: argparse.Namespace,
    vehicle: tuple[Config, SignalMap],
    stop: threading.Event,
) -> Iterator[Record]:
    """Yield the records of a log, at the pace that was asked for."""
    config, signal_map = vehicle
    writer = RecordWriter(config)
    pace = Pace(args.speed, stop.wait)
    engines: list[Engine] = []
    for published in publications(
        *(config, signal_map, args.log, dict(args.map)),
        "cold" if args.start == "cold" else None,
        built=engines.append,
    ):
        estimate = engines[0].estimate
        if published and estimate is not None:
            pace.wait(estimate.time_us)
            yield json.loads(writer.line(estimate))
        if stop.is_set():
            return
