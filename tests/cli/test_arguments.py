"""Arguments that commands share."""

from argparse import ArgumentParser
from pathlib import Path

import pytest

from bstm_daemon.cli import arguments
from bstm_daemon.errors import FileAccessError, UsageError


def test_paths() -> None:
    """Files arrive as paths under the contract's names."""
    parser = ArgumentParser()
    arguments.add_out(parser, "folder of results", "DIR")
    arguments.shared(parser, "config", "json", "report")

    short = parser.parse_args(["-c", "a.toml", "-o", "out"])
    long = parser.parse_args(
        ["--config", "a.toml", "--json", "r.json", "--report", "r.html"]
    )

    assert (short.config, short.out) == (Path("a.toml"), Path("out"))
    assert (short.json, short.report) == (None, None)
    assert (long.json, long.report) == (Path("r.json"), Path("r.html"))


def test_a_usage_is_an_argument() -> None:
    parser = ArgumentParser()
    arguments.option(parser, "logs LOG...", "drives", Path)
    arguments.option(parser, "-n --count N", "how often", int, default=3)
    arguments.option(parser, "--also LOG...", "more drives")
    arguments.option(parser, "--deep", "dig")

    plain = parser.parse_args(["a", "b"])
    full = parser.parse_args(["a", "-n", "2", "--also", "x", "y", "--deep"])

    assert vars(plain) == {
        "logs": [Path("a"), Path("b")],
        "count": 3,
        "also": [],
        "deep": False,
    }
    assert (full.count, full.also, full.deep) == (2, ["x", "y"], True)
    assert "[--also LOG [LOG ...]]" in parser.format_usage()


def test_config_is_required() -> None:
    """A command without a configuration ends with the usage."""
    parser = ArgumentParser()
    arguments.shared(parser, "config")

    with pytest.raises(SystemExit):
        parser.parse_args([])


def test_bus_map() -> None:
    """Each --map is one pair, in order."""
    parser = ArgumentParser()
    arguments.shared(parser, "map")

    args = parser.parse_args(["--map", "can0=chassis", "--map", "vcan1=body"])

    assert args.map == [("can0", "chassis"), ("vcan1", "body")]
    assert parser.parse_args([]).map == []
    assert parser.parse_args(["--map", "can1="]).map == [("can1", "")]


@pytest.mark.parametrize("text", ["can0", "=chassis", ""])
def test_bad_bus_map(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    """A pair that is none is shown with an example."""
    parser = ArgumentParser()
    arguments.shared(parser, "map")

    with pytest.raises(SystemExit):
        parser.parse_args(["--map", text])

    assert "such as can0=chassis" in capsys.readouterr().err


def test_results_that_would_take_the_place_of_what_is_read(
    tmp_path: Path,
) -> None:
    """Also by another way to the same file."""
    log = tmp_path / "drive.log"
    log.write_text("", "utf-8")
    (tmp_path / "link.log").symlink_to(log)
    for target in (log, tmp_path / "." / "drive.log", tmp_path / "link.log"):
        with pytest.raises(UsageError, match="would overwrite"):
            arguments.check_targets((None, target), (log, None))
    new = tmp_path / "new.json"
    with pytest.raises(UsageError, match="would overwrite"):
        arguments.check_targets((new, new), ())

    arguments.check_targets((new, None), (log,))


def test_results_that_can_not_be_written_are_told_before_the_work(
    tmp_path: Path,
) -> None:
    with pytest.raises(FileAccessError, match="No such file"):
        arguments.check_targets((tmp_path / "no" / "x.json",), ())


def test_a_file_that_exists_wants_force(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--force"):
        arguments.check_new(tmp_path, force=False)

    arguments.check_new(tmp_path, force=True)
    arguments.check_new(tmp_path / "new.toml", force=False)
    arguments.check_new(None, force=False)
