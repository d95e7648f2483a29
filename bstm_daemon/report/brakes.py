"""``bstm identify brakes``: its result in words, as page and as JSON."""

from math import isfinite
from typing import Any, Final

import numpy as np

from bstm_daemon.analysis.identify.brakes import Brakes
from bstm_daemon.report.json_file import picked
from bstm_daemon.report.plots import (
    BLUE,
    COLOURS,
    GREY,
    VERMILION,
    Plot,
    cloud,
    curve,
    plot,
    wide_range,
)
from bstm_daemon.report.shell import Page, Section, Table
from bstm_daemon.report.text import columns, number, wrapped
from bstm_daemon.report.timescale import clock

STOP_HEAD: Final = (
    *("stop", "from", "km/h", "bar", "samples", "friction ratio"),
    *("disc before", "zero"),
)
LEAST_SPAN: Final = 0.05
"""Least half width of a friction axis, as a share of the median."""


VALUES: Final = (
    ("friction scale", "scale", "friction_scale", "{:.4f}", 1.0),
    ("front", "front_scale", "front_scale", "{:.4f}", 1.0),
    ("rear", "rear_scale", "rear_scale", "{:.4f}", 1.0),
    ("push-out", "pushout_pa", "pushout_pressure_pa", "{:.3f} bar", 1e-5),
    ("front share", "front_share", "front_share", "{:.3f}", 1.0),
    ("exponent of speed", "lean_speed", "speed_exponent", "{:+.3f}", 1.0),
    (
        "exponent of pressure",
        "lean_pressure",
        "pressure_exponent",
        "{:+.3f}",
        1,
    ),
    ("hydraulic lag", "lag_s", "lag_s", "{:.2f} s", 1.0),
)
"""Each value: name, attribute, key in JSON, form, factor on what is SI."""


def brake_rows(result: Brakes) -> list[tuple[str, ...]]:
    """Return name, value, error and verdict of what the brakes have."""
    return [
        (
            name,
            form.format(found.value * factor)
            if isfinite(found.value)
            else "-",
            number(found.standard_error * factor, 2),
            "identified" if found.identified else f"not: {found.caveat}",
        )
        for name, attribute, _, form, factor in VALUES
        if (found := getattr(result, attribute)) is not None
    ]


def brake_doubts(result: Brakes) -> list[str]:
    """Return why values are not identified, those of one reason together."""
    rows = [row for row in brake_rows(result) if row[3] != "identified"]
    found = []
    for words in dict.fromkeys(row[3] for row in rows):
        names = ", ".join(row[0] for row in rows if row[3] == words)
        found.append(f"{names} not identified: {words.removeprefix('not: ')}")
    return found


def stop_rows(result: Brakes) -> list[tuple[str, ...]]:
    """Return a row a stop, of :data:`STOP_HEAD`."""
    return [
        (
            str(i + 1),
            clock(stop.start_s),
            f"{3.6 * stop.from_ms:.0f} to {3.6 * stop.to_ms:.0f}",
            f"{stop.pressure_pa.mean() / 1e5:.1f}",
            str(len(stop.since_s)),
            f"{result.ratio(stop).mean():.3f}",
            " ".join(
                f"{corner} {value:.0f}"
                for corner, value in stop.initial_c.items()
            )
            or "-",
            f"{stop.zero_n:+.0f} N{'' if stop.own_zero else ' (others)'}",
        )
        for i, stop in enumerate(result.stops)
    ]


def brakes_text(result: Brakes) -> str:
    """Return the result as text for the screen."""
    rows, samples = brake_rows(result), result.samples
    identified = [row for row in rows if row[3] == "identified"]
    lines = columns(
        [("value", "found", "+-"), *(row[:3] for row in identified)]
    )
    lines.append(
        f"at {3.6 * samples.speed_mean_ms:.0f} km/h and "
        f"{samples.pressure_mean_pa / 1e5:.1f} bar; "
        f"{len(samples.stop)} samples, "
        f"residual {result.residual_n:.0f} N; the released pressure reads "
        f"{result.rest_pa / 1e5:+.3f} bar"
    )
    lines += wrapped(brake_doubts(result))
    lines += ["", *columns([STOP_HEAD, *stop_rows(result)]), ""]
    return "\n".join([*lines, *wrapped(result.remarks)])


