"""Reads a configuration file and reports every problem of it at once.

Each section is validated by itself, so that a bad ``[vehicle]`` hides no bad
signal; then the rules between sections run over the sections that are valid.
"""

from __future__ import annotations

import re
import tomllib
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final, TypeVar

from pydantic import ValidationError

from bstm_daemon.config import (
    BusConfig,
    Config,
    CoolingConfig,
    CornerConfig,
    EffectConfig,
    HeatConfig,
    SignalConfig,
    TableConfig,
    ThermalConfig,
    VehicleConfig,
)
from bstm_daemon.config_accuracy import AccuracyConfig
from bstm_daemon.config_advice import AdviceConfig
from bstm_daemon.config_errors import hint, problems_of_section, toml_text
from bstm_daemon.config_fluid import FluidConfig, ForecastConfig
from bstm_daemon.config_rules import Draft, problems_between
from bstm_daemon.config_section import Section
from bstm_daemon.config_service import (
    DaemonConfig,
    E2eConfig,
    MetricsConfig,
    PublishConfig,
    RecordConfig,
    StateConfig,
)
from bstm_daemon.config_wear import WearConfig
from bstm_daemon.errors import ConfigError, FileAccessError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

S = TypeVar("S", bound=Section)

_TABLES: Final[dict[str, type[Section]]] = {
    "vehicle": VehicleConfig,
    "table": TableConfig,
    "thermal": ThermalConfig,
    "cooling": CoolingConfig,
    "accuracy": AccuracyConfig,
    "heat": HeatConfig,
    "fluid": FluidConfig,
    "wear": WearConfig,
    "forecast": ForecastConfig,
    "publish": PublishConfig,
    "advice": AdviceConfig,
    "state": StateConfig,
    "daemon": DaemonConfig,
    "record": RecordConfig,
    "metrics": MetricsConfig,
}
_ARRAYS: Final[dict[str, type[Section]]] = {
    "bus": BusConfig,
    "corner": CornerConfig,
    "effect": EffectConfig,
    "e2e": E2eConfig,
}
_REQUIRED: Final = ("vehicle", "bus", "signals", "corner")
_WITHOUT_DEFAULTS: Final = ("vehicle", "table")
_POSITION: Final = re.compile(r"(.*) \(at (.*)\)$", re.DOTALL)


def load_config(path: Path) -> Config:
    """Read and validate the configuration file *path*.

    Paths inside it (``dbc``) are relative to its folder, ``path.parent``.

    Raises:
        FileAccessError: The file is missing or unreadable.
        ConfigError: With one line for every problem,
            ``FILE: [section] key = value: reason, allowed range``.

    """
    with naming_file(path):
        draft, problems = read_draft(path)
        if problems:
            raise ConfigError(problems)
    sections = {
        name: value
        for name in Config.model_fields
        if (value := getattr(draft, name))
    }
    return Config(**sections)


def read_draft(path: Path) -> tuple[Draft, list[str]]:
    """Read *path* as far as it is valid; also list its problems.

    Raises:
        FileAccessError: The file is missing or unreadable.
        ConfigError: It is not TOML.

    """
    return draft_of(_read(path))


def draft_of(document: dict[str, Any]) -> tuple[Draft, list[str]]:
    """Take what is valid of a parsed file; also list its problems."""
    draft = Draft()
    problems = [*_section_names(document)]
    for name, model in _TABLES.items():
        setattr(draft, name, _table(document, name, model, problems))
    for name, model in _ARRAYS.items():
        setattr(draft, name, _array(document, name, model, problems))
    draft.signals = _signals(document, problems)
    draft.written_table = bool(document.get("table"))
    draft.written_buses = _tables(document.get("bus"))
    draft.written_corners = _tables(document.get("corner"))
    signals = document.get("signals")
    if isinstance(signals, dict):
        draft.written_signals = {
            role: table
            for role, table in signals.items()
            if isinstance(table, dict)
        }
    problems.extend(problems_between(draft))
    return draft, problems


@contextmanager
def naming_file(path: Path) -> Iterator[None]:
    """Put the file's name before each problem of a ConfigError from inside."""
    try:
        yield
    except ConfigError as error:
        lines = [f"{path}: {problem}" for problem in error.problems]
        raise ConfigError(lines) from error


def _read(path: Path) -> dict[str, Any]:
    try:
        text = path.read_bytes().decode("utf-8")
    except OSError as error:
        msg = f"{path}: {error.strerror}, give a readable configuration file"
        raise FileAccessError(msg) from error
    except UnicodeDecodeError as error:
        msg = f"byte {error.start}: is not UTF-8, save the file as UTF-8"
        raise ConfigError([msg]) from error
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = _POSITION.match(str(error))
        reason, place = found.groups() if found else (str(error), "TOML")
        raise ConfigError([f"{place}: {reason}"]) from error


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
            problem = f"{name} = {toml_text(value)}: stands before any section"
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
    return f"[[{name}]]" if name in _ARRAYS else f"[{name}]"


def _table(
    document: dict[str, Any],
    name: str,
    model: type[Section],
    problems: list[str],
) -> Section | None:
    table = document.get(name, {})
    if not isinstance(table, dict):
        problems.append(f"{name}: must be one section, written [{name}]")
        return None
    if name in _WITHOUT_DEFAULTS and not table:
        return None
    return _validated(table, model, f"[{name}]", problems)


def _array(
    document: dict[str, Any],
    name: str,
    model: type[Section],
    problems: list[str],
) -> list[Section]:
    tables = document.get(name, [])
    if not isinstance(tables, list):
        problems.append(f"[{name}]: must be written [[{name}]], one each")
        return []
    sections = []
    for number, table in enumerate(tables, start=1):
        label = table.get("name") if isinstance(table, dict) else None
        if not (label and isinstance(label, str)):
            label = f"number {number}"
        section = _validated(table, model, f"[[{name}]] {label}", problems)
        if section is not None:
            sections.append(section)
    return sections


def _signals(
    document: dict[str, Any], problems: list[str]
) -> dict[str, SignalConfig]:
    tables = document.get("signals", {})
    if not isinstance(tables, dict):
        problems.append("signals: must be sections, written [signals.<role>]")
        return {}
    signals = {}
    for role, table in tables.items():
        where = f"[signals.{role}]"
        signal = _validated(table, SignalConfig, where, problems)
        if signal is not None:
            signals[role] = signal
    return signals


def _validated(
    table: object, model: type[S], where: str, problems: list[str]
) -> S | None:
    try:
        return model.model_validate(table)
    except ValidationError as error:
        problems.extend(problems_of_section(error, model, where))
        return None


def _tables(value: object) -> list[dict[str, Any]]:
    listed = value if isinstance(value, list) else []
    return [table for table in listed if isinstance(table, dict)]
