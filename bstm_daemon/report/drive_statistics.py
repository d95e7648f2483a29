"""Statistics of a drive: peaks, margin, brake energy, validity; and as text.

The table on the screen and the HTML page say the same because both take it
from here. Times are seconds since the first row.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.channels import FLAGS
from bstm_daemon.model.heat.needs import INPUTS
from bstm_daemon.replay.results import ElapsedTime, Part, Results
from bstm_daemon.report.findings import (
    STANDING_MS,
    Finding,
    FindingCollector,
    ReasonCollector,
    ReasonTime,
    StopFinder,
    Stretches,
    StretchFinder,
)
from bstm_daemon.report.text import columns, percent, wrapped
from bstm_daemon.report.timescale import HOUR_S, clock, duration

SHORTEST_GAP_S: Final = 1.0
"""Shortest gap of an input; a shorter one is a late frame."""

SUMMARY_NODES: Final = ("disc", "pad_front", "pad_back", "fluid")
"""Nodes whose peaks a summary holds."""

RISING_K: Final = 1.0
"""Least rise over a log that is worth a word at its end."""

VALIDITY_NAMES: Final = ("valid", "degraded", "invalid")
"""Names of the codes 0, 1 and 2 of a validity column."""


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest temperature of a node.

    ``after_stop_s`` counts from the last stop before the peak; where none
    came before, from the first one after it, negative. None without a stop.
    ``validity`` is the code of the estimate at the peak. ``at_end``: it is
    the last row and :data:`RISING_K` above the first, so the real peak comes
    after the log.
    """

    temperature_c: float
    time_s: float
    after_stop_s: float | None
    validity: int
    at_end: bool


@dataclass(frozen=True, slots=True)
class CornerSummary:
    """One corner. None stands for what the results do not hold.

    ``energies_j`` are the brake energy that heated the model, then those by
    Feed-Forward and Feed-Back. ``validity_shares`` are fractions of the rows,
    in the order of :data:`VALIDITY_NAMES`.
    """

    corner: str
    modelled: bool
    peaks: dict[str, Peak]
    margin_k: float | None
    wet_boiling_point_c: float | None
    energies_j: tuple[float | None, ...]
    validity_shares: tuple[float, float, float] | None

    @property
    def after_stop_s(self) -> float | None:
        """How long after the stop the fluid peaked, see :class:`Peak`."""
        fluid = self.peaks.get("fluid")
        return None if fluid is None else fluid.after_stop_s


@dataclass(frozen=True, slots=True)
class DriveSummary:
    """A drive and its corners, front axle first."""

    start_s: float
    duration_s: float
    distance_m: float | None
    top_speed_ms: float | None
    standing_s: float | None
    stops_s: tuple[float, ...]
    corners: tuple[CornerSummary, ...]
    findings: tuple[Finding, ...] = ()
    """Suspect inputs, and when the heat was not known."""
    reasons: tuple[ReasonTime, ...] = ()
    """Why estimates were not valid, the longest first."""


