"""``bstm heat``: the sources side by side in words, as page and as JSON.

The page has figures 4.5 to 4.10 and 6.1 to 6.3 of the thesis.
"""

from collections.abc import Sequence
from math import isfinite, nan
from typing import Any, Final

import numpy as np

from bstm_daemon.analysis.identify.heat_comparison import (
    LEAST_ENERGY_J,
    SOURCES,
    HeatComparison,
    StopFriction,
)
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.report.heat_figures import (
    energy_plot,
    friction_plots,
    integrated_plot,
    momentary_plot,
    per_force_plot,
    power_plot,
    smooth,
    stop_plots,
)
from bstm_daemon.report.json_file import own_fields, picked
from bstm_daemon.report.plots import COLOURS, curve, numbers, time_plot
from bstm_daemon.report.shell import Page, Section, Table
from bstm_daemon.report.text import columns, wrapped
from bstm_daemon.report.timescale import clock

STOPS_DRAWN: Final = 8
"""Stops with figures of their own: those with the most energy."""

AROUND_S: Final = 30.0
"""Shown before the first and after the last stop."""

SERIES_DIGITS: Final = 7

STOPS_SHOWN: Final = 40
"""Rows on the screen; JSON and page have them all."""

DASH: Final = "-"

SHORT_HEADS: Final = {
    SOURCES["ff"]: "FF",
    SOURCES["fb"]: "FB",
    SOURCES["can"]: "CAN",
}
"""Headings of the stops on the screen, where the page has the full name."""

NAMES: Final = {
    "ff": "pressure (Feed-Forward)",
    "fb": "motion (Feed-Back)",
    "can": "the bus's brake torque",
}
"""The sources in the first sentence of the page."""

AGREE: Final = 0.1
"""Share by which two sources of heat may differ and still agree."""

ADVICE: Final = {
    "ff": "the pad friction, the pressure's zero or the piston area is off "
    "(bstm identify brakes)",
    "can": "the torque of the bus is not all of the brake torque of this "
    "car; check its unit and scale in the DBC, and whether it is of one "
    "wheel, of one axle or of regeneration alone, before using it",
}
"""What to do where a source differs from motion."""

TOTAL_HEAD: Final = ("source", "energy", "to Feed-Back", "to balance", "")


def stop_head(heat: HeatComparison) -> tuple[str, ...]:
    """Return the headings of :func:`stop_rows`; energies in kJ."""
    return (
        *("stop", "from", "km/h", "bar", "disc"),
        *(SOURCES[name] for name in SOURCES if name in heat.power_w),
        *("balance", "kinetic", "drag", "climb", "drive", "FF/FB"),
    )


def stop_rows(heat: HeatComparison) -> list[tuple[str, ...]]:
    """Return a row a stop: energies by source, then Eq 4.5 term by term."""
    rows = []
    for i, stop in enumerate(heat.stops):
        hottest_c = max(stop.initial_c.values(), default=nan)
        balance, energy_j = stop.balance, stop.energy_j
        back_j = energy_j.get("fb", 0.0)
        ratio = energy_j.get("ff", nan) / back_j if back_j > 0.0 else nan
        speeds = f"{3.6 * balance.from_ms:.0f}-{3.6 * balance.to_ms:.0f}"
        rows.append(
            (
                str(i + 1),
                clock(stop.begin_s),
                speeds if isfinite(balance.brake_j) else DASH,
                f"{stop.pressure_pa / 1e5:.1f}",
                _figure(hottest_c, ".0f", " °C"),
                *(
                    f"{energy_j[name] / 1e3:.0f}"
                    for name in SOURCES
                    if name in heat.power_w
                ),
                _figure(balance.brake_j / 1e3, ".0f"),
                _figure(balance.kinetic_j / 1e3, ".0f"),
                _figure(balance.drag_j / 1e3, ".0f"),
                _figure(balance.climb_j / 1e3, ".0f"),
                _figure(balance.drive_j / 1e3, ".0f"),
                _figure(ratio, ".3f"),
            )
        )
    return rows


def _figure(value: float, form: str, unit: str = "") -> str:
    return f"{value:{form}}{unit}" if isfinite(value) else DASH


def total_rows(heat: HeatComparison) -> list[tuple[str, ...]]:
    """Return a row a source: energy of the drive, against Feed-Back."""
    rows: list[tuple[str, ...]] = []
    back = heat.total_j("fb") if "fb" in heat.power_w else 0.0
    for key, name in SOURCES.items():
        if key not in heat.power_w:
            rows.append((name, DASH, DASH, DASH, heat.absent[key]))
            continue
        total_j = heat.total_j(key)
        stops = [
            stop.energy_j[key] / stop.balance.brake_j
            for stop in heat.stops
            if stop.balance.brake_j > LEAST_ENERGY_J
        ]
        to_back = _figure(total_j / back if back > 0.0 else nan, ".3f")
        to_balance = _figure(np.median(stops) if stops else nan, ".3f")
        rows.append((name, f"{total_j / 1e6:.3f} MJ", to_back, to_balance, ""))
    return rows


