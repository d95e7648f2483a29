"""``bstm identify cooling``: its result in words, as page and as JSON."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.report.json_file import picked
from bstm_daemon.report.plots import (
    BLACK,
    BLUE,
    COLOURS,
    GREY,
    VERMILION,
    cloud,
    curve,
    plot,
)
from bstm_daemon.report.shell import Page, Section, Table
from bstm_daemon.report.text import columns, number, wrapped
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.analysis.identify.cooling import (
        AxleCooling,
        Cooling,
        CoolingPoint,
    )
    from bstm_daemon.report.plots import Plot

HEAD: Final = (
    *("speed", "S", "+-", "ten pairs", "+-", "configured"),
    *("cool-downs", "disc", "rms", "verdict"),
)
TABLE_HEAD: Final = ("speed", "S", "from")


def speed_text(speed_ms: float) -> str:
    """Return a speed as text, ``parked`` for none."""
    return "parked" if speed_ms <= 0.0 else f"{3.6 * speed_ms:.0f} km/h"


def point_rows(axle: AxleCooling) -> list[tuple[str, ...]]:
    """Return a row a speed, of :data:`HEAD`; S in 1e-3 1/s."""
    return [
        (
            speed_text(point.speed_ms),
            f"{1e3 * point.value:.3f}",
            f"{1e3 * point.standard_error:.3f}",
            f"{1e3 * point.ten_pairs:.3f}",
            f"{1e3 * point.ten_pairs_spread:.3f}",
            f"{1e3 * point.configured:.3f}",
            str(len(point.series)),
            _range(point),
            f"{point.residual_k:.1f} K",
            "identified" if point.identified else "not",
        )
        for point in axle.points
    ]


def _range(point: CoolingPoint) -> str:
    hottest = max(float(one.measured_k[0]) for one in point.series)
    coolest = min(float(one.measured_k[-1]) for one in point.series)
    return f"{hottest - KELVIN_OFFSET:.0f} to {coolest - KELVIN_OFFSET:.0f} °C"


def table_rows(axle: AxleCooling) -> list[tuple[str, ...]]:
    """Return a row a point of the table to configure, S in 1e-3 1/s."""
    return [
        (
            f"{speed:.2f} m/s",
            f"{1e3 * s:.3f}",
            "measured" if measured else "configured, scaled by neighbours",
        )
        for speed, s, measured in axle.table
    ]


def axle_lines(axle: AxleCooling) -> list[str]:
    """Return what else is to be said of an axle."""
    lines = [
        f"{speed_text(point.speed_ms)}: not identified: {point.caveat}"
        for point in axle.points
        if not point.identified
    ]
    for point in axle.points:
        if point.speed_ms <= 0.0 and axle.still is not None:
            lines.append(
                f"parked, S is the convection beside the configured "
                f"radiation; all of the loss is {1e3 * point.whole:.3f} +- "
                f"{1e3 * point.whole_error:.3f}e-3 1/s, of which convection "
                f"is {100 * axle.still:.0f} % (configured "
                f"{100 * axle.configured_still:.0f} %); this share leans on "
                "the configured emissivity"
            )
        if len(point.by_corner) > 1:
            sides = ", ".join(
                f"{corner} {1e3 * value:.3f}"
                for corner, (value, _) in point.by_corner.items()
            )
            lines.append(f"{speed_text(point.speed_ms)}: {sides}")
    lines.append(
        f"what is left over: noise {number(axle.fit.noise_k, 2)} K, drift "
        f"{number(axle.fit.drift_k, 2)} K over {axle.fit.drift_s:g} s"
    )
    return lines


def cooling_text(result: Cooling) -> str:
    """Return the result as text for the screen; S in 1e-3 1/s."""
    lines = []
    for axle in result.axles:
        lines.append(
            f'{axle.axle} discs, S in 1e-3 1/s, [cooling] form = "{axle.form}"'
        )
        lines += columns([HEAD, *point_rows(axle)])
        lines += wrapped(axle_lines(axle))
        if axle.table:
            lines += ["", *columns([TABLE_HEAD, *table_rows(axle)])]
        lines.append("")
    return "\n".join([*lines, *wrapped((*result.searched, *result.remarks))])


def cooling_json(result: Cooling) -> dict[str, Any]:
    """Return the result as plain data, SI."""
    return picked(result, "searched", "remarks") | {
        "axles": {axle.axle: _axle_json(axle) for axle in result.axles}
    }


def _axle_json(axle: AxleCooling) -> dict[str, Any]:
    return picked(
        axle,
        "form",
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


def _point_json(point: CoolingPoint) -> dict[str, Any]:
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


def cooling_page(result: Cooling, subtitle: str) -> Page:
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
    return Page("Disc cooling", sections, tiles[:8], subtitle=subtitle)


def _sections(axle: AxleCooling) -> list[Section]:
    sections = [
        Section(
            f"{axle.axle.capitalize()} discs: S over speed (Eq 4.12), "
            "1e-3 1/s",
            Table(HEAD, point_rows(axle)),
            plots=(("S over speed", _table_plot(axle)),),
            lines=axle_lines(axle),
            note="Bars: two standard errors. Ten pairs: the thesis's average "
            "over the pairs of five measurements, radiation included.",
            across=1,
        ),
    ]
    if axle.table:
        sections.append(
            Section(
                f"{axle.axle.capitalize()} discs: the table to configure, "
                "1e-3 1/s",
                Table(TABLE_HEAD, table_rows(axle)),
            )
        )
    sections.append(
        Section(
            f"{axle.axle.capitalize()} discs: cool-downs (thesis figures "
            "4.11 and 4.12)",
            plots=[
                pair for point in axle.points for pair in _point_plots(point)
            ],
            note="Coloured: measured. Black: Eq 4.12 with the S found. "
            "Dotted: with the ten-pair average.",
        )
    )
    return sections


def _table_plot(axle: AxleCooling) -> Plot:
    driven = [point for point in axle.points if point.speed_ms > 0.0]
    parked = [point for point in axle.points if point.speed_ms <= 0.0]
    speed = 3.6 * np.array([p.speed_ms for p in (*parked, *driven)])
    found = np.array([p.whole for p in parked] + [p.value for p in driven])
    error = np.array(
        [p.whole_error for p in parked] + [p.standard_error for p in driven]
    )
    pairs = np.array([p.ten_pairs for p in (*parked, *driven)])
    configured = np.array([p.configured for p in driven])
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
    if len(driven) > 1:
        traces.append(
            curve(
                speed[len(parked) :],
                1e3 * configured,
                "configured",
                GREY,
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
        colour = COLOURS[i % len(COLOURS)]
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
