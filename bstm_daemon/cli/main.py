"""The entry point ``bstm``: finds the command, runs it, words its failure.

A command is a module of this package with ``add_arguments(parser)`` and
``run(args) -> int``. It is imported when it is called, so a missing optional
package disables one command and not the program.
"""

from __future__ import annotations

import argparse
import importlib
import logging
import os
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NoReturn, Protocol, cast

from bstm_daemon import __version__
from bstm_daemon.errors import BstmError, ConfigError, FileAccessError

if TYPE_CHECKING:
    from collections.abc import Sequence

NOTICE: Final = "estimate and advice, not a safety function"

EXIT_USAGE: Final = 2
EXIT_INTERRUPTED: Final = 130
EXIT_BROKEN_PIPE: Final = 141
"""128 plus the number of the signal, as a shell reports them."""


@dataclass(frozen=True, slots=True)
class Command:
    """Where a command lives, and its line in the overview."""

    module: str
    summary: str


COMMANDS: Final[dict[str, Command]] = {
    "demo": Command(
        "bstm_daemon.cli.demo",
        "simulate a descent, estimate it from CAN alone, write a report",
    ),
    "init": Command(
        "bstm_daemon.cli.init",
        "propose a configuration from a DBC and recorded logs",
    ),
    "check": Command(
        "bstm_daemon.cli.check",
        "check a configuration and its DBC files, list every problem",
    ),
    "simulate": Command(
        "bstm_daemon.cli.simulate",
        "write the CAN log of the simulated car on a drive",
    ),
    "replay": Command(
        "bstm_daemon.cli.replay",
        "estimate brake temperatures from recorded CAN logs",
    ),
    "run": Command(
        "bstm_daemon.cli.run",
        "monitor a live CAN bus, publish temperatures and risk",
    ),
    "watch": Command(
        "bstm_daemon.cli.watch",
        "show the published temperatures live in the terminal",
    ),
    "forecast": Command(
        "bstm_daemon.cli.forecast",
        "tell from a state file what the brake fluid will do, parked",
    ),
    "identify": Command(
        "bstm_daemon.cli.identify",
        "find resistances and brake friction of the car in recorded drives",
    ),
    "heat": Command(
        "bstm_daemon.cli.heat",
        "compare the brake heat of Feed-Forward, Feed-Back and the bus",
    ),
    "match": Command(
        "bstm_daemon.cli.match",
        "match the model to drives with measured temperatures",
    ),
    "verify": Command(
        "bstm_daemon.cli.verify",
        "judge the model on drives with measured temperatures",
    ),
    "gap": Command(
        "bstm_daemon.cli.gap",
        "find, name and add the effect that the model lacks",
    ),
    "install-service": Command(
        "bstm_daemon.cli.install_service",
        "write the systemd units of the live service",
    ),
}
"""Every command, in the order of the overview."""


class CommandModule(Protocol):
    """What the module of a command offers."""

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's arguments."""

    def run(self, args: argparse.Namespace) -> int:
        """Run the command and return its exit code."""


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the arguments in one line."""

    def error(self, message: str) -> NoReturn:
        """Print *message* and where the usage is, and leave with 2."""
        self.exit(
            EXIT_USAGE,
            f"{self.prog}: {message}; usage: {self.prog} --help\n",
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``bstm`` with *argv* and return the exit code."""
    try:
        code = _run(sys.argv[1:] if argv is None else list(argv))
        sys.stdout.flush()
    except SystemExit as leave:
        return leave.code if isinstance(leave.code, int) else EXIT_USAGE
    except BrokenPipeError:
        # the reader of stdout has gone; without this the interpreter would
        # fail once more when it flushes at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except (BstmError, OSError) as error:
        print(_worded(error), file=sys.stderr)
        return getattr(error, "exit_code", FileAccessError.exit_code)
    return code


def _run(argv: list[str]) -> int:
    called = next((word for word in argv if not word.startswith("-")), "")
    command = COMMANDS.get(called)
    module = None if command is None else _load(command)
    args = _parse(argv, called, module)
    offset = getattr(args, "verbosity_offset", 0)
    _set_up_log(args.verbose - args.quiet + offset)
    code: int = args.run(args)
    return code


def _worded(error: BstmError | OSError) -> str:
    if isinstance(error, ConfigError):
        count = len(error.problems)
        return f"{error}\n{count} problem{'s' * (count != 1)}"
    if isinstance(error, BstmError):
        return f"bstm: {error}"
    place = f"{error.filename}: " if error.filename else ""
    return f"bstm: {place}{error.strerror or error}"


def _load(command: Command) -> CommandModule:
    return cast("CommandModule", importlib.import_module(command.module))


def _parse(
    argv: list[str], called: str, module: CommandModule | None
) -> argparse.Namespace:
    parser = Parser(
        prog="bstm",
        description=f"Brake temperatures from a CAN bus: {NOTICE}.",
    )
    parser.add_argument(
        "--version",
        action="version",
        version=f"bstm {__version__}: {NOTICE}",
    )
    _add_verbosity(parser, default=0)
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True
    )
    for name, command in COMMANDS.items():
        subparser = commands.add_parser(
            name, help=command.summary, description=command.summary + "."
        )
        if name == called and module is not None:
            module.add_arguments(subparser)
            subparser.set_defaults(run=module.run)
            # not to overwrite what stood before the command
            _add_verbosity(subparser, default=argparse.SUPPRESS)
    return parser.parse_args(argv)


def _add_verbosity(
    parser: argparse.ArgumentParser, default: int | str
) -> None:
    parser.add_argument(
        "-v",
        "--verbose",
        action="count",
        default=default,
        help="log more; twice for debugging",
    )
    parser.add_argument(
        "-q",
        "--quiet",
        action="count",
        default=default,
        help="log less; twice for errors only",
    )


def _set_up_log(verbosity: int) -> None:
    """Send the log to stderr: text on a terminal, JSON lines elsewhere.

    Warnings are shown; each ``-v`` shows one level more, ``-q`` one less.
    """
    import structlog  # noqa: PLC0415  (--help does without it)

    level = min(max(logging.WARNING - 10 * verbosity, 10), logging.CRITICAL)
    is_terminal = sys.stderr.isatty()
    use_color = is_terminal and not os.environ.get("NO_COLOR")
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(level),
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.dev.ConsoleRenderer(colors=use_color)
            if is_terminal
            else structlog.processors.JSONRenderer(),
        ],
        logger_factory=lambda *_: structlog.WriteLogger(sys.stderr),
        cache_logger_on_first_use=False,
    )


if __name__ == "__main__":
    sys.exit(main())
