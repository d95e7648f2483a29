"""Reads a configuration file and reports every problem of it at once.

Each section is validated by itself, so that a bad ``[vehicle]`` hides no bad
signal; then the rules between sections run over the sections that are valid.
"""

import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any, Final, TypeVar, get_args, get_origin

from pydantic import ValidationError

from bstm_daemon.config import limits
from bstm_daemon.config.csv_tables import put_csv_tables
from bstm_daemon.config.rules import Draft, problems_between
from bstm_daemon.config.section import Section
from bstm_daemon.config.sections import Config
from bstm_daemon.config.wording import problems_of_section, toml_text
from bstm_daemon.errors import ConfigError, FileAccessError, hint

S = TypeVar("S", bound="Section")

_REQUIRED: Final = ("vehicle", "bus", "signals", "corner")
_WITHOUT_DEFAULTS: Final = ("vehicle", "table")
_TOO_DEEP: Final = f"tables and lists nested deeper than {limits.TOML_DEPTH}"
_TOO_LARGE: Final = f"an integer of more than {limits.TOML_INTEGER_BITS} bits"
_POSITION: Final = re.compile(r"(.*) \(at (.*)\)$", re.DOTALL)


def load_config(path: Path) -> Config:
    """Read and validate the configuration file *path*.

    Paths inside it (``dbc``, ``csv``) are relative to its folder.

    Raises:
        FileAccessError: The file is missing or unreadable.
        ConfigError: With one line for every problem,
            ``FILE: [section] key = value: reason, allowed range``.

    """
    with naming_file(path):
        document = with_ignored_buses(read_toml(path))
        put_csv_tables(document, path.parent)
        _, problems = draft_of(document)
        if problems:
            raise ConfigError(problems)
    written = {name: value for name, value in document.items() if value}
    return Config.model_validate(written)


def load_section(path: Path, model: type[S]) -> S:
    """Read a file that is one section of its own, such as the bridge's.

    Raises:
        FileAccessError: The file is missing or unreadable.
        ConfigError: With one line for every problem.
    """
    problems: list[str] = []
    with naming_file(path):
        section = _validated(read_toml(path), model, "", problems)
        if section is None:
            raise ConfigError([problem.strip() for problem in problems])
    return section


def read_draft(path: Path) -> tuple[Draft, list[str]]:
    """Read *path* as far as it is valid; also list its problems.

    Raises:
        FileAccessError: The file is missing or unreadable.
        ConfigError: It is not TOML, beyond a limit, or names a CSV file that
            can not be used.

    """
    document = with_ignored_buses(read_toml(path))
    put_csv_tables(document, path.parent)
    return draft_of(document)


def draft_of(document: dict[str, Any]) -> tuple[Draft, list[str]]:
    """Take what is valid of a parsed file; also list its problems."""
    problems = [*_section_names(document)]
    valid = {
        name: _valid(document, name, problems) for name in Config.model_fields
    }
    names = [one.name for one in fields(Draft) if one.name in valid]
    draft = Draft(document, **{name: valid[name] for name in names})
    problems.extend(problems_between(draft))
    return draft, problems


def with_ignored_buses(document: dict[str, Any]) -> dict[str, Any]:
    """Return *document* with its ``[[bus]]`` of ``ignore = true`` merged.

    Their names become ``ignored_interfaces`` of the first other bus.
    """
    buses = document.get("bus")
    if not isinstance(buses, list):
        return document
    read, names = [], []
    for bus in buses:
        if isinstance(bus, dict) and bus == {
            "name": bus.get("name"),
            "ignore": True,
        }:
            names.append(bus["name"])
        else:
            read.append(bus)
    if not (names and read and isinstance(read[0], dict)):
        return document
    listed = read[0].get("ignored_interfaces", [])
    first = read[0] | {"ignored_interfaces": [*listed, *names]}
    return document | {"bus": [first, *read[1:]]}


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Put the file's name before each problem of a ConfigError from inside."""
    try:
        yield
    except ConfigError as error:
        lines = [f"{path}: {problem}" for problem in error.problems]
        raise ConfigError(lines) from error


