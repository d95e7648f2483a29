"""The picture at the sizes that people have."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.screen import Screen

from bstm_daemon.bus.output.e2e import protect
from bstm_daemon.bus.output.layout import data_id_list
from bstm_daemon.estimate import Input, Reason, State, Validity
from bstm_daemon.watch.board import ASCII_BARS, Board
from bstm_daemon.watch.picture import picture

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Sender

    MakeSender = Callable[..., Sender]

ALL = ("FL", "FR", "RL", "RR")


@pytest.fixture
def car(make_sender: MakeSender, board: Board) -> tuple[Board, Sender]:
    """Return a board after 20 s of a car with four discs."""
    sender = make_sender(ALL)
    sender.feed(board, 10.0, disc_c=200.0, fluid_c=60.0)
    sender.feed(board, 10.0, disc_c=412.5, fluid_c=92.7)
    return board, sender


def screen(width: int, height: int) -> Console:
    """Return a console of a given size that keeps what it shows."""
    return Console(
        file=io.StringIO(),
        width=width,
        height=height,
        force_terminal=True,
        color_system=None,
    )


def drawn(
    board: Board,
    now_us: int = 19_900_000,
    width: int = 80,
    height: int = 24,
    source: str = "can0",
) -> list[str]:
    """Return the lines of the screen, without styles."""
    console = screen(width, height)
    lines = console.render_lines(
        Screen(picture(board, now_us, source, console)), pad=True
    )
    return ["".join(part.text for part in line) for line in lines]


def test_eighty_columns(car: tuple[Board, Sender]) -> None:
    lines = [line.rstrip() for line in drawn(car[0])]

    head = "bstm  can0  running  heat fb  history known  inputs fresh"
    assert lines[:2] == [f"{head}  oldest 0.1 s", "rejected 0  dropped 0"]
    rows = [line.split() for line in lines[2:14]]
    assert rows == [
        [*ALL],
        ["estimate", *["valid"] * 4],
        ["risk", *["normal", "62", "K"] * 4],
        ["disc", *["412.5"] * 4],
        ["\u2581", "412"] * 4,
        ["pad", "front", *["362.5"] * 4],
        ["\u2581", "362"] * 4,
        ["pad", "back", *["112.5"] * 4],
        ["\u2581", "112"] * 4,
        ["fluid", *["92.7"] * 4],
        ["\u2581", "93"] * 4,
        ["parked", *["-"] * 4],
    ]
    assert lines[-1].endswith("q leaves")


def test_a_narrow_screen_keeps_every_number(
    car: tuple[Board, Sender],
) -> None:
    words = " ".join(drawn(car[0], width=40)).split()

    assert words.count("412.5") == words.count("92.7") == 4
    assert words.count("62") == 4


def test_a_low_screen_keeps_the_corners(car: tuple[Board, Sender]) -> None:
    lines = drawn(car[0], height=10)

    assert lines[5].split() == ["disc", *["412.5"] * 4]
    assert lines[8].split() == ["fluid", *["92.7"] * 4]
    assert lines[9].endswith("q leaves")


@pytest.mark.slow
@given(width=st.integers(1, 200), height=st.integers(1, 60))
def test_fills_any_screen_exactly(
    make_sender: MakeSender, width: int, height: int
) -> None:
    for seconds in (0.0, 2.0):
        board = Board(0x5B0, ALL)
        make_sender(ALL).feed(board, seconds)

        lines = drawn(board, 0, width, height)

        assert len(lines) == height
        assert {len(line) for line in lines} == {width}


def test_only_the_corners_of_the_car(
    make_sender: MakeSender, board: Board
) -> None:
    make_sender(("RR", "FL")).feed(board, 1.0)

    assert ["FL", "RR"] in [line.split() for line in drawn(board, 0)]


def test_silence_is_said_and_hides_the_risk(
    car: tuple[Board, Sender],
) -> None:
    lines = drawn(car[0], 32_400_000)

    assert lines[0].startswith("bstm  can0  silent for 12 s")
    rows = {line.split()[0]: line.split()[1:] for line in lines[2:6]}
    assert rows["estimate"] == ["silent", "for", "12", "s"] * 4
    assert rows["risk"] == ["-"] * 4


def test_a_daemon_that_said_goodbye(car: tuple[Board, Sender]) -> None:
    board, sender = car
    sender.status["state"] = State.STOPPING
    now_us = sender.feed(board, 0.1)

    assert drawn(board, now_us)[0].startswith("bstm  can0  stopping")
    later = drawn(board, now_us + 9_000_000)[0]
    assert later.startswith("bstm  can0  stopped for 9 s")


@pytest.mark.parametrize(
    ("status", "text"),
    [
        ({"state": State.NO_INPUT}, "bstm  can0  no input"),
        ({"history_known": False}, "history unknown"),
        ({"compiled_kernel": False}, "Python kernel"),
        ({"clock_jump": True}, "clock jumped"),
        ({"input_suspect": True}, "inputs fresh  an input is suspect  oldest"),
        ({"heat_substituted": True}, "heat fb  heat substituted or unknown"),
        (
            {"speed_stale": True, "ambient_stale": True},
            "stale: speed, ambient",
        ),
        ({"oldest_input_age_s": 3.25}, "oldest 3.2 s"),
        ({"oldest_input_age_s": float("nan")}, "oldest - s"),
        ({"rejected_frames": 7, "dropped_frames": 9}, "rejected 7  dropped 9"),
    ],
)
def test_the_status_is_told(
    car: tuple[Board, Sender], status: dict[str, object], text: str
) -> None:
    board, sender = car
    sender.status.update(status)
    now_us = sender.feed(board, 0.1)

    assert text in drawn(board, now_us, width=160)[0]


def test_no_value(make_sender: MakeSender, board: Board) -> None:
    sender = make_sender(("FL",))
    sender.validity = Validity.NOT_AVAILABLE
    nothing = float("nan")
    now_us = sender.feed(board, 1.0, nothing, float("inf"))

    lines = [line.split() for line in drawn(board, now_us)]

    assert ["estimate", "no", "value"] in lines
    assert ["risk", "unknown", "error", "K"] in lines
    assert ["disc", "-"] in lines
    assert ["fluid", "error"] in lines


def test_no_frames_yet(board: Board) -> None:
    text = " ".join(" ".join(drawn(board)).split())

    assert "no frame yet with an id from 0x5B0 to 0x5C3" in text


def test_another_daemon_or_none_of_ours(board: Board) -> None:
    board.frame(0x5B0, bytes(8), 0)

    said = " ".join(drawn(board))
    assert "1 frames with these ids from another sender" in said


def test_another_layout_shows_no_values(car: tuple[Board, Sender]) -> None:
    board, _ = car
    counter = 200 % 16
    data = protect((9 << 16).to_bytes(8, "little"), counter, data_id_list(0))
    board.frame(0x5B0, data, 0)

    text = "\n".join(drawn(board))

    assert "frames of layout 9, this program reads layout 3" in text
    assert "disc" not in text


def test_bad_frames_are_counted(car: tuple[Board, Sender]) -> None:
    board, _ = car
    board.frame(0x5B0, bytes(8), 0)

    assert "bad frames here 1" in drawn(board)[1]


def test_a_file_name_moves_no_cursor(board: Board) -> None:
    line = drawn(board, source="a\x1b[2J\n.log")[0]

    assert line.startswith(r"bstm  a\x1b[2J\n.log ")


def test_a_long_reason_is_told_whole(board: Board) -> None:
    reason = "can0: " + " ".join(["no such device"] * 6)

    text = " ".join(" ".join(drawn(board, width=40, source=reason)).split())

    assert reason in text


@pytest.mark.slow
@given(width=st.integers(1, 120), height=st.integers(1, 40))
def test_ascii_is_kept_at_any_size(
    make_sender: MakeSender, width: int, height: int
) -> None:
    board = Board(0x5B0, ALL)
    make_sender(ALL).feed(board, 2.0)
    console = screen(width, height)

    console.print(picture(board, 0, "can0", console, ASCII_BARS))

    assert console.file.getvalue().isascii()


def test_styles_follow_risk_and_validity(car: tuple[Board, Sender]) -> None:
    board, sender = car
    sender.validity = Validity.DEGRADED
    now_us = sender.feed(board, 1.0, disc_c=600.0, fluid_c=160.0)

    console = screen(80, 24)
    spans = {
        part.text.strip(): str(part.style)
        for part in console.render(picture(board, now_us, "can0", console))
    }

    assert spans["critical"] == "bold white on red"
    assert spans["degraded"] == "yellow"
    assert spans["running"] == "green"
    assert spans["600.0"] == "bold"


def test_the_reasons_stand_below_the_validity(
    car: tuple[Board, Sender],
) -> None:
    """A line each, in the colour of the validity; the inputs in the head."""
    board, sender = car
    sender.validity = Validity.DEGRADED
    sender.reasons = Reason.UNVERIFIED | Reason.MODEL_DISAGREES
    sender.status["unverified"] = Input.PRESSURE
    now_us = sender.feed(board, 1.0)

    console = screen(80, 24)
    console.print(picture(board, now_us, "can0", console))
    assert isinstance(console.file, io.StringIO)
    lines = console.file.getvalue().splitlines()

    first = next(i for i, line in enumerate(lines) if "estimate" in line)
    assert lines[first].split() == ["estimate", *["degraded"] * 4]
    assert lines[first + 1].split() == ["unverified"] * 4
    assert lines[first + 2].split() == ["model", "disagrees"] * 4
    assert "unverified: pressure" in " ".join(lines[:3])


def test_what_is_invalid_is_not_drawn_as_valid(
    car: tuple[Board, Sender],
) -> None:
    board, sender = car
    sender.validity = Validity.INVALID
    now_us = sender.feed(board, 0.1, disc_c=600.0)

    console = screen(80, 24)
    spans = {
        part.text.strip(): str(part.style)
        for part in console.render(picture(board, now_us, "can0", console))
    }

    assert spans["invalid"] == "red"
    assert "bold" not in spans["600.0"]


def test_sound_inputs_and_own_heat_take_no_room(
    car: tuple[Board, Sender],
) -> None:
    head = " ".join(drawn(car[0])[:2])

    assert "suspect" not in head
    assert "substituted" not in head
