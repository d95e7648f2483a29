"""What the board knows after which frames."""

from __future__ import annotations

from math import isnan
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.bus.output.e2e import protect
from bstm_daemon.bus.output.layout import data_id_list
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimate import HeatMode, RiskLevel, State, Validity
from bstm_daemon.watch.board import Board

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Sender

    MakeSender = Callable[..., Sender]


def test_it_begins_knowing_nothing(board: Board) -> None:
    assert board.corners == ()
    assert not board.has_frames
    assert board.state is State.NOT_AVAILABLE
    assert board.heat_mode is HeatMode.NOT_AVAILABLE
    assert board.risk("FL") is RiskLevel.UNKNOWN
    assert board.validity("BSTM_FL_Risk") is Validity.NOT_AVAILABLE
    assert isnan(board.value("BSTM_FL_Temperatures", "Disc"))
    assert board.silence_s("BSTM_Status", 10**9) is None
    assert board.wrong_layout is None


def test_a_second_of_frames(board: Board, sender: Sender) -> None:
    sender.status |= {"torque_stale": True, "input_suspect": True}
    now_us = sender.feed(board, 1.0, disc_c=412.5, fluid_c=120.0)

    assert board.corners == ("FL", "FR")
    assert board.value("BSTM_FL_Temperatures", "Disc") == 412.5
    assert board.value("BSTM_FR_Risk", "Margin") == pytest.approx(35.0)
    assert board.risk("FL") is RiskLevel.ELEVATED
    assert board.validity("BSTM_FL_Temperatures") is Validity.VALID
    assert board.state is State.RUNNING
    assert board.heat_mode is HeatMode.FB
    assert board.stale_inputs == ["torque"]
    assert board.is_set("InputSuspect")
    assert not board.is_set("HeatSubstituted")
    assert board.history("FL", "Disc").columns(now_us, 1) == [412.5]
    assert board.rejected == 0


def test_configured_corners_are_there_at_once() -> None:
    assert Board(0x5B0, ["RR", "FL"]).corners == ("FL", "RR")


def test_three_missing_cycles_are_silence(
    board: Board, sender: Sender
) -> None:
    last_us = sender.feed(board, 1.0)

    assert board.silence_s("BSTM_Status", last_us + 350_000) is None
    assert board.silence_s("BSTM_Status", last_us + 400_000) == 0.4
    assert board.silence_s("BSTM_FL_Risk", last_us + 400_000) is None


def test_frames_that_fail_the_check_change_nothing(
    board: Board, sender: Sender
) -> None:
    sender.feed(board, 1.0, disc_c=100.0)
    frames = sender.frames(disc_c=900.0, fluid_c=90.0)
    for frame in frames:
        board.frame(frame.can_id, frame.data[:-1] + b"\x55", 2_000_000)
        board.frame(frame.can_id, frame.data, 2_000_000, extended=True)
        board.frame(frame.can_id + 0x100, frame.data, 2_000_000)

    assert board.value("BSTM_FL_Temperatures", "Disc") == 100.0
    assert board.rejected == len(frames)


def test_a_repeated_frame_is_no_news(board: Board, sender: Sender) -> None:
    (frame, *_) = sender.frames(100.0, 50.0)
    board.frame(frame.can_id, frame.data, 0)
    board.frame(frame.can_id, frame.data, 10_000_000)

    assert board.silence_s(frame.name, 10_000_000) == 10.0
    assert board.rejected == 0


def test_codes_without_a_meaning_are_not_good_news(board: Board) -> None:
    bits = 7 << 12 | 9 << 56
    data = protect(bits.to_bytes(8, "little"), 0, data_id_list(0x08))
    board.frame(0x5B8, data, 0)

    assert board.validity("BSTM_FL_Risk") is Validity.INVALID
    assert board.risk("FL") is RiskLevel.UNKNOWN


def test_another_layout_is_noticed(board: Board, sender: Sender) -> None:
    sender.feed(board, 0.1)
    assert board.wrong_layout is None

    data = protect((9 << 16).to_bytes(8, "little"), 1, data_id_list(0))
    board.frame(0x5B0, data, 0)

    assert board.wrong_layout == 9


def test_a_drum_is_a_corner_without_values(
    make_sender: MakeSender, board: Board
) -> None:
    sender = make_sender(("FL", "RL"))
    sender.validity = Validity.NOT_AVAILABLE
    sender.feed(board, 1.0, disc_c=float("nan"), fluid_c=float("nan"))

    assert board.corners == ("FL", "RL")
    assert board.validity("BSTM_RL_Temperatures") is Validity.NOT_AVAILABLE
    assert isnan(board.history("RL", "Disc").columns(0, 1)[0])


def test_a_base_that_does_not_fit() -> None:
    with pytest.raises(ConfigError, match="id_base"):
        Board(0x7FF)
