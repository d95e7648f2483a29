"""``identify cooling --while-braking``: in words, as page and as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.analysis.identify.cooling_while_braking import WINDOW_S
from bstm_daemon.report.json_file import picked
from bstm_daemon.report.plots import (
    BLACK,
    BLUE,
    GREY,
    VERMILION,
    curve,
    plot,
    time_plot,
)
from bstm_daemon.report.shell import Page, Section, Table
from bstm_daemon.report.text import columns, wrapped
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.analysis.identify.cooling_while_braking import (
        BrakedAxle,
        BrakedCooling,
    )
    from bstm_daemon.report.plots import Plot

LINE_HEAD: Final = ("speed", "S", "+-", "configured", "driven")


def line_rows(axle: BrakedAxle) -> list[tuple[str, ...]]:
    """Return the line at the configured speeds, S in 1e-3 1/s."""
    rows: list[tuple[str, ...]] = []
    for speed, configured in zip(
        axle.speeds_ms, axle.configured.tolist(), strict=True
    ):
        value, error = axle.at(speed)
        rows.append(
            (
                f"{3.6 * speed:.0f} km/h",
                f"{1e3 * value:.3f}",
                f"{1e3 * error:.3f}",
                f"{1e3 * configured:.3f}",
                "yes" if axle.driven(speed) else "no: configured, scaled",
            )
        )
    return rows


def axle_lines(axle: BrakedAxle) -> list[str]:
    """Return what else is to be said of an axle."""
    times = len({window.place for window in axle.windows})
    couples = len({w.role for w in axle.windows})
    coldest, hottest = (one - KELVIN_OFFSET for one in axle.range_k)
    lines = [f"not identified: {axle.caveat}"] if axle.caveat else []
    lines.append(
        f"{times} windows of {WINDOW_S:g} s, {couples} thermocouples, "
        f"{coldest:.0f} to {hottest:.0f} °C: misses by {axle.held_k:.1f} K "
        f"rms in windows not fitted, {axle.fitted_k:.1f} K in those fitted"
    )
    lines.append(
        f"heat {axle.heat[0]:.2f} +- {axle.heat[1]:.2f} times that of the "
        f"configured mass and shares; resistances while braking "
        f"{axle.resist[0]:.2f} +- {axle.resist[1]:.2f} times the configured"
    )
    return lines


def braked_text(result: BrakedCooling) -> str:
    """Return the result as text for the screen; S in 1e-3 1/s."""
    lines = []
    for axle in result.axles:
        lines.append(
            f'{axle.axle} discs, S in 1e-3 1/s, [cooling] form = "{axle.form}"'
        )
        lines += columns([LINE_HEAD, *line_rows(axle)])
        lines += [*wrapped(axle_lines(axle)), ""]
    return "\n".join([*lines, *wrapped(result.remarks)])


def braked_json(result: BrakedCooling) -> dict[str, Any]:
    """Return the result as plain data, SI."""
    return {
        "axles": {axle.axle: _axle_json(axle) for axle in result.axles},
        "remarks": result.remarks,
    }


def _axle_json(axle: BrakedAxle) -> dict[str, Any]:
    values, errors = zip(*map(axle.at, axle.speeds_ms), strict=True)
    return picked(
        axle,
        "form",
        why_not="caveat",
        speed_ms="speeds_ms",
        driven_ms="held_ms",
        fitted_rms_k="fitted_k",
        held_out_rms_k="held_k",
    ) | {
        "identified": not axle.caveat,
        "s_per_s": values,
        "standard_error": errors,
        "heat_factor": axle.heat[0],
        "heat_factor_error": axle.heat[1],
        "resistance_factor": axle.resist[0],
        "resistance_factor_error": axle.resist[1],
        "windows": [
            picked(window, "log", "role", "start_s", measured_k="disc_k")
            | {"held_out_model_k": axle.held_model_k[:, i]}
            for i, window in enumerate(axle.windows)
        ],
    }


def braked_page(result: BrakedCooling, subtitle: str) -> Page:
    """Return the page of the discs of whole drives."""
    sections = []
    tiles = []
    for axle in result.axles:
        name = f"{axle.axle.capitalize()} discs"
        tiles += [
            (f"{axle.held_k:.1f} K", f"{axle.axle}, rms, windows not fitted"),
            (f"{axle.fitted_k:.1f} K", f"{axle.axle}, rms, windows fitted"),
        ]
        sections += [
            Section(
                f"{name}: S over speed (Eq 4.12), 1e-3 1/s",
                Table(LINE_HEAD, line_rows(axle)),
                plots=(("S over speed", _line_plot(axle)),),
                lines=(*axle_lines(axle), *result.remarks),
                across=1,
            ),
            Section(
                f"{name}: measured and predicted",
                plots=_drive_plots(axle),
                note="Each window of 90 s is predicted from its first "
                "measurement by the fit to the other half of the windows.",
                across=1,
            ),
        ]
    title = "Disc cooling while braking"
    return Page(title, sections, tiles, subtitle=subtitle)


def _line_plot(axle: BrakedAxle) -> Plot:
    speeds = np.array(sorted({*axle.speeds_ms, *axle.held_ms}))
    value, error = np.array([axle.at(float(speed)) for speed in speeds]).T
    return plot(
        [
            curve(
                3.6 * np.array(axle.speeds_ms),
                1e3 * axle.configured,
                "configured",
                GREY,
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
