"""bstm view: a feed or a log in a browser, from the command line."""

import itertools
import json
import re
import shutil
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.files import shipped_file
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump

CAR = shipped_file("config/example_vehicle.toml")
DBC = shipped_file("dbc/example_vehicle.dbc")
CHROMIUM = shutil.which("chromium")
LIMIT_S = 60.0

DRIVE = """
[drive]
name = "stop"
description = "a stop after four minutes"
ambient_c = 10.0
thermocouple_logger = false
[[segment]]
speed_kmh = 100.0
rate_ms2 = 3.0
gear = 3
[[segment]]
speed_kmh = 0.0
rate_ms2 = 6.0
[[segment]]
parked = true
duration_s = 260.0
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of four minutes and a half."""
    path = tmp_path_factory.mktemp("view") / "stop.log"
    write_candump(path, simulate(parse_drive(DRIVE, "stop")), Encoder(DBC))
    return path


@pytest.fixture
def view() -> Iterator[Callable[..., str]]:
    """Return what starts the command and gives the address of its page."""
    running: list[subprocess.Popen[str]] = []

    def start(*arguments: str | Path) -> str:
        running.append(
            subprocess.Popen(
                [
                    *(sys.executable, "-m", "bstm_daemon.cli.main", "view"),
                    *("--listen", "127.0.0.1:0", *map(str, arguments)),
                ],
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        assert running[-1].stdout is not None
        found = re.search(r"http\S+", running[-1].stdout.readline())
        assert found is not None, running[-1].communicate()[1]
        return found[0]

    yield start
    for process in running:
        process.send_signal(signal.SIGTERM)
        _, said = process.communicate(timeout=LIMIT_S)
        assert (process.returncode, said) == (0, "")


def events(url: str) -> Iterator[dict[str, Any]]:
    with urllib.request.urlopen(  # noqa: S310  (it is our own)
        f"{url}events", timeout=LIMIT_S
    ) as answer:
        for line in answer:
            if line.startswith(b"data: "):
                yield json.loads(line[6:])


@pytest.mark.slow
def test_a_log_runs_at_the_pace_that_is_asked_for(
    view: Callable[..., str], log: Path
) -> None:
    url = view("--log", log, "-c", CAR, "--speed", "100", "--start", "cold")
    begin_s = time.monotonic()
    times = []
    for event in events(url):
        assert event["source"] == str(log)
        if event["record"]:
            times.append(event["record"]["time_s"])
            hottest = event["record"]["corners"]["FL"]
            if times[-1] - times[0] > 250.0:
                break
    # not before its time; later where the machine is slow
    assert time.monotonic() - begin_s > 2.0
    assert times == sorted(times)
    assert hottest["disc_c"] > 20.0
    assert hottest["validity"] in ("valid", "degraded")


@pytest.mark.slow
def test_a_log_at_a_hundred_times_in_the_browser(
    view: Callable[..., str], log: Path
) -> None:
    if CHROMIUM is None:
        pytest.skip("no chromium on PATH: the page is not shown")
    api = pytest.importorskip("playwright.sync_api")
    url = view("--log", log, "-c", CAR, "--speed", "100", "--start", "cold")
    with api.sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox"]
        )
        tab = browser.new_page()
        wrong: list[str] = []
        tab.on("console", lambda one: wrong.append(one.text))
        tab.on("pageerror", lambda one: wrong.append(str(one)))
        tab.goto(url)
        end_s = time.monotonic() + LIMIT_S
        # two curves of the whole drive, a point every two seconds
        while tab.evaluate("columns[0].length") < 125:
            assert time.monotonic() < end_s
            tab.wait_for_timeout(50)
        times = tab.evaluate("columns[0]")
        discs = tab.evaluate("columns[1]")
        browser.close()
    assert wrong == []
    steps = {b - a for a, b in itertools.pairwise(times)}
    assert steps == {2}, "no point is missing"
    assert max(discs) > 20.0


@pytest.mark.slow
def test_the_feed_of_a_configuration(
    view: Callable[..., str], tmp_path: Path
) -> None:
    text = CAR.read_text("utf-8").replace("../dbc/", f"{DBC.parent}/")
    car = tmp_path / "car.toml"
    car.write_text(
        text.replace('# socket = "/run/bstm/feed.sock"', 'socket = "f.sock"')
    )
    url = view("-c", car)
    first = next(events(url))
    assert first["source"] == str(tmp_path / "f.sock")
    assert first["record"] is None


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--log", "x.log"], 2, "-c FILE"),
        (["-c", str(CAR)], 2, "no [feed] socket"),
        (["--listen", "0.0.0.0:80"], 2, "--token"),
        (["--listen", "here"], 2, "ADDRESS:PORT"),
        (["--token", "missing"], 74, "missing"),
        (["--log", "x.log", "-c", str(CAR)], 74, "x.log"),
    ],
)
def test_mistakes(
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    words: str,
) -> None:
    if arguments[0] != "--listen":
        arguments = ["--listen", "127.0.0.1:0", *arguments]
    assert main(["view", *arguments]) == code
    assert words in capsys.readouterr().err


def test_a_token_is_long_and_a_secret(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "token"
    file.write_text("short\n")
    file.chmod(0o644)
    assert main(["view", "--token", str(file)]) == 2
    assert "chmod o=" in capsys.readouterr().err
    file.chmod(0o600)
    assert main(["view", "--token", str(file)]) == 2
    assert "16 characters" in capsys.readouterr().err