def read_toml(path: Path) -> dict[str, Any]:
    """Return the document of the TOML file *path*.

    Raises:
        FileAccessError: it is missing or unreadable.
        ConfigError: it is no TOML, or beyond the limits.
    """
    try:
        text = limits.read_limited(path, limits.TOML_BYTES).decode("utf-8")
    except OSError as error:
        msg = f"{path}: {error.strerror}, give a readable configuration file"
        raise FileAccessError(msg) from error
    except UnicodeDecodeError as error:
        msg = f"byte {error.start}: is not UTF-8, save the file as UTF-8"
        raise ConfigError([msg]) from error
    except ValueError as error:
        raise ConfigError([str(error)]) from error
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = _POSITION.match(str(error))
        reason, place = found.groups() if found else (str(error), "TOML")
        raise ConfigError([f"{place}: {reason}"]) from error
    except RecursionError as error:
        raise ConfigError([f"TOML: {_TOO_DEEP}"]) from error
    except ValueError as error:
        # of Python's own limit on the digits of a number
        raise ConfigError([f"TOML: {_TOO_LARGE}"]) from error
    _require_limits(document)
    return document


def _require_limits(document: dict[str, Any]) -> None:
    """Refuse what is nested too deep and integers that are too large."""
    level: list[tuple[str, Any]] = list(document.items())
    for _ in range(limits.TOML_DEPTH):
        inner: list[tuple[str, Any]] = []
        for place, value in level:
            if isinstance(value, dict):
                inner += ((f"{place}.{k}", one) for k, one in value.items())
            elif isinstance(value, list):
                inner += ((f"{place}[{k}]", v) for k, v in enumerate(value))
            elif (
                isinstance(value, int)
                and value.bit_length() > limits.TOML_INTEGER_BITS
            ):
                raise ConfigError([f"{place}: {_TOO_LARGE}"])
        level = inner
    if level:
        raise ConfigError([f"{level[0][0]}: {_TOO_DEEP}"])


def _section_names(document: dict[str, Any]) -> Iterator[str]:
    known = Config.model_fields
    for name, value in document.items():
        if name in known:
            continue
        if isinstance(value, dict):
            problem = f"[{name}]: unknown section"
        elif isinstance(value, list):
            problem = f"[[{name}]]: unknown section"
        else:
            problem = f"{name} = {toml_text(value)}: is before any section"
        yield f"{problem}, {hint(name, known)}"
    for name in _REQUIRED:
        needless = name == "bus" and _only_columns(document.get("signals"))
        if not (document.get(name) or needless):
            yield f"{_heading(name)}: missing, every file needs it"


def _only_columns(signals: object) -> bool:
    """Whether all roles come from a table, so that no bus is needed."""
    tables = list(signals.values()) if isinstance(signals, dict) else []
    return bool(tables) and all(
        isinstance(table, dict) and "column" in table for table in tables
    )


def _heading(name: str) -> str:
    if name == "signals":
        return "[signals.<role>]"
    return f"[[{name}]]" if _form(name)[0] is list else f"[{name}]"


def _form(name: str) -> tuple[type | None, type[Section]]:
    """Return what holds section *name* (list, dict, else none), its model."""
    annotation: Any = Config.model_fields[name].annotation
    models = [one for one in get_args(annotation) if one is not type(None)]
    origin = get_origin(annotation)
    holder = origin if origin in {list, dict} else None
    return holder, models[-1] if models else annotation


def _valid(document: dict[str, Any], name: str, problems: list[str]) -> Any:
    """Return the valid sections *name* in the form that Config has."""
    holder, model = _form(name)
    empty: Any = [] if holder is list else {}
    value = document.get(name, empty)
    if not isinstance(value, type(empty)):
        problems.append(f"{name}: must be written {_heading(name)}")
        return empty if holder else None
    if holder is list:
        sections = [
            _validated(one, model, f"[[{name}]] {_label(one, n)}", problems)
            for n, one in enumerate(value, start=1)
        ]
        return [one for one in sections if one is not None]
    if holder is dict:
        found = {
            key: _validated(table, model, f"[{name}.{key}]", problems)
            for key, table in value.items()
        }
        return {key: one for key, one in found.items() if one is not None}
    if name in _WITHOUT_DEFAULTS and not value:
        return None
    return _validated(value, model, f"[{name}]", problems)


def _label(table: object, number: int) -> str:
    label = table.get("name") if isinstance(table, dict) else None
    return label if label and isinstance(label, str) else f"number {number}"


def _validated(
    table: object, model: type[S], where: str, problems: list[str]
) -> S | None:
    try:
        return model.model_validate(table)
    except ValidationError as error:
        problems.extend(problems_of_section(error, model, where))
        return None
