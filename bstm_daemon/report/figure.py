"""The plots of a replay as data for plotly.js: traces, and a layout a view.

A view shows an axle, left beside right, or one corner over the full width.
Every curve is in the page once and tied to the axes of its side; a view says
which are seen and where the axes lie. All time axes move together.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from html import escape
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.report.summary import front_first
from bstm_daemon.report.timescale import time_axis
from bstm_daemon.report.traces import Trace, drive_traces

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy.typing as npt

    from bstm_daemon.results import Results

EPOCH: Final = datetime(2000, 1, 1)  # noqa: DTZ001
"""Elapsed time 0 on the date axes, which alone have 1-2-5-10-15-30 ticks."""

DAY_TICKS_MS: Final = 86_400_000
MINUTE_TICKS_MS: Final = 60_000
SECOND_TICKS_MS: Final = 1000

AXLES: Final = (
    ("Front axle", ("FL", "FR")),
    ("Rear axle", ("RL", "RR")),
)
RIGHT_CORNERS: Final = ("FR", "RR")

PANELS: Final = {
    "speed": ("speed [km/h]", 90),
    "pressure": ("brake pressure [bar]", 90),
    "power": ("brake power [kW]", 140),
    "temperature": ("temperature [°C]", 300),
    "fluid": ("brake fluid temperature [°C]", 240),
}
"""Title and height [px] of each panel, from the top."""

VEHICLE_PANELS: Final = ("speed", "pressure")

MARGIN_PX: Final = {"l": 52, "r": 190, "t": 28, "b": 46}
PANEL_GAP_PX: Final = 34
TIME_LABELS_PX: Final = 20
"""More gap where the vehicle's time axis has its figures."""

COLUMN_GAP: Final = 0.05
"""Between left and right, as a share of the width."""

GRID_COLOUR: Final = "#e6e8eb"
AXIS_COLOUR: Final = "#8c959f"
TEXT_COLOUR: Final = "#1f2328"
VALIDITY_COLOURS: Final = {1: "rgba(240,200,40,0.28)", 2: "rgba(90,90,90,0.30)"}
"""Shades behind degraded and invalid stretches."""

SPANS_DRAWN: Final = 300
"""More stretches than this are merged to what a screen can show."""


@dataclass(frozen=True, slots=True)
class View:
    """A choice of the reader: which curves, which legend lines, layout."""

    name: str
    visible: list[bool]
    showlegend: list[bool]
    layout: dict[str, Any]


@dataclass(frozen=True, slots=True)
class Figure:
    """Plotly traces with ``x`` in elapsed seconds, and the views on them."""

    traces: list[dict[str, Any]]
    views: list[View]


