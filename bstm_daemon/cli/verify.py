"""``bstm verify``: the model judged on drives with thermocouples."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from bstm_daemon.analysis.matching.drives import read_drive
from bstm_daemon.analysis.matching.verification import (
    LIMITS,
    errors_of,
    judged,
)
from bstm_daemon.cli.arguments import (
    add_bus_map,
    add_config,
    add_json,
    add_report,
    check_targets,
)
from bstm_daemon.cli.progress import Progress
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.errors import LogError
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.shell import write_page
from bstm_daemon.report.verify import verify_json, verify_page, verify_text

if TYPE_CHECKING:
    import argparse

    from bstm_daemon.analysis.matching.verification import NodeErrors

FAILED: Final = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare logs, limits and where results go."""
    parser.add_argument("logs", nargs="+", type=Path, metavar="LOG")
    add_config(parser)
    parser.add_argument(
        "--require",
        choices=tuple(LIMITS),
        default="thesis",
        help="which limits decide the exit code (default %(default)s): fluid "
        "within 30 K and its peak within 5 min; floor and goal are narrower "
        "and judge disc, pad and drift too",
    )
    add_json(parser)
    add_report(parser)
    add_bus_map(parser)


def run(args: argparse.Namespace) -> int:
    """Judge, print and write; 1 where a required limit is not met."""
    check_targets((args.json, args.report), (args.config, *args.logs))
    config, signal_map = load_vehicle(args.config)
    errors: list[NodeErrors] = []
    learned = None
    for log in args.logs:
        with Progress(f"verify {log.name}") as progress:
            drive = read_drive(
                log,
                config,
                signal_map,
                dict(args.map),
                progress=progress.show,
                estimates=True,
                learned=learned,
            )
            learned = drive.learned
        found = errors_of(drive, config)
        if not found:
            msg = (
                f"{log}: no measured temperature of a disc brake to verify: "
                "roles temp_<corner>_<node>"
            )
            raise LogError(msg)
        errors += found
    names = ", ".join(log.name for log in args.logs)
    print(f"{names}  ({config.vehicle.id}, {args.config})")
    print(verify_text(errors))
    verdicts = judged(errors, LIMITS[args.require])
    passed = all(one.passed for one in verdicts)
    if args.json:
        result = {
            "files": [str(log) for log in args.logs],
            "required": args.require,
            "passed": passed,
            **verify_json(errors),
        }
        write_json(args.json, result)
    if args.report:
        subtitle = f"{names} · {config.vehicle.id} · {args.config.name}"
        write_page(args.report, verify_page(errors, args.require, subtitle))
        print(args.report)
    return 0 if passed else FAILED
