"""``bstm identify``: values of the car from recorded drives."""

import argparse
from collections.abc import Callable
from typing import Any, Final, NamedTuple

from bstm_daemon.analysis.identify import writing
from bstm_daemon.analysis.identify.brakes import identify_brakes
from bstm_daemon.analysis.identify.coastdown import NAMES, identify_coast_down
from bstm_daemon.analysis.identify.cooling import identify_cooling
from bstm_daemon.analysis.identify.cooling_while_braking import (
    identify_while_braking,
)
from bstm_daemon.analysis.identify.driving import read_drivings
from bstm_daemon.cli.arguments import option
from bstm_daemon.cli.log_command import LogCommand, add_log_arguments
from bstm_daemon.cli.progress import Progress
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import UsageError
from bstm_daemon.report import brakes, coastdown, cooling
from bstm_daemon.report.shell import Page

HOLDABLE: Final = dict(
    zip(("drag", "friction", "rolling"), NAMES, strict=True)
)
NOTHING_IDENTIFIED: Final = 1


class Kind(NamedTuple):
    """What is identified: how, and its result in every form."""

    identify: Callable[..., Any]
    text: Callable[[Any], str]
    page: Callable[[Any, str], Page]
    data: Callable[[Any], dict[str, Any]]
    changes: Callable[[Any, Config], list[writing.Change]]


WHILE_BRAKING: Final = "cooling while braking"
KINDS: Final = {
    "coastdown": Kind(
        identify_coast_down,
        coastdown.coast_down_text,
        coastdown.coast_down_page,
        coastdown.coast_down_json,
        lambda result, _: writing.coast_down_changes(result),
    ),
    "brakes": Kind(
        identify_brakes,
        brakes.brakes_text,
        brakes.brakes_page,
        brakes.brakes_json,
        writing.brake_changes,
    ),
    "cooling": Kind(
        identify_cooling,
        cooling.cooling_text,
        cooling.cooling_page,
        cooling.cooling_json,
        lambda result, config: writing.cooling_changes(result.axles, config),
    ),
    WHILE_BRAKING: Kind(
        identify_while_braking,
        cooling.braked_text,
        cooling.braked_page,
        cooling.braked_json,
        lambda result, config: writing.braked_changes(result.axles, config),
    ),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what is identified, the logs and where results go."""
    option(
        parser,
        "what",
        "coastdown: rolling resistance, C_fric and drag from stretches in "
        "neutral; brakes: friction scale, push-out and axle shares from "
        "stops; cooling: S over speed from measured discs that cool",
        choices=("coastdown", "brakes", "cooling"),
    )
    add_log_arguments(parser, new_config=True)
    option(
        parser,
        "--hold",
        "coastdown: keep this value as configured; may be repeated",
        action="append",
        choices=tuple(HOLDABLE),
        default=[],
    )
    what = "coastdown: the runs do not return on their road"
    option(parser, "--one-way", what)
    option(
        parser,
        "--even-grade",
        "coastdown: the grade is constant along each run; the noisy "
        "accelerometer is not used",
    )
    option(
        parser,
        "--while-braking",
        "cooling: S as a line over speed from whole drives, with heat from "
        "the car's motion",
    )


def run(args: argparse.Namespace) -> int:
    """Identify, print and write what was asked for.

    The result is 1 if no value is identified.
    """
    _check(args)
    command = LogCommand.opened(args)
    config = command.config
    with Progress("identify") as progress:
        drivings = command.read(
            read_drivings, args.logs, progress=progress.show
        )
    kind = KINDS[WHILE_BRAKING if args.while_braking else args.what]
    options: dict[str, Any] = {}
    if args.what == "coastdown":
        options["held"] = {HOLDABLE[name] for name in args.hold}
        options |= {"one_way": args.one_way, "even_grade": args.even_grade}
    with Progress(f"identify {args.what}"):
        result = kind.identify(drivings, config, **options)
    names = command.names
    print(f"{names} · {config.vehicle.id} · {args.config.name}")
    print(kind.text(result))
    for line in command.written(
        lambda: {"files": command.files, **kind.data(result)},
        lambda subtitle: kind.page(result, subtitle),
    ):
        print(line)
    changes = kind.changes(result, config)
    if args.out is not None:
        _write(args, changes, f"bstm identify {args.what}, {names}")
    return 0 if changes else NOTHING_IDENTIFIED


def _check(args: argparse.Namespace) -> None:
    if args.what != "coastdown" and (
        args.hold or args.one_way or args.even_grade
    ):
        msg = "--hold, --one-way and --even-grade are options of coastdown"
        raise UsageError(msg)
    if args.what != "cooling" and args.while_braking:
        msg = "--while-braking is an option of cooling"
        raise UsageError(msg)


def _write(
    args: argparse.Namespace, changes: list[writing.Change], origin: str
) -> None:
    if not changes:
        print(f"{args.out}: not written, nothing was identified")
        return
    writing.write_changed(args.config, args.out, changes, origin)
    print(f"{args.out}: {len(changes)} values")
    for change in changes:
        print(f"  {change}")
