"""``bstm match``: the model's values from drives with thermocouples."""

import argparse
import time
from dataclasses import replace
from typing import Any, Final

from bstm_daemon.analysis.gap.calibration import Calibration
from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.analysis.matching.changes import changes_of
from bstm_daemon.analysis.matching.coarse import guesses_of
from bstm_daemon.cli.arguments import option
from bstm_daemon.cli.log_command import LogCommand, add_log_arguments
from bstm_daemon.cli.progress import Progress
from bstm_daemon.report.match import (
    headline,
    match_json,
    match_page,
    match_text,
    step_json,
    step_lines,
)

PART_MISSING: Final = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare logs, what is matched and where results go."""
    add_log_arguments(parser, new_config=True)
    option(
        parser,
        "--only",
        "cooling: match only what another rim changes, the air at disc and "
        "caliper; implies --plain",
        choices=("cooling",),
        default="",
    )
    what = "match left and right separately, even if configured alike"
    option(parser, "--each", what)
    option(
        parser,
        "--plain",
        "match once; otherwise bstm gap searches the same drives, and what it "
        "names is added where the error on what was left out falls",
    )


def run(args: argparse.Namespace) -> int:
    """Match, print, and write what was asked for.

    The result is 1 if a part of the model may be missing.
    """
    command = LogCommand.opened(args)
    config = command.config
    guessed = guesses_of(args.config)
    with Progress("match") as progress:
        calibration = Calibration(
            args.logs, command.signal_map, dict(args.map), progress.show
        )
        found = calibration.run(
            config, guessed, only=args.only, each=args.each, plain=args.plain
        )
        config, matches, by_forces, why_not = found.matched
        learned = [
            calibration.handed_on(match) for match in matches if args.out
        ]
    verdict = "; ".join(headline(match) for match in matches)
    print(verdict)
    names = command.names
    print(command.heading(names))
    for change in by_forces:
        print(f"  by forces, before the match: {change}")
    for reason in why_not:
        print(f"  by forces: {reason}")
    for line in step_lines(found.steps):
        print(f"  {line}")
    for match in matches:
        print(match_text(match))
    origin = f"matched, {names}, {time.strftime('%Y-%m-%d')}"
    changes = changes_of(matches, config, origin)
    added = {one.name for one in found.effects}
    changes = [one for one in changes if one.effect not in added]
    places = {(one.section, one.key, one.corner) for one in changes}
    changes += [
        replace(one, note=f"by forces, {names}")
        for one in by_forces
        if (one.section, one.key, one.corner) not in places
    ]
    if args.out is not None:
        write_changed(
            *(args.config, args.out, changes, origin, verdict),
            Entries(found.effects, matched=learned),
        )
        print(f"{args.out}: {len(changes) + len(found.effects)} values")
    searched: dict[str, Any] = {}
    if not args.plain:
        searched["steps"] = [step_json(step) for step in found.steps]
        searched["effects"] = found.effects
    for line in command.written(
        lambda: {
            "files": command.files,
            "corners": [match_json(match) for match in matches],
            "changes": [str(change) for change in changes],
            **searched,
        },
        lambda subtitle: match_page(matches, subtitle, found.steps),
    ):
        print(line)
    return PART_MISSING if any(match.verdict for match in matches) else 0
