"""Questions to a lake, in SQL."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from bstm_daemon.errors import FileAccessError, UsageError, require_packages

if TYPE_CHECKING:
    from bstm_daemon.fleet.lake import Lake

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
