"""``bstm simulate``: cars, effects and sensors from the command line."""

from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.cli.main import main

TEXT = """
[drive]
name = "short"
description = "a stop"
[[segment]]
speed_kmh = 72.0
rate_ms2 = 4.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 4.0
[[segment]]
parked = true
duration_s = 20.0
"""


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """Return a drive file of half a minute."""
    path = tmp_path / "short.toml"
    path.write_text(TEXT)
    return path


def truth(folder: Path, drive: Path, *arguments: str) -> np.ndarray:
    """Return the table that ``bstm simulate`` writes with *arguments*."""
    out = folder / "truth.csv"
    code = main(
        [
            *("simulate", str(drive), "-o", str(folder / "x.log")),
            *("--truth", str(out), *arguments),
        ]
    )
    assert code == 0
    return np.genfromtxt(out, delimiter=",", names=True, deletechars="")


def test_vehicle_preset_and_effect(tmp_path: Path, drive: Path) -> None:
    nominal = truth(tmp_path, drive)
    second = truth(tmp_path, drive, "--vehicle", "second")
    shifted = truth(tmp_path, drive, "--effect", "brake_share=2")
    road = truth(tmp_path, drive, "--preset", "road")
    off = truth(tmp_path, drive, "--preset", "road", "--effect", "disc_hat=0")

    energy = "FL.brake_energy_j"
    assert second[energy][-1] < 0.95 * nominal[energy][-1]
    assert shifted[energy][-1] == pytest.approx(1.2 * nominal[energy][-1])
    assert road["FL.hat_c"][-1] > 20.5
    assert off["FL.hat_c"][-1] < 20.1 < road["FL.hat_c"][-1]


def test_sensors_change_the_log_only(tmp_path: Path, drive: Path) -> None:
    clean = truth(tmp_path, drive)
    log = (tmp_path / "x.log").read_bytes()
    noisy = truth(tmp_path, drive, "--sensors", "n4", "--seed", "3")

    np.testing.assert_array_equal(clean, noisy)
    assert (tmp_path / "x.log").read_bytes() != log


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--effect", "disc_hat"], "NAME=STRENGTH"),
        (["--effect", "disc_hut=1"], "no effect 'disc_hut'"),
        (["--effect", "disc_hat=9"], "0 to 3"),
        (["--preset", "rosy"], "no preset"),
    ],
)
def test_mistakes_are_named(
    drive: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    words: str,
) -> None:
    out = str(tmp_path / "x.log")
    code = main(["simulate", str(drive), "-o", out, *arguments])

    assert code == 2
    assert words in capsys.readouterr().err


def test_list_names_every_drive(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "--list"]) == 0

    shown = capsys.readouterr().out
    assert "simalp" in shown
    assert "m15" in shown
