"""Figures of ``bstm fleet``: equality, second run, speed-up, size, scale.

``python tests/benchmarks/fleet.py [FOLDER] [--cars N] [--drives N]`` makes the
logs in FOLDER (default: a temporary one) and prints what it finds. In a FOLDER
that is there it goes on where it was ended; remove a figure from its
``figures.json`` to have it measured again. Kills are in
``tests/fleet/test_kills.py``.
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
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import pyarrow as pa
import pyarrow.parquet as pq

from bstm_daemon.cli.main import main
from bstm_daemon.fleet.drive import replay_drive
from bstm_daemon.fleet.lake import Lake, Options, Receipt, ask
from bstm_daemon.fleet.plan import Plan
from bstm_daemon.fleet.run import Run
from bstm_daemon.simulation import load_drive, parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.fleet.drive import Job

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "config" / "example_vehicle.toml"
DBC = ROOT / "dbc" / "example_vehicle.dbc"
FIRST_S = 1_700_000_000.0
HOUR_S = 3600.0
PLANNED = 100_000
SYNTHETIC = 2_000
QUICK = "--no-forecast"
"""Of all short drives: it changes nothing of what is compared."""

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


def bstm(*arguments: object, code: int = 0) -> float:
    """Run ``bstm`` in a process of its own; return how long it took [s].

    *code* is the exit code that it must have.
    """
    begun_s = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "bstm_daemon.cli.main", *map(str, arguments)],
        check=False,
        capture_output=True,
        cwd=ROOT,
    )
    assert done.returncode == code, done.stderr
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
                if not state.exists():
                    words = ("replay", drive.log, "-c", CONFIG, *start, QUICK)
                    with contextlib.redirect_stdout(io.StringIO()):
                        main([*map(str, (*words, "--state-out", state))])
                same += (
                    state.read_bytes()
                    == lake.path(drive, "state").read_bytes()
                )
                start = "--state", state
    return same


def made_anew(folder: Path, lake: Lake, source: str, target: str) -> list[str]:
    """Let the log *target* come or change; return what is made anew.

    *target* gets the content of *source*, an hour later for each drive that
    its number is higher, or is corrupt where there is no *source*.
    """
    before = {path: path.stat().st_mtime_ns for path in receipts(lake)}
    log = folder / "logs" / f"{target}.log"
    if source:
        write_shifted(folder / "logs" / f"{source}.log", log)
    else:
        log.write_bytes(b"no log\n")
    plan(folder, lake.root)
    code = 0 if source else 1
    bstm("fleet", "replay", lake.root, "--jobs", 2, QUICK, code=code)
    return sorted(
        f"{path.parent.name}/{path.stem}"
        for path in receipts(lake)
        if before.get(path) != path.stat().st_mtime_ns
    )


def receipts(lake: Lake) -> list[Path]:
    return [*(lake.root / "receipts").rglob("[!.]*.json")]


def write_shifted(source: Path, target: Path) -> None:
    """Write *source* half an hour later."""
    lines = []
    for line in source.read_text("utf-8").splitlines():
        whole, rest = line[1:].split(".", 1)
        lines.append(f"({int(whole) + int(HOUR_S / 2)}.{rest}\n")
    target.write_text("".join(lines), "utf-8")


def cost(folder: Path) -> dict[str, float]:
    """Return what an hour of ``long-run`` and a drive cost.

    CPU time [s] with and without forecast, of the estimates [bytes an hour],
    and of row, state and receipt [bytes a drive].
    """
    driven = simulate(load_drive("long-run"))
    log = folder / "long" / "logs" / "car" / "long.log"
    log.parent.mkdir(parents=True, exist_ok=True)
    write_candump(log, driven, Encoder(DBC))
    vehicles = folder / "long" / "fleet.toml"
    vehicles.write_bytes((folder / "fleet.toml").read_bytes())
    hours = driven.time_s[-1] / HOUR_S
    found = {}
    for name, forecast in (
        ("CPU an hour of log, --no-forecast [s]", False),
        ("CPU an hour of log [s]", True),
    ):
        lake = Lake(folder / "long" / f"lake{forecast:d}")
        plan(folder / "long", lake.root)
        here = Here(lake)
        before_s = time.process_time()
        with (
            closing(Plan(lake)) as planned,
            patch("distributed.as_completed", lambda loop: here),  # noqa: ARG005, B023
        ):
            made = Run(lake, planned, Options(100_000, forecast=forecast))
            made.execute(here, made.chains(), lambda: None)
        assert made.outcome.made == 1
        spent_s = time.process_time() - before_s
        found[name] = round(spent_s / hours, 2)
    (estimates,) = (lake.root / "estimates").glob("*/*/*.parquet")
    size = estimates.stat().st_size
    found["estimates an hour at 10 Hz [MB]"] = round(size / hours / 1e6, 3)
    rest = [
        path
        for name in ("drives", "state", "receipts")
        for path in (lake.root / name).rglob("*.*")
        if path.is_file()
    ]
    size = sum(path.stat().st_size for path in rest)
    found["row, state and receipt [kB]"] = round(size / 1e3, 1)
    return found


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


class Here(NoCluster):
    """Replays every drive in this process."""

    def done(self, job: Job) -> int:
        return replay_drive(job)


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


def in_new_process(
    measure: Callable[[Path], tuple[float, float]], folder: Path
) -> tuple[float, float]:
    """Return what *measure* finds where no memory was in use before."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        return pool.submit(measure, folder).result()


