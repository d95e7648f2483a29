"""The folder of a fleet's results: each file, its receipt, questions in SQL.

A receipt is written after all other files of its drive. Its key is the hash of
all that the results follow from, the key of the drive before among them, so
that a drive is made anew exactly where something before it has changed.
"""

import json
import re
import sys
import tomllib
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cache
from hashlib import blake2b
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final, NamedTuple

from bstm_daemon import __version__
from bstm_daemon.config.csv_tables import csv_names
from bstm_daemon.config.reading import read_toml
from bstm_daemon.errors import FileAccessError, UsageError, require_packages
from bstm_daemon.files import make_folder, replacing
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.service.state_file import safe_name

_PACKAGE: Final = Path(__file__).resolve().parents[1]
_CODE: Final = ("**/*.py", "**/*.c", "**/*.h", "**/*.toml")
_READ_BYTES: Final = 2**20
_LIBRARIES: Final = ("cantools", "numpy", "pyarrow", "distributed")


@dataclass(frozen=True)
class Options:
    """Options of a replay that change its results."""

    every_us: int
    forecast: bool


@dataclass(frozen=True)
class Drive:
    """A log in the plan; ``problem`` is why its begin could not be read.

    ``name`` is that of its files in the lake, ``first_us`` its first stamp
    [us], ``size`` and ``mtime_ns`` those of the file when it was planned.
    """

    vehicle: str
    name: str
    log: str
    first_us: int
    problem: str | None
    size: int
    mtime_ns: int
    config: str
    type: str
    map: str


@dataclass(frozen=True)
class Receipt:
    """What became of a drive: done, or failed where there is a ``message``.

    ``key`` is empty where a new attempt may end otherwise, ``last_us`` the
    last stamp [us].
    """

    key: str
    log_hash: str
    size: int
    mtime_ns: int
    message: str | None
    last_us: int | None
    options: Options
    program: dict[str, str]


@cache
def program() -> dict[str, str]:
    """Return what makes the numbers here: versions, code, kernel form."""
    code = blake2b(digest_size=16)
    files = {path for glob in _CODE for path in _PACKAGE.glob(glob)}
    for path in sorted(files):
        code.update(path.relative_to(_PACKAGE).as_posix().encode())
        code.update(path.read_bytes())
    found = {
        "bstm": __version__,
        "code": code.hexdigest(),
        "kernel": "reference" if load_kernel() is None else "compiled",
        "python": ".".join(map(str, sys.version_info[:2])),
    }
    for name in _LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "none"
    return found


def hash_of_file(path: Path) -> str:
    """Return the hash of the content of *path*.

    Raises:
        FileAccessError: it can not be read.
    """
    found = blake2b(digest_size=16)
    try:
        with path.open("rb") as file:
            while data := file.read(_READ_BYTES):
                found.update(data)
    except OSError as error:
        msg = f"{path}: cannot be read: {error.strerror or error}"
        raise FileAccessError(msg) from error
    return found.hexdigest()


def hash_of_config(path: Path) -> str:
    """Return the hash of the configuration *path* and the files it names.

    Raises:
        FileAccessError: one can not be read.
        ConfigError: the configuration is no TOML.
    """
    document = read_toml(path)
    buses = document.get("bus", [])
    names = [b.get("dbc") for b in buses] if isinstance(buses, list) else []
    names += csv_names(document)
    files = [path, *(path.parent / n for n in names if isinstance(n, str))]
    return hash_of([hash_of_file(file) for file in files])


def key_of(
    previous: str,
    drive: Drive,
    log_hash: str,
    config_hash: str,
    options: Options,
) -> str:
    """Return the key of *drive* behind the drive with the key *previous*."""
    made = [program()[name] for name in ("bstm", "code", "kernel")]
    return hash_of(
        [previous, log_hash, config_hash, drive.map, asdict(options), made]
    )


FILES: Final = {
    "estimates": "estimates/vehicle={car}/date={day}/{name}.parquet",
    "row": "drives/vehicle={car}/{name}.parquet",
    "state": "state/{car}/{name}.state",
    "page": "pages/{car}/{name}.html",
    "receipt": "receipts/{car}/{name}.json",
}
"""Files of a drive: its rows by the day of its begin, the one row about it,
the state at its end, its page if it was asked for, its receipt."""

RESULTS: Final = ("estimates", "row", "state")
"""Those of a drive that is done, beside the receipt."""


