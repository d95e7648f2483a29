"""``bstm match``: the model's values from drives with thermocouples."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from bstm_daemon.analysis.identify.writing import write_changed
from bstm_daemon.analysis.matching.drives import read_drives
from bstm_daemon.analysis.matching.matcher import changes_of, match_drives
from bstm_daemon.analysis.matching.tunables import Target
from bstm_daemon.cli.arguments import (
    add_bus_map,
    add_config,
    add_json,
    add_new_config,
    add_report,
    check_new,
    check_targets,
)
from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.corner_model import corner_model
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.match import match_json, match_page, match_text
from bstm_daemon.report.shell import write_page

if TYPE_CHECKING:
    import argparse

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare logs, what is matched and where results go."""
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG")
    add_config(parser)
    add_new_config(parser)
    parser.add_argument(
        "--only",
        choices=("cooling",),
        default="",
        help="cooling: match only what another rim changes, the air at disc "
        "and caliper",
    )
    parser.add_argument(
        "--each",
        action="store_true",
        help="match left and right by themselves, though configured alike",
    )
    add_json(parser)
    add_report(parser)
    add_bus_map(parser)


def run(args: argparse.Namespace) -> int:
    """Match, print, and write what was asked for."""
    check_new(args.out, force=args.force)
    check_targets(
        (args.out, args.json, args.report), (args.config, *args.logs)
    )
    config, signal_map = load_vehicle(args.config)
    drives = _drives(args, config, signal_map)
    again = _follows_temperature(config)
    matches = _matches(args, config, drives, beside=not again)
    if again:
        # friction is that at the temperatures of the matched model
        drives = _drives(args, _matched(config, matches), signal_map)
        matches = _matches(args, config, drives)
    names = ", ".join(log.name for log in args.logs)
    print(f"{names}  ({config.vehicle.id}, {args.config})")
    for match in matches:
        print(match_text(match))
    _write(args, config, matches, names)
    if args.report:
        subtitle = f"{names} · {config.vehicle.id} · {args.config.name}"
        write_page(args.report, match_page(matches, drives, subtitle))
        print(args.report)
    return 0


def _drives(
    args: argparse.Namespace, config: Config, signal_map: SignalMap
) -> list[Drive]:
    with Progress("read") as progress:
        return read_drives(
            args.logs,
            config,
            signal_map,
            dict(args.map),
            progress.show,
        )


def _matches(
    args: argparse.Namespace,
    config: Config,
    drives: list[Drive],
    *,
    beside: bool = True,
) -> list[Match]:
    with Progress("match") as progress:
        return match_drives(
            config,
            drives,
            only=args.only,
            each=args.each,
            beside=beside,
            progress=progress.show,
        )


def _follows_temperature(config: Config) -> bool:
    """Whether heat comes from pressure by a friction that knows fade."""
    laws = [
        corner_model(config, one).friction for one in config.disc_corners()
    ]
    return config.heat.mode != "fb" and any(
        set(law.temperature) != {1.0} for law in laws
    )


def _matched(config: Config, matches: list[Match]) -> Config:
    for match in matches:
        target = Target(config, match.corners)
        config = target.changed(match.joint.values).config
    return config


def _write(
    args: argparse.Namespace,
    config: Config,
    matches: list[Match],
    names: str,
) -> None:
    today = time.strftime("%Y-%m-%d")
    origin = f"matched, {names}, {today}"
    changes = changes_of(matches, config, origin)
    if args.json:
        result = {
            "files": [str(log) for log in args.logs],
            "corners": [match_json(match) for match in matches],
            "changes": [str(change) for change in changes],
        }
        write_json(args.json, result)
    if args.out is not None:
        write_changed(args.config, args.out, changes, origin)
        print(f"{args.out}: {len(changes)} values")
