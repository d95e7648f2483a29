"""The entry point ``bstm``: runs a command and reports its failure.

A command is a module of this package with ``add_arguments(parser)`` and
``run(args) -> int``. It is imported when it is called, so a missing optional
package disables one command and not the program.
"""

import argparse
import importlib
import logging
import os
import sys
from collections.abc import Collection, Iterator, MutableMapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import Any, Final, NoReturn

from bstm_daemon import __version__, errors
from bstm_daemon.watch.terminal_text import raw_stream, visible, visible_stream

# matrices here are small: for so little, threads cost ten times what they do
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

NOTICE: Final = "estimate and advice, not a safety function"

EXIT_USAGE: Final = 2
EXIT_INTERRUPTED: Final = 130
EXIT_BROKEN_PIPE: Final = 141
"""128 plus the number of the signal, as a shell reports them."""


COMMANDS: Final[dict[str, str]] = {
    "demo": "simulate a descent, estimate it from CAN alone, write a report",
    "init": "propose a configuration from a DBC and recorded logs",
    "config": "print the JSON schema of the configuration for editors",
    "check": "check a configuration and its DBC files, list every problem",
    "simulate": "write the CAN log of the simulated car on a drive",
    "replay": "estimate brake temperatures from recorded CAN logs",
    "run": "monitor a live CAN bus, publish temperatures and risk",
    "watch": "show the published temperatures live in the terminal",
    "view": "show the estimates live as a page in a browser",
    "bridge": "publish the estimates to an MQTT broker",
    "forecast": "forecast the brake fluid of the parked car from a state file",
    "identify": "find the car's resistances and brake friction in drives",
    "heat": "compare the brake heat of Feed-Forward, Feed-Back and the bus",
    "match": "match the model to drives with measured temperatures",
    "verify": "verify the model on drives with measured temperatures",
    "gap": "find, name and add the effect that the model lacks",
    "fleet": "replay the drives of many cars in chains, and question them",
    "fmu": "export the model as an FMU for other simulation tools",
    "model": "show the thermal network of a corner as a graph",
    "install-service": "write the systemd units of the live service",
    "shell": "print the completion of a shell, or the man page",
}
"""Command to its line in the overview, in that order."""


class Parser(argparse.ArgumentParser):
    """Reports wrong arguments in one line; options stand anywhere."""

    _is_mixing = False

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse; options and files of a command may stand in any order."""
        if self._is_mixing or self._subparsers is not None:
            return super().parse_known_args(args, namespace)
        # argparse calls this method again, for options and for files
        self._is_mixing = True
        try:
            parsed, rest = self.parse_known_intermixed_args(args, namespace)
        finally:
            self._is_mixing = False
        if rest:
            meant = errors.nearest(rest[0], self._option_string_actions)
            tail = f": did you mean '{meant}'?" if meant else ""
            self.error(f"unrecognized arguments: {' '.join(rest)}{tail}")
        return parsed, rest

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """Add an argument; one of several words is called by these."""
        if "choices" in options and not names[0].startswith("-"):
            words = ",".join(map(str, options["choices"]))
            options.setdefault("metavar", f"{{{words}}}")
        return super().add_argument(*names, **options)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Say which of the choices was probably meant."""
        if action.choices is None or value in action.choices:
            return
        known = [str(choice) for choice in action.choices]
        message = (
            f"no {value!r}: {errors.hint(str(value), known, ', '.join(known))}"
        )
        raise argparse.ArgumentError(action, message)

    def error(self, message: str) -> NoReturn:
        """Print *message* and how to get the usage, and exit with 2."""
        self.exit(
            EXIT_USAGE, f"{self.prog}: {message}; usage: {self.prog} --help\n"
        )


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``bstm`` with *argv* and return the exit code.

    What it writes on a terminal is visible text, whatever names it shows.
    """
    with (
        redirect_stdout(visible_stream(sys.stdout)),
        redirect_stderr(visible_stream(sys.stderr)),
    ):
        return _main(argv)


def _main(argv: Sequence[str] | None) -> int:
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
    except (errors.BstmError, OSError) as error:
        print(_worded(error), file=sys.stderr)
        return getattr(error, "exit_code", errors.FileAccessError.exit_code)
    return code


def _run(argv: list[str]) -> int:
    called = next((word for word in argv if not word.startswith("-")), "")
    args = _parse(argv, called)
    from bstm_daemon.cli.arguments import refuse_swapped, require_extras  # noqa: PLC0415  (after --help)

    offset = getattr(args, "verbosity_offset", 0)
    _set_up_log(args.verbose - args.quiet + offset)
    refuse_swapped(args)
    require_extras(args)
    code: int = args.run(args)
    return code


def _worded(error: errors.BstmError | OSError) -> str:
    if isinstance(error, errors.ConfigError):
        count = len(error.problems)
        return f"{error}\n{count} problems" if count > 1 else str(error)
    if isinstance(error, errors.BstmError):
        return f"bstm: {error}"
    place = f"{error.filename}: " if error.filename else ""
    return f"bstm: {place}{error.strerror or error}"


def _parse(argv: list[str], called: str) -> argparse.Namespace:
    return parser_of({called}).parse_args(argv)


@contextmanager
def _not_loading(package: str) -> Iterator[None]:
    """Hide *package*, which is then loaded where its features are used.

    python-can loads asammdf and with it pandas for a format that is read
    otherwise here: 80 MB and a second for every command.
    """
    hidden = package not in sys.modules
    if hidden:
        sys.modules[package] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        if hidden:
            del sys.modules[package]


def parser_of(called: Collection[str]) -> Parser:
    """Return the parser; only modules of *called* commands are imported."""
    parser = Parser(
        prog="bstm",
        description=f"Brake temperatures from a CAN bus: {NOTICE}.",
    )
    parser.add_argument(
        "--version", action="version", version=f"bstm {__version__}: {NOTICE}"
    )
    _add_verbosity(parser, default=0)
    commands = parser.add_subparsers(
        title="commands", metavar="COMMAND", required=True
    )
    for name, summary in COMMANDS.items():
        subparser = commands.add_parser(
            name, help=summary, description=f"{summary}."
        )
        if name in called:
            with _not_loading("asammdf"):
                module = importlib.import_module(
                    f"bstm_daemon.cli.{name.replace('-', '_')}"
                )
            module.add_arguments(subparser)
            subparser.set_defaults(run=module.run)
            # keep the options that stood before the command
            _add_verbosity(subparser, default=argparse.SUPPRESS)
    return parser


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
    is_terminal = raw_stream(sys.stderr).isatty()
    use_color = is_terminal and not os.environ.get("NO_COLOR")
    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(level),
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            *(
                (
                    _visible_fields,
                    structlog.dev.ConsoleRenderer(colors=use_color),
                )
                if is_terminal
                else (structlog.processors.JSONRenderer(),)
            ),
        ],
        logger_factory=lambda *_: structlog.WriteLogger(
            raw_stream(sys.stderr)
        ),
        cache_logger_on_first_use=False,
    )


def _visible_fields(
    _: object, __: str, fields: MutableMapping[str, Any]
) -> MutableMapping[str, Any]:
    """Return the fields of a log line, the texts in them visible."""

    def shown(value: Any) -> Any:
        if isinstance(value, list):
            return [shown(item) for item in value]
        return visible(value) if isinstance(value, str) else value

    return {key: shown(value) for key, value in fields.items()}


if __name__ == "__main__":
    sys.exit(main())
