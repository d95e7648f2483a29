"""The command-line options that every way to boot a guest has."""

from __future__ import annotations

import argparse
import dataclasses

from guest import FAILED, VIRTUAL_TIME, Guest, RigError, Share, boot, tell


def make_parser(
    description: str | None, example: str
) -> argparse.ArgumentParser:
    """Return a parser with the common options; add one's own, then parse."""
    parser = argparse.ArgumentParser(
        description=description,
        epilog=f"example: {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = parser.add_argument
    add(
        "-t",
        "--timeout",
        type=float,
        default=600.0,
        metavar="S",
        help="wall time in seconds for boot and command (600)",
    )
    add("-m", "--memory", default="512M", help="the guest's memory (512M)")
    add(
        "-w",
        "--write",
        action="append",
        default=[],
        metavar="SOURCE[:TARGET]",
        help="directory of this machine the guest may write to",
    )
    add(
        "--virtual-time",
        action="store_true",
        help="sleeping takes no wall time; needs a kernel of "
        "build-uml-timetravel in BSTM_RIG_KERNEL",
    )
    add("-v", "--verbose", action="store_true", help="show the console")
    add("command", nargs=argparse.REMAINDER)
    return parser


def parse(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Return the options; ``command`` is without a leading ``--``."""
    given = parser.parse_args()
    given.command = given.command[given.command[:1] == ["--"] :]
    if not given.command:
        parser.error("no command")
    return given


def run(guest: Guest, given: argparse.Namespace) -> int:
    """Boot *guest* with the common options; tell why where it fails."""
    try:
        writable = (Share.parse(text, writable=True) for text in given.write)
        return boot(
            dataclasses.replace(
                guest,
                shares=(*guest.shares, *writable),
                memory=given.memory,
                timeout_s=given.timeout,
                arguments=VIRTUAL_TIME if given.virtual_time else (),
                verbose=given.verbose,
            )
        )
    except (RigError, OSError) as error:
        tell(str(error))
        return FAILED
