"""The picture at the sizes that people have."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.e2e import protect
from bstm_daemon.bus.output_layout import State, Validity, data_id_list
from bstm_daemon.watch.board import Board
from bstm_daemon.watch.history import ASCII_BARS
from bstm_daemon.watch.picture import number, picture
from bstm_daemon.watch.styled import painted

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


def drawn(
    board: Board,
    now_us: int = 19_900_000,
    width: int = 80,
    height: int = 24,
    source: str = "can0",
) -> list[str]:
    """Return the picture without styles."""
    return [
        painted(line, use_color=False)
        for line in picture(board, now_us, source, width, height)
    ]


def test_eighty_columns(car: tuple[Board, Sender]) -> None:
    lines = drawn(car[0])

    assert lines[:5] == [
        f"{'bstm  running  heat fb  history known':76}can0",
        "inputs fresh  oldest 0.1 s  rejected 0  dropped 0".ljust(80),
        " " * 80,
        *(
            f"{left:39}  {left.replace('FL', 'FR'):39}"
            for left in (
                "FL valid  risk normal  margin 62 K",
                "disc       412.5               ▁   412",
            )
        ),
    ]
    assert lines[8] == f"{'parked         -':39}  {'parked         -':39}"
    assert lines[10].startswith("RL valid  risk normal  margin 62 K ")
    assert lines[-1].endswith("q leaves")


def test_sixty_columns_and_few_lines(car: tuple[Board, Sender]) -> None:
    lines = drawn(car[0], width=60)

    assert lines[2] == " " * 60
    assert [line[:3] for line in lines[3:23:5]] == [f"{n} " for n in ALL]
    assert lines[22].startswith("fluid")


def test_a_low_screen_keeps_the_corners(car: tuple[Board, Sender]) -> None:
    lines = drawn(car[0], width=60, height=6)

    assert lines[1:5] == [
        f"{name} normal 62 K disc 412 pad 362/112 fluid 93 valid".ljust(60)
        for name in ALL
    ]


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


def test_three_corners_stand_where_they_are_on_the_car(
    make_sender: MakeSender, board: Board
) -> None:
    make_sender(("FL", "FR", "RR")).feed(board, 1.0)

    rear = next(line for line in drawn(board, 0) if "RR" in line)

    assert rear.startswith(" " * 41 + "RR")


def test_silence_is_said_and_hides_the_risk(
    car: tuple[Board, Sender],
) -> None:
    lines = drawn(car[0], 32_400_000)

    assert lines[0].startswith("bstm  silent for 12 s")
    assert lines[3].startswith("FL silent for 12 s   ")


def test_a_daemon_that_said_goodbye(car: tuple[Board, Sender]) -> None:
    board, sender = car
    sender.status["state"] = State.STOPPING
    now_us = sender.feed(board, 0.1)

    assert drawn(board, now_us)[0].startswith("bstm  stopping")
    later = drawn(board, now_us + 9_000_000)[0]
    assert later.startswith("bstm  stopped since 9 s")


@pytest.mark.parametrize(
    ("status", "text"),
    [
        ({"state": State.NO_INPUT}, "bstm  no input"),
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

    assert text in " ".join(drawn(board, now_us)[:2])


def test_no_value(make_sender: MakeSender, board: Board) -> None:
    sender = make_sender(("FL",))
    sender.validity = Validity.NOT_AVAILABLE
    nothing = float("nan")
    now_us = sender.feed(board, 1.0, nothing, float("inf"))

    lines = [line.rstrip() for line in drawn(board, now_us)]

    assert "FL no value  risk unknown  margin error K" in lines
    assert "disc           -" in lines
    assert "fluid      error" in lines


def test_no_frames_yet(board: Board) -> None:
    text = " ".join(" ".join(drawn(board)).split())

    assert "no frame yet with an id from 0x5B0 to 0x5C3" in text


def test_another_daemon_or_none_of_ours(board: Board) -> None:
    board.frame(0x5B0, bytes(8), 0)

    assert "1 frames with our ids, none of them ours" in " ".join(drawn(board))


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

    assert line.endswith("a?[2J?.log")


def test_a_long_reason_is_told_whole(board: Board) -> None:
    reason = "can0: " + " ".join(["no such device"] * 6)

    text = " ".join(" ".join(drawn(board, width=40, source=reason)).split())

    assert reason in text


def test_ascii(car: tuple[Board, Sender]) -> None:
    board, _ = car
    lines = picture(board, 19_900_000, "can0", 80, 24, ASCII_BARS)

    text = "".join(painted(line, use_color=True) for line in lines)

    assert text.isascii()


def test_styles_follow_risk_and_validity(car: tuple[Board, Sender]) -> None:
    board, sender = car
    sender.validity = Validity.DEGRADED
    now_us = sender.feed(board, 1.0, disc_c=600.0, fluid_c=160.0)

    spans = {
        span.text: span.style
        for line in picture(board, now_us, "can0", 80, 24)
        for span in line
    }

    assert spans["critical"] == "alarm"
    assert spans["degraded"] == "warning"
    assert spans["running"] == "good"
    assert spans[" 600.0 "] == "strong"


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.25, "1.2"), (float("nan"), "-"), (float("inf"), "error")],
)
def test_number(value: float, text: str) -> None:
    assert number(value) == text


def test_sound_inputs_and_own_heat_take_no_room(
    car: tuple[Board, Sender],
) -> None:
    head = " ".join(drawn(car[0])[:2])

    assert "suspect" not in head
    assert "substituted" not in head
