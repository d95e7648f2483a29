"""Plots of one panel each: curves and clouds over time or a quantity."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from html import escape
from typing import Any, Final, NamedTuple

import numpy as np

from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.report.decimation import ThinCurve
from bstm_daemon.report.timescale import time_axis

EPOCH: Final = datetime(2000, 1, 1)  # noqa: DTZ001
"""Elapsed time 0 on the date axes, which alone have 1-5-10-15-30 ticks."""

# Okabe & Ito 2008: distinguishable with any common colour deficiency
ORANGE: Final = "#e69f00"
GREEN: Final = "#009e73"
BLUE: Final = "#0072b2"
SKY_BLUE: Final = "#56b4e9"
VERMILION: Final = "#d55e00"
PURPLE: Final = "#cc79a7"
BLACK: Final = "#1f2328"
GREY: Final = "#8c959f"
PAPER: Final = "#ffffff"
COLOURS: Final = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, BLACK)

NODE_COLOURS: Final = {
    "disc": VERMILION,
    "pad_front": ORANGE,
    "pad_back": GREEN,
    "fluid": BLUE,
}

GRID_COLOUR: Final = "#e6e8eb"
AXIS: Final = {
    "showline": True,
    "linecolor": GREY,
    "gridcolor": GRID_COLOUR,
    "zerolinecolor": GRID_COLOUR,
}

MINUTE_TICKS_MS: Final = 60_000
SECOND_TICKS_MS: Final = 1000

CURVE_POINTS: Final = 1600
CLOUD_POINTS: Final = 1200
HEIGHT_PX: Final = 280
_DIGITS: Final = 5


@dataclass(frozen=True, slots=True)
class Plot:
    """A panel: plotly traces and layout.

    With ``clock``, x is in seconds and shown as min:s. The time axes of
    ``linked`` plots move together. ``view`` is the choice of the reader that
    shows it, "" where it is always shown.
    """

    data: list[dict[str, Any]]
    layout: dict[str, Any]
    clock: bool = False
    linked: bool = False
    view: str = ""


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
    known = np.flatnonzero(np.isfinite(y))
    if len(known):
        # a point without a value on each side keeps the line's breaks
        part = slice(max(known[0] - 1, 0), known[-1] + 2)
        x, y = x[part], y[part]
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


class NodeCurve(NamedTuple):
    """A measured temperature beside the model's, (n,) each."""

    node: str
    time_s: Column
    measured_c: Column
    model_c: Column
    error_k: Column
    before_c: Column | None = None


def node_plots(
    nodes: Sequence[NodeCurve], error_title: str
) -> tuple[Plot, Plot]:
    """Return temperatures, measured ones thick, and errors of *nodes*."""
    temperatures, errors = [], []
    for one in nodes:
        name, colour = one.node.replace("_", " "), NODE_COLOURS[one.node]
        x = one.time_s
        thick = curve(x, one.measured_c, name, colour, width=4.0)
        thin = curve(x, one.model_c, name, colour, legend=False)
        temperatures += [thick | {"opacity": 0.4}, thin]
        if one.before_c is not None:
            look: dict[str, Any] = {"dash": "4px,4px", "width": 1.0}
            before = curve(x, one.before_c, name, colour, legend=False, **look)
            temperatures.append(before)
        errors.append(curve(x, one.error_k, name, colour))
    span = (0.0, max(float(one.time_s[-1]) for one in nodes))
    return (
        time_plot(temperatures, "temperature [°C]", span, height=420),
        time_plot(errors, error_title, span),
    )


def plot(
    data: Sequence[dict[str, Any]], x_title: str, y_title: str, **changes: Any
) -> Plot:
    """Return *data* over a quantity; *changes* go into the layout."""
    layout = _layout(y_title)
    layout["xaxis"] = axis(x_title)
    return Plot(list(data), _merged(layout, changes))


def time_plot(
    data: Sequence[dict[str, Any]],
    y_title: str,
    span_s: tuple[float, float],
    **changes: Any,
) -> Plot:
    """Return *data*, x in seconds, over the clock from and to *span_s*."""
    layout = _layout(y_title)
    layout["xaxis"] |= clock_axis(span_s)
    return Plot(list(data), _merged(layout, changes), clock=True)


def stamp(elapsed_s: float) -> str:
    """Return *elapsed_s* as a plotly date."""
    return (EPOCH + timedelta(seconds=elapsed_s)).isoformat(
        sep=" ", timespec="milliseconds"
    )


def clock_axis(span_s: tuple[float, float]) -> dict[str, Any]:
    """Return a time axis over *span_s*.

    Its ticks have the figures of its title, and finer ones zoomed in.
    """
    labels = time_axis(span_s[1])
    stops = (
        (None, SECOND_TICKS_MS - 1, labels.finest),
        (SECOND_TICKS_MS, MINUTE_TICKS_MS - 1, labels.fine),
        (MINUTE_TICKS_MS, None, labels.coarse),
    )
    return {
        "type": "date",
        "range": [stamp(span_s[0]), stamp(max(span_s[1], span_s[0] + 1.0))],
        "title": {"text": labels.title, "standoff": 4},
        "tickformatstops": [
            {"dtickrange": [shortest, longest], "value": form}
            for shortest, longest, form in stops
        ],
        "hoverformat": labels.fine,
        "nticks": 12,
    }


def axis(title: str, **changes: Any) -> dict[str, Any]:
    """Return the layout of an axis with *title*, escaped, and *changes*."""
    return AXIS | {"title": {"text": escape(title), "standoff": 4}} | changes


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


def numbers(values: Column, digits: int = _DIGITS) -> list[float | None]:
    """Return *values* rounded to *digits*, None where there is none."""
    return [
        float(f"{value:.{digits}g}") if np.isfinite(value) else None
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
    """Return the looks that every plot has."""
    return {
        "height": HEIGHT_PX,
        "font": {
            "family": "system-ui, 'Segoe UI', Roboto, Arial, sans-serif",
            "size": 11.5,
            "color": BLACK,
        },
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "hoverlabel": {"bgcolor": PAPER},
        "margin": {"l": 62, "r": 24, "t": 30, "b": 44},
        "hovermode": "closest",
        "legend": {"orientation": "h", "x": 0, "y": 1.02, "yanchor": "bottom"},
        "xaxis": dict(AXIS),
        "yaxis": axis(y_title),
    }
