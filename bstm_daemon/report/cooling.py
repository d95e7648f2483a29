"""``bstm identify cooling``: its results in words, as page and as JSON.

Those of cool-downs, and those of whole drives (``--while-braking``).
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from bstm_daemon.analysis.identify import cooling
from bstm_daemon.analysis.identify.cooling_while_braking import (
    WINDOW_S,
    BrakedAxle,
    BrakedCooling,
)
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.report.json_file import picked
from bstm_daemon.report.plots import (
    BLACK,
    BLUE,
    COLOURS,
    GREY,
    VERMILION,
    Plot,
    cloud,
    curve,
    plot,
    time_plot,
)
from bstm_daemon.report.shell import Page, Section, Table
from bstm_daemon.report.text import Columns, columns, number, wrapped
from bstm_daemon.units import KELVIN_OFFSET

LINE_HEAD: Final = ("speed", "S", "+-", "configured", "driven")


def speed_text(speed_ms: float) -> str:
    """Return a speed as text, ``parked`` for none."""
    return "parked" if speed_ms <= 0.0 else f"{3.6 * speed_ms:.0f} km/h"


def s_text(s_per_s: float) -> str:
    """Return S as text, in 1e-3 1/s."""
    return f"{1e3 * s_per_s:.3f}"


def couple_text(role: str) -> str:
    """Return the name of the thermocouple of *role*."""
    return role.removeprefix("temp_").replace("_", " ")


def axle_title(axle: cooling.AxleCooling | BrakedAxle) -> str:
    """Return the line of text above the table of an axle."""
    form = axle.disc.form
    return f'{axle.axle} discs, S in 1e-3 1/s, [cooling] form = "{form}"'


def _range(point: cooling.CoolingPoint) -> str:
    hottest = max(float(one.measured_k[0]) for one in point.series)
    coolest = min(float(one.measured_k[-1]) for one in point.series)
    return f"{hottest - KELVIN_OFFSET:.0f} to {coolest - KELVIN_OFFSET:.0f} °C"


POINTS: Final[Columns[cooling.CoolingPoint]] = Columns(
    ("speed", lambda one: speed_text(one.speed_ms)),
    ("S", lambda one: s_text(one.value)),
    ("+-", lambda one: s_text(one.standard_error)),
    ("ten pairs", lambda one: s_text(one.ten_pairs)),
    ("+-", lambda one: s_text(one.ten_pairs_spread)),
    ("configured", lambda one: s_text(one.configured)),
    ("cool-downs", lambda one: str(len(one.series))),
    ("disc", _range),
    ("rms", lambda one: f"{one.residual_k:.1f} K"),
    ("verdict", lambda one: "identified" if one.identified else "not"),
)
"""What was found at each speed, S in 1e-3 1/s."""

_FROM: Final = ("configured, scaled by neighbours", "measured")
TABLE: Final[Columns[tuple[float, float, bool]]] = Columns(
    ("speed", lambda row: f"{row[0]:.2f} m/s"),
    ("S", lambda row: s_text(row[1])),
    ("from", lambda row: _FROM[row[2]]),
)
"""The table to configure, S in 1e-3 1/s."""


def axle_lines(axle: cooling.AxleCooling) -> list[str]:
    """Return what else is to be said of an axle."""
    lines = [
        f"{speed_text(point.speed_ms)}: not identified: {point.caveat}"
        for point in axle.points
        if not point.identified
    ]
    for point in axle.points:
        if point.speed_ms <= 0.0 and axle.still is not None:
            lines.append(
                "parked, S is the convection without the configured "
                f"radiation; the total loss is {1e3 * point.whole:.3f} +- "
                f"{1e3 * point.whole_error:.3f}e-3 1/s, of which convection "
                f"is {100 * axle.still:.0f} % (configured "
                f"{100 * axle.disc.still:.0f} %); this share depends on the "
                "configured emissivity"
            )
        if len(point.by_corner) > 1:
            sides = ", ".join(
                f"{corner} {1e3 * value:.3f}"
                for corner, (value, _) in point.by_corner.items()
            )
            lines.append(f"{speed_text(point.speed_ms)}: {sides}")
    lines.append(
        f"residual: noise {number(axle.fit.noise_k, 2)} K, drift "
        f"{number(axle.fit.drift_k, 2)} K over {axle.fit.drift_s:g} s"
    )
    return lines


def cooling_text(result: cooling.Cooling) -> str:
    """Return the result as text for the screen; S in 1e-3 1/s."""
    lines = []
    for axle in result.axles:
        lines += [axle_title(axle), *POINTS.lines(axle.points)]
        lines += wrapped(axle_lines(axle))
        if axle.table:
            lines += ["", *TABLE.lines(axle.table)]
        lines.append("")
    return "\n".join([*lines, *wrapped((*result.searched, *result.remarks))])


def cooling_json(result: cooling.Cooling) -> dict[str, Any]:
    """Return the result as plain data, SI."""
    return picked(result, "searched", "remarks") | {
        "axles": {axle.axle: _axle_json(axle) for axle in result.axles}
    }


def _axle_json(axle: cooling.AxleCooling) -> dict[str, Any]:
    return picked(
        axle,
        form="disc.form",
        standstill_convection_fraction="still",
        covariance="fit.covariance",
        residual_k="fit.residual_k",
        other_form_residual_k="other_residual_k",
    ) | {
        "speed_ms": [speed for speed, *_ in axle.table],
        "s_per_s": [s for _, s, _ in axle.table],
        "measured": [measured for *_, measured in axle.table],
        "points": [_point_json(point) for point in axle.points],
    }


def _point_json(point: cooling.CoolingPoint) -> dict[str, Any]:
    return picked(
        point,
        *("speed_ms", "standard_error", "identified", "ten_pairs_spread"),
        s_per_s="value",
        whole_s_per_s="whole",
        whole_standard_error="whole_error",
        configured_s_per_s="configured",
        why_not="caveat",
        ten_pairs_s_per_s="ten_pairs",
    ) | {
        "by_corner": {
            corner: {"s_per_s": value, "standard_error": error}
            for corner, (value, error) in point.by_corner.items()
        },
        "cool_downs": [
            picked(
                one,
                *("time_s", "measured_k", "model_k"),
                log="down.log",
                role="down.role",
                start_s="down.start_s",
            )
            for one in point.series
        ],
    }


def cooling_page(result: cooling.Cooling, subtitle: str) -> Page:
    """Return the page of the cool-downs: S over speed, every cool-down."""
    sections = [part for axle in result.axles for part in _sections(axle)]
    sections.append(Section("What was searched", lines=result.searched))
    first = sections[0]
    sections[0] = replace(first, lines=[*first.lines, *result.remarks])
    tiles = [
        (f"{1e3 * point.value:.3f}e-3", f"{speed_text(point.speed_ms)} [1/s]")
        for axle in result.axles[:1]
        for point in axle.points
        if point.identified
    ]
    lead = " ".join(map(_sentence, result.axles))
    return Page("Disc cooling", sections, tiles[:8], lead, subtitle=subtitle)


def _sentence(axle: cooling.AxleCooling) -> str:
    """Return for a person how fast the discs of *axle* cool."""
    known = [point for point in axle.points if point.identified]
    if not known:
        return (
            f"No cool-down of the {axle.axle} discs was long and steady "
            "enough to identify S."
        )
    ends = " to ".join(
        f"{s_text(point.value)} ({speed_text(point.speed_ms)})"
        for point in (known[0], *known[1:][-1:])
    )
    return (
        f"The {axle.axle} discs cool with S = {ends} in 1e-3 1/s, identified "
        f"at {len(known)} of {len(axle.points)} speeds."
    )


def _sections(axle: cooling.AxleCooling) -> list[Section]:
    name = f"{axle.axle.capitalize()} discs"
    found = Section(
        f"{name}: S over speed (Eq 4.12), 1e-3 1/s",
        Table.of(POINTS, axle.points),
        plots=(("S over speed", _table_plot(axle)),),
        lines=axle_lines(axle),
        note="Bars: two standard errors. Ten pairs: the thesis's average "
        "over the pairs of five measurements, radiation included.",
        across=1,
    )
    configure = Section(
        f"{name}: the table to configure, 1e-3 1/s",
        Table.of(TABLE, axle.table),
    )
    curves = Section(
        f"{name}: cool-downs (thesis figures 4.11 and 4.12)",
        plots=[pair for point in axle.points for pair in _point_plots(point)],
        note="Coloured: measured. Black: Eq 4.12 with the S found. "
        "Dotted: with the ten-pair average.",
    )
    return [found, *([configure] if axle.table else []), curves]


def _table_plot(axle: cooling.AxleCooling) -> Plot:
    """Plot what was found; at standstill S is all of the loss."""
    driven = [p for p in axle.points if p.speed_ms > 0.0]
    speed = 3.6 * np.array([p.speed_ms for p in axle.points])
    found, error = np.array([p.loss for p in axle.points]).T
    pairs = np.array([p.ten_pairs for p in axle.points])
    points = cloud(speed, 1e3 * found, "found", VERMILION, size=8)
    points["error_y"] = {
        "type": "data",
        "array": (2e3 * error).tolist(),
        "color": VERMILION,
    }
    traces = [points, cloud(speed, 1e3 * pairs, "ten pairs", BLUE, size=8)]
    if axle.table:
        x, y = np.array([(s, value) for s, value, _ in axle.table]).T
        traces.append(curve(3.6 * x, 1e3 * y, "table to configure", VERMILION))
    if len(driven) > 1:
        x, y = np.array([(p.speed_ms, p.configured) for p in driven]).T
        traces.append(_configured(3.6 * x, 1e3 * y))
    return _over_speed(traces, xaxis={"rangemode": "tozero"})


def _configured(x: Column, y: Column) -> dict[str, Any]:
    return curve(x, y, "configured", GREY, dash="5px,3px")


def _over_speed(traces: Sequence[dict[str, Any]], **axes: Any) -> Plot:
    axes["yaxis"] = {"rangemode": "tozero"}
    return plot(traces, "speed [km/h]", "S [1e-3 1/s]", **axes)


def _point_plots(point: cooling.CoolingPoint) -> list[tuple[str, Plot]]:
    title = speed_text(point.speed_ms)
    fall, residuals = [], []
    for i, one in enumerate(point.series):
        colour = COLOURS[i % len(COLOURS)]
        name = couple_text(one.down.role)
        ambient = one.down.bins(one.down.ambient_k)
        pairs = ambient + (one.measured_k[0] - ambient) * np.exp(
            -point.ten_pairs * (one.time_s - one.time_s[0])
        )
        x = one.time_s
        measured_c, model_c, pairs_c = (
            kelvin - KELVIN_OFFSET
            for kelvin in (one.measured_k, one.model_k, pairs)
        )
        black: dict[str, Any] = {"colour": BLACK, "legend": i == 0}
        fall += [
            curve(x, measured_c, name, colour, width=3.0),
            curve(x, model_c, "Eq 4.12", width=1.2, **black),
            curve(x, pairs_c, "ten pairs", dash="2px,3px", width=1.0, **black),
        ]
        residuals.append(curve(x, one.model_k - one.measured_k, name, colour))
    return [
        (title, plot(fall, "time [s]", "disc [°C]")),
        (
            f"{title}: Eq 4.12 minus measurement",
            plot(residuals, "time [s]", "residual [K]"),
        ),
    ]


def line_rows(axle: BrakedAxle) -> list[tuple[str, ...]]:
    """Return the line at the configured speeds, S in 1e-3 1/s."""
    return [
        (
            f"{3.6 * speed:.0f} km/h",
            *(
                s_text(s_per_s)
                for s_per_s in (
                    *axle.at(speed),
                    float(axle.disc.configured(speed)),
                )
            ),
            "yes" if axle.driven(speed) else "no: configured, scaled",
        )
        for speed in axle.speeds_ms
    ]


def braked_lines(axle: BrakedAxle) -> list[str]:
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
        lines += [axle_title(axle), *columns([LINE_HEAD, *line_rows(axle)])]
        lines += [*wrapped(braked_lines(axle)), ""]
    return "\n".join([*lines, *wrapped(result.remarks)])


def braked_json(result: BrakedCooling) -> dict[str, Any]:
    """Return the result as plain data, SI."""
    return {
        "axles": {axle.axle: _braked_json(axle) for axle in result.axles},
        "remarks": result.remarks,
    }


def _braked_json(axle: BrakedAxle) -> dict[str, Any]:
    values, errors = zip(*map(axle.at, axle.speeds_ms), strict=True)
    return picked(
        axle,
        form="disc.form",
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
    sections, tiles = [], []
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
                lines=(*braked_lines(axle), *result.remarks),
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
    lead = " ".join(
        f"The line of S over speed predicts the {axle.axle} discs to "
        f"{axle.held_k:.1f} K in windows that it was not fitted to"
        f"{'; not identified: ' * bool(axle.caveat)}{axle.caveat}."
        for axle in result.axles
    )
    title = "Disc cooling while braking"
    return Page(title, sections, tiles, lead, subtitle=subtitle)


def _line_plot(axle: BrakedAxle) -> Plot:
    speeds = np.array(sorted({*axle.disc.speeds_ms, *axle.held_ms}))
    value, error = np.array([axle.at(float(speed)) for speed in speeds]).T
    table = np.array([axle.disc.speeds_ms, axle.disc.s_per_s])
    x = 3.6 * speeds
    band = [
        curve(
            x,
            1e3 * np.maximum(value + side * 2.0 * error, 0.0),
            "two standard errors",
            VERMILION,
            dash="2px,3px",
            width=1.0,
            legend=side > 0,
        )
        for side in (1, -1)
    ]
    traces = [
        _configured(3.6 * table[0], 1e3 * table[1]),
        curve(x, 1e3 * value, "found", VERMILION, width=2.4),
        *band,
    ]
    return _over_speed(traces)


def _drive_plots(axle: BrakedAxle) -> list[tuple[str, Plot]]:
    found = []
    couples: dict[tuple[str, str], list[int]] = {}
    for i, window in enumerate(axle.windows):
        couples.setdefault((window.log, window.role), []).append(i)
    for (log, role), places in couples.items():
        windows = [axle.windows[i] for i in places]

        def joined(parts: Iterable[Column]) -> Column:
            # a point without a value breaks the line between windows
            return np.concatenate([[*part, np.nan] for part in parts])

        x = joined(window.time_s for window in windows)
        measured = joined(w.disc_k for w in windows) - KELVIN_OFFSET
        model = joined(axle.held_model_k[:, i] for i in places) - KELVIN_OFFSET
        known = np.isfinite(x)
        x = np.interp(np.arange(len(x)), np.flatnonzero(known), x[known])
        curves = [
            curve(x, measured, "measured", BLUE, width=2.4),
            curve(x, model, "predicted", BLACK, width=1.2),
        ]
        span = float(x.min()), float(x.max())
        drawn = time_plot(curves, "disc [°C]", span)
        found.append((f"{log}: {couple_text(role)}", drawn))
    return found
