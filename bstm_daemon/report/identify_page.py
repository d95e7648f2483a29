"""The page of ``bstm identify``: values, runs, and the figures behind."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.report.identify_words import (
    RUN_HEAD,
    STOP_HEAD,
    brake_doubts,
    brake_rows,
    number,
    run_rows,
    stop_rows,
    value_rows,
)
from bstm_daemon.report.plot_page import (
    PageHead,
    PageSection,
    Table,
    write_plot_page,
)
from bstm_daemon.report.plots import cloud, curve, plot, wide_range
from bstm_daemon.report.traces import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    VERMILION,
)

if TYPE_CHECKING:
    from pathlib import Path

    from bstm_daemon.identify.brakes import Brakes
    from bstm_daemon.identify.coastdown import CoastDown
    from bstm_daemon.identify.coastdown_run import Run
    from bstm_daemon.report.plots import Plot

LEAST_SPAN: Final = 0.05
"""A friction axis reaches so far to both sides of the median."""

_COLOURS: Final = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, BLACK)


def write_coast_down_page(
    path: Path, result: CoastDown, *, subtitle: str, version: str
) -> None:
    """Write the coast-down as one HTML page to *path*.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    tiles = tuple(
        (number(one.value), f"{one.name} +- {number(one.standard_error, 2)}")
        for one in result.values
    )
    worst = max((abs(run.miss) for run in result.runs), default=0.0)
    sections = [
        PageSection(
            "Resistances (Eq 4.2)",
            Table(
                ("value", "found", "+-", "configured", "verdict"),
                tuple(value_rows(result)),
            ),
            lines=result.remarks,
        ),
        PageSection(
            "Speed over time, measured and in theory (thesis figure 4.4)",
            plots=tuple(
                pair
                for i, run in enumerate(result.runs)
                for pair in _run_plots(i, run)
            ),
            note="Theory: Eq 4.2 from the run's first speed on, with the "
            "grade as three numbers a run. Grey: with the configured values.",
        ),
        PageSection(
            "Energy (Eq 4.5 and 4.6)",
            Table(RUN_HEAD, tuple(run_rows(result))),
            note="Kinetic energy lost, 1/2 m v2 + 1/2 J w2, is the work of "
            "the resistances, of the climb and of what drives; left over is "
            "the rest as a share of the kinetic energy.",
        ),
    ]
    head = PageHead(
        "Coast-down",
        subtitle,
        version,
        (*tiles, (f"{100 * worst:.2f} %", "energy left over, worst run")),
    )
    write_plot_page(path, head, sections)


def _run_plots(i: int, run: Run) -> list[tuple[str, Plot]]:
    title = f"run {i + 1}, grade {100 * run.grade:+.2f} %"
    measured = 3.6 * run.speed_ms
    theory, before = 3.6 * run.theory_ms, 3.6 * run.configured_ms
    x = run.time_s
    return [
        (
            title,
            plot(
                [
                    curve(x, before, "configured", "#8c959f", dash="5px,3px"),
                    curve(x, measured, "measured", BLUE, width=3.2),
                    curve(x, theory, "theory", ORANGE, width=1.4),
                ],
                "time [s]",
                "speed [km/h]",
            ),
        ),
        (
            f"run {i + 1}: theory less measurement",
            plot(
                [
                    curve(
                        x,
                        before - measured,
                        "configured",
                        "#8c959f",
                        dash="5px,3px",
                    ),
                    curve(x, theory - measured, "theory", ORANGE),
                ],
                "time [s]",
                "residual [km/h]",
            ),
        ),
    ]


def write_brakes_page(
    path: Path, result: Brakes, *, subtitle: str, version: str
) -> None:
    """Write what the stops tell of the brakes as one HTML page to *path*.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    stops = result.stops
    pressure = np.concatenate([stop.pressure_pa for stop in stops]) / 1e5
    force = np.concatenate([stop.force_n for stop in stops]) / 1e3
    speed = 3.6 * np.concatenate([stop.speed_ms for stop in stops])
    ratio = np.concatenate([result.ratio(stop) for stop in stops])
    gain = stops[0].gain
    ends = np.array([result.pushout_pa.value, 1e5 * pressure.max()])
    line = result.scale.value * gain * (ends - ends[0]) / 1e3
    before = np.concatenate(
        [
            np.full(
                len(stop.since_s),
                np.mean(list(stop.initial_c.values()))
                if stop.initial_c
                else np.nan,
            )
            for stop in stops
        ]
    )
    axis = {"range": wide_range(ratio, LEAST_SPAN)}
    shaded = np.isfinite(before).any()
    plots = [
        (
            "brake force over pressure",
            plot(
                [
                    cloud(pressure, force, "samples", BLUE),
                    curve(
                        np.array([0.0, pressure.max()]),
                        gain * np.array([0.0, 1e5 * pressure.max()]) / 1e3,
                        "configured friction, no push-out",
                        "#8c959f",
                        dash="5px,3px",
                    ),
                    curve(ends / 1e5, line, "found", VERMILION),
                ],
                "pressure [bar]",
                "brake force [kN]",
            ),
        ),
        (
            "friction within the stops",
            plot(
                [
                    curve(
                        stop.since_s,
                        result.ratio(stop),
                        f"stop {i + 1}",
                        _COLOURS[i % len(_COLOURS)],
                        legend=len(stops) <= 10,
                    )
                    for i, stop in enumerate(stops)
                ],
                "time since the press [s]",
                "friction over configured",
                yaxis=axis,
            ),
        ),
        (
            "friction over speed",
            plot(
                [
                    cloud(
                        speed,
                        ratio,
                        "",
                        shade=pressure,
                        shade_title="bar",
                    )
                ],
                "speed [km/h]",
                "friction over configured",
                yaxis=axis,
            ),
        ),
        (
            "friction over pressure",
            plot(
                [cloud(pressure, ratio, "", shade=speed, shade_title="km/h")],
                "pressure [bar]",
                "friction over configured",
                yaxis=axis,
            ),
        ),
    ]
    if shaded:
        plots.append(
            (
                "friction over the discs' temperature before the stop",
                plot(
                    [
                        cloud(
                            before,
                            ratio,
                            "",
                            shade=pressure,
                            shade_title="bar",
                        )
                    ],
                    "measured disc before the stop [°C]",
                    "friction over configured",
                    yaxis=axis,
                ),
            )
        )
    sections = [
        PageSection(
            "Brakes",
            Table(
                ("value", "found", "+-", "identified"),
                tuple(
                    (*row[:3], "yes" if row[3] == "identified" else "no")
                    for row in brake_rows(result)
                ),
            ),
            lines=(
                *brake_doubts(result),
                *result.searched,
                *result.remarks,
            ),
        ),
        PageSection(
            "Friction",
            plots=tuple(plots),
            note="Friction over its configured value: brake force from "
            "motion over that of Eq 4.1 at the pressure less push-out. The "
            "line and the value hold at "
            f"{3.6 * result.speed_ms:.0f} km/h.",
        ),
        PageSection("Stops", Table(STOP_HEAD, tuple(stop_rows(result)))),
    ]
    tiles = (
        (
            f"{result.scale.value:.3f}",
            f"friction scale +- {number(result.scale.standard_error, 2)}",
        ),
        (
            f"{result.pushout_pa.value / 1e5:.2f} bar",
            "push-out" + ("" if result.pushout_pa.identified else ", held"),
        ),
        (
            f"{result.front_share.value:.2f}",
            "front share"
            + ("" if result.front_share.identified else ", configured"),
        ),
    )
    write_plot_page(
        path, PageHead("Brakes", subtitle, version, tiles), sections
    )
