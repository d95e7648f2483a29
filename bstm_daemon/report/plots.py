"""Plots of one panel each: curves and clouds over time or a quantity."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.report.decimation import ThinCurve
from bstm_daemon.report.layout import (
    AXIS_COLOUR,
    GRID_COLOUR,
    TEXT_COLOUR,
    stamp,
    tick_stops,
)
from bstm_daemon.report.timescale import time_axis

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    Column = npt.NDArray[np.float64]

CURVE_POINTS: Final = 1600
CLOUD_POINTS: Final = 1200
HEIGHT_PX: Final = 280
_DIGITS: Final = 5


@dataclass(frozen=True, slots=True)
class Plot:
    """A panel: plotly traces and layout.

    ``clock`` tells that x is seconds to be shown as min:s.
    """

    data: list[dict[str, Any]]
    layout: dict[str, Any]
    clock: bool = False


def curve(  # noqa: PLR0913
    x: Column,
    y: Column,
    name: str,
    colour: str,
    *,
    dash: str = "solid",
    width: float = 1.6,
    second: bool = False,
    legend: bool = True,
) -> dict[str, Any]:
    """Return *y* over *x*, (n,) each, as a line; NaN breaks it.

    *second* draws it on the axis at the right.
    """
    thin = ThinCurve(CURVE_POINTS)
    thin.add(np.asarray(x, np.float64), np.asarray(y, np.float64))
    x, y = thin.points()
    return {
        "type": "scatter",
        "mode": "lines",
        "name": escape(name),
        "x": np.round(x, 3).tolist(),
        "y": numbers(y),
        "yaxis": "y2" if second else "y",
        "line": {"color": colour, "width": width, "dash": dash},
        "showlegend": legend,
        "connectgaps": False,
    }


def cloud(  # noqa: PLR0913
    x: Column,
    y: Column,
    name: str,
    colour: str | None = None,
    *,
    shade: Column | None = None,
    shade_title: str = "",
    size: float = 5,
) -> dict[str, Any]:
    """Return *y* over *x*, (n,) each, as points.

    With *shade*, (n,), their colour is its value, else *colour*.
    """
    known = np.flatnonzero(np.isfinite(x) & np.isfinite(y))
    if len(known) > CLOUD_POINTS:
        step = np.linspace(0, len(known) - 1, CLOUD_POINTS).astype(int)
        known = known[np.unique(step)]
    marker: dict[str, Any] = {"size": size, "opacity": 0.7}
    if shade is None:
        marker["color"] = colour
    else:
        marker |= {
            "color": numbers(shade[known]),
            "colorscale": "Viridis",
            "showscale": True,
            "colorbar": {
                "title": {"text": escape(shade_title), "side": "right"},
                "thickness": 12,
            },
        }
    return {
        "type": "scatter",
        "mode": "markers",
        "name": escape(name),
        "x": numbers(x[known]),
        "y": numbers(y[known]),
        "marker": marker,
        "showlegend": bool(name),
    }


def plot(
    data: Sequence[dict[str, Any]],
    x_title: str,
    y_title: str,
    **changes: Any,
) -> Plot:
    """Return *data* over a quantity; *changes* go into the layout."""
    layout = _layout(y_title)
    layout["xaxis"] |= {"title": {"text": escape(x_title), "standoff": 4}}
    return Plot(list(data), _merged(layout, changes))


def time_plot(
    data: Sequence[dict[str, Any]],
    y_title: str,
    span_s: tuple[float, float],
    **changes: Any,
) -> Plot:
    """Return *data*, x in seconds, over the clock from and to *span_s*."""
    labels = time_axis(span_s[1])
    layout = _layout(y_title)
    layout["xaxis"] |= {
        "type": "date",
        "range": [stamp(span_s[0]), stamp(max(span_s[1], span_s[0] + 1.0))],
        "title": {"text": labels.title, "standoff": 4},
        "tickformatstops": tick_stops(labels),
        "hoverformat": labels.finest,
        "nticks": 12,
    }
    return Plot(list(data), _merged(layout, changes), clock=True)


def right_axis(title: str) -> dict[str, Any]:
    """Return the layout of a value axis at the right, as ``yaxis2``."""
    return {
        "overlaying": "y",
        "side": "right",
        "tickmode": "auto",
        "rangemode": "tozero",
        "showgrid": False,
        "zeroline": False,
        "title": {"text": escape(title), "standoff": 4},
    }


def wide_range(values: Column, least: float) -> list[float] | None:
    """Return the range of an axis that shows *values*.

    It reaches to *least* times the median on both sides, so that noise does
    not fill the panel, and leaves out the outermost percent.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    middle = float(np.median(known))
    low, high = np.percentile(known, (1.0, 99.0)).tolist()
    space = 0.08 * (high - low)
    return [
        min(low - space, middle - least * abs(middle)),
        max(high + space, middle + least * abs(middle)),
    ]


def numbers(values: Column) -> list[float | None]:
    """Return *values* rounded for a page, None where there is none."""
    return [
        float(f"{value:.{_DIGITS}g}") if np.isfinite(value) else None
        for value in np.asarray(values, np.float64).tolist()
    ]


def _merged(layout: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    if "yaxis2" in changes:
        layout["margin"]["r"] = 58
    for key, value in changes.items():
        known = layout.get(key)
        if isinstance(known, dict) and isinstance(value, dict):
            layout[key] = {**known, **value}
        else:
            layout[key] = value
    return layout


def _layout(y_title: str) -> dict[str, Any]:
    line = {
        "showline": True,
        "linecolor": AXIS_COLOUR,
        "gridcolor": GRID_COLOUR,
        "zerolinecolor": GRID_COLOUR,
    }
    return {
        "height": HEIGHT_PX,
        "margin": {"l": 62, "r": 24, "t": 30, "b": 44},
        "font": {
            "family": "system-ui, 'Segoe UI', Roboto, Arial, sans-serif",
            "size": 11.5,
            "color": TEXT_COLOUR,
        },
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "hovermode": "closest",
        "legend": {
            "orientation": "h",
            "x": 0,
            "y": 1.02,
            "yanchor": "bottom",
        },
        "xaxis": dict(line),
        "yaxis": {**line, "title": {"text": escape(y_title), "standoff": 4}},
    }
