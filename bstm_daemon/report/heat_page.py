"""The page of ``bstm heat``: the thesis's figures 4.5 to 4.10, 6.1 to 6.3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.identify.heat_comparison import SOURCES
from bstm_daemon.report.heat_figures import (
    LOG_COLOURS,
    energy_plot,
    friction_plots,
    integrated_plot,
    momentary_plot,
    per_force_plot,
    power_plot,
    smooth,
    stop_plots,
)
from bstm_daemon.report.heat_words import (
    TOTAL_HEAD,
    friction_lines,
    stop_head,
    stop_rows,
    total_rows,
)
from bstm_daemon.report.plot_page import (
    PageHead,
    PageSection,
    Table,
    write_plot_page,
)
from bstm_daemon.report.plots import curve, time_plot

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bstm_daemon.identify.heat_comparison import HeatComparison
    from bstm_daemon.identify.stop_friction import StopFriction

STOPS_DRAWN: Final = 8
"""Stops with figures of their own: those with the most energy."""

AROUND_S: Final = 30.0


def write_heat_page(
    path: Path,
    drives: Sequence[tuple[str, HeatComparison, StopFriction]],
    *,
    subtitle: str,
    version: str,
) -> None:
    """Write the comparisons of *drives*, each with its name, to *path*.

    Raises:
        MissingExtraError: plotly is not installed.
        FileAccessError: *path* can not be written.
    """
    sections = []
    for name, heat, friction in drives:
        prefix = f"{name}: " if len(drives) > 1 else ""
        sections += _drive_sections(prefix, heat, friction)
    if len(drives) > 1:
        sections.insert(0, _side_by_side(drives))
    head = PageHead(
        "Brake heat by source",
        subtitle,
        version,
        _tiles(drives[0][1]) if len(drives) == 1 else (),
    )
    write_plot_page(path, head, sections)


def _tiles(heat: HeatComparison) -> tuple[tuple[str, str], ...]:
    return tuple(
        (f"{heat.total_j(key) / 1e6:.2f} MJ", name)
        for key, name in SOURCES.items()
        if key in heat.power_w
    )


def _drive_sections(
    prefix: str, heat: HeatComparison, friction: StopFriction
) -> list[PageSection]:
    span = (float(heat.time_s[0]), float(heat.time_s[-1]))
    active = _active(heat, span)
    sections = [
        PageSection(
            f"{prefix}Heat over the drive (thesis figure 6.1)",
            Table(TOTAL_HEAD, tuple(total_rows(heat))),
            plots=(
                ("energy so far", energy_plot(heat, span)),
                ("power", power_plot(heat, active)),
            ),
            note="To balance: median over the stops of the source's energy "
            "over W_brake of Eq 4.5.",
            across=1,
        )
    ]
    if np.isfinite(heat.momentary_ratio()).any():
        sections.append(
            PageSection(
                f"{prefix}Feed-Forward over Feed-Back (thesis figures 6.2, "
                "6.3)",
                plots=(
                    ("while braking", momentary_plot(heat, active)),
                    ("of the energies so far", integrated_plot(heat, active)),
                ),
            )
        )
    if np.isfinite(heat.pressure_per_force()).any():
        sections.append(
            PageSection(
                f"{prefix}Pressure over brake force (thesis figures 4.9, "
                "4.10)",
                plots=(("", per_force_plot(heat, active)),),
                note="Higher means less friction. Line: median over a second.",
                across=1,
            )
        )
    chosen = sorted(
        sorted(
            range(len(heat.stops)),
            key=lambda i: -max(heat.stops[i].energy_j.values()),
        )[:STOPS_DRAWN]
    )
    if chosen:
        sections.append(
            PageSection(
                f"{prefix}Stops (thesis figures 4.5, 4.6 and 4.8)",
                plots=tuple(
                    pair
                    for i in chosen
                    for pair in stop_plots(heat, heat.stops[i], i + 1)
                ),
                across=3,
                note="Dotted: W_brake of Eq 4.5, where every source should "
                "end. "
                + (
                    f"The {STOPS_DRAWN} stops with the most energy."
                    if len(heat.stops) > STOPS_DRAWN
                    else ""
                ),
            )
        )
        sections.append(
            PageSection(
                f"{prefix}Energy balance of the stops [kJ] (Eq 4.5)",
                Table(stop_head(heat), tuple(stop_rows(heat))),
                note="Balance = kinetic - drag - climb + drive. Climb is "
                "what the accelerometer says beyond the change of speed: the "
                "grade, its own bias, and the slip of braked tyres.",
            )
        )
    figures = friction_plots(friction)
    if figures:
        sections.append(
            PageSection(
                f"{prefix}Friction coefficient (thesis figure 4.7)",
                plots=figures,
                lines=tuple(friction_lines(friction)),
                note="Within a stop: brake force from motion over what Eq "
                "4.1 gives for a friction of 1; one value for the whole car. "
                "Front and rear: mean of a stop, by the heat in the measured "
                "discs; an axle without one has the rest of the balance and "
                "with it every error of mass and grade.",
            )
        )
    return sections


def _active(
    heat: HeatComparison, span: tuple[float, float]
) -> tuple[float, float]:
    """Return the part of *span* with stops in it, and some around."""
    if not heat.stops:
        return span
    return (
        max(span[0], heat.stops[0].begin_s - AROUND_S),
        min(span[1], heat.stops[-1].end_s + AROUND_S),
    )


def _side_by_side(
    drives: Sequence[tuple[str, HeatComparison, StopFriction]],
) -> PageSection:
    """Return pressure over force of all drives from their first press on."""
    data, rows, last_s = [], [], 1.0
    for i, (name, heat, _) in enumerate(drives):
        ratio = smooth(heat.pressure_per_force())
        known = np.flatnonzero(np.isfinite(ratio))
        if len(known):
            since = heat.time_s - heat.time_s[known[0]]
            last_s = max(last_s, float(since[known[-1]]))
            part = slice(known[0], known[-1] + 1)
            data.append(
                curve(
                    since[part],
                    ratio[part],
                    name,
                    LOG_COLOURS[i % len(LOG_COLOURS)],
                    width=2,
                )
            )
        rows += [(name, *row[:4]) for row in total_rows(heat) if not row[4]]
    return PageSection(
        "Logs side by side (thesis figures 4.9 and 4.10)",
        Table(("log", *TOTAL_HEAD[:4]), tuple(rows)),
        plots=(
            (
                "pressure over brake force since the first press",
                time_plot(data, "pressure / force [Pa/N]", (0.0, last_s)),
            ),
        ),
        across=1,
    )
