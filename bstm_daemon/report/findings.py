"""Findings of a drive: suspect inputs, heat that was not known, and when.

A finding is an input that was suspect, with the faults found meanwhile, or
heat that was not that of the heat mode; see ``docs/validity.md``. The
stretches in which a condition holds, and the stops, are found as rows come.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from bstm_daemon import channels
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.estimate import REASON_WORDS
from bstm_daemon.model.heat.plausibility import CAUSES, FAULTS, SUSPECT, WORDS
from bstm_daemon.model.heat.plausibility import reasons as words_of
from bstm_daemon.report.text import percent
from bstm_daemon.report.timescale import clock, duration

Bits = npt.NDArray[np.int64]


STANDING_MS: Final = 0.5
"""At or below this a vehicle stands, as wheel-speed sensors stop there."""

MOVING_MS: Final = 1.0
"""Above this it has driven off; between the two its state does not change."""

SHORTEST_STOP_S: Final = 10.0
"""Shortest stop with a heat soak; a shorter one is a crossing."""


@dataclass(frozen=True, slots=True)
class Stretches:
    """Total and longest duration of a condition, and its first start."""

    total_s: float
    longest_s: float
    longest_from_s: float
    first_from_s: float


class StretchFinder:
    """Adds up the stretches of a growing drive in which something holds.

    Times count from the first row. A row stands for the time since the row
    before. What holds throughout is one stretch as long as the drive.
    """

    def __init__(self, shortest_s: float = 0.0) -> None:
        """Leave out stretches that are shorter than *shortest_s*."""
        self._shortest_s = shortest_s
        self._last_s = 0.0
        # the last row before a stretch that is not over yet
        self._open_from_s: float | None = None
        self._found: Stretches | None = None

    def add(self, elapsed_s: Column, holds: npt.NDArray[np.bool_]) -> None:
        """Add rows: time since the first, whether it holds; (n,) each."""
        was = self._open_from_s is not None
        edges = np.flatnonzero(np.diff(holds, prepend=was))
        before_s = np.append(self._last_s, elapsed_s)[edges].tolist()
        for edge, last_s in zip(edges.tolist(), before_s, strict=True):
            if holds[edge]:
                self._open_from_s = last_s
            elif self._open_from_s is not None:
                self._found = self._found_with(self._open_from_s, last_s)
                self._open_from_s = None
        if len(elapsed_s):
            self._last_s = float(elapsed_s[-1])

    def stretches(self) -> Stretches | None:
        """Return what was found so far, None if there is no time in it."""
        if self._open_from_s is None:
            return self._found
        return self._found_with(self._open_from_s, self._last_s)

    def _found_with(self, from_s: float, to_s: float) -> Stretches | None:
        length_s = to_s - from_s
        if length_s <= 0.0 or length_s < self._shortest_s:
            return self._found
        found = self._found or Stretches(0.0, 0.0, from_s, from_s)
        if length_s > found.longest_s:
            found = replace(found, longest_s=length_s, longest_from_s=from_s)
        return replace(found, total_s=found.total_s + length_s)


class StopFinder:
    """Finds standstills of :data:`SHORTEST_STOP_S` or more as a drive grows.

    A vehicle that stands in the first row has not stopped. A NaN speed
    changes nothing.
    """

    def __init__(self) -> None:
        """Begin before the first row."""
        self._stops_s: list[float] = []
        self._standing: bool | None = None
        self._since_s: float | None = None
        self._last_s = 0.0

    def add(self, elapsed_s: Column, speed_ms: Column) -> None:
        """Add rows: time since the first and speed, shape (n,) each."""
        if not len(elapsed_s):
            return
        before = bool(self._standing)
        standing = _held(speed_ms <= STANDING_MS, speed_ms > MOVING_MS, before)
        if self._standing is None:
            before = bool(standing[0])
        for row in np.flatnonzero(np.diff(standing, prepend=before)).tolist():
            if standing[row]:
                self._since_s = float(elapsed_s[row])
            else:
                self._stops_s = self._with_open(float(elapsed_s[row]))
                self._since_s = None
        self._standing = bool(standing[-1])
        self._last_s = float(elapsed_s[-1])

    def stops_s(self) -> tuple[float, ...]:
        """Return the start of each so far, also of one that goes on."""
        return tuple(self._with_open(self._last_s))

    def _with_open(self, until_s: float) -> list[float]:
        since_s = self._since_s
        if since_s is None or until_s - since_s < SHORTEST_STOP_S:
            return self._stops_s
        return [*self._stops_s, since_s]


def _held(
    begins: npt.NDArray[np.bool_],
    ends: npt.NDArray[np.bool_],
    before: bool,  # noqa: FBT001
) -> npt.NDArray[np.bool_]:
    """Latch: true from a row of *begins* until a row of *ends*."""
    row = np.arange(len(begins))
    decided = np.maximum.accumulate(np.where(begins | ends, row, -1))
    latched: npt.NDArray[np.bool_] = np.where(
        decided >= 0, begins[decided], before
    )
    return latched


LEAST_S: Final = 1.0
"""Least total duration of a finding that is reported."""

_REFUSED: Final = channels.FLAGS["samples_refused"]
_STUCK: Final = channels.FLAGS["stuck"]
_FORCES: Final = channels.FLAGS["forces_contradict"]
_WHEELS: Final = _REFUSED | _STUCK | channels.FLAGS["wheels_contradict"]

_SUBJECTS: Final = {
    "speed_suspect": (0, _WHEELS | channels.FLAGS["acceleration_contradicts"]),
    "wheel_speed_suspect": (channels.WHEEL_SUSPECT, _WHEELS),
    "pressure_suspect": (
        channels.CORNER_PRESSURE_SUSPECT,
        _REFUSED
        | _STUCK
        | channels.FLAGS["switch_contradicts"]
        | channels.FLAGS["pressure_contradicts"],
    ),
    "acceleration_suspect": (
        0,
        _REFUSED | _FORCES | channels.FLAGS["acceleration_contradicts"],
    ),
    "torque_suspect": (0, _REFUSED | _FORCES),
    "temperature_suspect": (0, _REFUSED),
    "ambient_suspect": (0, 0),
    "heat_substituted": (0, 0),
    "heat_unknown": (0, 0),
    "heat_lost": (channels.HEAT_LOST, 0),
    "heat_doubt": (channels.HEAT_UNCERTAIN, 0),
}
"""By fault: the bit of the first corner, and what may be its cause."""

_NAMED: Final = SUSPECT & ~CAUSES
_NAMELESS: Final = ""


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding: for how long in all, and when it began first.

    ``corners`` are those it was about, none where it is about the car;
    ``reasons`` what was found meanwhile, in plain words.
    """

    name: str
    corners: tuple[str, ...]
    total_s: float
    from_s: float
    reasons: tuple[str, ...]

    @property
    def text(self) -> str:
        """The finding in one line."""
        where = f" ({', '.join(self.corners)})" if self.corners else ""
        why = f": {', '.join(self.reasons)}" if self.reasons else ""
        return (
            f"{self.name}{where} for {self.total_s:.0f} s, "
            f"from {self.from_s:.0f} s on{why}"
        )


