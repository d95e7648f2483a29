"""The plots of a replay: panels of the vehicle, of all corners, of each one.

The panels of the vehicle (speed, pressure, advice) are always shown. Below
them the reader chooses a view: the corners side by side in one panel a
quantity, or everything about one corner. All time axes are as wide as one
another and move together, so that a stop can be followed down.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from html import escape
from itertools import cycle
from typing import Any, Final

from bstm_daemon.report.drive_curves import DriveCurves, Trace
from bstm_daemon.report.drive_statistics import CornerSummary, DriveSummary
from bstm_daemon.report.plots import COLOURS, GREY, Plot, stamp, time_plot
from bstm_daemon.report.timescale import clock

Titled = tuple[str, Plot]

PANELS: Final = {
    "speed": ("speed [km/h]", 80),
    "pressure": ("brake pressure [bar]", 80),
    "advice": ("advice and requests", 80),
    "margin": ("margin of the fluid to wet boiling [K]", 150),
    "temperature": ("temperature [°C]", 300),
    "fluid": ("brake fluid temperature [°C]", 220),
    "power": ("brake power [kW]", 120),
    "reasons": ("not valid because of", 70),
    "risk": ("probability of vapour [%]", 110),
}
"""Title and height [px] of each panel, from the top."""

VEHICLE_PANELS: Final = ("speed", "pressure", "advice")

OVERVIEW: Final = "All corners"
OVERVIEW_CURVES: Final = {
    "margin": ("margin", PANELS["margin"][0]),
    "temperature": ("disc", "disc temperature [°C]"),
    "fluid": ("fluid", PANELS["fluid"][0]),
    "power": ("used", PANELS["power"][0]),
}
"""By panel the curve of a corner that stands beside those of the others, and
the title."""

# fixed: a long legend would make its panel narrower than those above
MARGIN_PX: Final = {"l": 52, "r": 214, "t": 6, "b": 22, "autoexpand": False}

PARKED, SUSPECT, MISSING = 1, 2, 3

VALIDITY_COLOURS: Final = {
    1: "rgba(240,200,40,0.28)",
    2: "rgba(90,90,90,0.30)",
}
"""Shades behind degraded and invalid stretches of an estimate."""

INPUT_COLOURS: Final = {
    PARKED: "rgba(0,114,178,0.13)",
    SUSPECT: "rgba(213,94,0,0.22)",
    MISSING: VALIDITY_COLOURS[2],
}
"""Shades behind inputs; see :meth:`DriveCurves.input_spans`."""

KEYS: Final = (
    ("degraded", "degraded estimate"),
    ("suspect", "suspect input, heat of the other source"),
    ("invalid", "invalid estimate, missing input, unknown heat"),
    ("parked", "parked, bus asleep: nothing is missing"),
)
"""Shades by the class that the page has for them, and what they mean."""

_LABEL_ABOVE_C: Final = 70.0
"""A colder peak has its label above, a hotter one below: down there is the
time axis, up there the boiling point, 140 degC at least."""


def drive_plots(curves: DriveCurves, summary: DriveSummary) -> list[Titled]:
    """Return the plots of a drive with their titles, from the top."""
    traces = curves.traces()
    by_place: dict[tuple[str | None, str], list[Trace]] = {}
    for trace in traces:
        by_place.setdefault((trace.corner, trace.panel), []).append(trace)
    drawn = [
        (
            PANELS[panel][0],
            _panel(panel, by_place[None, panel], curves, summary),
        )
        for panel in VEHICLE_PANELS
        if (None, panel) in by_place
    ]
    if len(summary.corners) > 1:
        drawn += _overview(by_place, curves, summary)
    for corner in summary.corners:
        own = [
            (panel, by_place.get((corner.corner, panel))) for panel in PANELS
        ]
        drawn += [
            (
                f"{corner.corner}: {PANELS[panel][0]}",
                _panel(panel, found, curves, summary, corner),
            )
            for panel, found in own
            if found
        ]
    return drawn


def _overview(
    by_place: dict[tuple[str | None, str], list[Trace]],
    curves: DriveCurves,
    summary: DriveSummary,
) -> list[Titled]:
    """Return a panel a quantity with a curve for each corner."""
    drawn = []
    looks = zip(COLOURS, cycle(("solid", "6px,4px")), strict=False)
    lines = [{"color": c, "dash": dash, "width": 2.0} for c, dash in looks]
    for panel, (label, title) in OVERVIEW_CURVES.items():
        found = [
            replace(
                trace,
                label=one.corner,
                look={
                    "line": line,
                    "hovertemplate": trace.look["hovertemplate"],
                },
            )
            for one, line in zip(summary.corners, lines, strict=False)
            for trace in by_place.get((one.corner, panel), ())
            if trace.label == label
        ]
        if found:
            plot = _panel(panel, found, curves, summary)
            drawn.append((title, replace(plot, view=OVERVIEW)))
    return drawn


def _panel(
    panel: str,
    traces: Sequence[Trace],
    curves: DriveCurves,
    summary: DriveSummary,
    corner: CornerSummary | None = None,
) -> Plot:
    """Return *traces* over the time of the drive, with their shades."""
    height_px = PANELS[panel][1]
    axis: dict[str, Any] = {
        "rangemode": "tozero",
        "nticks": max(4, height_px // 35),
    }
    if panel in {"advice", "reasons"}:
        # lines, not values: the legend has their names
        highest = max(y for trace in traces for y in trace.y if y is not None)
        axis = {"range": [0.3, highest + 0.7], "showticklabels": False}
        axis |= {"showgrid": False, "zeroline": False}
    notes = (
        []
        if corner is None or panel != "fluid"
        else _fluid_peak(corner, summary)
    )
    drawn = time_plot(
        [
            {
                "type": "scatter",
                "mode": "lines",
                "name": escape(trace.label),
                "x": trace.x,
                "y": trace.y,
                "showlegend": panel != "speed",
                **trace.look,
            }
            for trace in traces
        ],
        "",
        (0.0, summary.duration_s),
        height=height_px + MARGIN_PX["t"] + MARGIN_PX["b"],
        margin=MARGIN_PX,
        hovermode="x unified",
        legend={"orientation": "v", "x": 1.01, "y": 1.0, "yanchor": "top"},
        xaxis={"title": {"text": ""}},
        yaxis=axis,
        annotations=notes,
        shapes=_shades(panel, curves, corner),
    )
    return replace(drawn, linked=True, view=corner.corner if corner else "")


def _fluid_peak(
    corner: CornerSummary, summary: DriveSummary
) -> list[dict[str, Any]]:
    """Return the label of the fluid's peak: how hot, how long after."""
    peak = corner.peaks.get("fluid")
    if peak is None:
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
            "y": peak.temperature_c,
            "ax": 0,
            "ay": -62 if peak.temperature_c < _LABEL_ABOVE_C else 62,
            "xanchor": _inward(peak.time_s, summary.duration_s),
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
    panel: str, curves: DriveCurves, corner: CornerSummary | None
) -> list[dict[str, Any]]:
    """Return the shades of doubtful inputs and of doubtful estimates."""
    spans: Iterable[tuple[int, float, float]] = curves.input_spans(panel)
    colours = INPUT_COLOURS
    if corner and panel in {"margin", "temperature", "fluid"}:
        spans, colours = curves.spans(corner.corner), VALIDITY_COLOURS
    return [
        {
            "type": "rect",
            "yref": "paper",
            "x0": stamp(start_s),
            "x1": stamp(end_s),
            "y0": 0,
            "y1": 1,
            "line": {"width": 0},
            "fillcolor": colours[code],
            "layer": "below",
        }
        for code, start_s, end_s in spans
    ]