class Lake:
    """Paths of one lake, and its receipts."""

    def __init__(self, root: Path) -> None:
        """Take the folder *root*, which may not exist yet."""
        self.root = root

    @property
    def plan(self) -> Path:
        """The plan, an SQLite database."""
        return self.root / "plan.sqlite"

    def path(self, drive: Drive, kind: str, day: str = "") -> Path:
        """Return where the file *kind* of *drive* is, see :data:`FILES`."""
        begin = datetime.fromtimestamp(drive.first_us * 1e-6, UTC)
        car, day = safe_name(drive.vehicle), day or f"{begin:%Y-%m-%d}"
        place = FILES[kind].format(car=car, day=day, name=drive.name)
        return self.root / place

    def files(self, drive: Drive) -> tuple[Path, ...]:
        """Return the files of *drive* once it is done, without receipt."""
        return tuple(self.path(drive, kind) for kind in RESULTS)

    def receipt(self, drive: Drive) -> Receipt | None:
        """Return the receipt of *drive*; None without or of another form."""
        try:
            path = self.path(drive, "receipt")
            found = json.loads(path.read_text(encoding="utf-8"))
            options = Options(**found.pop("options"))
            return Receipt(**found, options=options)
        except (OSError, KeyError, TypeError, ValueError):
            return None

    def write_receipt(self, drive: Drive, receipt: Receipt) -> None:
        """Write *receipt*, whole or not at all."""
        path = self.path(drive, "receipt")
        make_folder(path.parent)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(asdict(receipt)), encoding="utf-8")

    def is_made(self, drive: Drive, receipt: Receipt, key: str) -> bool:
        """Whether what *receipt* says of *drive* was made by *key*."""
        return receipt.key == key != "" and (
            receipt.message is not None
            or all(path.exists() for path in self.files(drive))
        )

    def current(
        self,
        drive: Drive,
        previous: str,
        config_hash: str,
        options: Options | None,
    ) -> Receipt | None:
        """Return the receipt of *drive* if nothing is to be done for it.

        The log is not read: it is as it was if size and time are. Without
        *options* those that it was replayed with are right.
        """
        receipt = self.receipt(drive)
        if receipt is None or (receipt.size, receipt.mtime_ns) != (
            drive.size,
            drive.mtime_ns,
        ):
            return None
        log_hash = receipt.log_hash
        options = options or receipt.options
        key = key_of(previous, drive, log_hash, config_hash, options)
        return receipt if self.is_made(drive, receipt, key) else None

    def clear(self, drive: Drive) -> None:
        """Remove the results of *drive*, and what killed runs left of them."""
        receipt, results = self.path(drive, "receipt"), self.files(drive)
        receipt.unlink(missing_ok=True)
        for path in (*results, receipt):
            for leftover in path.parent.glob(f".{path.name}.*"):
                leftover.unlink(missing_ok=True)
        # of another day if the begin was corrected
        days = self.path(drive, "estimates", "*").relative_to(self.root)
        for path in (*self.root.glob(str(days)), *results):
            path.unlink(missing_ok=True)


def hash_of(parts: Iterable[Any]) -> str:
    """Return the hash of *parts*, plain data."""
    text = json.dumps([*parts], sort_keys=True)
    return blake2b(text.encode(), digest_size=16).hexdigest()


_TABLES: Final = {
    "estimates": """SELECT * FROM read_parquet(
        '{root}/estimates/*/*/*.parquet',
        union_by_name = true, filename = true,
        hive_types = {{'vehicle': VARCHAR, 'date': DATE}})""",
    "drives": """SELECT *, CAST("begin" AS DATE) AS date
        FROM read_parquet('{root}/drives/*/*.parquet',
        hive_types = {{'vehicle': VARCHAR}})""",
    "corners": """SELECT * EXCLUDE (corners),
        unnest(corners, recursive := true) FROM drives""",
}
"""What each table is; a later one may read an earlier one."""


class Answer(NamedTuple):
    """Names of the columns, and rows of values."""

    names: list[str]
    rows: list[tuple[Any, ...]]

    def as_rows(self) -> list[dict[str, Any]]:
        """Return the rows as values by column."""
        return [dict(zip(self.names, row, strict=True)) for row in self.rows]


def shipped() -> dict[str, dict[str, str]]:
    """Return the shipped questions by name: ``what`` they ask and ``sql``."""
    text = Path(__file__).with_name("queries.toml").read_text("utf-8")
    return tomllib.loads(text)


def ask(lake: Lake, sql: str) -> Answer:
    """Return the answer to *sql*, or to the shipped question of that name.

    The tables are ``drives``, ``corners`` of them, and ``estimates``.

    Raises:
        MissingExtraError: duckdb is not installed.
        FileAccessError: no drive of *lake* is replayed.
        UsageError: DuckDB refuses it.
    """
    require_packages("duckdb", extra="fleet", purpose="bstm fleet query")
    import duckdb  # noqa: PLC0415  (an extra)

    question = shipped().get(sql)
    sql = question["sql"] if question else sql
    if not any((lake.root / "drives").glob("*/*.parquet")):
        msg = f"{lake.root}: no drive is replayed: run 'bstm fleet replay'"
        raise FileAccessError(msg)
    with duckdb.connect() as database:
        # of a table that is not asked for no file is opened
        words = {word.lower() for word in re.findall(r"\w+", sql)}
        asked = words | ({"drives"} if "corners" in words else set())
        database.execute("SET TimeZone = 'UTC'")
        try:
            root = str(lake.root).replace("'", "''")
            for name, query in _TABLES.items():
                if name in asked:
                    view = query.format(root=root)
                    database.execute(f"CREATE VIEW {name} AS {view}")
            found = database.execute(sql)
            names = [column[0] for column in found.description or ()]
            return Answer(names, found.fetchall())
        except duckdb.Error as error:
            raise UsageError(str(error)) from error
