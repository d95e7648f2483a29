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
from bstm_daemon.analysis.matching.coarse import guesses_of, read_as_guessed
from bstm_daemon.analysis.matching.drives import read_drives
from bstm_daemon.analysis.matching.matcher import match_drives
from bstm_daemon.analysis.matching.tunables import DRAG, Target
from bstm_daemon.cli.log_command import (
    add_log_arguments,
    heading,
    names_of,
    open_vehicle,
    write_results,
)
from bstm_daemon.cli.progress import Progress
from bstm_daemon.estimator.corner_model import corner_model
from bstm_daemon.report.match import (
    headline,
    match_json,
    match_page,
    match_text,
)

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from bstm_daemon.analysis.matching.coarse import Reading
    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.estimates import MatchedConfig
    from bstm_daemon.config.sections import Config


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
    readings = _readings(args, config, signal_map, guessed)
    again = _follows_temperature(config)
    matches = _matches(args, config, readings, guessed, beside=not again)
    near_m2 = [
        one.joint.values[DRAG] for one in matches if DRAG in one.joint.values
    ]
    if near_m2:
        readings = _readings(args, config, signal_map, guessed, near_m2)
        matches = _matches(args, config, readings, guessed)
    if again:
        # friction is that at the temperatures of the matched model
        matched = _matched(config, matches)
        readings = _readings(args, matched, signal_map, frozenset())
        matches = _matches(args, config, readings, guessed)
    names = names_of(args.logs)
    verdict = "; ".join(headline(match) for match in matches)
    print(verdict)
    print(heading(args, config, names))
    for match in matches:
        print(match_text(match))
    origin = f"matched, {names}, {time.strftime('%Y-%m-%d')}"
    changes = changes_of(matches, config, origin)
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


def _readings(
    args: argparse.Namespace,
    config: Config,
    signal_map: SignalMap,
    guessed: frozenset[str],
    near_m2: Sequence[float] = (),
) -> list[Reading]:
    """Read the logs, as often as what is guessed of their heat asks for."""
    with Progress("read") as progress:
        return read_as_guessed(
            config,
            guessed,
            lambda one: read_drives(
                args.logs, one, signal_map, dict(args.map), progress.show
            ),
            near_m2,
        )


def _matches(
    args: argparse.Namespace,
    config: Config,
    readings: list[Reading],
    guessed: frozenset[str],
    *,
    beside: bool = True,
) -> list[Match]:
    with Progress("match") as progress:
        return match_drives(
            config,
            readings,
            guessed=guessed,
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
