"""A signal table in the form of a DBC and its recording.

Each column is a signal of one message, so that names, units and behaviour are
judged as those of a CAN log. Where a table states no unit of the speed, the
accelerometer decides.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, product
from math import log
from pathlib import Path
from typing import Final

import numpy as np
from cantools.database.can import Database, Message, Signal

from bstm_daemon.analysis.setup.behaviour import Motion
from bstm_daemon.analysis.setup.judging import SPEEDS
from bstm_daemon.analysis.setup.name_rules import name_matches, words_of
from bstm_daemon.analysis.setup.proposal import Candidate, Proposal, propose
from bstm_daemon.analysis.setup.recording import (
    LARGEST,
    Recording,
    Samples,
    collect,
    told,
)
from bstm_daemon.bus.tables.source import TableSource, split_unit
from bstm_daemon.bus.tables.table_log import TableReader, open_source
from bstm_daemon.bus.tables.table_plan import ColumnOutput, TableMap
from bstm_daemon.bus.tables.time_axis import TimeAxis
from bstm_daemon.config.sections import TableConfig
from bstm_daemon.errors import LogError
from bstm_daemon.roles import GROUND_LAG_S
from bstm_daemon.units import UNITS, unit_named

_MESSAGE: Final = "table"
_TIMES: Final = {
    *("time", "timestamp", "zeit", "elapsed", "utc", "timecode"),
    *("seconds", "date", "datetime", "datum", "uhrzeit"),
}
_SHORT_TIME: Final = re.compile(r"t(?![a-zA-Z])")
_OTHER_TIMES: Final = {"lap", "best", "last", "split", "sector", "shift"}
_READABLE: Final = 0.9
_COUNTS: Final = ("#", "-", "no", "gear", "count", "(null)")
"""Texts in place of a unit, of a plain number."""

_UNITS_OF: Final = {
    "vehicle_speed": ("km/h", "mph", "m/s"),
    "acceleration_longitudinal": ("g", "m/s2"),
}
"""Units of a column that states none, the likeliest first."""

_ENOUGH_S: Final = 10.0
_CORRELATION: Final = 0.7
_AGREEMENT: Final = 1.25
"""Factor between the two; that of two pairs of units is 1.6 or more."""


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


def read_table(
    logs: Sequence[Path], show: Callable[[float], None] = lambda _: None
) -> Table:
    """Read all columns of *logs*, joined one after the other.

    *show* gets the share that is done.

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
    time = source.time or _time_of(logs[0], columns.values(), stated)
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
    each = 1.0 / len(logs)
    readers = [TableReader(log, plan) for log in logs]
    events = (
        told(reader.events(), reader, number * each, each, show)
        for number, reader in enumerate(readers)
    )
    collect(events, signals, table.recording)
    units = {
        name: "" if stated.get(column) in _COUNTS else stated.get(column, "")
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
    sure: list[Candidate] = []
    unsure = list(found.unsure)
    for one in found.sure:
        reason, is_shown = table.assumed.get(one.match.signal.name, ("", True))
        reason = "; ".join(filter(None, (reason, one.reason)))
        worded = replace(one, reason=reason, sure=is_shown)
        (sure if is_shown else unsure).append(worded)
    if not any(one.role.startswith(SPEEDS) for one in (*sure, *unsure)):
        for one in [one for one in sure if one.role in GROUND_LAG_S]:
            sure.remove(one)
            match = replace(one.match, role="vehicle_speed")
            reason = f"of a receiver, so it lags; {one.reason}"
            sure.insert(0, replace(one, match=match, reason=reason))
    return replace(found, sure=tuple(sure), unsure=tuple(unsure))


def table_notes(table: Table, proposal: Proposal) -> list[str]:
    """Return what of *table* is not used or not known, a sentence each."""
    used = {
        one.match.signal.name for one in (*proposal.sure, *proposal.unsure)
    }
    unused = [c for name, c in table.columns.items() if name not in used]
    units = [f"{name} in {unit!r}" for name, unit in table.unknown.items()]
    return [
        f"{title}: {', '.join(listed)}."
        for title, listed in (
            ("Columns without a role", unused),
            ("Units that are not known", units),
        )
        if listed
    ]


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
    for name, cells in (chunk.cells if chunk else {}).items():
        axis = TimeAxis(None, name, units.get(name, ""))
        stamps, good = axis.stamps(cells)
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


def _database(recording: Recording, units: Mapping[str, str]) -> Database:
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


def _assume_units(table: Table, units: Mapping[str, str]) -> None:
    """Give speed and acceleration units by which one follows the other."""
    signals: list[Signal] = []
    choices: list[tuple[str, ...]] = []
    for role, possible in _UNITS_OF.items():
        first = [
            one.signal
            for one in name_matches(table.database)
            if one.role == role
        ][:1]
        signals += first
        choices += [
            (unit_named(units[one.name]),) if units[one.name] else possible
            for one in first
        ]
    shown = _shown(
        [table.recording.samples[_MESSAGE, one.name] for one in signals],
        choices,
    )
    for place, signal in enumerate(signals):
        if units[signal.name]:
            continue
        signal.unit = shown[place] if shown else choices[place][0]
        reason = (
            "no unit is stated, but the speed changes as the acceleration says"
            if shown
            else f"no unit is stated, {signal.unit} is assumed: check it"
        )
        table.assumed[signal.name] = reason, bool(shown)


def _shown(
    samples: Sequence[Samples], choices: Sequence[tuple[str, ...]]
) -> tuple[str, ...]:
    """Return the units of speed and acceleration that fit, or none."""
    if len(samples) < 2 or "" in chain.from_iterable(choices):
        return ()
    motion = Motion({"": samples[0]})
    if motion.moving_s < _ENOUGH_S:
        return ()
    change = motion.change_ms2[motion.moving]
    acceleration = motion.smooth(motion.on_grid(samples[1]))[motion.moving]
    scatter = float(np.std(change)), float(np.std(acceleration))
    if not all(scatter):
        return ()
    correlation = float(np.corrcoef(change, acceleration)[0, 1])
    # noise in both leaves the ratio of their scatter as it is
    off = {
        pair: abs(
            log(scatter[0] * UNITS[pair[0]].factor)
            - log(scatter[1] * UNITS[pair[1]].factor)
        )
        for pair in product(*choices)
    }
    best = min(off, key=lambda pair: off[pair])
    fits = abs(correlation) > _CORRELATION and off[best] < log(_AGREEMENT)
    return best if fits else ()
