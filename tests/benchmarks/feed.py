"""The feed: what a publication costs the service, by its readers."""

from __future__ import annotations

import socket
import tempfile
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time
from typing import TYPE_CHECKING, Final

from side_by_side import LOADED, Goal, Outcome, Table

from bstm_daemon.feed.server import FeedServer
from bstm_daemon.files import shipped_file
from bstm_daemon.service.assembly import BusOverride, build_monitor

if TYPE_CHECKING:
    from bstm_daemon.estimate import Estimate

PER_S: Final = 10
CORE_PERCENT: Final = 0.08
"""Allowed with one reader: a twentieth of the service."""

LATE_S: Final = 0.01
"""Longest allowed; a frame is late from 0.1 s on."""

STALLED: Final = 50
ROUND: Final = 200
EPOCH_US: Final = 1_700_000_000_000_000


def run(*, full: bool) -> Outcome:
    """Measure with no reader, one that reads, and fifty that do not."""
    rounds = 25 if full else 7
    config = shipped_file("config/example_vehicle.toml")
    monitor = build_monitor(config, BusOverride())
    monitor.engine.tick(EPOCH_US)
    monitor.engine.tick(EPOCH_US + 20_000_000)
    estimate = monitor.engine.estimate
    assert estimate is not None
    rows, shares = [], {}
    longest_s = 0.0
    for name, readers, reads in (
        ("none", 0, False),
        ("one", 1, True),
        ("page and bridge", 2, True),
        (f"{STALLED} stalled", STALLED, False),
    ):
        with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
            path = Path(folder) / "feed.sock"
            feed = monitor.config.feed.model_copy(update={"socket": str(path)})
            output = FeedServer(print)
            used = monitor.config.model_copy(update={"feed": feed})
            output.begin(used, Path(folder))
            stack.callback(output.close)
            output.publish(estimate, EPOCH_US)
            connected = [
                stack.enter_context(reader(path)) for _ in range(readers)
            ]
            costs, longest_s = measured(
                output, estimate, connected if reads else [], rounds
            )
        share = 100.0 * PER_S * median(costs)
        shares[name] = share
        rows.append(
            (
                name,
                f"{median(costs) * 1e6:.1f}",
                f"{share:.4f}",
                f"{longest_s * 1e3:.2f}",
            )
        )
    return Outcome(
        "The feed",
        "CPU time of `FeedServer.publish`, the whole of what the feed adds "
        "to the thread of the service, at ten publications a second.",
        [
            Goal(
                f"one reader: at most {CORE_PERCENT} % of a core",
                CORE_PERCENT / shares["one"],
                1.0,
                LOADED,
            ),
            Goal(
                f"{STALLED} stalled readers: never {LATE_S * 1e3:.0f} ms",
                LATE_S / longest_s,
                1.0,
                0.9,
            ),
        ],
        [
            Table(
                "by readers",
                ("readers", "us a publication", "% of a core", "longest [ms]"),
                tuple(rows),
            )
        ],
    )


def reader(path: Path) -> socket.socket:
    """Return a reader connected to *path*."""
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    made.connect(str(path))
    made.setblocking(False)
    return made


def measured(
    output: FeedServer,
    estimate: Estimate,
    readers: list[socket.socket],
    rounds: int,
) -> tuple[list[float], float]:
    """Return seconds a publication, round by round, and the longest."""
    costs, longest_s = [], 0.0
    for _ in range(rounds):
        spent_s = 0.0
        for _ in range(ROUND):
            begin_s, wall_s = thread_time(), perf_counter()
            output.publish(estimate, EPOCH_US)
            spent_s += thread_time() - begin_s
            longest_s = max(longest_s, perf_counter() - wall_s)
            for one in readers:
                one.recv(65536)
        costs.append(spent_s / ROUND)
    return costs, longest_s
