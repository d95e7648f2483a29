"""``bstm simulate``: drives by name and by file, and what is refused."""

from __future__ import annotations

import csv
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.bus.logs.candump import CandumpReader
from bstm_daemon.cli.main import main
from bstm_daemon.simulation import drive_names

if TYPE_CHECKING:
    from pathlib import Path

DRIVE = """
[drive]
name = "away"
description = "pulling away and a stop"
ambient_c = 15.0
[[segment]]
speed_kmh = 36.0
rate_ms2 = 2.0
gear = 2
[[segment]]
speed_kmh = 0.0
rate_ms2 = 4.0
"""


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Return the file of a drive of 8 s."""
    path = tmp_path / "away.toml"
    path.write_text(DRIVE, encoding="utf-8")
    return path


def simulate(*arguments: object) -> int:
    """Run ``bstm simulate``."""
    return main(["simulate", *map(str, arguments)])


def test_writes_log_and_truth(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A drive of one's own, readable by the log reader, with its truth."""
    log, truth = tmp_path / "away.log", tmp_path / "truth.csv"

    assert simulate(drive, "-o", log, "--truth", truth) == 0

    reader = CandumpReader(log)
    frames = sum(len(chunk) for chunk in reader.chunks())
    assert not reader.refused
    assert reader.interfaces == ["can0"]
    with truth.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert float(rows[0]["FL.disc_c"]) == pytest.approx(15.0, abs=0.1)
    assert float(rows[-1]["FL.disc_c"]) > 16.0
    out, err = capsys.readouterr()
    assert err == ""
    assert f"{log}: {frames} frames, 0.1 min\n" in out
    assert f"{truth}: {len(rows)} rows of truth\n" in out


def test_the_same_again(drive: Path, tmp_path: Path) -> None:
    """The same drive gives the same bytes."""
    for name in ("a.log", "b.log"):
        assert simulate(drive, "-o", tmp_path / name) == 0

    a, b = ((tmp_path / name).read_bytes() for name in ("a.log", "b.log"))
    assert a == b


def test_list(capsys: pytest.CaptureFixture[str]) -> None:
    """Every drive by name with its description."""
    assert simulate("--list") == 0

    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines] == drive_names()
    assert "simalp" in drive_names()
    assert all(len(line.split()) > 3 for line in lines)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["alpine-decent", "-o", "x.log"], 2, "alpine-descent"),
        (["simalp", "-o", "x.log", "--preset", "moon"], 2, "plain"),
        (["simalp"], 2, "-o LOG"),
        (["-o", "x.log"], 2, "DRIVE"),
        (["simalp", "-o", "x.log", "--seed", "one"], 2, "--seed"),
        (["none.toml", "-o", "x.log"], 74, "none.toml"),
    ],
)
def test_what_is_refused(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    words: str,
) -> None:
    """Unknown drive or preset lists those there are; nothing is written."""
    monkeypatch.chdir(tmp_path)

    assert simulate(*arguments) == code

    out, err = capsys.readouterr()
    assert out == ""
    assert words in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("speed_kmh = 36.0", "speed_kmh = -1", "segment[1].speed_kmh"),
        ("gear = 2", "gearing = 2", "segment[1].gearing: unknown key"),
        ("[drive]", "[drive", "not TOML"),
    ],
)
def test_drive_that_is_none(
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    old: str,
    new: str,
    words: str,
) -> None:
    """78 with file and place."""
    drive.write_text(DRIVE.replace(old, new, 1), encoding="utf-8")

    assert simulate(drive, "-o", tmp_path / "x.log") == 78

    err = capsys.readouterr().err
    assert f"{drive}: " in err
    assert words in err
    assert not (tmp_path / "x.log").exists()


@pytest.mark.parametrize("option", ["-o", "--truth"])
def test_target_that_can_not_be_written(
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    option: str,
) -> None:
    """74 and the path."""
    targets = {"-o": tmp_path / "x.log", "--truth": tmp_path / "t.csv"}
    targets[option] = tmp_path / "none" / "x"

    code = simulate(drive, *(x for pair in targets.items() for x in pair))

    assert code == 74
    assert str(targets[option]) in capsys.readouterr().err


def test_samples_without_frames(drive: Path, tmp_path: Path) -> None:
    """The sensors' samples at 100 Hz, SI, by role."""
    target = tmp_path / "samples.npz"

    assert simulate(drive, "--samples", target) == 0

    with np.load(target) as samples:
        n = len(samples["time_s"])
        assert samples["vehicle_speed"].shape == (n,)
        assert samples["time_s"][1] - samples["time_s"][0] == (
            pytest.approx(0.01)
        )
        assert len(samples["temp_fl_fluid"]) == len(samples["slow_time_s"])


def test_two_results_in_one_file(
    drive: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The second would replace the first."""
    target = tmp_path / "x.log"

    assert simulate(drive, "-o", target, "--truth", target) == 2

    assert "would overwrite" in capsys.readouterr().err
    assert not target.exists()


def test_the_drive_is_not_overwritten(drive: Path) -> None:
    assert simulate(drive, "-o", drive) == 2
    assert drive.read_text(encoding="utf-8") == DRIVE
