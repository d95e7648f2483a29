"""Figures of ``bstm fleet``: equality, second run, speed-up, size, scale.

``python tests/benchmarks/fleet.py [FOLDER] [--cars N] [--drives N]`` makes the
logs in FOLDER (default: a temporary one) and prints a table.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import resource
import sqlite3
import subprocess
import sys
import tempfile
import time
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pyarrow as pa
import pyarrow.parquet as pq

from bstm_daemon.cli.main import main
from bstm_daemon.fleet.lake import Lake, Options, Receipt
from bstm_daemon.fleet.plan import Plan
from bstm_daemon.fleet.query import ask
from bstm_daemon.fleet.run import Run
from bstm_daemon.simulation import load_drive, parse_drive, simulate
from bstm_daemon.simulation.frames import Encoder
from bstm_daemon.simulation.recorder import write_candump

if TYPE_CHECKING:
    from bstm_daemon.fleet.drive import Job

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "config" / "example_vehicle.toml"
DBC = ROOT / "dbc" / "example_vehicle.dbc"
FIRST_S = 1_700_000_000.0
HOUR_S = 3600.0
PLANNED = 100_000
SYNTHETIC = 2_000

DRIVE = """
[drive]
name = "stop"
description = "one stop"
ambient_c = 10.0
[[segment]]
speed_kmh = {speed_kmh}
rate_ms2 = 4.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 5.0
[[segment]]
parked = true
duration_s = 2.0
"""


def bstm(*arguments: object) -> float:
    """Run ``bstm`` in a process of its own; return how long it took [s]."""
    begun_s = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "bstm_daemon.cli.main", *map(str, arguments)],
        check=True,
        capture_output=True,
        cwd=ROOT,
    )
    return time.perf_counter() - begun_s


def make_logs(folder: Path, cars: int, drives: int) -> None:
    encoder = Encoder(DBC)
    for car in range(cars):
        for number in range(drives):
            speed_kmh = 40.0 + 5.0 * ((3 * car + number) % 9)
            drive = parse_drive(DRIVE.format(speed_kmh=speed_kmh), "stop")
            log = folder / "logs" / f"car{car:02}" / f"{number}.log"
            log.parent.mkdir(parents=True, exist_ok=True)
            start_s = FIRST_S + HOUR_S * number
            write_candump(log, simulate(drive), encoder, start_stamp_s=start_s)
    (folder / "fleet.toml").write_text(
        f'[[vehicle]]\nlogs = "{{vehicle}}/*.log"\nconfig = "{CONFIG}"\n'
    )


def plan(folder: Path, lake: Path) -> None:
    vehicles = folder / "fleet.toml"
    bstm("fleet", "plan", folder / "logs", "--vehicles", vehicles, "-o", lake)


def same_by_hand(folder: Path, lake: Lake) -> int:
    """Replay each chain by hand; return how many drives are the same."""
    same = 0
    hand = folder / "hand"
    with closing(Plan(lake)) as planned:
        for car in planned.vehicles():
            start: tuple[object, ...] = ()
            for drive in planned.chain(car):
                state = hand / car / f"{drive.name}.state"
                state.parent.mkdir(parents=True, exist_ok=True)
                words = ("replay", drive.log, "-c", CONFIG, *start)
                with contextlib.redirect_stdout(io.StringIO()):
                    main([*map(str, (*words, "--state-out", state))])
                same += state.read_bytes() == lake.state(drive).read_bytes()
                start = "--state", state
    return same


def bytes_an_hour(folder: Path) -> float:
    """Return the size of the estimates of an hour of ``long-run`` [bytes]."""
    driven = simulate(load_drive("long-run"))
    log = folder / "long" / "logs" / "car" / "long.log"
    log.parent.mkdir(parents=True)
    write_candump(log, driven, Encoder(DBC))
    (folder / "long" / "fleet.toml").write_bytes(
        (folder / "fleet.toml").read_bytes()
    )
    lake = Lake(folder / "long" / "lake")
    plan(folder / "long", lake.root)
    bstm("fleet", "replay", lake.root, "--jobs", 1)
    (estimates,) = (lake.root / "estimates").glob("*/*/*.parquet")
    return estimates.stat().st_size / (driven.time_s[-1] / HOUR_S)


class NoCluster:
    """Takes every drive as done, so that the client alone is measured."""

    loop = None

    def __init__(self, lake: Lake) -> None:
        self.lake = lake
        self.waiting: list[Any] = []

    def nthreads(self) -> dict[str, int]:
        return {"tcp://none": 100}

    def submit(self, _: object, job: Job, key: str, *, pure: bool) -> Any:
        del pure
        return SimpleNamespace(
            key=key, result=partial(self.done, job), release=lambda: None
        )

    def done(self, job: Job) -> int:
        drive = job.drive
        receipt = Receipt(
            *(f"{drive.name}", "", 1, 1, None, drive.first_us),
            *(job.options, {}),
        )
        self.lake.write_receipt(drive, receipt)
        return 0

    def add(self, future: Any) -> None:
        self.waiting.append(future)

    def __next__(self) -> Any:
        """Return the oldest one."""
        return self.waiting.pop(0)


def planned_memory(folder: Path) -> tuple[float, float]:
    """Return time [s] and growth of memory [MiB] of the client's part.

    The growth is that from a tenth of the drives to all of them.
    """
    lake = Lake(folder / "many")
    plan(folder, lake.root)
    insert = (
        "WITH RECURSIVE n(i) AS (SELECT 0 UNION ALL SELECT i + 1 FROM n "
        "WHERE i < ? - 1) INSERT OR REPLACE INTO drive "
        "SELECT 'v' || (i % 300), 'd' || i, '/logs/' || i, i, NULL, 1, 1, "
        "?, 't', '{}' FROM n"
    )
    with closing(sqlite3.connect(lake.plan)) as database, database:
        database.execute("DELETE FROM drive")
        database.execute(insert, (PLANNED, str(CONFIG)))
    cluster, memory_kib = NoCluster(lake), []

    def progress() -> None:
        if replayed.outcome.made in (PLANNED // 10, PLANNED):
            usage = resource.getrusage(resource.RUSAGE_SELF)
            memory_kib.append(usage.ru_maxrss)

    begun_s = time.perf_counter()
    with (
        closing(Plan(lake)) as planned,
        patch("distributed.as_completed", lambda loop: cluster),  # noqa: ARG005
    ):
        replayed = Run(lake, planned, Options(100_000, forecast=True))
        replayed.execute(cluster, replayed.chains(), progress)
    assert replayed.outcome.made == PLANNED
    first, last = memory_kib
    return time.perf_counter() - begun_s, (last - first) / 1024.0


def synthetic_answer(folder: Path, lake: Lake) -> float:
    """Return how long the worst drive of each of many cars takes [s]."""
    source = next((lake.root / "drives").glob("*/*.parquet"))
    table = pq.ParquetFile(source).read()
    row = table.to_pylist()[0]
    found = Lake(folder / "synthetic")
    for i in range(SYNTHETIC):
        path = found.root / "drives" / f"vehicle=v{i % 300}" / f"{i}.parquet"
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.Table.from_pylist([row], table.schema), path)
    begun_s = time.perf_counter()
    sql = "SELECT vehicle, min(margin_k) FROM corners GROUP BY vehicle"
    assert len(ask(found, sql).rows) == 300
    return time.perf_counter() - begun_s


def run(folder: Path, cars: int, drives: int) -> dict[str, object]:
    make_logs(folder, cars, drives)
    count = cars * drives
    seconds = {}
    lakes = {jobs: Lake(folder / f"lake{jobs}") for jobs in (1, 2)}
    for jobs, lake in lakes.items():
        plan(folder, lake.root)
        seconds[jobs] = bstm("fleet", "replay", lake.root, "--jobs", jobs)
    with closing(Plan(lakes[2])) as planned:
        begun_s = time.perf_counter()
        again = Run(lakes[2], planned, Options(100_000, forecast=True)).look()
        second_s = time.perf_counter() - begun_s
    assert again.current == count
    spent_s, memory_mib = planned_memory(folder)
    return {
        "drives": count,
        "same as by hand": same_by_hand(folder, lakes[2]),
        "one worker [s]": round(seconds[1], 1),
        "two workers [s]": round(seconds[2], 1),
        "second run [s a 1000 drives]": round(second_s * 1000 / count, 2),
        "estimates [MB an hour at 10 Hz]": round(
            bytes_an_hour(folder) / 1e6, 2
        ),
        f"client's part of {PLANNED} drives [s]": round(spent_s, 1),
        "memory it grows by [MiB]": round(memory_mib, 1),
        f"worst of 300 cars, {SYNTHETIC} drives [s]": round(
            synthetic_answer(folder, lakes[2]), 2
        ),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--cars", type=int, default=40)
    parser.add_argument("--drives", type=int, default=10)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as away:
        at = given.folder or Path(away)
        print(json.dumps(run(at, given.cars, given.drives), indent=2))  # noqa: T201
