"""The plots of a replay as data for plotly.js: traces, and a layout a view.

A view shows an axle, left beside right, or one corner over the full width.
Every curve is in the page once and tied to the axes of its side; a view says
which are seen and where the axes lie. All time axes move together.

Panels are stacked; the vehicle's (speed, pressure, advice) span the width, a
corner's stand in the column of its side: 1 left, 2 right, 0 the vehicle's.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.report.plots import AXIS, GREY, base_layout, clock_axis, stamp
from bstm_daemon.report.timescale import clock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.report.drive_curves import DriveCurves, Trace
    from bstm_daemon.report.drive_statistics import CornerSummary, DriveSummary

AXLES: Final = (("Front axle", ("FL", "FR")), ("Rear axle", ("RL", "RR")))

PANELS: Final = {
    "speed": ("speed [km/h]", 90),
    "pressure": ("brake pressure [bar]", 90),
    "advice": ("advice and requests", 90),
    "power": ("brake power [kW]", 140),
    "temperature": ("temperature [°C]", 320),
    "fluid": ("brake fluid temperature [°C]", 240),
    "reasons": ("not valid because of", 70),
    "risk": ("probability of vapour [%]", 120),
}
"""Title and height [px] of each panel, from the top."""

VEHICLE_PANELS: Final = ("speed", "pressure", "advice")
CORNER_PANELS: Final = ("power", "temperature", "fluid", "reasons", "risk")
LEFT: Final = 1
RIGHT: Final = 2
RIGHT_CORNERS: Final = ("FR", "RR")

MARGIN_PX: Final = {"l": 52, "r": 190, "t": 28, "b": 46}
PANEL_GAP_PX: Final = 34
TIME_LABELS_PX: Final = 20
"""More gap where the vehicle's time axis has its figures."""

COLUMN_GAP: Final = 0.05
"""Between left and right, as a share of the width."""

HEADROOM: Final = 0.05
"""Above the highest point, as a share of the axis."""

VALIDITY_COLOURS: Final = {
    1: "rgba(240,200,40,0.28)",
    2: "rgba(90,90,90,0.30)",
}
"""Shades behind degraded and invalid stretches of an estimate."""

INPUT_COLOURS: Final = {1: "rgba(213,94,0,0.22)", 2: VALIDITY_COLOURS[2]}
"""Shades behind suspect and missing inputs; see ``DriveCurves``."""


@dataclass(frozen=True, slots=True)
class View:
    """A choice of the reader.

    ``traces`` are the numbers of the curves it shows, ``named`` those of
    them that have a line in a legend.
    """

    name: str
    traces: list[int]
    named: list[int]
    layout: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Figure:
    """Plotly traces with ``x`` in elapsed seconds, and the views on them."""

    traces: list[dict[str, Any]]
    views: list[View]


def replay_figure(curves: DriveCurves, summary: DriveSummary) -> Figure:
    """Return the figure of a drive; names of curves are HTML-escaped."""
    traces = curves.traces()
    present = tuple(corner.corner for corner in summary.corners)
    return Figure(
        [_plotly_trace(trace) for trace in traces],
        [
            _view(name, corners, traces, curves, summary)
            for name, corners in view_corners(present)
        ],
    )


def view_corners(
    corners: tuple[str, ...],
) -> list[tuple[str, tuple[str, ...]]]:
    """Return name and corners of each view, axles first, front first."""
    axles = [
        (name, pair)
        for name, pair in AXLES
        if all(corner in corners for corner in pair)
    ]
    singles = [(corner, (corner,)) for corner in sorted(corners)]
    return [*axles, *singles] or [("Vehicle", ())]


def _group(trace: Trace) -> str:
    return f"{trace.panel} {trace.label}"


def _plotly_trace(trace: Trace) -> dict[str, Any]:
    column = column_of(trace.corner)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": escape(trace.label),
        "x": trace.x,
        "y": trace.y,
        "xaxis": x_axis(column),
        "yaxis": y_axis(trace.panel, column),
        "legend": legend_of(trace.panel),
        "legendgroup": escape(_group(trace)),
        **trace.look,
    }


def _view(
    name: str,
    corners: tuple[str, ...],
    traces: Sequence[Trace],
    curves: DriveCurves,
    summary: DriveSummary,
) -> View:
    numbers = [
        i
        for i, trace in enumerate(traces)
        if trace.corner is None or trace.corner in corners
    ]
    seen = [traces[i] for i in numbers]
    # a legend line stands for both sides; the lone speed needs none
    named: dict[str, int] = {}
    for i, trace in zip(numbers, seen, strict=True):
        if trace.panel != "speed":
            named.setdefault(_group(trace), i)
    return View(
        name,
        numbers,
        list(named.values()),
        view_layout(corners, seen, curves, summary),
    )


@dataclass(frozen=True, slots=True)
class _Grid:
    """The places of a view: rows and columns as shares of the plot."""

    rows: dict[str, tuple[float, float]]
    columns: dict[int, tuple[float, float]]
    filled: dict[tuple[str, int], tuple[float, float]]
    height_px: int
    duration_s: float


