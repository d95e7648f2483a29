"""``bstm fleet``: from logs to answers, in processes of its own."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

if TYPE_CHECKING:
    from collections.abc import Sequence

ROOT = Path(__file__).parents[2]
DBC = ROOT / "dbc" / "example_vehicle.dbc"
CAR = ROOT / "config" / "example_vehicle.toml"

DRIVE = """
[drive]
name = "stop"
description = "one stop"
ambient_c = 10.0
[[segment]]
speed_kmh = 50.0
rate_ms2 = 4.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 5.0
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with ``fleet.toml`` and two drives of two cars."""
    driven = simulate(parse_drive(DRIVE, "stop"))
    for car in ("a", "b"):
        (tmp_path / "logs" / car).mkdir(parents=True)
        for number in (0, 1):
            write_candump(
                tmp_path / "logs" / car / f"{number}.log",
                driven,
                Encoder(DBC),
                start_stamp_s=1_700_000_000.0 + 3600.0 * number,
            )
    (tmp_path / "fleet.toml").write_text(
        f'[[vehicle]]\nlogs = "{{vehicle}}/*.log"\nconfig = "{CAR}"\n', "utf-8"
    )
    return tmp_path


def fleet(folder: Path, step: str, *arguments: str) -> int:
    """Run ``bstm fleet`` here."""
    lake = str(folder / "lake")
    if step == "plan":
        logs, vehicles = str(folder / "logs"), str(folder / "fleet.toml")
        return main(
            ["fleet", "plan", logs, "--vehicles", vehicles, "-o", lake]
        )
    return main(["fleet", step, lake, *arguments])


def started(
    folder: Path, arguments: Sequence[str]
) -> subprocess.CompletedProcess[str]:
    """Run ``bstm fleet replay`` in a process of its own."""
    command = [sys.executable, "-m", "bstm_daemon.cli.main", "fleet", "replay"]
    return subprocess.run(
        [*command, str(folder / "lake"), *arguments],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )


def test_before_a_replay(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fleet(folder, "status") == 74
    assert "bstm fleet plan" in capsys.readouterr().err

    assert fleet(folder, "plan") == 0
    assert "4 drives of 2 cars" in capsys.readouterr().out
    assert fleet(folder, "status") == 0
    assert "2 cars, 4 waiting" in capsys.readouterr().out
    assert fleet(folder, "query", "hottest") == 74
    assert fleet(folder, "query") == 0
    assert "wear " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--scheduler", "tcp://10.0.0.1:8786"], "only tls://"),
        (["--scheduler", "tls://a:1", "--jobs", "2"], "not allowed with"),
        (["--every", "0.25"], "multiple of 0.1"),
    ],
)
def test_usage(
    folder: Path,
    arguments: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    fleet(folder, "plan")

    assert fleet(folder, "replay", *arguments) == 2

    assert words in capsys.readouterr().err


def test_a_second_command_does_not_write_the_lake(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fleet(folder, "plan")
    code = (
        "import sys\nfrom pathlib import Path\n"
        "from bstm_daemon.service.state_file import lock\n"
        f"own = lock(Path({str(folder / 'lake' / 'lake')!r}))\n"
        "print('locked', flush=True)\nsys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    ) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"locked\n"
        assert fleet(folder, "plan") == 75
        assert fleet(folder, "replay") == 75
        other.communicate()

    assert "another 'bstm fleet' writes it" in capsys.readouterr().err


@pytest.mark.slow
def test_replay_status_and_query(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """On two processes; a log that is no log is a 1, and named."""
    (folder / "logs" / "b" / "2.log").write_text("no log\n")
    assert fleet(folder, "plan") == 0
    assert "2.log" in capsys.readouterr().out

    done = started(folder, ["--jobs", "2", "--no-forecast"])

    assert done.stderr == ""
    assert done.returncode == 1
    assert "4 replayed, 1 failed" in done.stdout
    assert "- b 2: " in done.stdout
    again = started(folder, ["--jobs", "2", "--no-forecast"])
    assert "4 up to date, 1 failed" in again.stdout
    assert fleet(folder, "status") == 1
    assert "4 up to date, 1 failed" in capsys.readouterr().out
    assert fleet(folder, "query", "hottest", "-o", str(folder / "a.csv")) == 0
    with (folder / "a.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {row["vehicle"] for row in rows} == {"a", "b"}
    assert fleet(folder, "query", "SELECT nothing") == 2
