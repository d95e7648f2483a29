"""``bstm match``: the model's values from drives with thermocouples."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from bstm_daemon.analysis.gap.form import with_form
from bstm_daemon.analysis.gap.recording import read_recording
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.analysis.matching.changes import changes_of, learned
from bstm_daemon.analysis.matching.coarse import guesses_of
from bstm_daemon.analysis.matching.workflow import match_logs
from bstm_daemon.cli.log_command import (
    add_log_arguments,
    heading,
    names_of,
    open_vehicle,
    write_results,
)
from bstm_daemon.cli.progress import Progress
from bstm_daemon.report.match import (
    headline,
    match_json,
    match_page,
    match_text,
)

if TYPE_CHECKING:
    import argparse

    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.estimates import MatchedConfig


PART_MISSING: Final = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare logs, what is matched and where results go."""
    add_log_arguments(parser, new_config=True)
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
        help="match left and right separately, even if configured alike",
    )


def run(args: argparse.Namespace) -> int:
    """Match, print, and write what was asked for.

    The result is 1 if a part of the model may be missing.
    """
    config, signal_map = open_vehicle(args, args.logs)
    guessed = guesses_of(args.config)
    with Progress("match") as progress:
        config, matches, by_forces, why_not = match_logs(
            args.logs,
            config,
            signal_map,
            guessed,
            overrides=dict(args.map),
            only=args.only,
            each=args.each,
            progress=progress.show,
        )
    names = names_of(args.logs)
    verdict = "; ".join(headline(match) for match in matches)
    print(verdict)
    print(heading(args, config, names))
    for change in by_forces:
        print(f"  by forces, before the match: {change}")
    for reason in why_not:
        print(f"  by forces: {reason}")
    for match in matches:
        print(match_text(match))
    origin = f"matched, {names}, {time.strftime('%Y-%m-%d')}"
    changes = changes_of(matches, config, origin)
    places = {(one.section, one.key, one.corner) for one in changes}
    changes += [
        replace(one, note=f"by forces, {names}")
        for one in by_forces
        if (one.section, one.key, one.corner) not in places
    ]
    if args.out is not None:
        write_changed(
            *(args.config, args.out, changes, origin, verdict),
            Entries(matched=_learned(args, matches, signal_map)),
        )
        print(f"{args.out}: {len(changes)} values")
    for line in write_results(
        args,
        (names, config.vehicle.id),
        lambda: {
            "files": [str(log) for log in args.logs],
            "corners": [match_json(match) for match in matches],
            "changes": [str(change) for change in changes],
        },
        lambda subtitle: match_page(matches, subtitle),
    ):
        print(line)
    return PART_MISSING if any(match.verdict for match in matches) else 0


def _learned(
    args: argparse.Namespace, matches: list[Match], signal_map: SignalMap
) -> list[MatchedConfig]:
    """Return what *matches* hand on, with what their form lacks."""
    found = []
    for match in matches:
        known = learned(match)
        config = match.after.config.model_copy(update={"matched": [known]})
        target = replace(match.after, config=config)
        with Progress("form") as progress:
            recordings = [
                read_recording(log, config, signal_map, dict(args.map))
                for log in args.logs
            ]
            comparison = compare(target, recordings)
            found.append(with_form(known, comparison, progress.show))
    return found
