"""Arguments that several commands share, declared once.

``-c`` is the configuration in every command; a bus channel has the long form
``--channel`` only.
"""

import argparse
from collections.abc import Callable, Iterable
from contextlib import suppress
from math import inf, isclose, isfinite, nan
from pathlib import Path
from typing import Any, Final

from bstm_daemon.errors import UsageError, require_packages
from bstm_daemon.files import ensure_writable, make_folder

LOG_ENDINGS: Final = frozenset(
    {
        *(".log", ".asc", ".blf", ".trc", ".csv", ".tsv", ".mf4", ".gz"),
        *(".vbo", ".xrk", ".xrz", ".parquet", ".h5", ".hdf5"),
    }
)


PUBLICATION_S = 0.1


def option(
    parser: argparse._ActionsContainer,
    usage: str,
    what: str,
    kind: Callable[[str], Any] | None = None,
    **more: Any,
) -> None:
    """Add what *usage* shows: ``-c --config FILE``, ``--only``, ``logs LOG``.

    Args:
        parser: of a command, or a group of it.
        usage: flags, or the name of what stands without one, then what is
            given: ``LOG`` for one, ``LOG...`` for several; a flag alone is
            true where it is given.
        what: its help.
        kind: makes the value out of its text.
        more: what argparse takes besides.
    """
    names = usage.split()
    given = "" if names[-1].startswith("-") else names.pop()
    if not names:
        names, given = [given], ""
    if given:
        more["metavar"] = given.removesuffix("...")
    elif not (kind or more):
        more["action"] = "store_true"
    if given.endswith("..."):
        more.setdefault("nargs", "+")
        more.setdefault("default", [])
    if kind is not None:
        more["type"] = kind
    parser.add_argument(*names, help=what, **more)


def shared(parser: argparse.ArgumentParser, *names: str) -> None:
    """Add those of :data:`SHARED` with these names."""
    for name in names:
        usage, what, more = SHARED[name]
        option(parser, usage, what, **more)


def add_out(parser: argparse.ArgumentParser, what: str, given: str) -> None:
    """Add ``-o --out``, where *what* goes to; ``args.out`` may be None."""
    option(parser, f"-o --out {given}", what, Path)


def add_config(parser: argparse.ArgumentParser, what: str) -> None:
    """Add ``-c --config FILE``, which may be missing, for *what*."""
    option(parser, "-c --config FILE", what, Path)


def add_force(parser: argparse.ArgumentParser, what: str) -> None:
    """Add ``--force``, which :func:`check_new` asks for."""
    option(parser, "--force", f"replace {what} if it exists")


def add_new_config(parser: argparse.ArgumentParser) -> None:
    """Add ``-o/--out NEW.toml`` and ``--force``."""
    what = "write the values into a copy of the configuration"
    add_out(parser, what, "NEW.toml")
    parser.set_defaults(out_is_config=True)
    add_force(parser, "NEW.toml")


def finite(text: str) -> float:
    """Return *text* as a finite number, nan where it is none."""
    with suppress(ValueError):
        number = float(text)
        return number if isfinite(number) else nan
    return nan


def number(
    low: float, high: float = inf, kind: type[float] = float
) -> Callable[[str], float]:
    """Return what reads an argument from *low* to *high*; int: whole ones."""

    def read(text: str) -> float:
        value: float = nan
        with suppress(ValueError):
            value = int(text) if kind is int else finite(text)
        if not low <= value <= high:
            limits = f"from {low:g} to {high:.12g}"
            if high == inf:
                limits = f"of {low:g} or more"
            name = "whole number" if kind is int else "number"
            msg = f"{text!r} is not a {name} {limits}"
            raise argparse.ArgumentTypeError(msg)
        return value

    return read


def require_extras(args: argparse.Namespace) -> None:
    """Refuse outputs whose packages are absent, before any work.

    The folder of figures is made.

    Raises:
        MissingExtraError: a package is absent.
        UsageError: there is no Chromium for figures.
        FileAccessError: their folder can not be made.
    """
    page, figures = (getattr(args, n, None) for n in ("report", "figures"))
    if page or figures:
        from bstm_daemon.report import shell  # noqa: PLC0415  (heavy)

        if page:
            shell.require_page_packages()
        if figures:
            shell.require_figure_packages()
            make_folder(figures)
    if getattr(args, "out_is_config", False) and args.out:
        require_packages("tomlkit", extra="identify", purpose="-o NEW.toml")


