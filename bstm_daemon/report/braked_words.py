"""What ``identify cooling --while-braking`` found, as text and as data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.identify.braked_discs import WINDOW_S
from bstm_daemon.report.identify_words import columns, wrapped
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.identify.cooling_while_braking import (
        BrakedAxle,
        BrakedCooling,
    )

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
    times = len({(w.log, w.start_s) for w in axle.windows})
    couples = len({w.role for w in axle.windows})
    coldest, hottest = (one - KELVIN_OFFSET for one in axle.range_k)
    lines = [f"not identified: {axle.doubt}"] if axle.doubt else []
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
        "axles": {axle.axle: _axle(axle) for axle in result.axles},
        "remarks": list(result.remarks),
    }


def _axle(axle: BrakedAxle) -> dict[str, Any]:
    values = [axle.at(speed) for speed in axle.speeds_ms]
    return {
        "form": axle.form,
        "identified": not axle.doubt,
        "why_not": axle.doubt,
        "speed_ms": list(axle.speeds_ms),
        "s_per_s": [value for value, _ in values],
        "standard_error": [error for _, error in values],
        "driven_ms": list(axle.held_ms),
        "heat_factor": axle.heat[0],
        "heat_factor_error": axle.heat[1],
        "resistance_factor": axle.resist[0],
        "resistance_factor_error": axle.resist[1],
        "fitted_rms_k": axle.fitted_k,
        "held_out_rms_k": axle.held_k,
        "windows": [
            {
                "log": window.log,
                "role": window.role,
                "start_s": window.start_s,
                "measured_k": window.disc_k.tolist(),
                "held_out_model_k": axle.held_model_k[:, i].tolist(),
            }
            for i, window in enumerate(axle.windows)
        ],
    }
