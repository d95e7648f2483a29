"""Tables of CFD and test benches: CSV files that a configuration names.

``csv = "cfd.csv"`` stands where a table would, in ``[cooling]``, in a corner's
``cooling`` or in a property over temperature. Reading a configuration puts the
points of the file there, so nothing else knows of the file.
"""

import re
from bisect import bisect
from math import isfinite, nan
from pathlib import Path
from typing import Any, Final

from bstm_daemon.config.limits import CSV_BYTES, CSV_ROWS, read_limited
from bstm_daemon.errors import ConfigError
from bstm_daemon.units import KELVIN_OFFSET, UNITS

Table = dict[str, Any]

COLUMNS: Final = {
    "speed": ("speed_m_s", "speed_km_h", "speed_mph"),
    "cooling": ("s_per_s", "coefficient_w_m2k", "conductance_w_k"),
    "temperature": ("temperature_c", "temperature_k"),
    "heat_capacity_j_kgk": ("heat_capacity_j_kgk", "heat_capacity_kj_kgk"),
    "conductivity_w_mk": ("conductivity_w_mk",),
}
"""Heads of columns by what they are. Blanks and marks do not count, so that
``speed [km/h]`` is one of them."""

MAPS: Final = {
    "speed_km_h": (UNITS["km/h"].factor, 0.0),
    "speed_mph": (UNITS["mph"].factor, 0.0),
    "temperature_k": (1.0, -KELVIN_OFFSET),
    "heat_capacity_kj_kgk": (1e3, 0.0),
}
"""Factor and offset to the unit of the configuration, where it is another."""

PROPERTIES: Final = (
    ("disc", "heat_capacity_j_kgk"),
    ("pad", "heat_capacity_j_kgk"),
    ("pad", "conductivity_w_mk"),
)
"""Properties over temperature."""

CAPACITY_20C_J_KGK: Final = {
    "grey-iron": 460.0,
    "grey-iron-smooth": 460.0,
    "pure-iron": 449.0,
}
"""Of the built-in materials of a disc."""


def put_csv_tables(document: Table, folder: Path) -> None:
    """Put the points of all named CSV files into *document*, in place.

    Args:
        document: a parsed configuration, valid or not.
        folder: what the names are relative to.

    Raises:
        ConfigError: with a problem for each file that can not be used.
    """
    problems = []
    for where, table, key, corners in _places(document):
        try:
            if key == "cooling":
                _put_cooling(document, folder, table, corners)
            else:
                x, y, _ = _points(folder, table, "temperature", key)
                table |= {"temperature_c": x, "value": y}
        except ValueError as error:
            problems.append(f"{where}: {error}")
        del table["csv"]
    if problems:
        raise ConfigError(problems)


def csv_names(document: Table) -> list[str]:
    """Return the names of the CSV files of *document*."""
    return [str(table["csv"]) for _, table, *_ in _places(document)]


def _places(document: Table) -> list[tuple[str, Table, str, list[Table]]]:
    """List where a file is named: words, table, key, corners it is for.

    Properties are before the cooling, which depends on them.
    """
    listed = document.get("corner")
    corners = [
        one
        for one in (listed if isinstance(listed, list) else [])
        if isinstance(one, dict)
        and _part(one, "disc")
        and isinstance(one.get("cooling", {}), dict)
    ]
    own = {"csv", "s_per_s"}
    shared = [c for c in corners if not own & _part(c, "cooling").keys()]
    places = [
        (f"[[corner]] {one.get('name')} {part}.{key}.csv", table, key, [one])
        for one in corners
        for part, key in PROPERTIES
        for table in [_part(_part(one, part), key)]
    ]
    places += [
        ("[cooling] csv", _part(document, "cooling"), "cooling", shared)
    ]
    places += [
        (f"[[corner]] {one.get('name')} cooling.csv", table, "cooling", [one])
        for one in corners
        for table in [_part(one, "cooling")]
    ]
    return [place for place in places if "csv" in place[1]]


def _part(table: Table, key: str) -> Table:
    """Return the table *key* of *table*, an empty one where it is none."""
    part = table.get(key)
    return part if isinstance(part, dict) else {}