def friction_lines(friction: StopFriction) -> list[str]:
    """Return the friction of the axles within the stops, as lines."""
    lines = []
    if friction.why_no_axles:
        lines.append(f"front and rear friction: {friction.why_no_axles}")
    for axle in ("front", "rear"):
        own = [one for one in friction.axles if one.axle == axle]
        if own:
            by = "its discs" if own[0].by_discs else "the rest of the balance"
            values = [one.friction for one in own]
            lines.append(
                f"{axle} friction by {by}: {min(values):.3f} to "
                f"{max(values):.3f} over {len(own)} stops"
            )
    return lines


def heat_text(heat: HeatComparison, friction: StopFriction) -> str:
    """Return the comparison as text for the screen."""
    lines = columns([TOTAL_HEAD, *total_rows(heat)])
    rows = stop_rows(heat)
    if rows:
        head = [SHORT_HEADS.get(name, name) for name in stop_head(heat)]
        lines += ["", "energies of the stops in kJ, Eq 4.5"]
        lines += columns([head, *rows[:STOPS_SHOWN]])
    if len(rows) > STOPS_SHOWN:
        lines.append(f"and {len(rows) - STOPS_SHOWN} more stops")
    momentary = heat.momentary_ratio()
    if np.isfinite(momentary).any():
        low, middle, high = np.nanpercentile(momentary, (5, 50, 95))
        per_force = np.nanmedian(heat.pressure_per_force())
        lines.append(
            f"\nFF/FB while braking: median {middle:.3f}, 5 to 95 % {low:.3f} "
            f"to {high:.3f}; pressure over force: median {per_force:.0f} Pa/N"
        )
    lines += wrapped([*friction_lines(friction), *heat.remarks])
    return "\n".join(lines)


def heat_json(heat: HeatComparison, friction: StopFriction) -> dict[str, Any]:
    """Return the comparison as plain data, SI.

    Series are rows of 0.1 s: time, power by source, running energy, ratios.
    """
    return {
        "sources": {
            key: {"energy_j": heat.total_j(key)}
            if key in heat.power_w
            else {"absent": heat.absent[key]}
            for key in SOURCES
        },
        "stops": [
            picked(
                stop,
                *("begin_s", "end_s", "energy_j"),
                mean_pressure_pa="pressure_pa",
                balance_j="balance.brake_j",
                initial_disc_c="initial_c",
            )
            | own_fields(stop.balance)
            for stop in heat.stops
        ],
        "friction": {
            "within_stops": [
                own_fields(one, "initial_c")
                | {
                    "initial_disc_c": one.initial_c,
                    "since_s": _series(one.since_s),
                    "friction": _series(one.friction),
                }
                for one in friction.within
            ],
            "axles": [
                picked(
                    one,
                    *("axle", "start_s", "friction", "by_discs"),
                    initial_disc_c="initial_c",
                )
                for one in friction.axles
            ],
            "why_no_axles": friction.why_no_axles,
        },
        "series": {
            "time_s": _series(heat.time_s),
            "speed_ms": _series(heat.speed_ms),
            "pressure_pa": _series(heat.pressure_pa),
            "power_w": {k: _series(v) for k, v in heat.power_w.items()},
            "energy_j": {k: _series(v) for k, v in heat.energy_j.items()},
            "momentary_ratio": _series(heat.momentary_ratio()),
            "integrated_ratio": _series(heat.integrated_ratio()),
            "pressure_per_force_pa_n": _series(heat.pressure_per_force()),
        },
        "remarks": heat.remarks,
    }


def _series(values: Column) -> list[float | None]:
    return numbers(values, SERIES_DIGITS)


def heat_page(
    drives: Sequence[tuple[str, HeatComparison, StopFriction]], subtitle: str
) -> Page:
    """Return the page of *drives*, each with its name."""
    sections = []
    for name, heat, friction in drives:
        subject = name if len(drives) > 1 else ""
        found = _drive_sections(heat, friction)
        sections += [one.of(subject) for one in found]
    tiles = []
    if len(drives) > 1:
        sections.insert(0, _side_by_side(drives))
    else:
        heat = drives[0][1]
        tiles = [
            (f"{heat.total_j(key) / 1e6:.2f} MJ", name)
            for key, name in SOURCES.items()
            if key in heat.power_w
        ]
    lead = ""
    for name, heat, _ in drives:
        text = sentence(heat)
        for advice in ADVICE.values():
            if advice in lead:
                text = text.replace(f": {advice}", "")
        lead += f" {name}: {text}" if len(drives) > 1 else text
    lead = lead.strip()
    return Page(
        "Brake heat by source", sections, tiles, lead, subtitle=subtitle
    )


