"""``fleet.toml``: which log is of which car, and each car's configuration."""

from __future__ import annotations

import re
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Final, NamedTuple

from pydantic import Field

from bstm_daemon.config.reading import load_section, naming_file, read_toml
from bstm_daemon.config.section import Section, Text, require
from bstm_daemon.errors import ConfigError

if TYPE_CHECKING:
    from pathlib import Path

PLACEHOLDER: Final = "{vehicle}"

_TOKENS: Final = {
    "**/": "(?:.*/)?",
    "**": ".*",
    "*": "[^/]*",
    "?": "[^/]",
    PLACEHOLDER: "(?P<vehicle>[^/]+)",
}
"""Parts of a path pattern as regular expressions, the longest first."""


class Vehicles(Section):
    """A ``[[vehicle]]`` table: one car, or all whose logs lie alike."""

    logs: Text
    """Pattern of the end of a log's path. ``*`` stays within a folder, ``**``
    does not; ``{vehicle}`` is the car's name."""
    id: Text | None = None
    """Name of the car where the pattern has no ``{vehicle}``."""
    config: Text
    """Configuration, relative to this file; it may have ``{vehicle}`` too."""
    type: Text | None = None
    """Cars of one type share what ``fleet gap`` learns; default: those of one
    configuration."""
    map: dict[str, str] = Field(default_factory=dict)
    """Interface of the logs to bus, as ``--map``."""

    def _check(self) -> None:
        require(
            self.logs.count(PLACEHOLDER) == (self.id is None),
            f"'logs' needs {PLACEHOLDER} once, or an 'id' instead of it",
        )

    @cached_property
    def _pattern(self) -> re.Pattern[str]:
        parts = re.split(
            "(" + "|".join(map(re.escape, _TOKENS)) + ")", self.logs
        )
        inner = "".join(_TOKENS.get(part, re.escape(part)) for part in parts)
        return re.compile(f"(?:.*/)?{inner}", re.DOTALL)

    def vehicle_of(self, log: Path) -> str | None:
        """Return the name of the car that *log* is of, None if of none."""
        found = self._pattern.fullmatch(log.as_posix())
        return (self.id or found["vehicle"]) if found else None


class FleetFile(Section):
    """The file."""

    vehicle: Annotated[list[Vehicles], Field(min_length=1)]


class Assignment(NamedTuple):
    """The car of a log: its name, configuration, type and interfaces."""

    vehicle: str
    config: Path
    type: str
    map: dict[str, str]


class Fleet:
    """The cars of a fleet."""

    def __init__(self, path: Path) -> None:
        """Read ``fleet.toml`` at *path*.

        Raises:
            FileAccessError: it is missing or unreadable.
            ConfigError: with every problem in it.
        """
        self._folder = path.resolve().parent
        with naming_file(path):
            if "corner" in read_toml(path):
                msg = "this is the configuration of one car, no FLEET.toml"
                raise ConfigError([f"{msg}, which lists [[vehicle]]"])
        self._vehicles = load_section(path, FleetFile).vehicle

    def assign(self, log: Path) -> Assignment | None:
        """Return the car of *log*, an absolute path: the first that fits."""
        for one in self._vehicles:
            vehicle = one.vehicle_of(log)
            if vehicle is not None:
                config = self._folder / one.config.replace(
                    PLACEHOLDER, vehicle
                )
                kind = one.type or config.stem
                return Assignment(vehicle, config, kind, one.map)
        return None
