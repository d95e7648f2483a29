"""Rows of results, what takes them, and the columns of risk and advice."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Flag, auto
from operator import attrgetter
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
import numpy.typing as npt

from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.estimate import CarRisk


Column = npt.NDArray[np.float64]

STRETCH_ROWS: Final = 2048
"""Rows handed on at a time: some 8 MB of numbers, and enough of them that
what is done once a stretch costs little."""


@dataclass(frozen=True)
class Results:
    """One row a publication: those of a whole log or a stretch of them.

    ``columns`` by name, all of one length, ``time_s`` (log time) first;
    temperatures degC, everything else SI. ``corners`` are all corners,
    ``modelled`` those with temperatures.
    """

    columns: dict[str, Column]
    corners: tuple[str, ...]
    modelled: tuple[str, ...]

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.columns["time_s"])

    def stretches(self) -> Iterator[Results]:
        """Yield views of at most :data:`STRETCH_ROWS` rows, one at least."""
        for first in range(0, max(len(self), 1), STRETCH_ROWS):
            part = {
                name: column[first : first + STRETCH_ROWS]
                for name, column in self.columns.items()
            }
            yield Results(part, self.corners, self.modelled)


class Part(Flag):
    """Columns that take most of a replay's time, made for who uses them."""

    NONE = 0
    VALIDITY = auto()
    """``validity`` and ``reasons`` of the corners."""
    FORECAST = auto()
    """Risk, forecast and advice, which go by the validity."""
    ALL = VALIDITY | FORECAST


class Sink(Protocol):
    """Takes rows as they come, in order, all of the same columns."""

    @property
    def parts(self) -> Part:
        """What it uses of that which is made only on demand."""

    def write(self, rows: Results, /) -> None:
        """Take *rows*; they stay as they are afterwards."""


class Collector:
    """Keeps every row in memory."""

    def __init__(self, parts: Part = Part.ALL) -> None:
        """Begin without rows; they shall have *parts*."""
        self.parts = parts
        self._rows: list[Results] = []

    def write(self, rows: Results) -> None:
        """Keep *rows*."""
        self._rows.append(rows)

    def results(self) -> Results:
        """Return all rows so far as one; there must have been some."""
        first = self._rows[0]
        columns = {
            name: np.concatenate([part.columns[name] for part in self._rows])
            for name in first.columns
        }
        return Results(columns, first.corners, first.modelled)


class Chosen:
    """Hands on the columns of rows that are wanted."""

    def __init__(self, sink: Sink, wanted: Callable[[str], bool]) -> None:
        """Hand those on to *sink* whose names are *wanted*."""
        self.parts = sink.parts
        self._sink = sink
        self._wanted = wanted

    def write(self, rows: Results) -> None:
        """Take *rows*."""
        columns = {
            name: column
            for name, column in rows.columns.items()
            if self._wanted(name)
        }
        self._sink.write(replace(rows, columns=columns))


def is_one_of_few(name: str) -> bool:
    """Whether the column *name* is one that a collection of drives needs."""
    ends = ("_c", "margin_k", "risk", "risk_now", "risk_level", "validity")
    return name in {"time_s", "speed_ms"} or name.endswith(ends)


class ElapsedTime:
    """Time since the first row; a clock set back does not count."""

    def __init__(self) -> None:
        """Begin at zero."""
        self.total_s = 0.0
        self._last_s: float | None = None

    def extend(self, time_s: Column) -> Column:
        """Return the elapsed time [s] at further rows of log time [s]."""
        if not len(time_s):
            return time_s
        before_s = time_s[0] if self._last_s is None else self._last_s
        steps_s = np.maximum(np.diff(time_s, prepend=before_s), 0.0)
        # from the total on, so that stretches add up as one would
        steps_s[0] += self.total_s
        elapsed_s: Column = np.cumsum(steps_s)
        self.total_s = float(elapsed_s[-1])
        self._last_s = float(time_s[-1])
        return elapsed_s


CORNER_COLUMNS: Final = {
    "fluid_std_k": "fluid_deviation_k",
    "risk_now": "probability_now",
    "risk": "probability",
    "risk_level": "level",
    "fade_level": "fade",
    "peak_c": "peak_k",
    "peak_in_s": "peak_in_s",
    "safe_in_s": "safe_in_s",
    "duty_peak_c": "duty_peak_k",
    "duty_in_s": "duty_in_s",
}
"""Attribute of a :class:`~bstm_daemon.estimate.CornerRisk` by column."""

CAR_COLUMNS: Final = {
    "risk_now": "probability_now",
    "risk": "probability",
    "risk_level": "level",
    "boiling_low_c": "boiling_low_k",
    "boiling_c": "boiling_k",
    "water_percent": "water_percent",
}
"""Attribute of a :class:`~bstm_daemon.estimate.CarRisk` by column."""

ADVICE_COLUMNS: Final = {
    "advice_message": "message",
    "advice_waiting_s": "waiting_s",
    "advice_shift": "shift_advice",
    "advice_gearbox": "gearbox_request",
    "advice_pedal_feel": "pedal_feel",
    "advice_isolation": "front_isolation",
    "advice_assist": "emergency_assist",
    "advice_intervention": "intervention",
}
"""Attribute of an :class:`~bstm_daemon.estimate.Advice` by column."""

ADVICE_CODES: Final = (
    *("advice_message", "advice_shift", "advice_gearbox"),
    *("advice_isolation", "advice_assist", "advice_intervention"),
)
"""Those of them that are codes."""


def record_columns(
    attributes: Mapping[str, str], records: Sequence[object]
) -> dict[str, Column]:
    """Return columns [n] of *records* [n].

    Args:
        attributes: attribute of a record by column; codes stay numbers, of a
            temperature in kelvin a column ``..._c`` is in degC.
        records: one a row.
    """
    rows = [*map(attrgetter(*attributes.values()), records)]
    table = np.array(rows, np.float64).T
    return {
        column: values - KELVIN_OFFSET if column.endswith("_c") else values
        for column, values in zip(attributes, table, strict=True)
    }


def risk_columns(
    records: npt.NDArray[np.object_],
    times_us: npt.NDArray[np.int64],
    corners: Sequence[str],
) -> tuple[dict[str, Column], dict[str, dict[str, Column]]]:
    """Return the columns of the car and those of each of *corners*.

    *records* holds a :class:`~bstm_daemon.estimate.CarRisk` per row. One
    stays the same object for some rows, so that few are unpacked.
    """
    starts = np.flatnonzero(
        [i == 0 or one is not records[i - 1] for i, one in enumerate(records)]
    )
    runs = np.diff(starts, append=len(records))
    distinct: list[CarRisk] = [records[i] for i in starts]

    def repeated(
        attributes: Mapping[str, str], found: Sequence[object]
    ) -> dict[str, Column]:
        columns = record_columns(attributes, found)
        return {key: np.repeat(one, runs) for key, one in columns.items()}

    car = repeated(CAR_COLUMNS, distinct)
    begun = np.array(
        [np.nan if r.forecast_us is None else r.forecast_us for r in distinct],
        np.float64,
    )
    age_us: Column = times_us.astype(np.float64) - np.repeat(begun, runs)
    car["forecast_age_s"] = age_us * 1e-6
    return car, {
        name: repeated(CORNER_COLUMNS, [one.corners[name] for one in distinct])
        for name in corners
    }
