"""The curves of a replay, thinned and rounded for a plot."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.report.decimation import kept_rows
from bstm_daemon.report.summary import SUMMARY_NODES, front_first

if TYPE_CHECKING:
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


def drive_traces(results: Results) -> list[Trace]:
    """Return every curve that *results* has numbers for.

    Panels are ``speed`` [km/h], ``pressure`` [bar], ``power`` [kW],
    ``temperature`` and ``fluid`` [degC].
    """
    elapsed_s = results.elapsed_s
    traces: list[Trace | None] = [
        _trace(
            "speed",
            None,
            "speed",
            elapsed_s,
            _scaled(results.columns.get("speed_ms"), KMH_A_MS),
            decimals=1,
            line={"color": BLACK, "width": 1.5},
            hovertemplate="%{y:.0f} km/h",
        ),
        *_pressure_traces(results, elapsed_s),
    ]
    for corner in front_first(results.corners):
        traces += _power_traces(results, corner, elapsed_s)
        for node in SUMMARY_NODES:
            traces += _node_traces(
                results, corner, node, "temperature", elapsed_s
            )
        traces += _node_traces(results, corner, "fluid", "fluid", elapsed_s)
        traces.append(_boiling_trace(results, corner, elapsed_s))
    return [trace for trace in traces if trace is not None]


def _trace(  # noqa: PLR0913
    panel: str,
    corner: str | None,
    label: str,
    elapsed_s: Column,
    values: Column | None,
    *,
    decimals: int,
    sampled: bool = False,
    **look: Any,
) -> Trace | None:
    """Return the thinned curve, None if there is nothing to draw.

    A *sampled* curve is joined over rows without a value: its sensor is
    slower than the rows, and a gap between two samples is no gap.
    """
    if values is None or not np.isfinite(values).any():
        return None
    if sampled:
        known = np.isfinite(values)
        elapsed_s, values = elapsed_s[known], values[known]
    rows = kept_rows(values, POINTS_A_TRACE)
    # adding 0.0 turns -0.0, which takes a character more, into 0.0
    y = np.round(values[rows], decimals) + 0.0
    return Trace(
        panel,
        corner,
        label,
        np.round(elapsed_s[rows], 2).tolist(),
        [None if value != value else value for value in y.tolist()],  # noqa: PLR0124
        look,
    )


def _scaled(values: Column | None, factor: float) -> Column | None:
    return None if values is None else values * factor


def _pressure_traces(
    results: Results, elapsed_s: Column
) -> list[Trace | None]:
    """Return one curve a circuit: corners of equal pressure share it."""
    circuits: list[tuple[Column, list[str]]] = []
    for corner in front_first(results.corners):
        pressure_pa = results.columns.get(f"{corner}.pressure_pa")
        if pressure_pa is None:
            continue
        for known, names in circuits:
            if np.array_equal(known, pressure_pa, equal_nan=True):
                names.append(corner)
                break
        else:
            circuits.append((pressure_pa, [corner]))
    return [
        _trace(
            "pressure",
            None,
            " ".join(names),
            elapsed_s,
            pressure_pa / PASCAL_A_BAR,
            decimals=2,
            line={
                "color": PRESSURE_COLOURS[i % len(PRESSURE_COLOURS)],
                "dash": CIRCUIT_DASHES[i % len(CIRCUIT_DASHES)],
                "width": 1.5,
            },
            hovertemplate="%{y:.1f} bar",
        )
        for i, (pressure_pa, names) in enumerate(circuits)
    ]


def _power_traces(
    results: Results, corner: str, elapsed_s: Column
) -> list[Trace | None]:
    looks: tuple[tuple[str, str, dict[str, Any]], ...] = (
        (
            "brake_power_w",
            "used",
            {
                "line": {"color": "#8c959f", "width": 0.5},
                "fill": "tozeroy",
                "fillcolor": "rgba(140,149,159,0.30)",
            },
        ),
        (
            "brake_power_ff_w",
            "Feed-Forward",
            {"line": {"color": BLUE, "width": 1.2}},
        ),
        (
            "brake_power_fb_w",
            "Feed-Back",
            {"line": {"color": PURPLE, "width": 1.2}},
        ),
    )
    return [
        _trace(
            "power",
            corner,
            label,
            elapsed_s,
            _scaled(results.columns.get(f"{corner}.{key}"), 1e-3),
            decimals=2,
            hovertemplate="%{y:.2f} kW",
            **look,
        )
        for key, label, look in looks
    ]


def _node_traces(
    results: Results, corner: str, node: str, panel: str, elapsed_s: Column
) -> list[Trace | None]:
    """Return estimate and measurement of *node*, in one colour."""
    label, colour = NODE_LABELS[node], NODE_COLOURS[node]
    return [
        _trace(
            panel,
            corner,
            label,
            elapsed_s,
            results.columns.get(f"{corner}.{node}_c"),
            decimals=1,
            line={"color": colour, "width": 1.8},
            hovertemplate="%{y:.0f} °C",
        ),
        _trace(
            panel,
            corner,
            f"{label}, measured",
            elapsed_s,
            results.columns.get(f"{corner}.{node}_measured_c"),
            decimals=1,
            sampled=True,
            line={"color": colour, "width": 2.4, "dash": "2px,4px"},
            hovertemplate="%{y:.0f} °C",
        ),
    ]


def _boiling_trace(
    results: Results, corner: str, elapsed_s: Column
) -> Trace | None:
    fluid_c = results.columns.get(f"{corner}.fluid_c")
    margin_k = results.columns.get(f"{corner}.margin_k")
    if fluid_c is None or margin_k is None:
        return None
    limit_c = fluid_c + margin_k
    known = np.flatnonzero(np.isfinite(limit_c))
    label = "wet boiling point"
    if len(known) and np.ptp(limit_c[known]) < CONSTANT_K:
        label += f" {limit_c[known[0]]:.0f} °C"
        ends = np.array([0, len(limit_c) - 1])
        elapsed_s = elapsed_s[ends]
        limit_c = np.repeat(limit_c[known[0]], 2)
    return _trace(
        "fluid",
        corner,
        label,
        elapsed_s,
        limit_c,
        decimals=1,
        line={"color": BLACK, "width": 1.3, "dash": "8px,4px"},
        hovertemplate="%{y:.0f} °C",
    )