class FindingCollector:
    """Finds the findings of a growing drive, in a bounded memory."""

    def __init__(self) -> None:
        """Begin without rows."""
        # the last one: causes of which no input has a bit
        names = [*_SUBJECTS, _NAMELESS]
        self._finders = {name: StretchFinder() for name in names}
        self._seen = dict.fromkeys(names, 0)

    def add(self, elapsed_s: Column, bits: Bits) -> None:
        """Add rows: time since the first and ``flags``, shape (n,) each."""
        for name, finder in self._finders.items():
            if name == _NAMELESS:
                holds = ((bits & CAUSES) != 0) & ((bits & _NAMED) == 0)
            else:
                holds = (bits & FAULTS[name]) != 0
            finder.add(elapsed_s, holds)
            self._seen[name] |= int(
                np.bitwise_or.reduce(bits[holds], initial=0)
            )

    def findings(self, corners: tuple[str, ...]) -> tuple[Finding, ...]:
        """Return the findings so far.

        *corners*: names in the order of the configuration.
        """
        found = []
        for name, finder in self._finders.items():
            held = finder.stretches()
            if held is None or held.total_s < LEAST_S:
                continue
            seen = self._seen[name]
            first, causes = _SUBJECTS.get(name, (0, CAUSES))
            about = tuple(
                corner
                for place, corner in enumerate(corners)
                if seen & first << place
            )
            why = words_of(seen & causes)
            subject = WORDS.get(name, ", ".join(why))
            why = why if name else []
            times_s = held.total_s, held.first_from_s
            found.append(Finding(subject, about, *times_s, tuple(why)))
        return tuple(found)


@dataclass(frozen=True, slots=True)
class ReasonTime:
    """A reason why estimates were not valid: how long, since when, where.

    ``share`` is that of the drive's duration.
    """

    words: str
    corners: tuple[str, ...]
    total_s: float
    share: float
    from_s: float

    @property
    def text(self) -> str:
        """The reason in one line."""
        return (
            f"{self.words} for {duration(self.total_s)} "
            f"({percent(self.share)}), from {clock(self.from_s)} on: "
            f"{' '.join(self.corners)}"
        )


class ReasonCollector:
    """Adds up why the estimates of a growing drive were not valid."""

    def __init__(self) -> None:
        """Begin without rows."""
        self._finders = {one: StretchFinder() for one in REASON_WORDS}
        self._corners: dict[int, set[str]] = {
            one: set() for one in self._finders
        }
        self._elapsed_s = 0.0

    def add(self, elapsed_s: Column, reasons: Mapping[str, Column]) -> None:
        """Add rows: time since the first, and bits by corner; (n,) each."""
        for one, finder in self._finders.items():
            holds = np.zeros(len(elapsed_s), bool)
            for corner, bits in reasons.items():
                own = (np.nan_to_num(bits).astype(np.int64) & one) != 0
                if own.any():
                    self._corners[one].add(corner)
                holds |= own
            finder.add(elapsed_s, holds)
        if len(elapsed_s):
            self._elapsed_s = float(elapsed_s[-1])

    def times(self) -> tuple[ReasonTime, ...]:
        """Return the reasons so far, the longest first."""
        found = [
            ReasonTime(
                REASON_WORDS[one],
                tuple(sorted(self._corners[one])),
                held.total_s,
                held.total_s / self._elapsed_s,
                held.first_from_s,
            )
            for one, finder in self._finders.items()
            if (held := finder.stretches()) is not None
        ]
        return tuple(sorted(found, key=lambda one: -one.total_s))
