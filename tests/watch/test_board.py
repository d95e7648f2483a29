"""What the board knows after which frames."""

from __future__ import annotations

from math import inf, isnan, nan
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.output.e2e import protect
from bstm_daemon.bus.output.layout import data_id_list
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimate import HeatMode, RiskLevel, State, Validity
from bstm_daemon.watch.board import (
    ASCII_BARS,
    BARS,
    HISTORY_S,
    Board,
    History,
    sparkline,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Sender

    MakeSender = Callable[..., Sender]

SECOND_US = 1_000_000


def filled(values: dict[int, float]) -> History:
    """Return a history with *values* by second."""
    history = History()
    for second, value in values.items():
        history.add(second * SECOND_US, value)
    return history


def test_the_last_column_ends_now() -> None:
    history = filled({0: 1.0, 299: 2.0})

    columns = history.columns(299 * SECOND_US, 5)

    assert columns[0] == 1.0
    assert columns[4] == 2.0
    assert all(isnan(value) for value in columns[1:4])


def test_a_column_is_the_largest_of_its_span() -> None:
    history = filled({second: float(second % 60) for second in range(300)})

    assert history.columns(299 * SECOND_US, 5) == [59.0] * 5


def test_a_second_keeps_its_largest() -> None:
    history = History()
    for value in (3.0, 9.0, 5.0):
        history.add(10, value)

    assert history.columns(10, 1) == [9.0]


def test_old_values_leave() -> None:
    history = filled({0: 900.0, 10: 5.0})

    assert history.columns(300 * SECOND_US, 1) == [5.0]
    assert isnan(history.columns(310 * SECOND_US, 1)[0])


def test_time_that_ran_back_begins_anew() -> None:
    history = filled({100: 900.0, 50: 5.0})

    assert history.columns(101 * SECOND_US, 1) == [5.0]


@pytest.mark.parametrize("value", [nan, inf])
def test_what_is_no_number_leaves_a_gap(value: float) -> None:
    history = filled({0: 7.0, 1: value, 2: 8.0})
    columns = history.columns(2 * SECOND_US, HISTORY_S)

    assert columns[-3] == 7.0
    assert isnan(columns[-2])


@given(
    values=st.dictionaries(
        st.integers(0, 1000), st.floats(-60, 2000), min_size=1
    ),
    count=st.integers(1, 400),
)
def test_no_peak_gets_lost(values: dict[int, float], count: int) -> None:
    ordered = dict(sorted(values.items()))
    now = max(ordered)
    recent = [v for t, v in ordered.items() if now - t < HISTORY_S]

    columns = filled(ordered).columns(now * SECOND_US, count)

    assert len(columns) == count
    assert max(v for v in columns if not isnan(v)) == max(recent)


def test_bars() -> None:
    assert sparkline([0.0, 50.0, nan, 100.0]) == "▁▅ █"
    assert sparkline([0.0, 50.0, nan, 100.0], ASCII_BARS) == "_= #".replace(
        "=", ASCII_BARS[4]
    )


def test_noise_is_not_blown_up() -> None:
    assert sparkline([20.0, 20.5, 21.0]) == "▁▁▁"


def test_nothing_is_blank() -> None:
    assert sparkline([nan] * 3) == "   "


@given(st.lists(st.floats(-400, 2000) | st.sampled_from([nan, inf, -inf])))
def test_any_values_have_a_bar_each(values: list[float]) -> None:
    line = sparkline(values)

    assert len(line) == len(values)
    assert set(line) <= {*BARS, " "}


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
