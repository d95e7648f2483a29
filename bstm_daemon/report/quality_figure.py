"""The plots of a check: both channels over time, and one over the other."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.quality.grid import shifted
from bstm_daemon.quality.limits import GRID_S
from bstm_daemon.report.decimation import ThinCurve
from bstm_daemon.report.layout import (
    AXIS_COLOUR,
    GRID_COLOUR,
    TEXT_COLOUR,
    stamp,
    tick_stops,
)
from bstm_daemon.report.timescale import time_axis
from bstm_daemon.report.traces import BLUE, ORANGE, VERMILION

if TYPE_CHECKING:
    from bstm_daemon.quality.finding import Comparison
    from bstm_daemon.quality.recording import Column

CURVE_POINTS: Final = 1600
CLOUD_POINTS: Final = 1500
HEIGHT_PX: Final = 250
_DIGITS: Final = 5


def comparison_plot(
    comparison: Comparison, duration_s: float
) -> dict[str, Any]:
    """Return plotly data and layout of *comparison*.

    ``x`` of the curves is seconds; every name is HTML-escaped.
    """
    reference_unit, reference_si = comparison.reference_scale
    reference = comparison.reference / reference_si
    channel = comparison.channel / comparison.unit_si
    own_axis = reference_unit != comparison.unit
    curves = [
        _curve(
            comparison.time_s,
            reference,
            f"{comparison.reference_name} [{reference_unit}]",
            {"color": BLUE, "width": 2.2},
            "y",
        ),
        _curve(
            comparison.time_s,
            channel,
            f"{comparison.channel_name} [{comparison.unit}]",
            {"color": ORANGE, "width": 1.3},
            "y3" if own_axis else "y",
        ),
    ]
    return {
        "data": [*curves, *_cloud(comparison, reference, channel)],
        "layout": _layout(comparison, duration_s, own_axis=own_axis),
    }


def _curve(
    time_s: Column,
    value: Column,
    name: str,
    line: dict[str, Any],
    axis: str,
) -> dict[str, Any]:
    known = np.flatnonzero(np.isfinite(value))
    if len(known):
        # a point without a value on each side keeps the line's breaks
        first, last = max(known[0] - 1, 0), known[-1] + 2
        time_s, value = time_s[first:last], value[first:last]
    thin = ThinCurve(CURVE_POINTS)
    thin.add(time_s, value)
    x, y = thin.points()
    return {
        "type": "scatter",
        "mode": "lines",
        "name": escape(name),
        "x": np.round(x, 2).tolist(),
        "y": _numbers(y),
        "yaxis": axis,
        "line": line,
    }


def _cloud(
    comparison: Comparison, reference: Column, channel: Column
) -> list[dict[str, Any]]:
    """Return the points of one channel over the other, and the line."""
    fit = comparison.fit
    if fit is not None and fit.lag_s is not None:
        reference = shifted(reference, round(fit.lag_s / GRID_S))
    both = np.flatnonzero(np.isfinite(reference) & np.isfinite(channel))
    if not len(both):
        return []
    # spread over the reference, not over time: hours of standing are one dot
    order = both[np.argsort(reference[both], kind="stable")]
    rank = np.linspace(reference[order[0]], reference[order[-1]], CLOUD_POINTS)
    by_value = np.searchsorted(reference[order], rank).clip(0, len(order) - 1)
    evenly = np.linspace(0, len(order) - 1, CLOUD_POINTS // 3).astype(int)
    chosen = order[np.unique(np.concatenate((by_value, evenly)))]
    x, y = reference[chosen], channel[chosen]
    found: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "markers",
            "x": _numbers(x),
            "y": _numbers(y),
            "xaxis": "x2",
            "yaxis": "y2",
            "marker": {"color": BLUE, "size": 3, "opacity": 0.45},
            "showlegend": False,
            "hoverinfo": "skip",
        }
    ]
    if fit is not None:
        _, reference_si = comparison.reference_scale
        ends = np.array([x.min(), x.max()])
        # an absurd channel has an absurd fit; what is no number is not drawn
        with np.errstate(over="ignore", invalid="ignore"):
            line = (
                fit.scale * ends * reference_si + fit.offset
            ) / comparison.unit_si
        found.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": _numbers(ends),
                "y": _numbers(line),
                "xaxis": "x2",
                "yaxis": "y2",
                "line": {"color": VERMILION, "width": 1.6},
                "showlegend": False,
                "hoverinfo": "skip",
            }
        )
    return found


def _numbers(values: Column) -> list[float | None]:
    return [
        float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None
        for value in values.tolist()
    ]


def _layout(
    comparison: Comparison, duration_s: float, *, own_axis: bool
) -> dict[str, Any]:
    labels = time_axis(duration_s)
    line = {
        "showline": True,
        "linecolor": AXIS_COLOUR,
        "gridcolor": GRID_COLOUR,
        "zerolinecolor": GRID_COLOUR,
    }
    reference_unit, _ = comparison.reference_scale
    layout: dict[str, Any] = {
        "height": HEIGHT_PX,
        "margin": {"l": 56, "r": 12, "t": 26, "b": 42},
        "font": {
            "family": "system-ui, 'Segoe UI', Roboto, Arial, sans-serif",
            "size": 11.5,
            "color": TEXT_COLOUR,
        },
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "hovermode": "x unified",
        "legend": {
            "orientation": "h",
            "x": 0,
            "y": 1.02,
            "yanchor": "bottom",
        },
        "xaxis": {
            **line,
            "type": "date",
            "domain": [0.0, 0.6],
            "range": _seen(comparison, duration_s),
            "title": {"text": labels.title, "standoff": 4},
            "tickformatstops": tick_stops(labels),
            "hoverformat": labels.fine,
            "nticks": 9,
        },
        "yaxis": {
            **line,
            "title": {"text": escape(reference_unit), "standoff": 4},
        },
        "xaxis2": {
            **line,
            "domain": [0.73, 1.0],
            "anchor": "y2",
            "title": {
                "text": escape(
                    f"{comparison.reference_name} [{reference_unit}]"
                ),
                "standoff": 4,
            },
        },
        "yaxis2": {
            **line,
            "anchor": "x2",
            "title": {
                "text": escape(_short(comparison.channel_name)),
                "standoff": 4,
            },
        },
    }
    if own_axis:
        layout["yaxis3"] = {
            "overlaying": "y",
            "side": "right",
            "anchor": "x",
            "showgrid": False,
            "tickmode": "auto",
            "zeroline": False,
            "title": {"text": escape(comparison.unit), "standoff": 4},
        }
    return layout


def _seen(comparison: Comparison, duration_s: float) -> list[str]:
    """Return the stretch of time in which both channels are present."""
    both = np.isfinite(comparison.reference) & np.isfinite(comparison.channel)
    known_s = comparison.time_s[both]
    if len(known_s) < 2:
        return [stamp(0.0), stamp(max(duration_s, 1.0))]
    return [stamp(max(float(known_s[0]), 0.0)), stamp(float(known_s[-1]))]


def _short(name: str) -> str:
    longest = 28
    return name if len(name) <= longest else f"{name[: longest - 1]}…"
