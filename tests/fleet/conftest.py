"""Logs of small fleets: some seconds of driving each, an hour apart."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.fleet.drive import Job, replay_drive
from bstm_daemon.fleet.lake import (
    Drive,
    Lake,
    Options,
    hash_of_config,
    program,
)
from bstm_daemon.fleet.plan import Fleet, Plan, add_logs
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

ROOT = Path(__file__).parents[2]
DBC = ROOT / "dbc" / "example_vehicle.dbc"
FIRST_S = 1_700_000_000
HOUR_S = 3600

DRIVE = """
[drive]
name = "stop"
description = "one stop"
ambient_c = 10.0
[[segment]]
speed_kmh = {speed_kmh}
rate_ms2 = 4.0
gear = 3
[[segment]]
speed_kmh = 0.0
rate_ms2 = 5.0
[[segment]]
parked = true
duration_s = 2.0
"""


@dataclass
class Made:
    """A fleet in a folder: its logs, ``fleet.toml`` and lake."""

    folder: Path

    @property
    def lake(self) -> Lake:
        return Lake(self.folder / "lake")

    def log(self, car: str, number: int) -> Path:
        return self.folder / "logs" / car / f"drive{number}.log"

    def plan(self, *logs: Path) -> list[Drive]:
        """Plan *logs*, or all; return those whose begin is unreadable."""
        fleet = Fleet(self.folder / "fleet.toml")
        return add_logs(self.lake, fleet, logs or [self.folder / "logs"])

    def chain(self, car: str) -> list[Drive]:
        plan = Plan(self.lake)
        try:
            return list(plan.chain(car))
        finally:
            plan.close()

    def replay(self, car: str, **options: Any) -> list[int]:
        """Replay the chain of *car* here, and return what each task did."""
        before, key = None, ""
        codes = []
        for drive in self.chain(car):
            made = Options(100_000, forecast=False)
            config_hash = hash_of_config(Path(drive.config))
            job = Job(
                *(str(self.lake.root), drive, before, key, made),
                config_hash,
                options.get("program", program()),
            )
            codes.append(replay_drive(job))
            receipt = self.lake.receipt(drive)
            before, key = drive, receipt.key if receipt else ""
        return codes

    def files(self) -> dict[str, bytes]:
        """Return every file of the lake but the plan and the lock."""
        root = self.lake.root
        return {
            path.relative_to(root).as_posix(): path.read_bytes()
            for path in sorted(root.rglob("*"))
            if path.is_file() and path.parent != root
        }


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    """Return three logs that begin at FIRST_S, of 8 to 10 s."""
    path = tmp_path_factory.mktemp("fleet") / "drive.log"
    found = []
    for speed_kmh in (40.0, 50.0, 60.0):
        drive = parse_drive(DRIVE.format(speed_kmh=speed_kmh), "stop")
        write_candump(
            path, simulate(drive), Encoder(DBC), start_stamp_s=FIRST_S
        )
        found.append(path.read_bytes())
    return found


def shifted(log: bytes, seconds: int) -> bytes:
    """Return *log* with stamps *seconds* later; it begins at FIRST_S."""
    found = []
    for line in log.splitlines(keepends=True):
        whole, rest = line[1:].split(b".", 1)
        found.append(b"(%d.%s" % (int(whole) + seconds, rest))
    return b"".join(found)


@pytest.fixture
def make_fleet(
    recorded: list[bytes], tmp_path: Path
) -> Callable[[int, Iterable[int]], Made]:
    """Return a maker of so many cars with drives of these numbers."""

    def make(cars: int, numbers: Iterable[int]) -> Made:
        fleet = Made(tmp_path)
        config = (ROOT / "config" / "example_vehicle.toml").read_text("utf-8")
        shutil.copy(DBC, tmp_path / "car.dbc")
        (tmp_path / "car.toml").write_text(
            config.replace("../dbc/example_vehicle.dbc", "car.dbc"), "utf-8"
        )
        (tmp_path / "fleet.toml").write_text(
            '[[vehicle]]\nlogs = "{vehicle}/*.log"\nconfig = "car.toml"\n',
            "utf-8",
        )
        for car in range(cars):
            for number in numbers:
                log = fleet.log(f"car{car}", number)
                log.parent.mkdir(parents=True, exist_ok=True)
                source = recorded[(car + number) % len(recorded)]
                log.write_bytes(shifted(source, number * HOUR_S))
        return fleet

    return make
