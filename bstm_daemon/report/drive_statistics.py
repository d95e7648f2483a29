"""A drive in few numbers: peaks, margin, brake energy, validity.

The table on the screen and the HTML page say the same because both take it
from here. Times are seconds since the first row.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.channels import FLAGS
from bstm_daemon.model.heat.needs import INPUTS
from bstm_daemon.replay.results import ElapsedTime, Results
from bstm_daemon.report.findings import FindingCollector
from bstm_daemon.report.stretches import (
    STANDING_MS,
    StopFinder,
    Stretches,
    StretchFinder,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    from bstm_daemon.report.findings import Finding

    Column = npt.NDArray[np.float64]

SHORTEST_GAP_S: Final = 1.0
"""An input that is missing for less is a late frame."""

SUMMARY_NODES: Final = ("disc", "pad_front", "pad_back", "fluid")
"""Nodes whose peaks a summary holds."""

VALIDITY_NAMES: Final = ("valid", "degraded", "invalid")
"""What the codes 0, 1 and 2 of a validity column mean."""


@dataclass(frozen=True, slots=True)
class Peak:
    """The highest temperature of a node.

    ``after_stop_s`` counts from the last stop before the peak; where none
    came before, from the first one after it, negative. None without a stop.
    ``validity`` is the code of the estimate at the peak. ``at_end``: it is
    the last row, so the real peak comes after the log.
    """

    temperature_c: float
    time_s: float
    after_stop_s: float | None
    validity: int
    at_end: bool


@dataclass(frozen=True, slots=True)
class CornerSummary:
    """One corner. None stands for what the results do not hold.

    ``energy_j`` is the brake energy that heated the model, ``energy_ff_j``
    and ``energy_fb_j`` those of the two heat models. ``validity_shares``
    are fractions of the rows, in the order of :data:`VALIDITY_NAMES`.
    """

    corner: str
    modelled: bool
    peaks: dict[str, Peak]
    margin_k: float | None
    margin_time_s: float | None
    wet_boiling_point_c: float | None
    energy_j: float | None
    energy_ff_j: float | None
    energy_fb_j: float | None
    validity_shares: tuple[float, float, float] | None


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
    """What spoke against the inputs, and when the heat was not known."""


def front_first(corners: tuple[str, ...]) -> tuple[str, ...]:
    """Return *corners* with the front axle first, left before right."""
    known = ("FL", "FR", "RL", "RR")
    return tuple(
        sorted(
            corners,
            key=lambda name: (
                known.index(name) if name in known else len(known),
                name,
            ),
        )
    )


class DriveStatistics:
    """A sink that keeps what a summary needs; columns may be missing."""

    def __init__(self) -> None:
        """Begin without rows."""
        self.rows = 0
        self._start_s = 0.0
        self._time = ElapsedTime()
        self._gaps = {
            name: StretchFinder(SHORTEST_GAP_S)
            for name in sorted({n for names in INPUTS.values() for n in names})
        }
        self._findings = FindingCollector()
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
        if not self._corners:
            self._places = rows.corners
            self._corners = {
                name: _CornerStatistics(name, modelled=name in rows.modelled)
                for name in front_first(rows.corners)
            }
        for stretch in rows.stretches():
            self._add(stretch.columns)

    def gaps(self, heat_mode: str) -> dict[str, Stretches]:
        """Return when inputs that *heat_mode* needs were missing, by name."""
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
        if "flags" in columns:
            bits = columns["flags"].astype(np.int64)
            for name, gap in self._gaps.items():
                gap.add(elapsed_s, (bits & FLAGS[f"{name}_missing"]) != 0)
            self._findings.add(elapsed_s, bits)
        if "speed_ms" in columns:
            self._add_speed(elapsed_s, steps_s, columns["speed_ms"])
        if "distance_m" in columns:
            counter_m = columns["distance_m"]
            known = counter_m[np.isfinite(counter_m)]
            if len(known):
                first_m = (self._counter_m or known)[0]
                self._counter_m = float(first_m), float(known[-1])
        for corner in self._corners.values():
            corner.add(columns, self.rows, elapsed_s, steps_s)
        self.rows += len(time_s)

    def _add_speed(
        self, elapsed_s: Column, steps_s: Column, speed_ms: Column
    ) -> None:
        self._stops.add(elapsed_s, speed_ms)
        standing = (speed_ms <= STANDING_MS).astype(np.float64)
        self._standing_s.add(steps_s, standing)
        self._travelled_m.add(steps_s, speed_ms)
        self._top_speed_ms.add(speed_ms)


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
    """The highest number so far and its first row; None without one."""

    def __init__(self) -> None:
        self.value: float | None = None

    def add(self, values: Column) -> int | None:
        """Return the row among *values* that is the new highest."""
        known = np.where(np.isfinite(values), values, -np.inf)
        row = int(known.argmax())
        found = float(known[row])
        if found == -np.inf or (
            self.value is not None and found <= self.value
        ):
            return None
        self.value = found
        return row


class _PeakFinder:
    """The highest temperature of a node, when and how valid it was."""

    def __init__(self) -> None:
        self._highest = _Highest()
        self._row = 0
        self._time_s = 0.0
        self._validity = 0

    def add(
        self,
        values: Column,
        first_row: int,
        elapsed_s: Column,
        validity: Column | None,
    ) -> None:
        row = self._highest.add(values)
        if row is None:
            return
        self._row = first_row + row
        self._time_s = float(elapsed_s[row])
        code = 0.0 if validity is None else float(validity[row])
        self._validity = 0 if np.isnan(code) else int(code)

    def peak(self, rows: int, stops_s: tuple[float, ...]) -> Peak | None:
        temperature_c = self._highest.value
        if temperature_c is None:
            return None
        return Peak(
            temperature_c=temperature_c,
            time_s=self._time_s,
            after_stop_s=_after_stop(self._time_s, stops_s),
            validity=self._validity,
            at_end=0 < self._row == rows - 1,
        )


class _CornerStatistics:
    def __init__(self, name: str, *, modelled: bool) -> None:
        self._name = name
        self._modelled = modelled
        self._peaks = {node: _PeakFinder() for node in SUMMARY_NODES}
        # the least is the highest of the negative
        self._margin_k = _Highest()
        self._margin_time_s: float | None = None
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
        def column(key: str) -> Column | None:
            return columns.get(f"{self._name}.{key}")

        validity = column("validity")
        if validity is not None:
            codes = np.arange(len(VALIDITY_NAMES))
            rows = np.count_nonzero(validity[:, None] == codes, axis=0)
            before = 0 if self._validity_rows is None else self._validity_rows
            self._validity_rows = before + rows
        for node, peak in self._peaks.items():
            values = column(f"{node}_c")
            if values is not None:
                peak.add(values, first_row, elapsed_s, validity)
        margin_k, fluid_c = column("margin_k"), column("fluid_c")
        if margin_k is not None:
            row = self._margin_k.add(-margin_k)
            if row is not None:
                self._margin_time_s = float(elapsed_s[row])
            if fluid_c is not None:
                self._boiling_point_c.add(-(fluid_c + margin_k))
        for kind, energy_j in self._energies_j.items():
            power_w = column(f"brake_power{kind}_w")
            if power_w is not None:
                energy_j.add(steps_s, power_w)

    def summary(self, rows: int, stops_s: tuple[float, ...]) -> CornerSummary:
        peaks = {
            node: peak.peak(rows, stops_s)
            for node, peak in self._peaks.items()
        }
        shares = None
        if self._validity_rows is not None:
            valid, degraded, invalid = (self._validity_rows / rows).tolist()
            shares = valid, degraded, invalid
        return CornerSummary(
            corner=self._name,
            modelled=self._modelled,
            peaks={node: peak for node, peak in peaks.items() if peak},
            margin_k=_negative(self._margin_k.value),
            margin_time_s=self._margin_time_s,
            wet_boiling_point_c=_negative(self._boiling_point_c.value),
            energy_j=self._energies_j[""].total,
            energy_ff_j=self._energies_j["_ff"].total,
            energy_fb_j=self._energies_j["_fb"].total,
            validity_shares=shares,
        )


def _after_stop(time_s: float, stops_s: tuple[float, ...]) -> float | None:
    if not stops_s:
        return None
    before = [stop for stop in stops_s if stop <= time_s]
    return time_s - (before[-1] if before else stops_s[0])


def _negative(value: float | None) -> float | None:
    return None if value is None else -value