def replayed(folder: Path, jobs: int) -> tuple[Lake, float]:
    """Return the lake made by *jobs* workers and how long it took [s]."""
    lake = Lake(folder / f"lake{jobs}")
    plan(folder, lake.root)
    spent_s = bstm("fleet", "replay", lake.root, "--jobs", jobs, QUICK)
    return lake, round(spent_s, 1)


def speed_up(folder: Path) -> float:
    """Return how many times as fast two workers are, on drives of 100 min.

    Each twice, one worker first and last: a machine's speed drifts.
    """
    long = folder / "speed"
    drive = simulate(load_drive("rich"))
    for car in range(4):
        for number in range(3):
            log = long / "logs" / f"car{car}" / f"{number}.log"
            log.parent.mkdir(parents=True, exist_ok=True)
            start_s = FIRST_S + 2.0 * HOUR_S * number
            write_candump(log, drive, Encoder(DBC), start_stamp_s=start_s)
    (long / "fleet.toml").write_bytes((folder / "fleet.toml").read_bytes())
    spent_s = {1: 0.0, 2: 0.0}
    for number, jobs in enumerate((1, 2, 2, 1)):
        lake = long / f"lake{number}"
        plan(long, lake)
        spent_s[jobs] += bstm("fleet", "replay", lake, "--jobs", jobs)
    return round(spent_s[1] / spent_s[2], 2)


def second_run_s(lake: Lake, count: int) -> float:
    """Return how long 1000 drives take a run with nothing to do [s]."""
    with closing(Plan(lake)) as planned:
        begun_s = time.perf_counter()
        again = Run(lake, planned, Options(100_000, forecast=False)).look()
        second_s = time.perf_counter() - begun_s
    assert again.current == count
    return round(second_s * 1000 / count, 2)


def run(folder: Path, cars: int, drives: int) -> dict[str, object]:
    """Return all figures; those found before are kept in *folder*."""
    kept = folder / "figures.json"
    found: dict[str, object] = {}
    if kept.exists():
        found = json.loads(kept.read_text("utf-8"))
    else:
        make_logs(folder, cars, drives)
    count, last = cars * drives, f"car{cars - 1:02}"
    lake = Lake(folder / "lake2")
    for name, figure in {
        "two workers [s]": lambda: replayed(folder, 2)[1],
        "same as by hand": lambda: same_by_hand(folder, lake),
        "second run [s a 1000 drives]": lambda: second_run_s(lake, count),
        "cost": lambda: cost(folder),
        f"client's part of {PLANNED} drives [s], memory [MiB]": lambda: (
            in_new_process(planned_memory, folder)
        ),
        f"worst of 300 cars, {SYNTHETIC} drives [s]": lambda: round(
            synthetic_answer(folder, lake), 2
        ),
        "made anew by a late drive": lambda: made_anew(
            folder, lake, f"car00/{drives - 4}", "car00/late"
        ),
        "made anew where a log became corrupt": lambda: made_anew(
            folder, lake, "", f"{last}/{drives - 4}"
        ),
        "two workers against one": lambda: speed_up(folder),
    }.items():
        if name not in found:
            found[name] = figure()
            kept.write_text(json.dumps(found, indent=2), "utf-8")
    return {"drives": count} | found


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--cars", type=int, default=40)
    parser.add_argument("--drives", type=int, default=10)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as away:
        at = given.folder or Path(away)
        print(json.dumps(run(at, given.cars, given.drives), indent=2))  # noqa: T201
