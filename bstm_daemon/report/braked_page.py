"""The page of ``identify cooling --while-braking``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.report.braked_words import (
    LINE_HEAD,
    axle_lines,
    line_rows,
)
from bstm_daemon.report.plot_page import (
    PageHead,
    PageSection,
    Table,
    write_plot_page,
)
from bstm_daemon.report.plots import curve, plot, time_plot
from bstm_daemon.report.traces import BLACK, BLUE, VERMILION
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from pathlib import Path

    from bstm_daemon.identify.cooling_while_braking import (
        BrakedAxle,
        BrakedCooling,
    )
    from bstm_daemon.report.plots import Plot


def write_braked_page(
    path: Path, result: BrakedCooling, *, subtitle: str, version: str
) -> None:
    """Write the discs of whole drives as one HTML page to *path*.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    sections = []
    tiles = []
    for axle in result.axles:
        name = f"{axle.axle.capitalize()} discs"
        tiles += [
            (f"{axle.held_k:.1f} K", f"{axle.axle}, rms, windows not fitted"),
            (f"{axle.fitted_k:.1f} K", f"{axle.axle}, rms, windows fitted"),
        ]
        sections += [
            PageSection(
                f"{name}: S over speed (Eq 4.12), 1e-3 1/s",
                Table(LINE_HEAD, tuple(line_rows(axle))),
                plots=(("S over speed", _line_plot(axle)),),
                lines=(*axle_lines(axle), *result.remarks),
                across=1,
            ),
            PageSection(
                f"{name}: measured and predicted",
                plots=tuple(_drive_plots(axle)),
                note="Each window of 90 s is predicted from its first "
                "measurement by the fit to the other half of the windows.",
                across=1,
            ),
        ]
    title = "Disc cooling while braking"
    write_plot_page(
        path, PageHead(title, subtitle, version, tuple(tiles)), sections
    )


def _line_plot(axle: BrakedAxle) -> Plot:
    speeds = np.array(sorted({*axle.speeds_ms, *axle.held_ms}))
    value, error = np.array([axle.at(float(speed)) for speed in speeds]).T
    grey = "#8c959f"
    return plot(
        [
            curve(
                3.6 * np.array(axle.speeds_ms),
                1e3 * axle.configured,
                "configured",
                grey,
                dash="5px,3px",
            ),
            curve(3.6 * speeds, 1e3 * value, "found", VERMILION, width=2.4),
            *(
                curve(
                    3.6 * speeds,
                    1e3 * np.maximum(value + side * 2.0 * error, 0.0),
                    "two standard errors",
                    VERMILION,
                    dash="2px,3px",
                    width=1.0,
                    legend=side > 0,
                )
                for side in (1, -1)
            ),
        ],
        "speed [km/h]",
        "S [1e-3 1/s]",
        yaxis={"rangemode": "tozero"},
    )


def _drive_plots(axle: BrakedAxle) -> list[tuple[str, Plot]]:
    found = []
    couples = dict.fromkeys((w.log, w.role) for w in axle.windows)
    for log, role in couples:
        places = [
            i
            for i, window in enumerate(axle.windows)
            if (window.log, window.role) == (log, role)
        ]
        gap = [np.nan]
        x = np.concatenate([[*axle.windows[i].time_s, *gap] for i in places])
        measured, model = (
            np.concatenate([[*one, *gap] for one in columns]) - KELVIN_OFFSET
            for columns in (
                [axle.windows[i].disc_k for i in places],
                [axle.held_model_k[:, i] for i in places],
            )
        )
        known = np.isfinite(x)
        x = np.interp(np.arange(len(x)), np.flatnonzero(known), x[known])
        found.append(
            (
                f"{log}: {role.removeprefix('temp_').replace('_', ' ')}",
                time_plot(
                    [
                        curve(x, measured, "measured", BLUE, width=2.4),
                        curve(x, model, "predicted", BLACK, width=1.2),
                    ],
                    "disc [°C]",
                    (float(x.min()), float(x.max())),
                ),
            )
        )
    return found