def _put_cooling(
    document: Table, folder: Path, table: Table, corners: list[Table]
) -> None:
    """Put S over speed into *table*, or what it is for each of *corners*.

    A conductance h A is ``S m cp(20 degC)``, of each disc another S.

    Raises:
        ValueError: the file can not be used, or not in this form.
    """
    speed_ms, values, column = _points(folder, table, "speed", "cooling")
    end_ms = (_part(document, "cooling") | table).get("blend_end_ms", 5.0)
    if isinstance(end_ms, int | float) and speed_ms[0] > end_ms:
        msg = (
            f"{table['csv']}: begins at {speed_ms[0]:.3g} m/s, needs a row at "
            f"or below blend_end_ms = {end_ms:g}"
        )
        raise ValueError(msg)
    if column == "s_per_s":
        table |= {"speed_ms": speed_ms, "s_per_s": values}
        return
    for corner in corners:
        disc = corner["disc"]
        cooling, thermal = (
            {**_part(document, name), **_part(corner, name)}
            for name in ("cooling", "thermal")
        )
        if cooling.get("form") != "conductance":
            msg = (
                f'{column} needs form = "conductance": it does not rise with '
                "the heat capacity of the disc, as a rate does"
            )
            raise ValueError(msg)
        try:
            cp = CAPACITY_20C_J_KGK.get(disc.get("material", "grey-iron"))
            if cp is None:
                cp = _at_20c(**disc["heat_capacity_j_kgk"])
            mass = disc["mass_kg"] * thermal.get(
                "disc_mass_correction_factor", 1.0
            )
            area = disc["total_area_m2"] if column[-3:] == "m2k" else 1.0
            s_per_s = [area / (mass * cp) * one for one in values]
        except (LookupError, TypeError, ArithmeticError):
            # the disc has a problem of its own, which is reported later
            continue
        if "cooling" not in corner:
            corner["cooling"] = {}
        corner["cooling"] |= {"speed_ms": speed_ms, "s_per_s": s_per_s}


def _at_20c(temperature_c: list[float], value: list[float]) -> float:
    """Return what a curve has at 20 degC; beyond its ends it is constant."""
    at = min(max(20.0, temperature_c[0]), temperature_c[-1])
    i = min(bisect(temperature_c, at), len(value) - 1)
    x0, x1 = temperature_c[i - 1 : i + 1]
    return value[i - 1] + (at - x0) / (x1 - x0) * (value[i] - value[i - 1])


def _points(
    folder: Path, table: Table, x: str, y: str
) -> tuple[list[float], list[float], str]:
    """Return x, y and the column of y of the file that *table* names.

    Raises:
        ValueError: it can not be used; the message has line and column.
    """
    name = table["csv"]
    inline = table.keys() & {"temperature_c", "value", "speed_ms", "s_per_s"}
    if not isinstance(name, str) or inline:
        msg = "must be the name of a file, and the only table there"
        raise ValueError(msg)
    try:
        text = read_limited(folder / name, CSV_BYTES).decode("utf-8-sig")
    except (OSError, ValueError) as error:
        msg = f"{name}: {getattr(error, 'strerror', None) or error}"
        raise ValueError(msg) from error
    lines = {
        number: line
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.startswith("#")
    }
    if not 3 <= len(lines) <= CSV_ROWS + 1:
        msg = f"{name}: needs a head and 2 to {CSV_ROWS} rows of numbers"
        raise ValueError(msg)
    first, *numbers = lines
    delimiter = next((one for one in ";\t" if one in lines[first]), ",")
    head, *rows = (line.split(delimiter) for line in lines.values())
    found: list[list[float]] = []
    for quantity in (x, y):
        column, place = _column(head, quantity, f"{name} line {first}")
        factor, offset = MAPS.get(column, (1.0, 0.0))
        values: list[float] = []
        for number, row in zip(numbers, rows, strict=True):
            cell = row[place].strip(' "') if place < len(row) else ""
            where = f"{name} line {number} column {column}: {cell!r}"
            value = _number(cell, delimiter) * factor + offset
            reason = ""
            if not isfinite(value):
                reason = "is no number"
            elif quantity == x and values and value <= values[-1]:
                reason = "must be above the row before"
            elif quantity != "temperature" and value < 0.0:
                reason = "must not be negative"
            if reason:
                msg = f"{where} {reason}"
                raise ValueError(msg)
            values.append(value)
        found.append(values)
    return found[0], found[1], column


def _column(head: list[str], quantity: str, where: str) -> tuple[str, int]:
    """Return the column of *quantity*, one of its heads, and its place."""
    allowed = {_letters(one): one for one in COLUMNS[quantity]}
    found = [
        (allowed[_letters(one)], place)
        for place, one in enumerate(head)
        if _letters(one) in allowed
    ]
    if len(found) != 1:
        msg = (
            f"{where}: needs one column of {', '.join(allowed.values())}, "
            f"has {', '.join(head)}"
        )
        raise ValueError(msg)
    return found[0]


def _letters(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.lower().replace("²", "2"))


def _number(cell: str, delimiter: str) -> float:
    """Return the number in *cell*, nan where it is none."""
    text = cell if delimiter == "," else cell.replace(",", ".")
    try:
        return float(text) if "_" not in text else nan
    except ValueError:
        return nan