class DriveStatistics:
    """A sink that keeps what a summary needs; columns may be missing."""

    def __init__(self, parts: Part = Part.VALIDITY) -> None:
        """Begin without rows; they shall have *parts*."""
        self.parts = parts
        self.rows = 0
        self._start_s = 0.0
        self._time = ElapsedTime()
        self._gaps = {
            name: StretchFinder(SHORTEST_GAP_S)
            for name in sorted({n for names in INPUTS.values() for n in names})
        }
        self._findings = FindingCollector()
        self._reasons = ReasonCollector()
        # in the order of the configuration, as the bits of the flags
        self._places: tuple[str, ...] = ()
        self._stops = StopFinder()
        self._standing_s = _Integral()
        self._travelled_m = _Integral()
        self._top_speed_ms = _Highest()
        self._counter_m: tuple[float, float] | None = None
        self._corners: dict[str, _CornerStatistics] = {}

    def write(self, rows: Results) -> None:
        """Take *rows*, in stretches of the same length always."""
        if not self._corners:  # front left, front right, then the rear
            self._places = rows.corners
            self._corners = {
                name: _CornerStatistics(name, modelled=name in rows.modelled)
                for name in sorted(rows.corners)
            }
        for stretch in rows.stretches():
            self._add(stretch.columns)

    def gaps(self, heat_mode: str) -> dict[str, Stretches]:
        """Return when inputs that *heat_mode* needs were missing, by name.

        While the bus of a parked car sleeps, none is.
        """
        found = {n: self._gaps[n].stretches() for n in INPUTS[heat_mode]}
        return {name: gap for name, gap in found.items() if gap is not None}

    def summary(self) -> DriveSummary:
        """Return the summary of all rows so far."""
        stops_s = self._stops.stops_s()
        distance_m = self._travelled_m.total
        if self._counter_m is not None:
            distance_m = self._counter_m[1] - self._counter_m[0]
        return DriveSummary(
            start_s=self._start_s,
            duration_s=self._time.total_s,
            distance_m=distance_m,
            top_speed_ms=self._top_speed_ms.value,
            standing_s=self._standing_s.total,
            stops_s=stops_s,
            corners=tuple(
                corner.summary(self.rows, stops_s)
                for corner in self._corners.values()
            ),
            findings=self._findings.findings(self._places),
            reasons=self._reasons.times(),
        )

    def _add(self, columns: Mapping[str, Column]) -> None:
        time_s = columns["time_s"]
        if not len(time_s):
            return
        if not self.rows:
            self._start_s = float(time_s[0])
        before_s = self._time.total_s
        elapsed_s = self._time.extend(time_s)
        steps_s = np.diff(elapsed_s, prepend=before_s)
        unseen = np.zeros(len(time_s), bool)
        if "flags" in columns:
            bits = columns["flags"].astype(np.int64)
            asleep = (bits & FLAGS["asleep"]) != 0
            for name, gap in self._gaps.items():
                missing = (bits & FLAGS[f"{name}_missing"]) != 0
                gap.add(elapsed_s, missing & ~asleep)
            unseen = ((bits & FLAGS["speed_missing"]) != 0) & ~asleep
            self._findings.add(elapsed_s, bits)
        reasons = {
            name: columns[f"{name}.reasons"]
            for name in self._corners
            if f"{name}.reasons" in columns
        }
        self._reasons.add(elapsed_s, reasons)
        if "speed_ms" in columns:
            speed_ms = columns["speed_ms"]
            self._stops.add(elapsed_s, speed_ms)
            self._travelled_m.add(steps_s, speed_ms)
            self._top_speed_ms.add(speed_ms, self.rows, elapsed_s)
            standing = (speed_ms <= STANDING_MS) & ~unseen
            self._standing_s.add(steps_s, standing.astype(np.float64))
        if "distance_m" in columns:
            counter_m = columns["distance_m"]
            known = counter_m[np.isfinite(counter_m)]
            if len(known):
                first_m = (self._counter_m or known)[0]
                self._counter_m = float(first_m), float(known[-1])
        for corner in self._corners.values():
            corner.add(columns, self.rows, elapsed_s, steps_s)
        self.rows += len(time_s)


class _Integral:
    """Running integral of rates, a row being the mean since the one before.

    Rows that hold no number add nothing; None as long as there is none.
    """

    def __init__(self) -> None:
        self.total: float | None = None

    def add(self, steps_s: Column, rate: Column) -> None:
        known = np.isfinite(rate)
        if known.any():
            part = float(np.sum(rate[known] * steps_s[known]))
            self.total = (self.total or 0.0) + part