def sentence(heat: HeatComparison) -> str:
    """Return for a person whether the sources of heat agree."""
    totals_j = {key: heat.total_j(key) for key in heat.power_w}
    known = [
        f"{NAMES[key]} {total_j / 1e6:.2f} MJ"
        for key, total_j in totals_j.items()
        if key in NAMES
    ]
    text = f"Brake heat of the drive by {', by '.join(known)}."
    back_j = totals_j.get("fb", 0.0)
    if not back_j > LEAST_ENERGY_J:
        return text
    for key, advice in ADVICE.items():
        if key in totals_j:
            ratio = totals_j[key] / back_j
            text += f" By {NAMES[key]} it is {ratio:.2f} of that by motion"
            text += "." if abs(ratio - 1.0) <= AGREE else f": {advice}."
    return text


def _drive_sections(
    heat: HeatComparison, friction: StopFriction
) -> list[Section]:
    span = (float(heat.time_s[0]), float(heat.time_s[-1]))
    active = _active(heat, span)
    sections = [
        Section(
            "Heat over the drive (thesis figure 6.1)",
            Table(TOTAL_HEAD, total_rows(heat)),
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
            Section(
                "Feed-Forward over Feed-Back (thesis figures 6.2, 6.3)",
                plots=(
                    ("while braking", momentary_plot(heat, active)),
                    ("of the energies so far", integrated_plot(heat, active)),
                ),
            )
        )
    if np.isfinite(heat.pressure_per_force()).any():
        sections.append(
            Section(
                "Pressure over brake force (thesis figures 4.9, 4.10)",
                plots=(("", per_force_plot(heat, active)),),
                note="Higher means less friction. Line: median over a second.",
                across=1,
            )
        )
    by_energy = sorted(
        range(len(heat.stops)),
        key=lambda i: -max(heat.stops[i].energy_j.values()),
    )
    if by_energy:
        note = "Dotted: W_brake of Eq 4.5, where every source should end."
        if len(heat.stops) > STOPS_DRAWN:
            note += f" The {STOPS_DRAWN} stops with the most energy."
        sections.append(
            Section(
                "Stops (thesis figures 4.5, 4.6 and 4.8)",
                plots=[
                    pair
                    for i in sorted(by_energy[:STOPS_DRAWN])
                    for pair in stop_plots(heat, heat.stops[i], i + 1)
                ],
                across=3,
                note=note,
            )
        )
        sections.append(
            Section(
                "Energy balance of the stops [kJ] (Eq 4.5)",
                Table(stop_head(heat), stop_rows(heat)),
                folded=True,
                note="Balance = kinetic - drag - climb + drive. Climb is the "
                "accelerometer's reading minus dv/dt: the grade, its bias, "
                "and the slip of braked tyres.",
            )
        )
    figures = friction_plots(friction)
    if figures:
        sections.append(
            Section(
                "Friction coefficient (thesis figure 4.7)",
                plots=figures,
                lines=friction_lines(friction),
                note="Within a stop: brake force from motion over that of Eq "
                "4.1 for a friction of 1; one value for the whole car. "
                "Front and rear: mean of a stop, from the heat in the "
                "measured discs; an axle without one gets the rest of the "
                "balance, including every error of mass and grade.",
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
) -> Section:
    """Return pressure over force of all drives from their first press on."""
    data, rows, last_s = [], [], 1.0
    for i, (name, heat, _) in enumerate(drives):
        ratio = smooth(heat.pressure_per_force())
        known = np.flatnonzero(np.isfinite(ratio))
        if len(known):
            since = heat.time_s - heat.time_s[known[0]]
            last_s = max(last_s, float(since[known[-1]]))
            part = slice(known[0], known[-1] + 1)
            colour = COLOURS[i % len(COLOURS)]
            data.append(curve(since[part], ratio[part], name, colour, width=2))
        rows += [(name, *row[:4]) for row in total_rows(heat) if not row[4]]
    drawn = time_plot(data, "pressure / force [Pa/N]", (0.0, last_s))
    return Section(
        "Logs side by side (thesis figures 4.9 and 4.10)",
        Table(("log", *TOTAL_HEAD[:4]), rows),
        plots=(("pressure over brake force since the first press", drawn),),
        across=1,
    )
