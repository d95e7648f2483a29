"""The curves of a replay, thinned and rounded for a plot as rows come."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations, cycle
from typing import Any, Final

import numpy as np

from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.channels import FLAGS
from bstm_daemon.estimate import (
    REASON_WORDS,
    Assist,
    Downshift,
    Intervention,
    Isolation,
    Message,
)
from bstm_daemon.model.heat.plausibility import FAULTS
from bstm_daemon.replay.results import ElapsedTime, Part, Results
from bstm_daemon.report.decimation import Buckets, ThinCurve, validity_spans
from bstm_daemon.report.drive_statistics import SUMMARY_NODES
from bstm_daemon.report.plots import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    NODE_COLOURS,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
)

_Look = tuple[str, str]


POINTS_A_TRACE: Final = 4000
"""Points of a curve: twice the columns of a large screen."""

PRESSURE_COLOURS: Final = (BLUE, ORANGE, GREEN, PURPLE)
CIRCUIT_DASHES: Final = ("solid", "5px,3px", "2px,3px", "8px,3px,2px,3px")

_UNITS: Final = {
    "margin": (1.0, 1, "%{y:.0f} K"),
    "speed": (3.6, 1, "%{y:.0f} km/h"),
    "pressure": (1e-5, 2, "%{y:.1f} bar"),
    "power": (1e-3, 2, "%{y:.2f} kW"),
    "temperature": (1.0, 1, "%{y:.0f} °C"),
    "fluid": (1.0, 1, "%{y:.0f} °C"),
    "risk": (100.0, 2, "%{y:.1f} %"),
}
"""By panel: factor from SI, decimals that are kept, and plotly's text."""

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

SOFTER_PEDAL: Final = 0.995
"""Below it, a pedal factor as published differs from 1."""


_PEDAL_FEEL: Final = "advice_pedal_feel"

_ADVICE: Final[dict[str, dict[int, tuple[str, str]]]] = {
    "advice_message": {
        Message.WAIT_BEFORE_DEPARTURE: ("wait before departure", VERMILION),
        Message.BRAKES_HOT: ("brakes hot", PURPLE),
    },
    "advice_shift": {Downshift.SHIFT_DOWN: ("driver: lower gear", BLUE)},
    "advice_gearbox": {
        Downshift.SHIFT_DOWN: ("gearbox: lower gear", SKY_BLUE)
    },
    _PEDAL_FEEL: {1: ("softer pedal", ORANGE)},
    "advice_isolation": {
        Isolation.REQUESTED: ("front brakes isolated", GREEN)
    },
    "advice_assist": {
        Assist.STANDBY: ("emergency assist ready", GREY),
        Assist.DETECTED: ("brakes do not answer", BLACK),
    },
    "advice_intervention": {
        Intervention.MAXIMUM_PRESSURE: ("maximum pressure", "#a32c00"),
        Intervention.PARK_BRAKE: ("park brake", "#5a3d8a"),
        Intervention.ISOLATE_FRONT: ("isolate front", "#00573f"),
    },
}
"""Label and colour of what is advised or requested, by column and code; from
the top, those to the driver first."""


_ADVICE_LOOKS: Final = [
    look for codes in _ADVICE.values() for look in codes.values()
]

