"""``bstm watch``: which bus it reads and how it ends."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import can.util
import pytest

from bstm_daemon.cli import watch
from bstm_daemon.cli.main import main

if TYPE_CHECKING:
    from bstm_daemon.bus.live.link import Link
    from bstm_daemon.watch.board import Board
    from bstm_daemon.watch.lines import LineView

CAR = Path(__file__).parents[2] / "config" / "example_vehicle.toml"


class Watched:
    """What was about to be watched."""

    link: Link
    board: Board


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    """Keep the command from watching, and no own python-can settings."""
    seen = Watched()

    def keep(link: Link, board: Board, view: LineView) -> None:
        seen.link, seen.board = link, board

    monkeypatch.setattr(watch, "watch_link", keep)
    monkeypatch.setattr(can.util, "load_file_config", dict)
    for name in ("INTERFACE", "CHANNEL", "CONFIG", "BITRATE"):
        monkeypatch.delenv(f"CAN_{name}", raising=False)
    return seen


def changed(tmp_path: Path, old: str, new: str) -> Path:
    """Return the example car with a change."""
    text = CAR.read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "car.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


def test_without_anything(watched: Watched) -> None:
    assert main(["watch"]) == 0

    assert type(watched.link).__name__ == "SocketcanLink"
    assert watched.link.channel == "can0"
    assert watched.board.ids[0] == 0x5B0
    assert watched.board.corners == ()


def test_of_a_configuration(watched: Watched) -> None:
    assert main(["watch", "-c", str(CAR)]) == 0

    assert watched.link.channel == "can0"
    assert watched.board.corners == ("FL", "FR", "RL", "RR")


def test_arguments_win(watched: Watched) -> None:
    arguments = ["-i", "virtual", "--channel", "x7", "--id-base", "0x100"]

    assert main(["watch", "-c", str(CAR), *arguments]) == 0

    assert type(watched.link).__name__ == "PortableLink"
    assert watched.link.channel == "x7"
    assert watched.board.ids[0] == 0x100


def test_own_configuration_of_python_can(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAN_INTERFACE", "virtual")
    monkeypatch.setenv("CAN_CHANNEL", "bench")

    assert main(["watch"]) == 0
    assert watched.link.channel == "bench"

    assert main(["watch", "--channel", "x8"]) == 0
    assert type(watched.link).__name__ == "PortableLink"
    assert watched.link.channel == "x8"


def test_control_c_is_a_way_to_leave(
    watched: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(link: Link, board: Board, view: LineView) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(watch, "watch_link", interrupt)

    assert main(["watch"]) == 0


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--id-base", "0x7F0"], 2, "0x0 to 0x7EC"),
        (["--id-base", "five"], 2, "--id-base"),
        (["-b", "0"], 2, "--bitrate"),
        (["--channel", ""], 2, "--channel"),
        (["--channel", "a name too long for it"], 78, "no name of an inter"),
        (["-c", "gone.toml"], 74, "gone.toml"),
    ],
)
def test_mistakes(
    watched: Watched,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    words: str,
) -> None:
    assert main(["watch", *arguments]) == code
    assert words in capsys.readouterr().err


def test_nonsense_interface(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "-i", "nonsense"]) == 78
    assert "nonsense" in capsys.readouterr().err
