"""The plan of a lake: every log with its car and its begin, in order.

``fleet.toml`` says which log is of which car, and each car's configuration.
The plan is an SQLite database, so that one of 100 000 drives is sorted and
read without holding it in memory.
"""

import json
import os
import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import astuple, fields
from functools import cached_property, lru_cache
from hashlib import blake2b
from pathlib import Path
from typing import Annotated, Final, NamedTuple

from pydantic import Field

from bstm_daemon import errors
from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.config.reading import load_section, naming_file, read_toml
from bstm_daemon.config.section import Section, Text, require
from bstm_daemon.files import make_folder
from bstm_daemon.fleet.lake import Drive, Lake
from bstm_daemon.replay.vehicle import load_vehicle
from bstm_daemon.service.state_file import safe_name

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
                raise errors.ConfigError([f"{msg}, which lists [[vehicle]]"])
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


_COLUMNS: Final = tuple(field.name for field in fields(Drive))
_SELECT: Final = f"SELECT {', '.join(_COLUMNS)} FROM drive"  # noqa: S608
_INSERT: Final = (
    f"INSERT OR REPLACE INTO drive ({', '.join(_COLUMNS)}) "  # noqa: S608
    f"VALUES ({', '.join('?' * len(_COLUMNS))})"
)
_SHOWN: Final = 10
_UNPLACED_US: Final = 0

_TABLE: Final = """
CREATE TABLE IF NOT EXISTS drive (
    vehicle TEXT, name TEXT, log TEXT PRIMARY KEY, first_us INTEGER,
    problem TEXT, size INTEGER, mtime_ns INTEGER, config TEXT, type TEXT,
    map TEXT, UNIQUE (vehicle, name));
CREATE INDEX IF NOT EXISTS chain ON drive (vehicle, first_us);
"""


class Plan:
    """The plan of one lake."""

    def __init__(self, lake: Lake) -> None:
        """Open the plan of *lake* for reading.

        Raises:
            FileAccessError: there is none.
        """
        if not lake.plan.is_file():
            msg = f"{lake.plan}: no plan: make it with 'bstm fleet plan'"
            raise errors.FileAccessError(msg)
        self._database = sqlite3.connect(lake.plan)

    def __len__(self) -> int:
        """Return the number of drives."""
        return self._count("*")

    def cars(self) -> int:
        """Return the number of cars."""
        return self._count("DISTINCT vehicle")

    def vehicles(self) -> list[str]:
        """Return the names of the cars, those with most data first."""
        rows = self._database.execute(
            "SELECT vehicle FROM drive GROUP BY vehicle "
            "ORDER BY sum(size) DESC, vehicle"
        )
        return [vehicle for (vehicle,) in rows]

    def chain(self, vehicle: str) -> Iterator[Drive]:
        """Give the drives of *vehicle* in the order of their begins."""
        query = (
            f"{_SELECT} WHERE vehicle = ? "
            "ORDER BY first_us, problem IS NOT NULL, name"
        )
        rows = self._database.execute(query, (vehicle,))
        for row in rows:
            yield Drive(*row)

    def close(self) -> None:
        """Close the database."""
        self._database.close()

    def _count(self, what: str) -> int:
        query = f"SELECT count({what}) FROM drive"  # noqa: S608
        found: int = self._database.execute(query).fetchone()[0]
        return found


def add_logs(
    lake: Lake,
    fleet: Fleet,
    paths: Iterable[Path],
    progress: Callable[[int, Path], None] = lambda _, __: None,
) -> list[Drive]:
    """Add the logs in *paths*, files and folders, to the plan of *lake*.

    A log of the plan that is as it was is not opened. A log whose begin can
    not be read goes behind the log of this car whose name comes before its
    own.

    Args:
        lake: made where it is missing.
        fleet: says which car a log is of; in a folder, a file of none is
            left out.
        paths: of logs.
        progress: called with the number of logs so far and the next one.

    Returns:
        The logs whose begin can not be read; the others are not returned.

    Raises:
        UsageError: a file is of no car, or two logs of a car begin at the
            same time; all are named, and the plan is as before.
        FileAccessError: a path or a configuration is missing.
        ConfigError: a configuration has a problem.
    """
    make_folder(lake.root)
    with closing(sqlite3.connect(lake.plan)) as database, database:
        for statement in _TABLE.split(";"):
            database.execute(statement)
        strange = []
        for number, (path, named) in enumerate(_files(paths)):
            assigned = fleet.assign(path)
            if assigned is not None:
                progress(number, path)
                _add(database, path, assigned)
            elif named:
                strange.append(str(path))
        _refuse("of no [[vehicle]] of fleet.toml", strange)
        twins = database.execute(
            "SELECT vehicle || ': ' || group_concat(log, ' and ') FROM drive "
            "WHERE problem IS NULL GROUP BY vehicle, first_us "
            "HAVING count(*) > 1"
        )
        _refuse("logs of a car that begin together", [row[0] for row in twins])
        return _place(database)


