"""The errors that reach a user, as one small tree.

::

    BstmError
     +-- UsageError          wrong arguments                      exit 2
     |    +-- MissingExtraError   an optional package is absent   exit 2
     +-- LogError            a log cannot be used                 exit 65
     +-- FileAccessError     a file is missing or not writable    exit 74
     +-- StateLockedError    another instance holds the state     exit 75
     +-- ConfigError         configuration or DBC problem         exit 78

Each carries a message that names the file, line or key and says what to do.
The command line prints it to stderr and ends with ``exit_code``; nothing else
in the package turns an exception into an exit code.
"""

import difflib
from collections.abc import Iterable
from importlib.util import find_spec
from typing import Final

LISTED_NAMES: Final = 12
"""Longer lists of names are left to the documentation."""


class BstmError(Exception):
    """Base of every error with a message meant for the user."""

    exit_code = 1


class UsageError(BstmError):
    """Arguments that contradict each other or name something unknown."""

    exit_code = 2


class MissingExtraError(UsageError):
    """A command needs an optional dependency that is not installed."""

    def __init__(self, package: str, extra: str, purpose: str) -> None:
        """Name the missing *package*, the *extra* that brings it and why."""
        super().__init__(
            f"{purpose} needs the package {package!r}: "
            f"pip install 'bstm-daemon[{extra}]'"
        )


def require_packages(*packages: str, extra: str, purpose: str) -> None:
    """Refuse *purpose* where one of the *packages* of *extra* is absent.

    Raises:
        MissingExtraError: it is.
    """
    for package in packages:
        if find_spec(package.replace("-", "_")) is None:
            raise MissingExtraError(package, extra, purpose)


class LogError(BstmError):
    """A log is unusable or holds none of the wanted ids."""

    exit_code = 65


class FileAccessError(BstmError):
    """A file is missing, unreadable or unwritable."""

    exit_code = 74


class StateLockedError(BstmError):
    """Another running instance holds the state file."""

    exit_code = 75


class ConfigError(BstmError):
    """One or more configuration or DBC problems, all of them listed."""

    exit_code = 78

    def __init__(self, problems: list[str]) -> None:
        """Keep the *problems*, one complete line each."""
        super().__init__("\n".join(problems))
        self.problems = problems


def nearest(name: str, known: Iterable[str]) -> str | None:
    """Return the known name that *name* was most probably meant to be."""
    found = difflib.get_close_matches(name, list(known), n=1, cutoff=0.6)
    return found[0] if found else None


def hint(
    name: str,
    known: Iterable[str],
    elsewhere: str = "docs/reference.md lists them",
) -> str:
    """Return which of the *known* names was meant, or which there are.

    Where they are too many to be listed, *elsewhere* says who lists them; if
    it is empty, some are.
    """
    names = sorted(known)
    meant = nearest(name, names)
    if meant is not None:
        return f"did you mean '{meant}'?"
    if not names:
        return "there are none"
    if len(names) > LISTED_NAMES:
        some = ", ".join(names[:LISTED_NAMES])
        more = len(names) - LISTED_NAMES
        return elsewhere or f"known are {some} and {more} more"
    return "known are " + ", ".join(names)
