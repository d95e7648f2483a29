"""``bstm verify``: verification on drives with thermocouples."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Final

from bstm_daemon.analysis.matching import verification
from bstm_daemon.analysis.matching.drives import Drive, read_drive, read_drives
from bstm_daemon.cli.arguments import option
from bstm_daemon.cli.log_command import LogCommand, add_log_arguments
from bstm_daemon.cli.progress import Progress
from bstm_daemon.errors import LogError
from bstm_daemon.report.verify import verify_json, verify_page, verify_text

FAILED: Final = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare logs, limits and where results go."""
    add_log_arguments(parser)
    option(
        parser,
        "--require",
        "which limits decide the exit code (default %(default)s): fluid "
        "within 30 K and its peak within 5 min; floor and goal are narrower "
        "and include disc, pad and drift",
        choices=tuple(verification.LIMITS),
        default="thesis",
    )
    option(
        parser,
        "--matched-on LOG...",
        "drives of the match: the baseline, a disc of one node, is fitted to "
        "them and not to the other LOGs",
        Path,
    )


def run(args: argparse.Namespace) -> int:
    """Judge, print and write; 1 where a limit is not met."""
    command = LogCommand.opened(args, *args.matched_on)
    config = command.config
    verified: list[tuple[Drive, list[verification.NodeErrors]]] = []
    learned = None
    for log in args.logs:
        with Progress(f"verify {log.name}") as progress:
            drive = command.read(
                read_drive,
                log,
                progress=progress.show,
                estimates=True,
                learned=learned,
            )
            learned = drive.learned
        found = verification.errors_of(drive, config)
        if not found:
            msg = (
                f"{log}: no measured temperature of a disc brake to verify: "
                "roles temp_<corner>_<node>"
            )
            raise LogError(msg)
        verified.append((replace(drive, estimates=None), found))
    errors = [one for _, found in verified for one in found]
    matched_on = command.read(read_drives, args.matched_on)
    verdicts = verification.judged(errors) + verification.held_against(
        verified, matched_on
    )
    print(command.heading(command.names))
    print(verify_text(errors, verdicts))
    passed = all(
        one.passed for one in verification.decisive(verdicts, args.require)
    )
    for line in command.written(
        lambda: {
            "files": command.files,
            "required": args.require,
            "passed": passed,
            **verify_json(errors, verdicts),
        },
        lambda subtitle: verify_page(errors, verdicts, args.require, subtitle),
    ):
        print(line)
    return 0 if passed else FAILED
