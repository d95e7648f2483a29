"""Names that would command a terminal are shown as what they are."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.cli.main import main
from bstm_daemon.watch.terminal_text import (
    raw_stream,
    visible,
    visible_stream,
)

if TYPE_CHECKING:
    from collections.abc import Callable

CAR = Path(__file__).parents[2] / "config" / "example_vehicle.toml"
TITLE = "\x1b]0;owned\x07"
HOSTILE = f"\x1b[2J{TITLE}\x9b31m\u202egnp\u2066"
SHOWN = r"\x1b[2J\x1b]0;owned\x07\x9b31m\u202egnp\u2066"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        (HOSTILE, SHOWN),
        ("Bremse \u00b0C \u2264 \u4e2d", "Bremse \u00b0C \u2264 \u4e2d"),
        ("two\n\tlines", r"two\n\tlines"),
        ("over\rwritten\x08\x7f", r"over\rwritten\x08\x7f"),
        ("caf\udce9.log", r"caf\udce9.log"),
        ("a\u200bb\u2028c\ufeff", r"a\u200bb\u2028c\ufeff"),
        ("\U000e0041", r"\U000e0041"),
        ("", ""),
    ],
)
def test_what_commands_a_terminal_is_escaped(text: str, shown: str) -> None:
    assert visible(text) == shown


@given(st.text(st.characters(exclude_categories=())))
def test_nothing_that_is_not_printable_is_left(text: str) -> None:
    shown = visible(text)

    assert shown.isprintable()
    assert visible(shown) == shown
    shown.encode("utf-8")


def test_a_stream_writes_what_is_visible_and_is_itself_otherwise() -> None:
    below = io.StringIO()
    stream = visible_stream(below)

    print(HOSTILE, "end\there", file=stream)

    assert below.getvalue() == f"{SHOWN} end\there\n"
    assert not stream.isatty()
    assert raw_stream(stream) is below
    assert raw_stream(below) is below


def hostile_config(folder: Path) -> Path:
    """Write a configuration with a bad key of a hostile name."""
    text = CAR.read_text("utf-8")
    name = HOSTILE.encode("unicode_escape").decode().replace(r"\x", r"\u00")
    changed = text.replace("mass_kg = ", f'"{name}" = ', 1)
    path = folder / "car.toml"
    path.write_text(changed, "utf-8")
    return path


def absent_log(folder: Path) -> list[str]:
    return ["replay", "-c", str(CAR), str(folder / f"{HOSTILE}.log")]


@pytest.mark.parametrize(
    "arguments",
    [
        lambda folder: ["check", str(hostile_config(folder))],
        lambda folder: ["run", "-c", str(hostile_config(folder))],
        lambda folder: ["watch", "-c", str(folder / HOSTILE)],
        absent_log,
        lambda _: ["check", f"--{HOSTILE}"],
    ],
    ids=["check", "run", "watch", "replay", "argument"],
)
def test_a_command_shows_hostile_names_escaped(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: Callable[[Path], list[str]],
) -> None:
    code = main(arguments(tmp_path))

    out, err = capsys.readouterr()
    assert code != 0
    assert r"\x1b" in err
    assert r"\u202e" in err
    assert all(c.isprintable() or c in "\n\t" for c in out + err)


def test_the_log_on_a_terminal_shows_hostile_names_escaped(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import structlog  # noqa: PLC0415

    from bstm_daemon.cli import main as module  # noqa: PLC0415

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("NO_COLOR", "1")
    before = structlog.get_config()
    try:
        module._set_up_log(1)
        structlog.get_logger().warning(
            "bus_missing", channel=TITLE, problems=[TITLE, 1]
        )
    finally:
        structlog.configure(**before)

    line = terminal.getvalue()
    assert line.count("owned") == 2
    assert all(c.isprintable() or c == "\n" for c in line)
    assert capsys.readouterr().out == ""
