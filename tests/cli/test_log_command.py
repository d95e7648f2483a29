"""What the commands over recorded drives share."""

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path

import pytest

from bstm_daemon.cli.log_command import LogCommand, add_log_arguments
from bstm_daemon.errors import UsageError
from bstm_daemon.report.shell import Page

CAR = Path(__file__).parents[2] / "config" / "example_vehicle.toml"


def parsed(*arguments: str, new_config: bool = False) -> Namespace:
    parser = ArgumentParser()
    add_log_arguments(parser, new_config=new_config)
    return parser.parse_args([*arguments, "-c", str(CAR)])


def test_a_target_that_would_overwrite_a_log(tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    args = parsed(str(log), "--json", str(log))

    with pytest.raises(UsageError, match="would overwrite"):
        LogCommand.opened(args)


def test_a_configuration_that_exists_wants_force(tmp_path: Path) -> None:
    new = tmp_path / "new.toml"
    new.write_text("", "utf-8")
    args = parsed("a/b.log", "c.log", "-o", str(new), new_config=True)

    with pytest.raises(UsageError, match="--force"):
        LogCommand.opened(args)
    args.force = True
    command = LogCommand.opened(args)

    assert command.heading(command.names) == (
        f"b.log, c.log  ({command.config.vehicle.id}, {CAR})"
    )
    assert command.signal_map.buses


def test_only_what_was_asked_for_is_made_and_written(tmp_path: Path) -> None:
    out, page = tmp_path / "result.json", tmp_path / "page.html"
    asked = []

    def pages(subtitle: str) -> Page:
        asked.append(subtitle)
        return Page("Title", [], subtitle=subtitle)

    args = parsed("drive.log", "--json", str(out))
    command = LogCommand.opened(args)
    assert command.written(lambda: {"a": 1}, pages) == []
    assert json.loads(out.read_text("utf-8")) == {"a": 1}
    assert asked == []

    args = parsed("drive.log", "--report", str(page))
    assert LogCommand.opened(args).written(dict, pages) == [str(page)]
    subtitle = f"drive.log · {command.config.vehicle.id} · {CAR.name}"
    assert asked == [subtitle]
    assert subtitle in page.read_text("utf-8")