class _Highest:
    """The highest number so far, its row, time and code of validity."""

    def __init__(self) -> None:
        self.value: float | None = None
        self.first = 0.0
        self.row = 0
        self.time_s = 0.0
        self.validity = 0

    def add(
        self,
        values: Column,
        first_row: int,
        elapsed_s: Column,
        validity: Column | None = None,
    ) -> None:
        known = np.where(np.isfinite(values), values, -np.inf)
        row = int(known.argmax())
        found = float(known[row])
        if found <= (-np.inf if self.value is None else self.value):
            return
        if self.value is None:
            self.first = float(known[np.isfinite(known).argmax()])
        self.value = found
        self.row = first_row + row
        self.time_s = float(elapsed_s[row])
        code = 0.0 if validity is None else float(validity[row])
        self.validity = 0 if np.isnan(code) else int(code)

    def peak(self, rows: int, stops_s: tuple[float, ...]) -> Peak | None:
        if self.value is None:
            return None
        before = [stop for stop in stops_s if stop <= self.time_s]
        stop_s = (*before[-1:], *stops_s[:1])[:1]
        return Peak(
            temperature_c=self.value,
            time_s=self.time_s,
            after_stop_s=self.time_s - stop_s[0] if stop_s else None,
            validity=self.validity,
            at_end=(
                self.row == rows - 1 and self.value > self.first + RISING_K
            ),
        )


class _CornerStatistics:
    def __init__(self, name: str, *, modelled: bool) -> None:
        self._name = name
        self._modelled = modelled
        self._peaks = {node: _Highest() for node in SUMMARY_NODES}
        # the least is the highest of the negative
        self._margin_k = _Highest()
        self._boiling_point_c = _Highest()
        self._energies_j = {kind: _Integral() for kind in ("", "_ff", "_fb")}
        self._validity_rows: npt.NDArray[np.int64] | None = None

    def add(
        self,
        columns: Mapping[str, Column],
        first_row: int,
        elapsed_s: Column,
        steps_s: Column,
    ) -> None:
        own = {
            key.removeprefix(f"{self._name}."): column
            for key, column in columns.items()
            if key.startswith(f"{self._name}.")
        }
        validity = own.get("validity")
        if validity is not None:
            codes = np.arange(len(VALIDITY_NAMES))
            rows = np.count_nonzero(validity[:, None] == codes, axis=0)
            before = 0 if self._validity_rows is None else self._validity_rows
            self._validity_rows = before + rows
        for node, peak in self._peaks.items():
            if f"{node}_c" in own:
                peak.add(own[f"{node}_c"], first_row, elapsed_s, validity)
        if "margin_k" in own:
            margin_k = own["margin_k"]
            self._margin_k.add(-margin_k, first_row, elapsed_s)
            if "fluid_c" in own:
                boiling_c = own["fluid_c"] + margin_k
                self._boiling_point_c.add(-boiling_c, first_row, elapsed_s)
        for kind, energy_j in self._energies_j.items():
            if f"brake_power{kind}_w" in own:
                energy_j.add(steps_s, own[f"brake_power{kind}_w"])

    def summary(self, rows: int, stops_s: tuple[float, ...]) -> CornerSummary:
        peaks = {
            node: peak.peak(rows, stops_s)
            for node, peak in self._peaks.items()
        }
        shares = None
        if self._validity_rows is not None:
            valid, degraded, invalid = (self._validity_rows / rows).tolist()
            shares = valid, degraded, invalid
        margin_k = self._margin_k.value
        boiling_c = self._boiling_point_c.value
        return CornerSummary(
            corner=self._name,
            modelled=self._modelled,
            peaks={node: peak for node, peak in peaks.items() if peak},
            margin_k=None if margin_k is None else -margin_k,
            wet_boiling_point_c=None if boiling_c is None else -boiling_c,
            energies_j=tuple(one.total for one in self._energies_j.values()),
            validity_shares=shares,
        )


VALIDITY_MARKS: Final = (" ", "~", "!")
"""Behind a peak whose estimate is valid, degraded, invalid."""

HEADINGS: Final = (
    *("corner", "disc", "pad front", "pad back", "fluid"),
    *("after stop", "margin", "MJ", "FF", "FB"),
)


