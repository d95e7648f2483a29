"""Workers, clients and schedulers killed at random moments.

The processes are real and on the loopback. ``BSTM_FLEET_KILLS`` is how often
each kind is killed.
"""

from __future__ import annotations

import os
import random
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

ROOT = Path(__file__).parents[2]
KILLS = int(os.environ.get("BSTM_FLEET_KILLS", "1"))
DEADLINE_S = 120.0
WORKERS = 2


class Processes:
    """A scheduler with two workers, and clients."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []
        self.address = ""
        self._stack = ExitStack()

    def close(self) -> None:
        for one in (*self.workers, self.scheduler):
            kill(one)
        self._stack.close()

    def start(self, name: str, *command: str) -> subprocess.Popen[bytes]:
        log = self._stack.enter_context(
            (self.folder / f"{name}.txt").open("ab")
        )
        return subprocess.Popen(
            [sys.executable, "-m", *command],
            stdout=log,
            stderr=log,
            cwd=self.folder,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
        )

    def keep_up(self) -> None:
        """Start the scheduler and workers that do not run."""
        if self.scheduler is None or self.scheduler.poll() is not None:
            for worker in self.workers:
                kill(worker)
            self.workers = []
            log = self.folder / "scheduler.txt"
            log.unlink(missing_ok=True)
            self.scheduler = self.start(
                *("scheduler", "distributed.cli.dask_scheduler"),
                *(
                    "--host",
                    "127.0.0.1",
                    "--port",
                    "0",
                    "--dashboard-address",
                    "127.0.0.1:0",
                ),
            )
            found = wait_for(
                lambda: re.search(rb"tcp://127.0.0.1:\d+", log.read_bytes())
            )
            self.address = found[0].decode()
        self.workers = [one for one in self.workers if one.poll() is None]
        while len(self.workers) < WORKERS:
            worker = self.start(
                *("workers", "distributed.cli.dask_worker", self.address),
                *(
                    "--nthreads",
                    "1",
                    "--no-nanny",
                    "--dashboard-address",
                    "127.0.0.1:0",
                ),
                *("--host", "127.0.0.1", "--death-timeout", "20"),
            )
            self.workers.append(worker)

    def replay(self, lake: Path) -> subprocess.Popen[bytes]:
        return self.start(
            *("client", "bstm_daemon.cli.main", "fleet", "replay", str(lake)),
            *("--scheduler", self.address, "--no-forecast"),
        )


def kill(process: subprocess.Popen[bytes] | None) -> None:
    if process is not None:
        process.send_signal(signal.SIGKILL)
        process.wait()


def wait_for(condition: Callable[[], Any]) -> Any:
    end_s = time.monotonic() + DEADLINE_S
    while time.monotonic() < end_s:
        found = condition()
        if found:
            return found
        time.sleep(0.02)
    pytest.fail("nothing happened")


@pytest.fixture
def processes(tmp_path: Path) -> Iterator[Processes]:
    found = Processes(tmp_path)
    yield found
    found.close()


def receipts(lake: Path) -> dict[Path, int]:
    """Return when each receipt was written."""
    return {
        path: path.stat().st_mtime_ns
        for path in (lake / "receipts").rglob("[!.]*.json")
    }


@pytest.mark.slow
def test_whatever_is_killed_the_lake_is_the_same(
    make_fleet: Callable[..., Any], processes: Processes
) -> None:
    """And no drive that was finished is replayed again."""
    fleet = make_fleet(4, range(5))
    fleet.plan()
    for car in range(4):
        fleet.replay(f"car{car}")
    expected = fleet.files()
    lake = fleet.lake.root
    lake.rename(fleet.folder / "reference")
    chance = random.Random(20)  # noqa: S311  (no secret)
    again = []
    for victim in ("worker", "client", "scheduler") * KILLS:
        fleet.plan()
        processes.keep_up()
        client = processes.replay(lake)
        # at a random number of finished drives, at any moment of the next
        count = chance.randrange(16)
        wait_for(lambda count=count: len(receipts(lake)) >= count)
        time.sleep(chance.uniform(0.0, 0.1))
        kill(
            {
                "worker": processes.workers[0],
                "client": client,
                "scheduler": processes.scheduler,
            }[victim]
        )
        finished = receipts(lake)

        code = client.wait(DEADLINE_S)

        assert (code == 0) == (victim == "worker"), victim
        processes.keep_up()
        assert processes.replay(lake).wait(DEADLINE_S) == 0
        assert fleet.files() == expected
        after = receipts(lake)
        again.append(
            sum(after[path] != at_ns for path, at_ns in finished.items())
        )
        lake.rename(fleet.folder / f"lake{len(again)}")
    assert again == [0] * len(again)
