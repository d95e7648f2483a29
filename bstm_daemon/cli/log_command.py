"""Arguments and results shared by the commands over recorded drives."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from bstm_daemon.cli.arguments import (
    add_new_config,
    check_new,
    check_targets,
    option,
    shared,
)
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.report.figures import write_figures
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.shell import write_page

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.report.shell import Page


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
    option(parser, "logs LOG...", what, Path, nargs=nargs)
    shared(parser, "config")
    if new_config:
        add_new_config(parser)
    shared(parser, "json", "report", "figures", "map")


def open_vehicle(
    args: argparse.Namespace, logs: Iterable[Path]
) -> tuple[Config, SignalMap]:
    """Refuse targets before the work that fills them, load the vehicle.

    Raises:
        UsageError: a target would overwrite what is read or written.
        FileAccessError: a target can not be written, a file not be read.
        ConfigError: of the configuration.
    """
    out = getattr(args, "out", None)
    if out is not None:
        check_new(out, force=args.force)
    check_targets((out, args.json, args.report), (args.config, *logs))
    return load_vehicle(args.config)


def names_of(logs: Iterable[Path]) -> str:
    """Return the names of *logs* in one line."""
    return ", ".join(log.name for log in logs)


def heading(args: argparse.Namespace, config: Config, subject: object) -> str:
    """Return the line above a result: *subject*, vehicle, configuration."""
    return f"{subject}  ({config.vehicle.id}, {args.config})"


def write_results(
    args: argparse.Namespace,
    subtitle: tuple[str, ...],
    result: Callable[[], dict[str, Any]],
    page: Callable[[str], Page],
    indent: int | None = 2,
) -> list[str]:
    """Write the JSON file, the page and the figures that were asked for.

    Args:
        args: parsed arguments with ``json``, ``report`` and ``config``.
        subtitle: parts of the page's subtitle, before the configuration.
        result: makes what goes into the JSON file.
        page: makes the page under a subtitle.
        indent: spaces a level of the JSON file, None for one line.

    Returns:
        A line for the page and one for the figures.

    Raises:
        FileAccessError: a file can not be written.
        MissingExtraError: a package for the page is not installed.
    """
    if args.json:
        write_json(args.json, result(), indent)
    under = " · ".join((*subtitle, args.config.name))
    return write_pages(args, lambda: page(under))


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