def summary_table(summary: DriveSummary) -> str:
    """Return *summary* as lines of text.

    Per corner the peak temperature [degC] of each node and when it was, how
    long after the stop the fluid peaked, the least margin to the wet boiling
    point [K], and the brake energy [MJ]: as it heated the model, by
    Feed-Forward, by Feed-Back. Below the table what was valid and why the
    rest was not, which inputs were suspect, and when the heat was not known.
    """
    with_hours = summary.duration_s >= HOUR_S
    rows: list[tuple[str, ...]] = [HEADINGS]
    rows += [_cells(corner, with_hours) for corner in summary.corners]
    form = "h:min:s" if with_hours else "min:s"
    caption = (
        f"peak temperatures in degC at {form}; "
        "margin to the wet boiling point; brake energy in MJ"
    )
    lines = [_drive_line(summary), caption, *columns(rows)]
    if any((corner.after_stop_s or 0.0) < 0.0 for corner in summary.corners):
        lines.append("after stop, negative: time before the first stop")
    lines += _validity_lines(summary)
    if summary.reasons:
        lines.append("not valid because of")
        lines += wrapped([one.text for one in summary.reasons])
    lines += wrapped([one.text for one in summary.findings], mark="")
    return "\n".join(lines)


def _drive_line(summary: DriveSummary) -> str:
    parts = [duration(summary.duration_s)]
    if summary.distance_m is not None:
        parts.append(f"{summary.distance_m / 1000:.1f} km")
    if summary.top_speed_ms is not None:
        parts.append(f"at most {summary.top_speed_ms * 3.6:.0f} km/h")
    if summary.standing_s is not None:
        parts.append(f"{duration(summary.standing_s)} standing")
    return ", ".join(parts)


def _cells(corner: CornerSummary, with_hours: bool) -> tuple[str, ...]:  # noqa: FBT001
    peaks = []
    for node in SUMMARY_NODES:
        peak = corner.peaks.get(node)
        if peak is None:
            peaks.append("-")
            continue
        mark = VALIDITY_MARKS[peak.validity]
        at = clock(peak.time_s, with_hours=with_hours)
        peaks.append(f"{peak.temperature_c:.0f}{mark}{at:>7}")
    after_s = corner.after_stop_s
    return (
        corner.corner,
        *peaks,
        "-" if after_s is None else clock(after_s),
        "-" if corner.margin_k is None else f"{corner.margin_k:.0f} K",
        *map(_megajoule, corner.energies_j),
    )


def _megajoule(energy_j: float | None) -> str:
    if energy_j is None:
        return "-"
    energy_mj = energy_j / 1e6
    # three figures are more than the heat models are worth
    decimals = 2 if abs(energy_mj) < 9.995 else 1
    return f"{energy_mj:.{decimals}f}"


def _validity_lines(summary: DriveSummary) -> list[str]:
    """Return what was valid; corners that agree share a line."""
    alike: dict[str, list[str]] = {}
    for corner in summary.corners:
        if not corner.modelled:
            text = "no temperatures: not modelled"
        elif corner.validity_shares is None:
            text = "validity not recorded"
        else:
            text = ", ".join(
                f"{percent(share)} {name}"
                for name, share in zip(
                    VALIDITY_NAMES, corner.validity_shares, strict=True
                )
                if share > 0.0
            )
        alike.setdefault(text, []).append(corner.corner)
    lines = [f"{' '.join(names)}: {text}" for text, names in alike.items()]
    rising = [
        corner.corner
        for corner in summary.corners
        if "fluid" in corner.peaks and corner.peaks["fluid"].at_end
    ]
    if rising:
        lines.append(
            f"{' '.join(rising)}: fluid still rising at the end of the log"
        )
    marked = {
        peak.validity
        for corner in summary.corners
        for peak in corner.peaks.values()
    } - {0}
    if marked:
        meaning = ", ".join(
            f"{VALIDITY_MARKS[code]} {VALIDITY_NAMES[code]}"
            for code in sorted(marked)
        )
        lines.append(f"peak marks: {meaning}")
    return lines