def column_of(corner: str | None) -> int:
    """Return 0 for the vehicle, 1 for the left, 2 for the right side."""
    if corner is None:
        return 0
    return RIGHT if corner in RIGHT_CORNERS else LEFT


def x_axis(column: int) -> str:
    """Return plotly's name of the time axis of *column*."""
    return _numbered("x", column)


def y_axis(panel: str, column: int) -> str:
    """Return plotly's name of the value axis of *panel* in *column*."""
    place = list(PANELS).index(panel)
    return _numbered("y", place + (column == RIGHT) * len(CORNER_PANELS))


def legend_of(panel: str) -> str:
    """Return plotly's name of the legend beside *panel*."""
    return _numbered("legend", list(PANELS).index(panel))


def _numbered(kind: str, place: int) -> str:
    return f"{kind}{place + 1}" if place else kind


def view_layout(
    corners: tuple[str, ...],
    seen: Sequence[Trace],
    curves: DriveCurves,
    summary: DriveSummary,
) -> dict[str, Any]:
    """Return the plotly layout of a view on *corners* with traces *seen*."""
    grid = _grid(corners, seen, summary.duration_s)
    layout = base_layout(grid.height_px, 12) | {
        "margin": MARGIN_PX,
        "hovermode": "x unified",
        "hoversubplots": "axis",
        "hoverlabel": {"bgcolor": "rgba(255,255,255,0.94)"},
        "annotations": [],
        "shapes": [],
    }
    shown = [None, *(c for c in summary.corners if c.corner in corners)]
    for corner in shown:
        layout["annotations"] += _titles(corner, grid)
        if corner is not None:
            layout["annotations"] += _fluid_peak(corner, grid)
        layout["shapes"] += _shades(curves, corner, grid)
    for column in (0, LEFT, RIGHT):
        layout |= _axes(column, grid)
    for panel, (_, top) in grid.rows.items():
        layout[legend_of(panel)] = {
            "x": 1.01,
            "xanchor": "left",
            "y": top,
            "yanchor": "top",
            "tracegroupgap": 0,
            "font": {"size": 11.5},
            "bgcolor": "rgba(255,255,255,0)",
        }
    return layout


def _grid(
    corners: tuple[str, ...], seen: Sequence[Trace], duration_s: float
) -> _Grid:
    """Stack the panels that have a curve, side by side where it takes two."""
    extents: dict[tuple[str, int], tuple[float, float]] = {}
    for trace in seen:
        place = (trace.panel, column_of(trace.corner))
        values = [value for value in trace.y if value is not None]
        low, high = extents.get(place, (0.0, 0.0))
        extents[place] = (min(low, *values), max(high, *values))
    present = [one for one in PANELS if one in {panel for panel, _ in extents}]
    # top and bottom of each panel, from the top of the plot
    edges_px: dict[str, tuple[int, int]] = {}
    used_px = 0
    for i, name in enumerate(present):
        if i:
            used_px += PANEL_GAP_PX
            if present[i - 1] in VEHICLE_PANELS and name in CORNER_PANELS:
                used_px += TIME_LABELS_PX
        edges_px[name] = used_px, used_px + PANELS[name][1]
        used_px = edges_px[name][1]
    rows = {
        name: (round(1 - low_px / used_px, 5), round(1 - top_px / used_px, 5))
        for name, (top_px, low_px) in edges_px.items()
    }
    sides = sorted({column_of(corner) for corner in corners})
    columns = dict.fromkeys([0, *sides], (0.0, 1.0))
    if sides == [LEFT, RIGHT]:
        half = (1 - COLUMN_GAP) / 2
        columns |= {LEFT: (0.0, half), RIGHT: (1 - half, 1.0)}
    height_px = used_px + MARGIN_PX["t"] + MARGIN_PX["b"]
    return _Grid(rows, columns, extents, height_px, duration_s)


def _axes(column: int, grid: _Grid) -> dict[str, Any]:
    """Return the axes of *column* that have a curve.

    An axis that is declared but has none spoils the clipping of others.
    """
    panels = VEHICLE_PANELS if column == 0 else CORNER_PANELS
    filled = [panel for panel in panels if (panel, column) in grid.filled]
    axes = {
        y_axis(panel, column): _value_axis(panel, column, grid)
        for panel in filled
    }
    if filled:
        axes[x_axis(column)] = _time_axis(column, filled[-1], grid)
    return {f"{name[0]}axis{name[1:]}": axis for name, axis in axes.items()}


