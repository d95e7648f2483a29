"""Real recordings (BSTM_REAL_DATA): none is a test drive, and they say so."""

import os
from pathlib import Path

import pytest

from bstm_daemon.cli.main import main

REAL = os.environ.get("BSTM_REAL_DATA")
ROOT = Path(__file__).parents[3]
CONFIGS = {
    "toyota": ROOT / "config" / "toyota_rav4.toml",
    "subaru": ROOT / "config" / "subaru_wrx_sti.toml",
    "gr86": ROOT / "tests" / "real" / "gr86_cup.toml",
    "tesla": ROOT / "tests" / "real" / "tesla_model3.toml",
    "f1": ROOT / "tests" / "real" / "f1.toml",
}
LOGS = {
    "toyota": "toyota-rav4-comma2k19/rav4_bus0_bus1.converted.candump.log",
    "subaru": "subaru-wrx-sti-candump/can_sample.log",
    "stand": "gt86-on-stand-candump/vsslog.log",
    "gr86": "gr86-cup-barber/R1_barber_telemetry_mvp.csv",
    "tesla": "tesla-model3-trackmode/telemetry-v1-2020-03-05-20_00_01.csv",
    "f1": "f1-five-channel/Spain.converted.csv",
}

pytestmark = [
    pytest.mark.real,
    pytest.mark.skipif(
        REAL is None, reason="BSTM_REAL_DATA names no folder of recordings"
    ),
]


def called(command: str, name: str, config: str | None = None) -> int:
    extra = ["--map", "can1="] if name == "toyota" else []
    return main(
        [
            *command.split(),
            str(Path(str(REAL)) / LOGS[name]),
            *("-c", str(CONFIGS[config or name]), *extra),
        ]
    )


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("toyota", 65, "0 pieces of 15 s"),
        ("subaru", 65, "drive line open or without torque"),
        ("gr86", 65, "0 pieces of 15 s"),
        ("f1", 65, "no pressure, no brake_switch"),
        ("tesla", 1, "4 windows only, 12 needed"),
    ],
)
def test_coast_down(
    name: str, code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called("identify coastdown", name) == code
    assert words in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    ("name", "code", "words"),
    [
        ("toyota", 65, "no brake pressure in this log"),
        ("subaru", 65, "0 samples of 12 needed"),
        ("tesla", 65, "samples of 12 needed"),
        ("gr86", 1, "friction scale, push-out not identified: standard error"),
    ],
)
def test_brakes(
    name: str, code: int, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called("identify brakes", name) == code
    assert words in "".join(capsys.readouterr())


@pytest.mark.parametrize(
    "command", ["identify coastdown", "identify brakes", "heat"]
)
def test_car_on_a_stand(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called(command, "stand", "subaru") == 65
    assert "the car stood on a stand" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("toyota", "no brake pressure in this log"),
        ("subaru", "no torque at the wheels in this log"),
        ("tesla", "no role brake_torque in this log"),
    ],
)
def test_heat(
    name: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert called("heat", name) == 0
    out, err = capsys.readouterr()
    assert err == ""
    assert words in out