def _refuse(what: str, found: list[str]) -> None:
    if found:
        more = f" and {len(found) - _SHOWN} more" * (len(found) > _SHOWN)
        msg = f"{what}: {'; '.join(found[:_SHOWN])}{more}"
        raise errors.UsageError(msg)


def _files(paths: Iterable[Path]) -> Iterator[tuple[Path, bool]]:
    """Give the files, sorted within a folder, and whether it was named."""
    for path in paths:
        if not path.exists():
            msg = f"{path}: No such file or directory"
            raise errors.FileAccessError(msg)
        if not path.is_dir():
            yield path.resolve(), True
            continue
        for folder, folders, names in os.walk(path.resolve()):
            folders.sort()
            for name in sorted(names):
                yield Path(folder) / name, False


def _add(
    database: sqlite3.Connection, path: Path, assigned: Assignment
) -> None:
    log, stat = str(path), path.stat()
    known = database.execute(
        "SELECT size, mtime_ns, name, first_us, problem, vehicle FROM drive "
        "WHERE log = ?",
        (log,),
    ).fetchone()
    same_car = known is not None and known[5] == assigned.vehicle
    if same_car and known[:2] == (stat.st_size, stat.st_mtime_ns):
        first_us, problem = known[3:5]
    else:
        first_us, problem = _begin(path, assigned)
    name = known[2] if same_car else _new_name(database, path, assigned)
    drive = Drive(
        vehicle=assigned.vehicle,
        name=name,
        log=log,
        first_us=first_us,
        problem=problem,
        size=stat.st_size,
        mtime_ns=stat.st_mtime_ns,
        config=str(assigned.config),
        type=assigned.type,
        map=json.dumps(assigned.map),
    )
    database.execute(_INSERT, astuple(drive))


def _new_name(
    database: sqlite3.Connection, path: Path, assigned: Assignment
) -> str:
    """Return a name for the files of the log *path* that none has yet."""
    name = safe_name(path.name.partition(".")[0] or path.name)
    taken = database.execute(
        "SELECT 1 FROM drive WHERE vehicle = ? AND name = ?",
        (assigned.vehicle, name),
    ).fetchone()
    if taken is None:
        return name
    digest = blake2b(str(path).encode(), digest_size=6).hexdigest()
    return f"{name}-{digest}"


def _begin(path: Path, assigned: Assignment) -> tuple[int, str | None]:
    """Return the first stamp of the log *path* [us], or why there is none."""
    try:
        signal_map = _signal_map(assigned.config)
        for events in EventLog(path, signal_map, assigned.map).events():
            if len(events.time_us):
                return int(events.time_us[0]), None
        problem = f"{path}: no sample"
    except (errors.LogError, errors.FileAccessError) as error:
        problem = str(error)
    except errors.BstmError:
        raise
    except Exception as error:  # noqa: BLE001  (a log may hold anything)
        problem = f"{path}: {type(error).__name__}: {error}"
    return _UNPLACED_US, problem


@lru_cache(maxsize=32)
def _signal_map(config: Path) -> SignalMap:
    return load_vehicle(config)[1]


def _place(database: sqlite3.Connection) -> list[Drive]:
    """Place the logs without a begin by their names, and return them."""
    query = f"{_SELECT} WHERE problem IS NOT NULL ORDER BY vehicle, name"
    rows = database.execute(query)
    found = [Drive(*row) for row in rows]
    for drive in found:
        database.execute(
            "UPDATE drive SET first_us = (SELECT coalesce(max(first_us), ?) "
            "FROM drive WHERE vehicle = ? AND name < ? AND problem IS NULL) "
            "WHERE log = ?",
            (_UNPLACED_US, drive.vehicle, drive.name, drive.log),
        )
    return found