def _value_axis(panel: str, column: int, grid: _Grid) -> dict[str, Any]:
    axis: dict[str, Any] = {
        "anchor": x_axis(column),
        "domain": grid.rows[panel],
        "rangemode": "tozero",
        **AXIS,
        "nticks": max(5, PANELS[panel][1] // 35),
    }
    if panel in {"advice", "reasons"}:
        # lines, not values: the legend has their names
        highest = grid.filled[panel, column][1]
        axis |= {"range": [0.3, highest + 0.7], "showticklabels": False}
        axis |= {"showgrid": False, "zeroline": False}
    sides = [side for side in (LEFT, RIGHT) if (panel, side) in grid.filled]
    if column and sides == [LEFT, RIGHT]:
        # one scale for both sides
        low = min(grid.filled[panel, side][0] for side in sides)
        high = max(grid.filled[panel, side][1] for side in sides)
        space = HEADROOM * (high - low or 1.0)
        axis["range"] = [low - space if low < 0.0 else 0.0, high + space]
        if column == RIGHT:
            axis["matches"] = y_axis(panel, LEFT)
    return axis


def _time_axis(column: int, lowest_panel: str, grid: _Grid) -> dict[str, Any]:
    whole = grid.columns[column] == (0.0, 1.0)
    axis = clock_axis((0.0, grid.duration_s)) | {
        "domain": grid.columns[column],
        "anchor": y_axis(lowest_panel, column),
        "showline": True,
        "linecolor": GREY,
        "gridcolor": AXIS["gridcolor"],
        "ticks": "outside",
        "tickcolor": GREY,
        "nticks": 12 if whole else 8,
    }
    columns = sorted({side for _, side in grid.filled})
    if column != columns[0]:
        axis["matches"] = x_axis(columns[0])
    if not column and columns != [0]:
        del axis["title"]
    return axis


def _titles(corner: CornerSummary | None, grid: _Grid) -> list[dict[str, Any]]:
    """Return the headings of a column's panels, or why one is empty."""
    column = column_of(corner.corner if corner else None)
    titles = []
    for panel in CORNER_PANELS if corner else VEHICLE_PANELS:
        if panel not in grid.rows:
            continue
        text = PANELS[panel][0]
        if corner is not None:
            text = f"<b>{escape(corner.corner)}</b>  {text}"
        if (panel, column) not in grid.filled:
            text += ": none"
            if corner is not None and not corner.modelled:
                text += ", corner not modelled"
        titles.append(
            {
                "text": text,
                "x": grid.columns[column][0],
                "xref": "paper",
                "xanchor": "left",
                "y": grid.rows[panel][1],
                "yref": "paper",
                "yanchor": "bottom",
                "yshift": 3,
                "showarrow": False,
                "font": {"size": 12.5},
            }
        )
    return titles


_LABEL_ABOVE_C: Final = 70.0
"""A colder peak has its label above, a hotter one below: down there is the
time axis, up there the boiling point, 140 degC at least."""


def _fluid_peak(corner: CornerSummary, grid: _Grid) -> list[dict[str, Any]]:
    """Return the label of the fluid's peak: how hot, how long after."""
    column = column_of(corner.corner)
    peak = corner.peaks.get("fluid")
    if peak is None or ("fluid", column) not in grid.filled:
        return []
    text = f"{peak.temperature_c:.0f} °C"
    if peak.after_stop_s is not None and peak.after_stop_s > 0.0:
        text += f"<br>{clock(peak.after_stop_s)} after the stop"
    if peak.at_end:
        text += "<br>still rising"
    return [
        {
            "text": text,
            "x": stamp(peak.time_s),
            "xref": x_axis(column),
            "y": peak.temperature_c,
            "yref": y_axis("fluid", column),
            "ax": 0,
            "ay": -62 if peak.temperature_c < _LABEL_ABOVE_C else 62,
            "xanchor": _inward(peak.time_s, grid.duration_s),
            "arrowhead": 2,
            "arrowsize": 0.9,
            "arrowwidth": 1,
            "arrowcolor": GREY,
            "bgcolor": "rgba(255,255,255,0.6)",
            "font": {"size": 12},
        }
    ]


def _inward(time_s: float, duration_s: float) -> str:
    """Return the text anchor that keeps a label inside its panel."""
    edge = 0.15 * duration_s
    if time_s < edge:
        return "left"
    return "right" if time_s > duration_s - edge else "center"


def _shades(
    curves: DriveCurves, corner: CornerSummary | None, grid: _Grid
) -> list[dict[str, Any]]:
    """Return the shades of doubtful inputs and of doubtful estimates."""
    column = column_of(corner.corner if corner else None)
    spans = [
        (panel, span, INPUT_COLOURS)
        for panel in (("power",) if corner else VEHICLE_PANELS)
        for span in curves.input_spans(panel)
    ]
    if corner:
        spans += [
            (panel, span, VALIDITY_COLOURS)
            for span in curves.spans(corner.corner)
            for panel in ("temperature", "fluid")
        ]
    return [
        {
            "type": "rect",
            "xref": x_axis(column),
            "yref": "paper",
            "x0": stamp(start_s),
            "x1": stamp(end_s),
            "y0": grid.rows[panel][0],
            "y1": grid.rows[panel][1],
            "line": {"width": 0},
            "fillcolor": colours[code],
            "layer": "below",
        }
        for panel, (code, start_s, end_s), colours in spans
        if (panel, column) in grid.filled
    ]
