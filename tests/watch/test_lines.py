"""One line a second where there is no screen."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.estimate import Input, Reason, Validity
from bstm_daemon.watch.lines import LineView, number, text_line

if TYPE_CHECKING:
    from bstm_daemon.watch.board import Board

    from .conftest import Sender


def test_a_line_a_second(board: Board, sender: Sender) -> None:
    stream = io.StringIO()
    with LineView(stream) as shown:
        for _ in range(25):
            now_us = sender.feed(board, 0.1)
            shown.show(board, now_us, "can0")
        assert not shown.has_left

    times = [line.split()[0] for line in stream.getvalue().splitlines()]
    assert times == ["t_s=0.0", "t_s=1.0", "t_s=2.0"]


def test_the_line_has_everything(board: Board, sender: Sender) -> None:
    sender.status["pressure_stale"] = True
    sender.status["unverified"] = Input.TORQUE | Input.SPEED
    sender.validity = Validity.DEGRADED
    sender.reasons = Reason.START_UNKNOWN | Reason.INPUT_SUSPECT
    now_us = sender.feed(board, 1.0, disc_c=412.5, fluid_c=92.0)

    fields = dict(
        pair.split("=") for pair in text_line(board, now_us, "a b").split()
    )

    assert fields["t_s"] == "0.9"
    assert fields["source"] == "a_b"
    assert fields["state"] == "running"
    assert fields["heat"] == "fb"
    assert fields["stale"] == "pressure"
    assert (fields["inputs"], fields["heat_from"]) == ("sound", "own")
    assert fields["FL.disc_c"] == "412.5"
    assert fields["FR.pad_front_c"] == "362.5"
    assert fields["FR.pad_back_c"] == "112.0"
    assert fields["FR.fluid_c"] == "92.0"
    assert fields["FR.margin_k"] == "63.0"
    assert fields["FR.risk"] == "normal"
    assert fields["FR.validity"] == "degraded"
    assert fields["FR.reasons"] == "start_unknown,input_suspect"
    assert fields["unverified"] == "speed,torque"


def test_the_line_has_doubts(board: Board, sender: Sender) -> None:
    sender.status |= {"input_suspect": True, "heat_substituted": True}
    line = text_line(board, sender.feed(board, 1.0), "can0")

    assert " inputs=suspect heat_from=substitute unverified=- " in line
    assert line.endswith(" FR.validity=valid FR.reasons=-")


def test_nothing_yet_and_silence(board: Board, sender: Sender) -> None:
    assert text_line(board, 0, "can0") == "t_s=0.0 source=can0 state=none"

    sender.feed(board, 1.0)
    line = text_line(board, 60_000_000, "can0")

    assert " state=silent " in line
    assert "FL.validity=silent" in line


@pytest.mark.parametrize(
    ("value", "text"),
    [(1.25, "1.2"), (float("nan"), "-"), (float("inf"), "error")],
)
def test_number(value: float, text: str) -> None:
    assert number(value) == text
