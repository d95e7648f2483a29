"""Columns and wrapped lines of a result."""

from __future__ import annotations

import pytest

from bstm_daemon.report.text import (
    WIDTH,
    Columns,
    columns,
    number,
    percent,
    table,
    wrapped,
)

ROWS = [("corner", "disc"), ("FL", "7"), ("RL", "412")]


def test_columns_are_aligned() -> None:
    assert columns(ROWS) == ["corner  disc", "FL         7", "RL       412"]
    assert table(*ROWS[:1], ROWS[1:]) == [
        "corner  disc",
        "FL      7",
        "RL      412",
    ]


def test_a_wide_table_has_narrow_gaps() -> None:
    (line,) = columns([("x" * 49, "y" * 50)])

    assert line == f"{'x' * 49} {'y' * 50}"
    assert len(line) == WIDTH


def test_lines_are_broken_at_the_width() -> None:
    first, second = wrapped(["word " * 24], mark="* ", indent="    ")

    assert first == "* " + "word " * 18 + "word"
    assert second == "    " + "word " * 4 + "word"


@pytest.mark.parametrize(
    ("value", "text"), [(1234.56, "1235"), (float("nan"), "-")]
)
def test_number(value: float, text: str) -> None:
    assert number(value) == text


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (0.0, "0 %"),
        (1.0, "100 %"),
        (0.978, "97.8 %"),
        (0.5, "50 %"),
        (1e-6, "< 0.1 %"),
        (1 - 1e-6, "> 99.9 %"),
    ],
)
def test_percent_hides_no_rest(share: float, text: str) -> None:
    assert percent(share) == text


def test_a_table_is_data() -> None:
    """Heading and text of a column stand together; one counts."""
    named: Columns[str] = Columns(("no", None), ("name", str.upper))

    assert named.head == ("no", "name")
    assert named.rows(["a", "bc"]) == [("1", "A"), ("2", "BC")]
    assert named.lines(["a", "bc"]) == ["no  name", "1      A", "2     BC"]
