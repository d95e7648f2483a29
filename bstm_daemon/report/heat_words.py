"""The brake heat by source, as lines of text and as plain data."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bstm_daemon.identify.heat_comparison import LEAST_ENERGY_J, SOURCES
from bstm_daemon.report.identify_words import columns, wrapped
from bstm_daemon.report.timescale import clock

if TYPE_CHECKING:
    from bstm_daemon.identify.heat_comparison import (
        Balance,
        HeatComparison,
    )
    from bstm_daemon.identify.stop_friction import StopFriction

STOPS_SHOWN: Final = 40
"""Rows on the screen; JSON and page have them all."""

DASH: Final = "-"


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
        hottest = max(stop.initial_c.values(), default=float("nan"))
        rows.append(
            (
                str(i + 1),
                clock(stop.begin_s),
                _speeds(stop.balance),
                f"{stop.pressure_pa / 1e5:.1f}",
                f"{hottest:.0f} °C" if isfinite(hottest) else DASH,
                *(
                    f"{stop.energy_j[name] / 1e3:.0f}"
                    for name in SOURCES
                    if name in heat.power_w
                ),
                *(
                    f"{value / 1e3:.0f}" if isfinite(value) else DASH
                    for value in (
                        stop.balance.brake_j,
                        stop.balance.kinetic_j,
                        stop.balance.drag_j,
                        stop.balance.climb_j,
                        stop.balance.drive_j,
                    )
                ),
                _ratio(stop.energy_j),
            )
        )
    return rows


def _speeds(balance: Balance) -> str:
    if not isfinite(balance.brake_j):
        return DASH
    return f"{3.6 * balance.from_ms:.0f}-{3.6 * balance.to_ms:.0f}"


def _ratio(energy_j: dict[str, float]) -> str:
    forward, back = energy_j.get("ff"), energy_j.get("fb")
    if forward is None or not back or back <= 0.0:
        return DASH
    return f"{forward / back:.3f}"


def total_rows(heat: HeatComparison) -> list[tuple[str, ...]]:
    """Return a row a source: energy of the drive, against Feed-Back."""
    rows: list[tuple[str, ...]] = []
    back = heat.total_j("fb") if "fb" in heat.power_w else 0.0
    for key, name in SOURCES.items():
        if key not in heat.power_w:
            rows.append((name, DASH, DASH, DASH, heat.absent[key]))
            continue
        total = heat.total_j(key)
        stops = [
            stop.energy_j[key] / stop.balance.brake_j
            for stop in heat.stops
            if stop.balance.brake_j > LEAST_ENERGY_J
        ]
        rows.append(
            (
                name,
                f"{total / 1e6:.3f} MJ",
                f"{total / back:.3f}" if back > 0.0 else DASH,
                f"{np.median(stops):.3f}" if stops else DASH,
                "",
            )
        )
    return rows


TOTAL_HEAD: Final = ("source", "energy", "to Feed-Back", "to balance", "")


def friction_lines(friction: StopFriction) -> list[str]:
    """Return what is said of friction within the stops."""
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
    shown = rows[:STOPS_SHOWN]
    if shown:
        head = stop_head(heat)
        short = tuple(
            {"Feed-Forward": "FF", "Feed-Back": "FB"}.get(name, name)
            for name in head
        )
        short = tuple("CAN" if n == SOURCES["can"] else n for n in short)
        lines += ["", "energies of the stops in kJ, Eq 4.5"]
        lines += columns([short, *shown])
    if len(rows) > len(shown):
        lines.append(f"and {len(rows) - len(shown)} more stops")
    momentary = heat.momentary_ratio()
    if np.isfinite(momentary).any():
        per_force = heat.pressure_per_force()
        said = (
            f"FF/FB while braking: median {np.nanmedian(momentary):.3f}, "
            f"5 to 95 % {np.nanpercentile(momentary, 5):.3f} to "
            f"{np.nanpercentile(momentary, 95):.3f}; "
            f"pressure over force: median {np.nanmedian(per_force):.0f} Pa/N"
        )
        lines += ["", said]
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
            {
                "begin_s": stop.begin_s,
                "end_s": stop.end_s,
                "from_ms": _finite(stop.balance.from_ms),
                "to_ms": _finite(stop.balance.to_ms),
                "mean_pressure_pa": stop.pressure_pa,
                "energy_j": stop.energy_j,
                "balance_j": _finite(stop.balance.brake_j),
                "kinetic_j": _finite(stop.balance.kinetic_j),
                "drag_j": _finite(stop.balance.drag_j),
                "climb_j": _finite(stop.balance.climb_j),
                "drive_j": _finite(stop.balance.drive_j),
                "initial_disc_c": stop.initial_c,
            }
            for stop in heat.stops
        ],
        "friction": {
            "within_stops": [
                {
                    "start_s": one.start_s,
                    "initial_disc_c": one.initial_c,
                    "since_s": _rounded(one.since_s),
                    "friction": _rounded(one.friction),
                }
                for one in friction.within
            ],
            "axles": [
                {
                    "axle": one.axle,
                    "start_s": one.start_s,
                    "initial_disc_c": one.initial_c
                    if isfinite(one.initial_c)
                    else None,
                    "friction": one.friction,
                    "by_discs": one.by_discs,
                }
                for one in friction.axles
            ],
            "why_no_axles": friction.why_no_axles,
        },
        "series": {
            "time_s": _rounded(heat.time_s),
            "speed_ms": _rounded(heat.speed_ms),
            "pressure_pa": _rounded(heat.pressure_pa),
            "power_w": {k: _rounded(v) for k, v in heat.power_w.items()},
            "energy_j": {k: _rounded(v) for k, v in heat.energy_j.items()},
            "momentary_ratio": _rounded(heat.momentary_ratio()),
            "integrated_ratio": _rounded(heat.integrated_ratio()),
            "pressure_per_force_pa_n": _rounded(heat.pressure_per_force()),
        },
        "remarks": list(heat.remarks),
    }


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None


def _rounded(values: Any) -> list[float | None]:
    return [
        float(f"{value:.7g}") if isfinite(value) else None
        for value in np.asarray(values, np.float64).tolist()
    ]