def refuse_swapped(args: argparse.Namespace) -> None:
    """Refuse a log in the place of the configuration, and the reverse.

    Raises:
        UsageError: by the endings of the names one stands there.
    """
    configs = (
        getattr(args, "configuration", None),
        getattr(args, "config", None),
    )
    for path in filter(None, configs):
        if LOG_ENDINGS.intersection(path.suffixes):
            msg = (
                f"{path}: this is a log, not a configuration (TOML), which "
                "is given with -c"
            )
            raise UsageError(msg)
    for path in getattr(args, "logs", ()):
        if path.suffix == ".toml":
            msg = (
                f"{path}: this is a configuration, not a log; configurations "
                "are given with -c"
            )
            raise UsageError(msg)


def refuse_overwriting(
    targets: Iterable[Path | None], sources: Iterable[Path | None]
) -> None:
    """Refuse *targets* that would overwrite a source or each other.

    Raises:
        UsageError: one would.
    """
    taken = {path.resolve() for path in sources if path is not None}
    for target in targets:
        if target is None:
            continue
        if target.resolve() in taken:
            msg = (
                f"{target}: would overwrite a file that is read or written "
                "here"
            )
            raise UsageError(msg)
        taken.add(target.resolve())


def check_targets(
    targets: Iterable[Path | None], sources: Iterable[Path | None]
) -> None:
    """Refuse *targets* before the work that fills them; None is no file.

    Raises:
        UsageError: one would overwrite a source or another target.
        FileAccessError: one can not be written.
    """
    asked = [target for target in targets if target is not None]
    refuse_overwriting(asked, sources)
    for target in asked:
        ensure_writable(target)


def check_new(target: Path | None, *, force: bool) -> None:
    """Refuse *target* if it exists and may not be replaced.

    Raises:
        UsageError: it exists, and *force* is not given.
    """
    if target is not None and target.exists() and not force:
        msg = f"{target}: exists already, give --force to replace it"
        raise UsageError(msg)


PORT: Final = number(0, 2**16 - 1, int)


def _every_s(text: str) -> float:
    seconds = finite(text)
    tenths = seconds / PUBLICATION_S
    if not (seconds > 0.0 and isclose(tenths, round(tenths), abs_tol=1e-6)):
        msg = f"{text!r} is not a positive multiple of {PUBLICATION_S} s"
        raise argparse.ArgumentTypeError(msg)
    return seconds


def _interface_and_bus(text: str) -> tuple[str, str]:
    interface, equals, bus = text.partition("=")
    if not (interface and equals):
        msg = (
            f"{text!r} is not IFACE=BUS, such as can0=chassis, or can1= to "
            "leave it out"
        )
        raise argparse.ArgumentTypeError(msg)
    return interface, bus


SHARED: Final[dict[str, tuple[str, str, dict[str, Any]]]] = {
    "config": (
        "-c --config FILE",
        "configuration of the vehicle (TOML)",
        {"kind": Path, "required": True},
    ),
    "json": (
        "--json FILE",
        "write the result as JSON to FILE as well",
        {"kind": Path},
    ),
    "report": (
        "--report FILE.html",
        "write an HTML report that needs no network",
        {"kind": Path},
    ),
    "figures": (
        "--figures DIR",
        "write each plot of the report as PNG and SVG into DIR",
        {"kind": Path},
    ),
    "map": (
        "--map IFACE=BUS",
        (
            "assign frames of the log's interface IFACE to [[bus]] BUS, or "
            "ignore them with an empty BUS; may be repeated"
        ),
        {"kind": _interface_and_bus, "action": "append", "default": []},
    ),
    "every": (
        "--every S",
        (
            "seconds from row to row of the files, a multiple of 0.1 "
            "(default: 0.1)"
        ),
        {"kind": _every_s, "default": PUBLICATION_S},
    ),
    "no-forecast": (
        "--no-forecast",
        "leave out risk and forecast",
        {"dest": "forecast", "action": "store_false"},
    ),
}
"""Arguments of several commands by name: usage, help, what else."""