_REASON_COLOURS: Final = (
    *(GREY, BLACK, ORANGE, PURPLE),
    *(BLUE, VERMILION, GREEN, SKY_BLUE),
)
_REASON_LOOKS: Final = dict(
    zip(
        REASON_WORDS,
        zip(REASON_WORDS.values(), _REASON_COLOURS, strict=True),
        strict=True,
    )
)
"""Label and colour of each reason."""


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
    """A curve as it grows, of one column.

    What is measured is joined over rows without a value: its sensor is
    slower than the rows, and a gap between two samples is no gap.
    """

    panel: str
    corner: str | None
    label: str
    column: str
    line: dict[str, Any]
    thin: ThinCurve = field(default_factory=lambda: ThinCurve(POINTS_A_TRACE))

    def add(self, elapsed_s: Column, columns: Mapping[str, Column]) -> None:
        """Add the rows of *columns*, none if the column is not there."""
        values = columns.get(self.column)
        if values is None:
            return
        if self.column.endswith("_measured_c"):
            known = np.isfinite(values)
            elapsed_s, values = elapsed_s[known], values[known]
        self.thin.add(elapsed_s, values * _UNITS[self.panel][0])

    def trace(self) -> Trace | None:
        """Return what is drawn, None if there is no number."""
        x, y = self.thin.points()
        known = y[np.isfinite(y)]
        if not len(known):
            return None
        label = self.label
        if self.column == _BOILING_POINT and np.ptp(known) < CONSTANT_K:
            label += f" {known[0]:.0f} °C"
            x, y = x[[0, -1]], known[[0, 0]]
        _, decimals, hover = _UNITS[self.panel]
        look: dict[str, Any] = {"line": self.line, "hovertemplate": hover}
        if label == "used":
            look |= {"fill": "tozeroy", "fillcolor": "rgba(140,149,159,0.30)"}
        # adding 0.0 turns -0.0, which takes a character more, into 0.0
        rounded = np.round(y, decimals) + 0.0
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
    line], ``margin`` [K], ``power`` [kW], ``temperature`` and ``fluid``
    [degC], ``reasons`` [number of the line], ``risk`` [%].
    """

    parts = Part.ALL

    def __init__(self) -> None:
        """Begin without rows."""
        self._time = ElapsedTime()
        self._starts_s = Buckets(np.minimum)
        self._validity: dict[str, Buckets] = {}
        self._inputs = {name: Buckets(np.maximum) for name in _PANEL_INPUTS}
        self._bars: dict[tuple[str, str | None], dict[_Look, Buckets]] = {
            ("advice", None): _bars(_ADVICE_LOOKS)
        }
        """By panel and corner a bar for each label and colour."""
        line = {"color": BLACK, "width": 1.5}
        self._speed = _Curve("speed", None, "speed", "speed_ms", line)
        self._pressures: dict[str, _Curve] = {}
        self._differing: set[tuple[str, str]] = set()
        self._corners: dict[str, list[_Curve]] = {}

    def write(self, rows: Results) -> None:
        """Take *rows*."""
        if not self._corners:
            for name in sorted(rows.corners):
                self._corners[name] = _corner_curves(name)
                self._pressures[name] = _Curve(
                    "pressure", None, name, f"{name}.pressure_pa", {}
                )
        for stretch in rows.stretches():
            self._add(stretch.columns)

    def traces(self) -> list[Trace]:
        """Return every curve that there are numbers for."""
        traces = [self._speed.trace(), *self._pressure_traces()]
        for curves in self._corners.values():
            traces += [curve.trace() for curve in curves]
        for (panel, corner), bars in self._bars.items():
            traces += self._bar_traces(panel, corner, bars)
        return [trace for trace in traces if trace is not None]

    def spans(self, corner: str) -> list[tuple[int, float, float]]:
        """Return the stretches in which *corner* is not valid.

        See :func:`~bstm_daemon.report.decimation.validity_spans`.
        """
        validity = self._validity.get(corner)
        return [] if validity is None else self._spans(validity.values)

    def input_spans(self, panel: str) -> list[tuple[int, float, float]]:
        """Return the stretches in which what *panel* shows is uncertain.

        *panel* is ``speed``, ``pressure`` or ``power``; others have none.
        Code 1: it is missing while the bus of the parked car sleeps; 2: an
        input is suspect, or heat is from the other source; 3: it is missing,
        the heat unknown. See
        :func:`~bstm_daemon.report.decimation.validity_spans`.
        """
        inputs = self._inputs.get(panel)
        return [] if inputs is None else self._spans(inputs.values)

    def _add(self, columns: dict[str, Column]) -> None:
        elapsed_s = self._time.extend(columns["time_s"])
        self._starts_s.add(elapsed_s)
        self._speed.add(elapsed_s, columns)
        given = self._bars["advice", None]
        for column, looks in _ADVICE.items():
            for code, look in looks.items() if column in columns else ():
                holds = columns[column] == code
                if column == _PEDAL_FEEL:
                    holds = columns[column] < SOFTER_PEDAL
                given[look].add(holds.astype(float))
        for name, curves in self._corners.items():
            fluid_c = columns.get(f"{name}.fluid_c")
            margin_k = columns.get(f"{name}.margin_k")
            known = columns
            if fluid_c is not None and margin_k is not None:
                known = {**columns, _BOILING_POINT: fluid_c + margin_k}
            for curve in (*curves, self._pressures[name]):
                curve.add(elapsed_s, known)
            self._add_validity(name, columns)
        if "flags" in columns:
            bits = columns["flags"].astype(np.int64)
            asleep = (bits & FLAGS["asleep"]) != 0
            for panel, (suspect, missing) in _PANEL_INPUTS.items():
                codes = np.where(bits & suspect, 2.0, 0.0)
                absent = (bits & missing) != 0
                codes[absent] = np.where(asleep, 1.0, 3.0)[absent]
                self._inputs[panel].add(codes)
        self._compare_pressures(columns)

    def _add_validity(
        self, corner: str, columns: Mapping[str, Column]
    ) -> None:
        """Add validity and reasons of *corner*, if it has any."""
        validity = columns.get(f"{corner}.validity")
        if validity is not None and len(validity):
            track = self._validity.setdefault(corner, Buckets(np.maximum))
            track.add(np.nan_to_num(validity, nan=0.0))
        reasons = columns.get(f"{corner}.reasons")
        if reasons is not None and len(reasons):
            bits = np.nan_to_num(reasons).astype(np.int64)
            bars = self._bars.setdefault(
                ("reasons", corner), _bars(_REASON_LOOKS.values())
            )
            for one, look in _REASON_LOOKS.items():
                bars[look].add((bits & one != 0).astype(float))

    def _compare_pressures(self, columns: Mapping[str, Column]) -> None:
        """Note which corners do not share a circuit."""
        for pair in combinations(self._pressures, 2):
            one, other = (columns.get(f"{name}.pressure_pa") for name in pair)
            if (
                one is None
                or other is None
                or not np.array_equal(one, other, equal_nan=True)
            ):
                self._differing.add(pair)

    def _pressure_traces(self) -> list[Trace | None]:
        """Return one curve a circuit: corners of equal pressure share it."""
        circuits: dict[str, list[str]] = {}
        for name, curve in self._pressures.items():
            if len(curve.thin.points()[0]):
                shared = (
                    first
                    for first in circuits
                    if (first, name) not in self._differing
                )
                circuits.setdefault(next(shared, name), []).append(name)
        looks = zip(cycle(PRESSURE_COLOURS), cycle(CIRCUIT_DASHES))
        return [
            replace(
                self._pressures[first],
                label=" ".join(names),
                line={"color": colour, "dash": dash, "width": 1.5},
            ).trace()
            for (first, names), (colour, dash) in zip(
                circuits.items(), looks, strict=False
            )
        ]

    def _bar_traces(
        self, panel: str, corner: str | None, bars: dict[_Look, Buckets]
    ) -> list[Trace]:
        """Return a bar for each of *bars* that holds at any time.

        One line above the other.
        """
        traces = []
        given = [look for look, held in bars.items() if held.values.any()]
        for i, (label, colour) in enumerate(given):
            line = float(len(given) - i)
            x: list[float] = []
            y: list[float | None] = []
            for _, start_s, end_s in self._spans(bars[label, colour].values):
                x += [round(start_s, 2), round(end_s, 2), round(end_s, 2)]
                y += [line, line, None]
            bar = {"color": colour, "width": 7}
            look = {"line": bar, "hovertemplate": label}
            traces.append(Trace(panel, corner, label, x, y, look))
        return traces

    def _spans(self, codes: Column) -> list[tuple[int, float, float]]:
        return validity_spans(self._starts_s.values, codes)


def _bars(looks: Iterable[_Look]) -> dict[_Look, Buckets]:
    return {look: Buckets(np.maximum) for look in looks}


def _corner_curves(corner: str) -> list[_Curve]:
    """Return the curves of a corner in the order in which they are drawn."""
    rows: list[tuple[str, str, str, str, float, dict[str, str]]] = [
        ("margin", "margin", "margin_k", BLUE, 1.8, {}),
        ("power", "used", "brake_power_w", GREY, 0.5, {}),
        ("power", "Feed-Forward", "brake_power_ff_w", BLUE, 1.2, {}),
        ("power", "Feed-Back", "brake_power_fb_w", PURPLE, 1.2, {}),
    ]
    places = [("temperature", node) for node in SUMMARY_NODES]
    for panel, node in (*places, ("fluid", "fluid")):
        label, colour = node.replace("_", " "), NODE_COLOURS[node]
        measured, dots = f"{node}_measured_c", {"dash": "2px,4px"}
        rows += [
            (panel, label, f"{node}_c", colour, 1.8, {}),
            (panel, f"{label}, sensor", measured, colour, 2.4, dots),
        ]
    steps, dashes = {"shape": "hv"}, {"dash": "8px,4px"}
    rows += [
        ("fluid", "peak if parked now", "peak_c", VERMILION, 1.3, steps),
        (
            "fluid",
            "peak if the duty continues",
            "duty_peak_c",
            ORANGE,
            1.3,
            steps,
        ),
        ("risk", "within 30 min, if parked", "risk", VERMILION, 1.5, {}),
        ("risk", "now", "risk_now", BLUE, 1.5, {}),
        ("fluid", "wet boiling point", _BOILING_POINT, BLACK, 1.3, dashes),
    ]
    return [
        _Curve(
            panel,
            corner,
            label,
            column if column == _BOILING_POINT else f"{corner}.{column}",
            {"color": colour, "width": width, **line},
        )
        for panel, label, column, colour, width, line in rows
    ]
