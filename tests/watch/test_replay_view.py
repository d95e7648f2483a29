"""The view of a log: the frames that the engine publishes over it."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.errors import FileAccessError, LogError
from bstm_daemon.replay.frames import (
    publications,
    write_frames,
)
from bstm_daemon.simulation import parse_drive, simulate
from bstm_daemon.simulation.recorder import Encoder, write_candump
from bstm_daemon.watch import replay_view
from bstm_daemon.watch.board import Board
from bstm_daemon.watch.lines import LineView, text_line
from bstm_daemon.watch.replay_view import DEFAULT_SPEED, watch_log

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Terminal

ROOT = Path(__file__).parents[2]
CAR = ROOT / "config" / "example_vehicle.toml"
CONFIG, SIGNAL_MAP = load_vehicle(CAR)

DRIVE = """
[drive]
name = "stop"
description = "one stop"
ambient_c = 10.0
[[segment]]
speed_kmh = 80.0
rate_ms2 = 4.0
gear = 3
[[segment]]
speed_kmh = 0.0
rate_ms2 = 5.0
[[segment]]
parked = true
duration_s = 4.0
"""

SHOW = """
import sys
from pathlib import Path
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.replay.frames import publications
from bstm_daemon.watch.board import Board
from bstm_daemon.watch.replay_view import watch_log
from bstm_daemon.watch.view import open_view
config, signal_map = load_vehicle(Path(sys.argv[1]))
ticks = publications(config, signal_map, Path(sys.argv[2]))
board = Board(config.publish.id_base)
watch_log(ticks, board, "stop.log", open_view(sys.stdout), 0.0)
"""


def show(path: Path, view: LineView, speed: float = DEFAULT_SPEED) -> None:
    """Show what the engine publishes over the log *path*."""
    board = Board(CONFIG.publish.id_base)
    ticks = publications(CONFIG, SIGNAL_MAP, path)
    watch_log(ticks, board, path.name, view, speed)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a drive of 14 s."""
    path = tmp_path_factory.mktemp("watch") / "stop.log"
    encoder = Encoder(ROOT / "dbc" / "example_vehicle.dbc")
    write_candump(path, simulate(parse_drive(DRIVE, "stop")), encoder)
    return path


class Paced(LineView):
    """Lines, and the pauses in between."""

    def __init__(self, leave_after: int = 10**9) -> None:
        """Leave after that many pauses."""
        self.stream = io.StringIO()
        super().__init__(self.stream)
        self.pauses_s: list[float] = []
        self._leave_after = leave_after

    @property
    def has_left(self) -> bool:
        """Whether there were enough pauses."""
        return len(self.pauses_s) >= self._leave_after

    def pause(self, seconds: float) -> None:
        """Note the pause, do not wait."""
        self.pauses_s.append(seconds)
        CLOCK.now_s += seconds


class Clock:
    """A clock that only pauses move [s]."""

    now_s = 50.0

    def monotonic(self) -> float:
        """Return the time."""
        return self.now_s


CLOCK = Clock()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Let the pace run on our clock."""
    monkeypatch.setattr(replay_view, "time", CLOCK)
    return CLOCK


def pairs(line: str) -> dict[str, str]:
    """Return the fields of a line."""
    return dict(pair.split("=", 1) for pair in line.split())


def test_it_shows_what_would_have_been_published(
    log: Path, tmp_path: Path
) -> None:
    view = Paced()
    show(log, view, 0.0)

    board = Board(CONFIG.publish.id_base)
    out = tmp_path / "out.log"
    ticks = publications(CONFIG, SIGNAL_MAP, log)
    channel = CONFIG.bus[CONFIG.publishing_bus].channel
    write_frames(ticks, channel, out)
    for line in out.read_text().splitlines():
        stamp, _, frame = line.split()
        now_us = round(float(stamp.strip("()")) * 1e6)
        can_id, _, data = frame.partition("#")
        board.frame(int(can_id, 16), bytes.fromhex(data), now_us)
    last = view.stream.getvalue().splitlines()[-1]
    expected = pairs(text_line(board, now_us, "-"))
    shown = pairs(last)
    assert shown.pop("source") == "stop.log__0:13__full_speed__end"
    expected.pop("source")
    assert shown == expected
    assert float(shown["FL.disc_c"]) > 30.0
    assert view.pauses_s == []


def test_speed_is_that_of_the_log(log: Path, clock: Clock) -> None:
    view, begin_s = Paced(), clock.now_s

    show(log, view, 60.0)

    lines = view.stream.getvalue().splitlines()
    seconds = float(pairs(lines[-1])["t_s"]) - float(pairs(lines[0])["t_s"])
    assert clock.now_s - begin_s == pytest.approx(
        seconds / 60.0, abs=0.2 / 60.0
    )
    assert "60x" in lines[3]


def test_leaving_ends_it(log: Path, clock: Clock) -> None:
    view = Paced(leave_after=20)

    show(log, view, 1.0)

    assert len(view.stream.getvalue().splitlines()) <= 4
    assert "end" not in view.stream.getvalue()


def test_a_jump_of_the_log_is_not_waited_for(clock: Clock) -> None:
    view = Paced()
    pace = replay_view.Pace(2.0, view.pause)
    stamps_us = [0, 100_000, 3_600_000_000, 3_600_100_000, 50_000, 150_000]

    for time_us in stamps_us:
        pace.wait(time_us)

    assert view.pauses_s == pytest.approx([0.0, 0.05, 1.0, 0.05, 0.0, 0.05])


def test_what_took_too_long_is_not_made_up_for(clock: Clock) -> None:
    view = Paced()
    pace = replay_view.Pace(1.0, view.pause)

    pace.wait(0)
    clock.now_s += 30.0
    pace.wait(100_000)
    pace.wait(200_000)

    assert view.pauses_s == pytest.approx([0.0, 0.0, 0.1])


@pytest.mark.parametrize(
    "width",
    [60, *(pytest.param(w, marks=pytest.mark.slow) for w in (80, 120))],
)
def test_on_a_terminal(
    log: Path, terminal: Callable[..., Terminal], width: int
) -> None:
    started = terminal(width, 24, SHOW, CAR, log)
    started.until("speed  end")
    started.press(b"q")
    ended = started.ended()
    lines = started.lines

    assert ended == 0
    assert ["FL", "FR", "RL", "RR"] in [line.split() for line in lines]
    assert any(line.count("critical") == 4 for line in lines)
    assert any("\u2581" in line for line in lines)
    assert lines[-1].endswith("q leaves")
    assert max(map(len, lines)) == width


@pytest.mark.parametrize(
    ("name", "text", "error", "words"),
    [
        ("empty.log", "", LogError, "empty.log"),
        ("table.csv", "time,speed\n0,1\n", LogError, "table.csv"),
        ("noise.log", "hello\n", LogError, "noise.log"),
        ("gone.log", None, FileAccessError, "gone.log"),
    ],
)
def test_a_log_that_cannot_be_shown(
    tmp_path: Path,
    name: str,
    text: str | None,
    error: type[Exception],
    words: str,
) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    view = Paced()

    with pytest.raises(error, match=words):
        show(path, view)

    assert view.stream.getvalue() == ""
