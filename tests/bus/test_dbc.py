"""DBC files: what is wrong is said with file, message and signals."""

from pathlib import Path
from typing import Any

import cantools
import pytest

from bstm_daemon.bus.dbc import (
    UnusableSignalError,
    load_dbc,
    multiplexers,
    raw_signal,
)
from bstm_daemon.errors import ConfigError

HEAD = 'VERSION ""\nBU_: X\n'
OVERLAP = (
    HEAD
    + "BO_ 100 ONE: 8 X\n"
    + ' SG_ a : 0|16@1+ (1,0) [0|0] "" X\n'
    + ' SG_ b : 8|16@1+ (1,0) [0|0] "" X\n'
    + "BO_ 101 TWO: 1 X\n"
    + ' SG_ c : 0|16@1+ (1,0) [0|0] "" X\n'
    + "BO_ 102 FINE: 1 X\n"
    + ' SG_ d : 0|8@1+ (1,0) [0|0] "" X\n'
)


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    return tmp_path / "car.dbc"


def problems_of(path: Path, **options: Any) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load_dbc(path, **{"strict": True, "encoding": "cp1252", **options})
    return caught.value.problems


def test_strict_lists_every_message_at_fault(dbc: Path) -> None:
    dbc.write_text(OVERLAP)

    first, second = problems_of(dbc)

    assert str(dbc) in first
    assert "message 'ONE'" in first
    assert "signals b and a are overlapping" in first
    assert "strict = false" in first
    assert "message 'TWO'" in second
    assert "c does not fit" in second


def test_lenient_loads_the_same_file(dbc: Path) -> None:
    dbc.write_text(OVERLAP)

    database = load_dbc(dbc, strict=False, encoding="cp1252")

    assert [message.name for message in database.messages] == [
        "ONE",
        "TWO",
        "FINE",
    ]


@pytest.mark.parametrize("strict", [True, False])
def test_a_syntax_error_has_line_and_column(
    dbc: Path, *, strict: bool
) -> None:
    dbc.write_text(HEAD + "BO_ 100 ONE: 8 X\n SG_ a : 0|16@1+ (1,0 [0|0]\n")

    (problem,) = problems_of(dbc, strict=strict)

    assert str(dbc) in problem
    assert "line 4, column 23" in problem


def test_a_missing_file_is_a_problem(dbc: Path) -> None:
    assert problems_of(dbc) == [
        f"{dbc}: cannot be read: No such file or directory"
    ]


def test_an_unknown_encoding_is_a_problem(dbc: Path) -> None:
    dbc.write_text(HEAD)

    (problem,) = problems_of(dbc, encoding="utf-9")

    assert "encoding = 'utf-9'" in problem


def test_the_encoding_is_used(dbc: Path) -> None:
    text = HEAD + 'BO_ 1 A: 8 X\n SG_ t : 0|8@1+ (1,0) [0|0] "°C" X\n'
    dbc.write_text(text, encoding="utf-8")

    database = load_dbc(dbc, strict=True, encoding="utf-8")

    assert database.messages[0].signals[0].unit == "°C"


def signal_text(layout: str, conversion: str = "(1,0)", size: int = 8) -> str:
    return (
        f"{HEAD}BO_ 100 A: {size} X\n"
        f' SG_ s : {layout} {conversion} [0|0] "" X\n'
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (signal_text("60|8@1+"), "ends at bit 68 of message 'A'"),
        (signal_text("56|9@0+"), "which has 64 bits"),
        (signal_text("0|65@1+", size=16), "has 65 bits"),
        (signal_text("0|24@1+") + "SIG_VALTYPE_ 100 s : 1;\n", "of 24 bits"),
        (signal_text("0|8@1+", "(0,5)"), "scale 0 and offset 5"),
        (signal_text("0|64@1+", "(1e300,0)"), "no usable value"),
    ],
)
def test_what_gives_no_value_is_refused(text: str, reason: str) -> None:
    database = cantools.database.load_string(text, "dbc", strict=False)

    with pytest.raises(UnusableSignalError, match=reason):
        raw_signal(database.messages[0], "s")


def test_multiplexers_are_followed_to_the_root() -> None:
    text = (
        HEAD
        + "BO_ 100 A: 8 X\n"
        + ' SG_ top M : 0|4@1+ (1,0) [0|0] "" X\n'
        + ' SG_ middle m1M : 4|4@1+ (1,0) [0|0] "" X\n'
        + ' SG_ leaf m3 : 8|8@1+ (1,0) [0|0] "" X\n'
        + "SG_MUL_VAL_ 100 middle top 1-1;\n"
        + "SG_MUL_VAL_ 100 leaf middle 3-4;\n"
    )
    message = cantools.database.load_string(text, "dbc").messages[0]

    assert multiplexers(message, "top") == []
    assert multiplexers(message, "leaf") == [
        ("middle", frozenset({3, 4})),
        ("top", frozenset({1})),
    ]
