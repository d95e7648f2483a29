"""Arguments and results shared by the commands over recorded drives."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.cli import arguments
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.config.sections import Config
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.shell import Page, write_figures, write_page

T = TypeVar("T")


def add_log_arguments(
    parser: argparse.ArgumentParser,
    what: str = "recorded drive",
    *,
    nargs: str = "+",
    new_config: bool = False,
) -> None:
    """Declare the logs, the vehicle and where results go.

    With *new_config* also ``-o NEW.toml`` and ``--force``.
    """
    arguments.option(parser, "logs LOG...", what, Path, nargs=nargs)
    arguments.shared(parser, "config")
    if new_config:
        arguments.add_new_config(parser)
    arguments.shared(parser, "json", "report", "figures", "map")


@dataclass(frozen=True, slots=True)
class LogCommand:
    """A command at work on recorded drives: its arguments and their car."""

    args: argparse.Namespace
    config: Config
    signal_map: SignalMap

    @classmethod
    def opened(cls, args: argparse.Namespace, *further: Path) -> LogCommand:
        """Refuse targets before the work that fills them, load the vehicle.

        Args:
            args: of :func:`add_log_arguments`.
            further: logs that are read besides ``args.logs``.

        Raises:
            UsageError: a target would overwrite what is read or written.
            FileAccessError: a target can not be written, a file not be read.
            ConfigError: of the configuration.
        """
        out = getattr(args, "out", None)
        if out is not None:
            arguments.check_new(out, force=args.force)
        sources = (args.config, *args.logs, *further)
        arguments.check_targets((out, args.json, args.report), sources)
        return cls(args, *load_vehicle(args.config))

    @property
    def names(self) -> str:
        """The names of the logs in one line."""
        return names_of(self.args.logs)

    @property
    def files(self) -> list[str]:
        """The logs as they were given."""
        return [str(log) for log in self.args.logs]

    def read(self, reader: Callable[..., T], log: Any, **more: Any) -> T:
        """Return what *reader* makes of *log*, a log or several."""
        return reader(
            *(log, self.config, self.signal_map, dict(self.args.map)), **more
        )

    def heading(self, subject: object) -> str:
        """Return the line above a result: *subject*, vehicle, file."""
        return f"{subject}  ({self.config.vehicle.id}, {self.args.config})"

    def written(
        self,
        result: Callable[[], dict[str, Any]],
        page: Callable[[str], Page],
        subject: str = "",
        indent: int | None = 2,
    ) -> list[str]:
        """Write the JSON file, the page and the figures that were asked for.

        Args:
            result: makes what goes into the JSON file.
            page: makes the page under a subtitle.
            subject: what the subtitle begins with, by default the logs.
            indent: spaces a level of the JSON file, None for one line.

        Returns:
            A line for the page and one for the figures.

        Raises:
            FileAccessError: a file can not be written.
            MissingExtraError: a package for the page is not installed.
        """
        args = self.args
        if args.json:
            write_json(args.json, result(), indent)
        parts = subject or self.names, self.config.vehicle.id, args.config.name
        return write_pages(args, lambda: page(" · ".join(parts)))


def names_of(logs: Iterable[Path]) -> str:
    """Return the names of *logs* in one line."""
    return ", ".join(log.name for log in logs)


def write_pages(
    args: argparse.Namespace, page: Callable[[], Page]
) -> list[str]:
    """Write the report and the figures that were asked for.

    Args:
        args: parsed arguments of :func:`add_report`.
        page: makes the page.

    Returns:
        A line for the report and one for the figures.

    Raises:
        FileAccessError: a file can not be written.
        MissingExtraError: a package for them is not installed.
        UsageError: there is no Chromium for the figures.
    """
    lines: list[str] = []
    if not (args.report or args.figures):
        return lines
    made = page()
    if args.report:
        write_page(args.report, made)
        lines.append(str(args.report))
    if args.figures:
        files = write_figures(args.figures, made)
        lines.append(f"{args.figures}: {len(files)} figures")
    return lines