def brakes_json(result: Brakes) -> dict[str, Any]:
    """Return the result as plain data, SI."""
    found = {
        key: getattr(result, attribute) for _, attribute, key, *_ in VALUES
    }
    return {
        name: one
        and picked(
            one, "value", "standard_error", "identified", why_not="caveat"
        )
        for name, one in found.items()
    } | {
        **picked(
            result,
            *("residual_n", "searched", "remarks"),
            released_pressure_pa="rest_pa",
            at_speed_ms="samples.speed_mean_ms",
            at_pressure_pa="samples.pressure_mean_pa",
        ),
        "samples": len(result.samples.stop),
        "stops": [
            picked(
                stop,
                *("log", "start_s", "duration_s", "from_ms", "to_ms"),
                *("zero_n", "since_s", "speed_ms", "pressure_pa", "force_n"),
                initial_disc_c="initial_c",
            )
            | {"friction_ratio": result.ratio(stop)}
            for stop in result.stops
        ],
    }


def brakes_page(result: Brakes, subtitle: str) -> Page:
    """Return the page of the brakes: values, friction, stops."""
    rows = brake_rows(result)
    values = [
        (*row[:3], "yes" if row[3] == "identified" else "no") for row in rows
    ]
    identified = [row[:2] for row in rows if row[3] == "identified"]
    found = ", ".join(f"{name} {value}" for name, value in identified)
    lead = (
        f"{len(result.stops)} stops identify: {found}."
        if identified
        else f"{len(result.stops)} stops identify no value of the brakes."
    )
    sections = [
        Section(
            "Friction",
            plots=_friction_plots(result),
            note="Friction over its configured value: brake force from "
            "motion over that of Eq 4.1 at the pressure minus push-out. The "
            "line and the value apply at "
            f"{3.6 * result.samples.speed_mean_ms:.0f} km/h.",
        ),
        Section(
            "Brakes",
            Table(("value", "found", "+-", "identified"), values),
            lines=[*brake_doubts(result), *result.searched, *result.remarks],
        ),
        Section("Stops", Table(STOP_HEAD, stop_rows(result)), folded=True),
    ]
    pushout, front = result.pushout_pa, result.front_share
    tiles = (
        (
            f"{result.scale.value:.3f}",
            f"friction scale +- {number(result.scale.standard_error, 2)}",
        ),
        (
            f"{pushout.value / 1e5:.2f} bar",
            "push-out" + ("" if pushout.identified else ", held"),
        ),
        (
            f"{front.value:.2f}",
            "front share" + ("" if front.identified else ", configured"),
        ),
    )
    return Page("Brakes", sections, tiles, lead, subtitle=subtitle)


def _friction_plots(result: Brakes) -> list[tuple[str, Plot]]:
    stops, samples = result.stops, result.samples
    pressure, speed = samples.pressure_pa / 1e5, 3.6 * samples.speed_ms
    ratio = result.ratio(samples)
    discs_c = [
        np.mean(list(stop.initial_c.values())) if stop.initial_c else np.nan
        for stop in stops
    ]
    before = np.array(discs_c)[samples.stop]
    y_title = "friction over configured"
    axis = {"range": wide_range(ratio, LEAST_SPAN)}
    within = [
        curve(
            stop.since_s,
            result.ratio(stop),
            f"stop {i + 1}",
            COLOURS[i % len(COLOURS)],
            legend=len(stops) <= 10,
        )
        for i, stop in enumerate(stops)
    ]
    plots = [
        ("brake force over pressure", _force_plot(result)),
        (
            "friction within the stops",
            plot(within, "time since the press [s]", y_title, yaxis=axis),
        ),
    ]
    quantities = [
        ("speed", "speed [km/h]", speed, pressure, "bar"),
        ("pressure", "pressure [bar]", pressure, speed, "km/h"),
    ]
    if np.isfinite(before).any():
        name = "the discs' temperature before the stop"
        x_title = "measured disc before the stop [°C]"
        quantities.append((name, x_title, before, pressure, "bar"))
    for name, x_title, x, shade, unit in quantities:
        points = cloud(x, ratio, "", shade=shade, shade_title=unit)
        drawn = plot([points], x_title, y_title, yaxis=axis)
        plots.append((f"friction over {name}", drawn))
    return plots


def _force_plot(result: Brakes) -> Plot:
    samples = result.samples
    pressure, gain = samples.pressure_pa / 1e5, samples.gain
    whole = np.array([0.0, pressure.max()])
    ends = np.array([result.pushout_pa.value / 1e5, pressure.max()])
    line = 1e2 * result.scale.value * gain * (ends - ends[0])
    return plot(
        [
            cloud(pressure, samples.force_n / 1e3, "samples", BLUE),
            curve(
                whole,
                1e2 * gain * whole,
                "configured friction, no push-out",
                GREY,
                dash="5px,3px",
            ),
            curve(ends, line, "found", VERMILION),
        ],
        "pressure [bar]",
        "brake force [kN]",
    )
