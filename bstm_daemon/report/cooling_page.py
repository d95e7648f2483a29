"""The page of ``bstm identify cooling``: S over speed, every cool-down."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.report.cooling_words import (
    HEAD,
    TABLE_HEAD,
    axle_lines,
    point_rows,
    speed_text,
    table_rows,
)
from bstm_daemon.report.plot_page import (
    PageHead,
    PageSection,
    Table,
    write_plot_page,
)
from bstm_daemon.report.plots import cloud, curve, plot
from bstm_daemon.report.traces import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    VERMILION,
)
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from pathlib import Path

    from bstm_daemon.identify.cooling import (
        AxleCooling,
        Cooling,
        CoolingPoint,
    )
    from bstm_daemon.report.plots import Plot

_COLOURS: Final = (BLUE, GREEN, ORANGE, PURPLE)


def write_cooling_page(
    path: Path, result: Cooling, *, subtitle: str, version: str
) -> None:
    """Write the cool-downs as one HTML page to *path*.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    sections = [part for axle in result.axles for part in _sections(axle)]
    tiles = [
        (f"{1e3 * point.value:.3f}e-3", f"{speed_text(point.speed_ms)} [1/s]")
        for axle in result.axles[:1]
        for point in axle.points
        if point.identified
    ]
    sections.append(PageSection("What was searched", lines=result.searched))
    sections[0] = PageSection(
        sections[0].heading,
        sections[0].table,
        sections[0].plots,
        (*sections[0].lines, *result.remarks),
        sections[0].note,
    )
    head = PageHead("Disc cooling", subtitle, version, tuple(tiles[:8]))
    write_plot_page(path, head, sections)


def _sections(axle: AxleCooling) -> list[PageSection]:
    sections = [
        PageSection(
            f"{axle.axle.capitalize()} discs: S over speed (Eq 4.12), "
            "1e-3 1/s",
            Table(HEAD, tuple(point_rows(axle))),
            plots=(("S over speed", _table_plot(axle)),),
            lines=tuple(axle_lines(axle)),
            note="Bars: two standard errors. Ten pairs: the thesis's average "
            "over the pairs of five measurements, radiation included.",
            across=1,
        ),
    ]
    if axle.table:
        sections.append(
            PageSection(
                f"{axle.axle.capitalize()} discs: the table to configure, "
                "1e-3 1/s",
                Table(TABLE_HEAD, tuple(table_rows(axle))),
            )
        )
    sections.append(
        PageSection(
            f"{axle.axle.capitalize()} discs: cool-downs (thesis figures "
            "4.11 and 4.12)",
            plots=tuple(
                pair for point in axle.points for pair in _point_plots(point)
            ),
            note="Coloured: measured. Black: Eq 4.12 with the S found. "
            "Dotted: with the ten-pair average.",
        )
    )
    return sections


def _table_plot(axle: AxleCooling) -> Plot:
    told = [point for point in axle.points if point.speed_ms > 0.0]
    parked = [point for point in axle.points if point.speed_ms <= 0.0]
    speed = 3.6 * np.array([p.speed_ms for p in (*parked, *told)])
    found = np.array([p.whole for p in parked] + [p.value for p in told])
    error = np.array(
        [p.whole_error for p in parked] + [p.standard_error for p in told]
    )
    pairs = np.array([p.ten_pairs for p in (*parked, *told)])
    configured = np.array([p.configured for p in told])
    points = cloud(speed, 1e3 * found, "found", VERMILION, size=8)
    points["error_y"] = {
        "type": "data",
        "array": (2e3 * error).tolist(),
        "color": VERMILION,
    }
    traces = [
        points,
        cloud(speed, 1e3 * pairs, "ten pairs", BLUE, size=8),
    ]
    if axle.table:
        x, y = np.array([(s, value) for s, value, _ in axle.table]).T
        traces.append(curve(3.6 * x, 1e3 * y, "table to configure", VERMILION))
    if len(told) > 1:
        traces.append(
            curve(
                speed[len(parked) :],
                1e3 * configured,
                "configured",
                "#8c959f",
                dash="5px,3px",
            )
        )
    return plot(
        traces,
        "speed [km/h]",
        "S [1e-3 1/s]",
        xaxis={"rangemode": "tozero"},
        yaxis={"rangemode": "tozero"},
    )


def _point_plots(point: CoolingPoint) -> list[tuple[str, Plot]]:
    title = speed_text(point.speed_ms)
    fall, apart = [], []
    for i, one in enumerate(point.series):
        colour = _COLOURS[i % len(_COLOURS)]
        name = one.down.role.removeprefix("temp_").replace("_", " ")
        ambient = one.down.bins(one.down.ambient_k)
        pairs = ambient + (one.measured_k[0] - ambient) * np.exp(
            -point.ten_pairs * (one.time_s - one.time_s[0])
        )
        x = one.time_s
        fall += [
            curve(x, one.measured_k - KELVIN_OFFSET, name, colour, width=3.0),
            curve(
                x,
                one.model_k - KELVIN_OFFSET,
                "Eq 4.12",
                BLACK,
                width=1.2,
                legend=i == 0,
            ),
            curve(
                x,
                pairs - KELVIN_OFFSET,
                "ten pairs",
                BLACK,
                dash="2px,3px",
                width=1.0,
                legend=i == 0,
            ),
        ]
        apart.append(curve(x, one.model_k - one.measured_k, name, colour))
    return [
        (title, plot(fall, "time [s]", "disc [°C]")),
        (
            f"{title}: Eq 4.12 less measurement",
            plot(apart, "time [s]", "residual [K]"),
        ),
    ]
