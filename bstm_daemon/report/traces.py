"""The curves of a replay, thinned and rounded for a plot as rows come."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.heat.plausibility import FAULTS
from bstm_daemon.heat.sample_plan import FLAGS
from bstm_daemon.report.advice_lines import AdviceLines
from bstm_daemon.report.decimation import ThinCurve
from bstm_daemon.report.spans import Buckets, validity_spans
from bstm_daemon.report.summary import SUMMARY_NODES, front_first
from bstm_daemon.results import ElapsedTime

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy.typing as npt

    from bstm_daemon.results import Results

    Column = npt.NDArray[np.float64]

POINTS_A_TRACE: Final = 4000
"""Twice the columns of a large screen: what a curve can show of itself."""

NODE_LABELS: Final = {
    "disc": "disc",
    "pad_front": "pad front",
    "pad_back": "pad back",
    "fluid": "fluid",
}

# Okabe & Ito 2008, told apart with any of the common colour deficiencies
ORANGE: Final = "#e69f00"
GREEN: Final = "#009e73"
BLUE: Final = "#0072b2"
VERMILION: Final = "#d55e00"
PURPLE: Final = "#cc79a7"
BLACK: Final = "#1f2328"

NODE_COLOURS: Final = {
    "disc": VERMILION,
    "pad_front": ORANGE,
    "pad_back": GREEN,
    "fluid": BLUE,
}
PRESSURE_COLOURS: Final = (BLUE, ORANGE, GREEN, PURPLE)
CIRCUIT_DASHES: Final = ("solid", "5px,3px", "2px,3px", "8px,3px,2px,3px")

PASCAL_A_BAR: Final = 1e5
KMH_A_MS: Final = 3.6

CONSTANT_K: Final = 0.05
"""A limit that moves less than this is drawn with its two ends."""

_PANEL_INPUTS: Final = {
    "speed": (
        FLAGS["speed_suspect"]
        | FLAGS["wheels_contradict"]
        | FAULTS["wheel_speed_suspect"],
        FLAGS["speed_missing"],
    ),
    "pressure": (FLAGS["pressure_suspect"], FLAGS["pressure_missing"]),
    "power": (
        FLAGS["heat_substituted"]
        | FLAGS["acceleration_suspect"]
        | FLAGS["torque_suspect"],
        FLAGS["heat_unknown"],
    ),
}
"""Bits of ``flags`` by the panel that they shade: suspect, and missing."""

_BOILING_POINT: Final = "boiling_point_c"


@dataclass(frozen=True, slots=True)
class Trace:
    """A curve of a panel: ``corner`` is None where it is the vehicle's.

    ``x`` [s since the first row] and ``y`` (None: no value) are what is
    drawn; ``look`` holds further plotly attributes.
    """

    panel: str
    corner: str | None
    label: str
    x: list[float]
    y: list[float | None]
    look: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Curve:
    """A curve as it grows: the column times ``factor``.

    A ``sampled`` one is joined over rows without a value: its sensor is
    slower than the rows, and a gap between two samples is no gap.
    """

    panel: str
    corner: str | None
    label: str
    column: str
    decimals: int
    factor: float = 1.0
    sampled: bool = False
    look: dict[str, Any] = field(default_factory=dict)
    thin: ThinCurve = field(default_factory=lambda: ThinCurve(POINTS_A_TRACE))

    def add(self, elapsed_s: Column, columns: Mapping[str, Column]) -> None:
        """Add the rows of *columns*, none if the column is not there."""
        values = columns.get(self.column)
        if values is None:
            return
        if self.sampled:
            known = np.isfinite(values)
            elapsed_s, values = elapsed_s[known], values[known]
        self.thin.add(elapsed_s, values * self.factor)

    def trace(self) -> Trace | None:
        """Return what is drawn, None if there is no number."""
        return self.trace_of(*self.thin.points(), self.label, self.look)

    def trace_of(
        self, x: Column, y: Column, label: str, look: dict[str, Any]
    ) -> Trace | None:
        """Return *x* and *y* as a trace of this panel."""
        if not np.isfinite(y).any():
            return None
        # adding 0.0 turns -0.0, which takes a character more, into 0.0
        rounded = np.round(y, self.decimals) + 0.0
        return Trace(
            self.panel,
            self.corner,
            label,
            np.round(x, 2).tolist(),
            [None if v != v else v for v in rounded.tolist()],  # noqa: PLR0124
            look,
        )


class DriveCurves:
    """A sink that keeps what the plots draw; columns may be missing.

    Panels are ``speed`` [km/h], ``pressure`` [bar], ``advice`` [number of the
    line], ``power`` [kW], ``temperature`` and ``fluid`` [degC], ``risk`` [%].
    """

    def __init__(self) -> None:
        """Begin without rows."""
        self._time = ElapsedTime()
        self._starts_s = Buckets(np.minimum)
        self._validity: dict[str, Buckets] = {}
        self._inputs = {name: Buckets(np.maximum) for name in _PANEL_INPUTS}
        self._advice = AdviceLines()
        self._speed = _Curve(
            "speed",
            None,
            "speed",
            "speed_ms",
            decimals=1,
            factor=KMH_A_MS,
            look={
                "line": {"color": BLACK, "width": 1.5},
                "hovertemplate": "%{y:.0f} km/h",
            },
        )
        self._pressures: dict[str, _Curve] = {}
        self._differing: set[tuple[str, str]] = set()
        self._corners: dict[str, list[_Curve]] = {}
        self._boiling: dict[str, _Curve] = {}

    def write(self, rows: Results) -> None:
        """Take *rows*."""
        if not self._corners:
            for name in front_first(rows.corners):
                self._corners[name] = _corner_curves(name)
                self._pressures[name] = _pressure_curve(name)
                self._boiling[name] = _boiling_curve(name)
        for stretch in rows.stretches():
            self._add(stretch.columns)

    def traces(self) -> list[Trace]:
        """Return every curve that there are numbers for."""
        traces = [self._speed.trace(), *self._pressure_traces()]
        traces += self._advice_traces()
        for name, curves in self._corners.items():
            traces += [curve.trace() for curve in curves]
            traces.append(_boiling_trace(self._boiling[name]))
        return [trace for trace in traces if trace is not None]

    def spans(self, corner: str) -> list[tuple[int, float, float]]:
        """Return the stretches in which *corner* is not valid.

        See :func:`~bstm_daemon.report.spans.validity_spans`.
        """
        validity = self._validity.get(corner)
        if validity is None:
            return []
        return validity_spans(self._starts_s.values, validity.values)

    def input_spans(self, panel: str) -> list[tuple[int, float, float]]:
        """Return the stretches in which what *panel* shows is in doubt.

        *panel* is ``speed``, ``pressure`` or ``power``; others have none.
        Code 1: an input is suspect, or heat is from the other source; 2: it
        is missing, the heat unknown. See
        :func:`~bstm_daemon.report.spans.validity_spans`.
        """
        inputs = self._inputs.get(panel)
        codes = np.empty(0) if inputs is None else inputs.values
        if not len(codes):
            return []
        return validity_spans(self._starts_s.values, codes)

    def _add(self, columns: dict[str, Column]) -> None:
        elapsed_s = self._time.extend(columns["time_s"])
        self._starts_s.add(elapsed_s)
        self._speed.add(elapsed_s, columns)
        self._advice.add(columns)
        for name, curves in self._corners.items():
            for curve in (*curves, self._pressures[name]):
                curve.add(elapsed_s, columns)
            self._boiling[name].add(elapsed_s, _boiling_point(name, columns))
            validity = columns.get(f"{name}.validity")
            if validity is not None and len(validity):
                track = self._validity.setdefault(name, Buckets(np.maximum))
                track.add(np.nan_to_num(validity, nan=0.0))
        if "flags" in columns:
            bits = columns["flags"].astype(np.int64)
            for panel, (suspect, missing) in _PANEL_INPUTS.items():
                codes = np.where(bits & suspect, 1.0, 0.0)
                codes[(bits & missing) != 0] = 2.0
                self._inputs[panel].add(codes)
        self._compare_pressures(columns)

    def _compare_pressures(self, columns: Mapping[str, Column]) -> None:
        """Note which corners do not share a circuit."""
        for pair in combinations(self._pressures, 2):
            one, other = (columns.get(f"{name}.pressure_pa") for name in pair)
            if pair not in self._differing and not (
                one is not None
                and other is not None
                and np.array_equal(one, other, equal_nan=True)
            ):
                self._differing.add(pair)

    def _pressure_traces(self) -> list[Trace | None]:
        """Return one curve a circuit: corners of equal pressure share it."""
        circuits: list[list[str]] = []
        for name, curve in self._pressures.items():
            if not len(curve.thin.points()[0]):
                continue
            for names in circuits:
                if (names[0], name) not in self._differing:
                    names.append(name)
                    break
            else:
                circuits.append([name])
        traces = []
        for i, names in enumerate(circuits):
            curve = self._pressures[names[0]]
            line = {
                "color": PRESSURE_COLOURS[i % len(PRESSURE_COLOURS)],
                "dash": CIRCUIT_DASHES[i % len(CIRCUIT_DASHES)],
                "width": 1.5,
            }
            look = {"line": line, "hovertemplate": "%{y:.1f} bar"}
            x, y = curve.thin.points()
            traces.append(curve.trace_of(x, y, " ".join(names), look))
        return traces

    def _advice_traces(self) -> list[Trace]:
        """Return a bar a kind of advice, one line above the other."""
        bars = self._advice.bars(self._starts_s.values)
        traces = []
        for line, bar in enumerate(reversed(bars), 1):
            x: list[float] = []
            y: list[float | None] = []
            for start_s, end_s in bar.stretches_s:
                x += [round(start_s, 2), round(end_s, 2), round(end_s, 2)]
                y += [float(line), float(line), None]
            look = {
                "line": {"color": bar.colour, "width": 7},
                "hovertemplate": bar.label,
            }
            traces.append(Trace("advice", None, bar.label, x, y, look))
        return traces[::-1]


def _corner_curves(corner: str) -> list[_Curve]:
    """Return the curves of a corner in the order in which they are drawn."""
    used = {
        "line": {"color": "#8c959f", "width": 0.5},
        "fill": "tozeroy",
        "fillcolor": "rgba(140,149,159,0.30)",
    }
    forward = {"line": {"color": BLUE, "width": 1.2}}
    back = {"line": {"color": PURPLE, "width": 1.2}}
    curves = [
        _Curve(
            "power",
            corner,
            label,
            f"{corner}.brake_power{kind}_w",
            decimals=2,
            factor=1e-3,
            look={"hovertemplate": "%{y:.2f} kW", **look},
        )
        for label, kind, look in (
            ("used", "", used),
            ("Feed-Forward", "_ff", forward),
            ("Feed-Back", "_fb", back),
        )
    ]
    for node in SUMMARY_NODES:
        curves += _node_curves(corner, node, "temperature")
    curves += _node_curves(corner, "fluid", "fluid")
    return [*curves, *forecast_curves(corner)]


def _node_curves(corner: str, node: str, panel: str) -> list[_Curve]:
    """Return estimate and measurement of *node*, in one colour."""
    label, colour = NODE_LABELS[node], NODE_COLOURS[node]
    return [
        _Curve(
            panel,
            corner,
            label,
            f"{corner}.{node}_c",
            decimals=1,
            look={
                "line": {"color": colour, "width": 1.8},
                "hovertemplate": "%{y:.0f} °C",
            },
        ),
        _Curve(
            panel,
            corner,
            f"{label}, measured",
            f"{corner}.{node}_measured_c",
            decimals=1,
            sampled=True,
            look={
                "line": {"color": colour, "width": 2.4, "dash": "2px,4px"},
                "hovertemplate": "%{y:.0f} °C",
            },
        ),
    ]


def forecast_curves(corner: str) -> list[_Curve]:
    """Return what was told ahead: a peak beside what came, and the risk."""
    return [
        _Curve(
            "fluid",
            corner,
            label,
            f"{corner}.{column}_c",
            decimals=1,
            look={
                "line": {"color": colour, "width": 1.3, "shape": "hv"},
                "hovertemplate": "%{y:.0f} °C",
            },
        )
        for label, column, colour in (
            ("peak if parked now", "peak", VERMILION),
            ("peak if it goes on", "duty_peak", ORANGE),
        )
    ] + [
        _Curve(
            "risk",
            corner,
            label,
            f"{corner}.{column}",
            decimals=2,
            factor=100.0,
            look={
                "line": {"color": colour, "width": 1.5},
                "hovertemplate": "%{y:.1f} %",
            },
        )
        for label, column, colour in (
            ("within 30 min, if parked", "risk", VERMILION),
            ("now", "risk_now", BLUE),
        )
    ]


def _pressure_curve(corner: str) -> _Curve:
    return _Curve(
        "pressure",
        None,
        corner,
        f"{corner}.pressure_pa",
        decimals=2,
        factor=1.0 / PASCAL_A_BAR,
    )


def _boiling_curve(corner: str) -> _Curve:
    return _Curve(
        "fluid",
        corner,
        "wet boiling point",
        _BOILING_POINT,
        decimals=1,
        look={
            "line": {"color": BLACK, "width": 1.3, "dash": "8px,4px"},
            "hovertemplate": "%{y:.0f} °C",
        },
    )


def _boiling_point(
    corner: str, columns: Mapping[str, Column]
) -> dict[str, Column]:
    fluid_c = columns.get(f"{corner}.fluid_c")
    margin_k = columns.get(f"{corner}.margin_k")
    if fluid_c is None or margin_k is None:
        return {}
    return {_BOILING_POINT: fluid_c + margin_k}


def _boiling_trace(curve: _Curve) -> Trace | None:
    """Return the limit, a line of two points where it does not move."""
    x, y = curve.thin.points()
    label = curve.label
    known = y[np.isfinite(y)]
    if len(known) and np.ptp(known) < CONSTANT_K:
        label += f" {known[0]:.0f} °C"
        x, y = x[[0, -1]], known[[0, 0]]
    return curve.trace_of(x, y, label, curve.look)
