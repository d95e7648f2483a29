"""The progress line: on a terminal only, and gone at the end."""

import io
from pathlib import Path

import pytest

from bstm_daemon.cli.main import main
from bstm_daemon.cli.progress import Progress

from .. import ford_like  # noqa: TID252  (tests are no package)


class Terminal(io.StringIO):
    """A text stream that says it is a terminal."""

    def isatty(self) -> bool:
        """Say so."""
        return True


def test_nothing_where_no_terminal_is() -> None:
    """A log file or a pipe gets no progress."""
    stream = io.StringIO()

    with Progress("replay", stream) as progress:
        progress.show(0.5)

    assert stream.getvalue() == ""


def test_terminal_sees_label_and_share() -> None:
    """The line is drawn in place and erased at the end."""
    stream = Terminal()

    with Progress("replay", stream) as progress:
        progress.show(0.42)
        drawn = stream.getvalue()

    assert drawn == "\r\x1b[Kreplay   0%\r\x1b[Kreplay  42%"
    assert stream.getvalue() == drawn + "\r\x1b[K"


def test_a_part_of_the_work_is_its_share_of_the_line() -> None:
    stream = Terminal()

    with Progress("heat", stream) as progress:
        progress.part(0.2, 0.6)(0.5)

    assert "heat  40%" in stream.getvalue()


def test_redraws_are_rare() -> None:
    """Many calls in a row draw once, beside the line at the begin."""
    stream = Terminal()

    with Progress("replay", stream) as progress:
        for _ in range(100):
            progress.show(0.1)

    assert stream.getvalue().count("replay") == 2


def test_line_is_erased_after_a_failure() -> None:
    """An error message starts on a clean line."""
    stream = Terminal()

    def fail() -> None:
        with Progress("replay", stream) as progress:
            progress.show(0.1)
            raise KeyError

    with pytest.raises(KeyError):
        fail()

    assert stream.getvalue().endswith("\r\x1b[K")


@pytest.mark.parametrize("by_frames", [True, False])
def test_init_tells_how_far_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, by_frames: bool
) -> None:
    """Frames are read twice, a table once."""
    shares: list[float] = []
    monkeypatch.setattr(
        Progress, "show", lambda _, share, *__: shares.append(share)
    )
    words = ["--log", str(tmp_path / "drive.csv")]
    if by_frames:
        dbc = ford_like.write_dbc(tmp_path / "car.dbc")
        log = ford_like.write_log(tmp_path / "drive.log")
        words = ["--dbc", str(dbc), "--log", str(log)]
    else:
        rows = "".join(f"{0.1 * i:.1f},{i % 90}\n" for i in range(500))
        (tmp_path / "drive.csv").write_text(f"Time [s],Speed [km/h]\n{rows}")

    assert main(["init", *words, "-o", str(tmp_path / "car.toml")]) == 0

    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    assert any(0.3 < share < 0.7 for share in shares) == by_frames
