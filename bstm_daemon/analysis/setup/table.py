"""A signal table in the form of a DBC and its recording.

Each column is a signal of one message, so that names, units and behaviour are
judged as those of a CAN log. Where a table states no unit of the speed, the
accelerometer decides.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TYPE_CHECKING, Final

import numpy as np
from cantools.database.can import Database, Message, Signal

from bstm_daemon.analysis.setup.name_rules import name_matches
from bstm_daemon.analysis.setup.proposal import Proposal, propose
from bstm_daemon.analysis.setup.recording import LARGEST, Recording, collect
from bstm_daemon.analysis.setup.words import words_of
from bstm_daemon.bus.tables.source import split_unit
from bstm_daemon.bus.tables.table_log import TableReader, open_source
from bstm_daemon.bus.tables.table_plan import ColumnOutput, TableMap
from bstm_daemon.bus.tables.time_axis import TimeAxis
from bstm_daemon.config.sections import TableConfig
from bstm_daemon.errors import LogError
from bstm_daemon.units import UNITS, unit_named

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from bstm_daemon.analysis.setup.recording import Samples
    from bstm_daemon.bus.tables.source import TableSource

_MESSAGE: Final = "table"
_TIMES: Final = {
    *("time", "timestamp", "zeit", "elapsed", "utc", "timecode"),
    *("seconds", "date", "datetime", "datum", "uhrzeit"),
}
_SHORT_TIME: Final = re.compile(r"t(?![a-zA-Z])")
_OTHER_TIMES: Final = {"lap", "best", "last", "split", "sector", "shift"}
_READABLE: Final = 0.9
_COUNTS: Final = ("#", "-", "gear", "count", "(null)")
"""Texts in place of a unit, of a plain number."""

_STEP_S: Final = 0.5
_LONGEST_GAP_S: Final = 1.5
_ENOUGH: Final = 40
_CORRELATION: Final = 0.6
_FAST: Final = 75.0
"""A speed above this is not in m/s."""

_STRONG: Final = 4.0
"""An acceleration above this is not in g."""


@dataclass(slots=True)
class Table:
    """One or more tables of the same columns.

    Args:
        time: column with the time.
        columns: the column of each signal.
        unknown: columns whose unit is none of the configuration's, with it.
        assumed: signals whose unit is not stated, why it is the one taken,
            and whether the log shows it.
        database: the signals.
        recording: their samples.
    """

    time: str
    columns: dict[str, str]
    unknown: dict[str, str] = field(default_factory=dict)
    assumed: dict[str, tuple[str, bool]] = field(default_factory=dict)
    database: Database = field(default_factory=Database)
    recording: Recording = field(default_factory=Recording)


def read_table(logs: Sequence[Path]) -> Table:
    """Read all columns of *logs*, joined one after the other.

    Raises:
        FileAccessError: a table cannot be read.
        LogError: it is damaged, has no column with the time, or not the
            columns of the first one.
        MissingExtraError: a package that reads it is missing.
    """
    source = _source_of(logs[0])
    stated = source.units()
    count = Counter(source.names())
    columns: dict[str, str] = {}
    for name in (name for name in count if name and count[name] == 1):
        short = split_unit(name)[0]
        columns[name if short in columns else short] = name
    time = _time_of(logs[0], list(columns.values()), stated)
    columns = {n: column for n, column in columns.items() if column != time}
    table = Table(time, columns)
    signals = [(_MESSAGE, name) for name in columns]
    plan = TableMap(
        buses=(),
        messages={},
        timeouts_us=(),
        table=TableConfig(time=time),
        outputs=tuple(
            ColumnOutput(n, column, 1.0, 0.0, -LARGEST, LARGEST, flag=False)
            for n, column in enumerate(columns.values())
        ),
    )
    events = (TableReader(log, plan).events() for log in logs)
    collect(events, signals, table.recording)
    units = {
        name: "" if stated.get(column, "") in _COUNTS else stated.get(column)
        for name, column in columns.items()
    }
    table.unknown = {
        columns[name]: text
        for name, text in units.items()
        if text and not unit_named(text)
    }
    table.database = _database(table.recording, units)
    _assume_units(table, units)
    return table


def propose_for(table: Table) -> Proposal:
    """Propose a column of *table* for each role that one fits."""
    found = propose(table.database, table.recording)
    sure, unsure = [], list(found.unsure)
    for one in found.sure:
        reason, is_shown = table.assumed.get(one.match.signal.name, ("", True))
        worded = replace(
            one, reason="; ".join(filter(None, (reason, one.reason)))
        )
        (sure if is_shown else unsure).append(worded)
    speeds = ("vehicle_speed", "wheel_speed_")
    if not any(one.role.startswith(speeds) for one in (*sure, *unsure)):
        for one in [one for one in sure if one.role == "gnss_speed"]:
            sure.remove(one)
            match = replace(one.match, role="vehicle_speed")
            reason = f"of a receiver, so it lags; {one.reason}"
            unsure.append(replace(one, match=match, reason=reason, sure=False))
    return replace(found, sure=tuple(sure), unsure=tuple(unsure))


def unused_columns(table: Table, proposal: Proposal) -> list[str]:
    """Return the columns that are proposed for no role."""
    used = {
        one.match.signal.name for one in (*proposal.sure, *proposal.unsure)
    }
    return [c for name, c in table.columns.items() if name not in used]


def _source_of(log: Path) -> TableSource:
    return open_source(log, None, lambda *_: None)


def _time_of(log: Path, names: Iterable[str], units: dict[str, str]) -> str:
    """Return the column that has the time: readable, and it rises."""
    likely = [
        name
        for name in names
        for words in (set(words_of(split_unit(name)[0])),)
        if (words & _TIMES or _SHORT_TIME.match(name))
        and not words & _OTHER_TIMES
    ]
    chunk = next(_source_of(log).chunks(likely), None) if likely else None
    for name in likely if chunk else ():
        axis = TimeAxis(None, name, units.get(name, ""))
        stamps, good = axis.stamps(chunk.cells[name])
        steps = np.diff(stamps[good])
        if (
            len(steps)
            and np.mean(good) > _READABLE
            and np.mean(steps >= 0) > _READABLE
            and steps.sum() > 0
        ):
            return name
    listed = f" ({', '.join(likely)} do not rise)" if likely else ""
    msg = (
        f"{log}: no column has name and values of a time{listed}: name the "
        "column Time, or write [table] rate_hz and the roles by hand"
    )
    raise LogError(msg)


def _database(recording: Recording, units: dict[str, str | None]) -> Database:
    """Return the columns with samples as signals; 0 and 1 only is a flag."""
    signals = [
        Signal(
            name,
            start=0,
            length=1 if np.isin(samples.value, (0.0, 1.0)).all() else 64,
            unit=units[name] or None,
        )
        for (_, name), samples in recording.samples.items()
    ]
    message = Message(0, _MESSAGE, 64, signals, strict=False)
    return Database([message], strict=False)


def _assume_units(table: Table, units: dict[str, str | None]) -> None:
    """Give speed and acceleration the unit that they have by each other."""
    recording = table.recording
    first = {
        one.role: one.signal
        for one in reversed(name_matches(table.database))
        if one.role in ("vehicle_speed", "acceleration_longitudinal")
    }
    speed = first.get("vehicle_speed")
    accel = first.get("acceleration_longitudinal")
    choices = []
    for signal, possible, limit in (
        (speed, ("km/h", "mph", "m/s"), _FAST),
        (accel, ("g", "m/s2"), _STRONG),
    ):
        if signal is None:
            choices.append([""])
        elif units[signal.name]:
            choices.append([unit_named(units[signal.name] or "")])
        else:
            value = recording.samples[_MESSAGE, signal.name].value
            high = float(np.quantile(np.abs(value), 0.999))
            above = high > limit
            keep = possible[:2] if limit == _FAST else possible[1:]
            choices.append(list(keep if above else possible))
    shown: list[tuple[str, ...]] = []
    reason = ""
    if speed is not None and accel is not None:
        bounds = _slope(
            recording.samples[_MESSAGE, speed.name],
            recording.samples[_MESSAGE, accel.name],
        )
        shown = [
            pair
            for pair in product(*choices)
            if all(pair)
            and bounds[0]
            < UNITS[pair[1]].factor / UNITS[pair[0]].factor
            < bounds[1]
        ]
        reason = f"the table states no unit; change of speed over acceleration is {bounds[0]:.3g} to {bounds[1]:.3g} per second"
    for place, signal in enumerate((speed, accel)):
        if signal is None or units[signal.name]:
            continue
        is_shown = len({pair[place] for pair in shown}) == 1
        unit = shown[0][place] if is_shown else choices[place][0]
        signal.unit = unit
        table.assumed[signal.name] = (
            (f"{unit}: {reason}", True)
            if is_shown
            else (f"no unit is stated, {unit} assumed: check it", False)
        )


def _slope(speed: Samples, accel: Samples) -> tuple[float, float]:
    """Return bounds of the change of *speed* per second over *accel*.

    The two regressions bound it, as both may be noisy; (0, 0) where they tell
    nothing. Gaps are left out.
    """
    keep = np.concatenate([[True], np.diff(speed.time_s) > 0])
    times, values = speed.time_s[keep], speed.value[keep]
    picked = [0]
    for place, stamp in enumerate(times.tolist()):
        if stamp - times[picked[-1]] >= _STEP_S:
            picked.append(place)
    times, values = times[picked], values[picked]
    steps = np.diff(times)
    mean = (accel.value[1:] + accel.value[:-1]) / 2
    area = np.concatenate([[0.0], np.cumsum(mean * np.diff(accel.time_s))])
    rows = steps < _LONGEST_GAP_S
    x = (np.diff(np.interp(times, accel.time_s, area)) / steps)[rows]
    y = (np.diff(values) / steps)[rows]
    if len(x) < _ENOUGH or not (np.std(x) and np.std(y)):
        return 0.0, 0.0
    r = float(np.corrcoef(x, y)[0, 1])
    ratio = float(np.std(y) / np.std(x))
    if abs(r) < _CORRELATION:
        return 0.0, 0.0
    return 0.9 * ratio * abs(r), 1.1 * ratio / abs(r)