def replay_figure(results: Results) -> Figure:
    """Return the figure of *results*; every name in it is HTML-escaped."""
    traces = drive_traces(results)
    return Figure(
        [_plotly_trace(trace) for trace in traces],
        [
            _view(name, corners, traces, results)
            for name, corners in view_corners(results.corners)
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
    singles = [(corner, (corner,)) for corner in front_first(corners)]
    return [*axles, *singles] or [("Vehicle", ())]


def validity_spans(
    elapsed_s: npt.NDArray[np.float64], validity: npt.NDArray[np.float64]
) -> list[tuple[int, float, float]]:
    """Return code, start and end [s] of each stretch that is not valid.

    A stretch ends where the next one begins. Where there are more than a
    screen can show, neighbours are merged and keep the worse code.
    """
    codes = np.nan_to_num(validity, nan=0.0).astype(np.int64)
    starts_s = elapsed_s
    if np.count_nonzero(np.diff(codes)) > SPANS_DRAWN:
        first = np.linspace(0, len(codes), SPANS_DRAWN, endpoint=False)
        rows = first.astype(np.intp)
        codes, starts_s = np.maximum.reduceat(codes, rows), elapsed_s[rows]
    changes = np.flatnonzero(np.diff(codes)) + 1
    bounds = [0, *changes.tolist(), len(codes)]
    spans = []
    for begin, end in zip(bounds, bounds[1:], strict=False):
        if begin < end and codes[begin] > 0:
            end_s = starts_s[end] if end < len(codes) else elapsed_s[-1]
            spans.append(
                (int(codes[begin]), float(starts_s[begin]), float(end_s))
            )
    return spans


def _column(corner: str | None) -> int:
    """Return 0 for the vehicle, 1 for the left, 2 for the right side."""
    if corner is None:
        return 0
    return 2 if corner in RIGHT_CORNERS else 1


def _panels(column: int) -> tuple[str, ...]:
    if column == 0:
        return VEHICLE_PANELS
    return tuple(name for name in PANELS if name not in VEHICLE_PANELS)


def _x_axis(column: int) -> str:
    return "x" if column == 0 else f"x{column + 1}"


def _y_axis(panel: str, column: int) -> str:
    number = list(PANELS).index(panel) + 1
    if column == 2:  # noqa: PLR2004
        number += len(_panels(column))
    return "y" if number == 1 else f"y{number}"


def _layout_key(axis: str) -> str:
    return f"{axis[0]}axis{axis[1:]}"


def _legend(panel: str) -> str:
    number = list(PANELS).index(panel) + 1
    return "legend" if number == 1 else f"legend{number}"


def _group(trace: Trace) -> str:
    return f"{trace.panel} {trace.label}"


def _plotly_trace(trace: Trace) -> dict[str, Any]:
    column = _column(trace.corner)
    return {
        "type": "scatter",
        "mode": "lines",
        "name": escape(trace.label),
        "x": trace.x,
        "y": trace.y,
        "xaxis": _x_axis(column),
        "yaxis": _y_axis(trace.panel, column),
        "legend": _legend(trace.panel),
        "legendgroup": escape(_group(trace)),
        "connectgaps": False,
        **trace.look,
    }


def _view(
    name: str,
    corners: tuple[str, ...],
    traces: Sequence[Trace],
    results: Results,
) -> View:
    visible = [
        trace.corner is None or trace.corner in corners for trace in traces
    ]
    seen = [
        trace for trace, shown in zip(traces, visible, strict=True) if shown
    ]
    groups: set[str] = set()
    showlegend = []
    for trace, shown in zip(traces, visible, strict=True):
        # a legend line stands for both sides; a lone curve needs none
        first = shown and _group(trace) not in groups
        showlegend.append(first and trace.panel != "speed")
        if first:
            groups.add(_group(trace))
    return View(
        escape(name),
        visible,
        showlegend,
        _layout(corners, seen, results),
    )


def _layout(
    corners: tuple[str, ...], seen: Sequence[Trace], results: Results
) -> dict[str, Any]:
    time_s = results.columns["time_s"]
    elapsed_s = time_s - time_s[0] if len(time_s) else time_s
    duration_s = float(elapsed_s[-1]) if len(elapsed_s) else 0.0
    rows, height_px = _rows({trace.panel for trace in seen})
    sides = _sides(corners)
    layout: dict[str, Any] = {
        "height": height_px,
        "margin": MARGIN_PX,
        "font": {
            "family": "system-ui, 'Segoe UI', Roboto, Arial, sans-serif",
            "size": 12,
            "color": TEXT_COLOUR,
        },
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "hovermode": "x unified",
        "hoversubplots": "axis",
        "hoverlabel": {"bgcolor": "rgba(255,255,255,0.94)"},
        # the stretch of time that a reader chose outlives a change of view
        "uirevision": "time",
        "annotations": [],
        "shapes": [],
    }
    filled = {(trace.panel, _column(trace.corner)) for trace in seen}
    for column in range(3):
        domain = sides.get(column)
        layout |= _axes(column, domain, filled, rows, duration_s)
        if domain is not None:
            corner = next((c for c in corners if _column(c) == column), None)
            layout["annotations"] += _titles(
                corner, column, domain[0], filled, rows
            )
    for panel, (_, top) in rows.items():
        layout[_legend(panel)] = {
            "x": 1.01,
            "xanchor": "left",
            "y": top,
            "yanchor": "top",
            "uirevision": " ".join(corners),
            "tracegroupgap": 0,
            "font": {"size": 11.5},
            "bgcolor": "rgba(255,255,255,0)",
        }
    for corner in corners:
        layout["shapes"] += _shades(results, corner, elapsed_s, rows)
    return layout


def _rows(
    panels: Iterable[str],
) -> tuple[dict[str, tuple[float, float]], int]:
    """Stack *panels*: bottom and top as shares of the plot, height [px]."""
    present = [name for name in PANELS if name in set(panels)]
    tops_px: dict[str, int] = {}
    used_px = 0
    for i, name in enumerate(present):
        if i:
            used_px += PANEL_GAP_PX
            if (
                present[i - 1] in VEHICLE_PANELS
                and name not in VEHICLE_PANELS
            ):
                used_px += TIME_LABELS_PX
        tops_px[name] = used_px
        used_px += PANELS[name][1]
    rows = {
        name: (
            round(1 - (top_px + PANELS[name][1]) / used_px, 5),
            round(1 - top_px / used_px, 5),
        )
        for name, top_px in tops_px.items()
    }
    return rows, used_px + MARGIN_PX["t"] + MARGIN_PX["b"]


def _sides(corners: tuple[str, ...]) -> dict[int, tuple[float, float]]:
    """Return the horizontal domain of each column that a view shows."""
    columns = sorted({_column(corner) for corner in corners})
    if len(columns) < 2:  # noqa: PLR2004
        return dict.fromkeys([0, *columns], (0.0, 1.0))
    half = (1 - COLUMN_GAP) / 2
    return {0: (0.0, 1.0), 1: (0.0, half), 2: (1 - half, 1.0)}


def _axes(
    column: int,
    domain: tuple[float, float] | None,
    filled: set[tuple[str, int]],
    rows: dict[str, tuple[float, float]],
    duration_s: float,
) -> dict[str, Any]:
    """Return the axes of *column*; those that have no curve are hidden."""
    x_axis = _x_axis(column)
    panels = [name for name in _panels(column) if (name, column) in filled]
    axes: dict[str, Any] = {}
    for panel in _panels(column):
        axis: dict[str, Any] = {"anchor": x_axis, "visible": False}
        if domain is not None and panel in panels:
            axis |= {
                "visible": True,
                "domain": rows[panel],
                "rangemode": "tozero",
                "showline": True,
                "linecolor": AXIS_COLOUR,
                "gridcolor": GRID_COLOUR,
                "zerolinecolor": GRID_COLOUR,
                "nticks": 4 if PANELS[panel][1] < 200 else 8,  # noqa: PLR2004
                "uirevision": f"{column} {domain}",
            }
            left = _y_axis(panel, 1)
            if column == 2 and (panel, 1) in filled:  # noqa: PLR2004
                # one scale: what is hotter looks hotter
                axis["matches"] = left
        axes[_layout_key(_y_axis(panel, column))] = axis
    labels = time_axis(duration_s)
    x: dict[str, Any] = {"type": "date", "visible": False}
    if column:
        x["matches"] = "x"
    if domain is not None and panels:
        bottom = _y_axis(panels[-1], column)
        x |= {
            "visible": True,
            "domain": domain,
            "anchor": bottom,
            "range": [stamp(0.0), stamp(max(duration_s, 1.0))],
            "showline": True,
            "linecolor": AXIS_COLOUR,
            "gridcolor": GRID_COLOUR,
            "ticks": "outside",
            "tickcolor": AXIS_COLOUR,
            "hoverformat": labels.fine,
            "tickformatstops": [
                {
                    "dtickrange": [None, SECOND_TICKS_MS - 1],
                    "value": labels.finest,
                },
                {
                    "dtickrange": [SECOND_TICKS_MS, MINUTE_TICKS_MS - 1],
                    "value": labels.fine,
                },
                {
                    "dtickrange": [MINUTE_TICKS_MS, None],
                    "value": labels.coarse,
                },
            ],
        }
        if column or not any(side for _, side in filled):
            x["title"] = {"text": labels.title, "standoff": 6}
    axes[_layout_key(x_axis)] = x
    return axes


def _titles(
    corner: str | None,
    column: int,
    left: float,
    filled: set[tuple[str, int]],
    rows: dict[str, tuple[float, float]],
) -> list[dict[str, Any]]:
    """Return the headings of a column's panels, or why one is empty."""
    titles = []
    for panel in _panels(column):
        if panel not in rows:
            continue
        text = PANELS[panel][0]
        if corner is not None:
            text = f"<b>{escape(corner)}</b>  {text}"
        if (panel, column) not in filled:
            text += ": none, not modelled"
        titles.append(
            {
                "text": text,
                "x": left,
                "xref": "paper",
                "xanchor": "left",
                "y": rows[panel][1],
                "yref": "paper",
                "yanchor": "bottom",
                "yshift": 3,
                "showarrow": False,
                "font": {"size": 12.5},
            }
        )
    return titles


def _shades(
    results: Results,
    corner: str,
    elapsed_s: npt.NDArray[np.float64],
    rows: dict[str, tuple[float, float]],
) -> list[dict[str, Any]]:
    validity = results.columns.get(f"{corner}.validity")
    panels = [name for name in ("temperature", "fluid") if name in rows]
    if validity is None or not len(validity):
        return []
    return [
        {
            "type": "rect",
            "xref": _x_axis(_column(corner)),
            "yref": "paper",
            "x0": stamp(start_s),
            "x1": stamp(end_s),
            "y0": rows[panel][0],
            "y1": rows[panel][1],
            "line": {"width": 0},
            "fillcolor": VALIDITY_COLOURS[code],
            "layer": "below",
        }
        for code, start_s, end_s in validity_spans(elapsed_s, validity)
        for panel in panels
    ]


def stamp(elapsed_s: float) -> str:
    """Return *elapsed_s* as a plotly date."""
    return (EPOCH + timedelta(seconds=elapsed_s)).isoformat(
        sep=" ", timespec="milliseconds"
    )
