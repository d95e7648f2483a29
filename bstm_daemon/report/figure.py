"""The plots of a replay as data for plotly.js: traces, and a layout a view.

A view shows an axle, left beside right, or one corner over the full width.
Every curve is in the page once and tied to the axes of its side; a view says
which are seen and where the axes lie. All time axes move together.
"""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.report.layout import (
    column_of,
    legend_of,
    view_layout,
    x_axis,
    y_axis,
)
from bstm_daemon.report.summary import DriveSummary, front_first

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.report.traces import DriveCurves, Trace

AXLES: Final = (
    ("Front axle", ("FL", "FR")),
    ("Rear axle", ("RL", "RR")),
)


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
    """Return the figure of a drive; every name in it is HTML-escaped."""
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
    singles = [(corner, (corner,)) for corner in front_first(corners)]
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
        escape(name),
        numbers,
        list(named.values()),
        view_layout(corners, seen, curves, summary),
    )
