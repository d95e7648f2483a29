"""What ``bstm identify cooling`` found, as text and as plain data."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.report.identify_words import columns, number, wrapped
from bstm_daemon.report.timescale import clock
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.identify.cooling import (
        AxleCooling,
        Cooling,
        CoolingPoint,
    )

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
        f"{speed_text(point.speed_ms)}: not identified: {point.doubt}"
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
    return {
        "axles": {axle.axle: _axle(axle) for axle in result.axles},
        "searched": list(result.searched),
        "remarks": list(result.remarks),
    }


def _axle(axle: AxleCooling) -> dict[str, Any]:
    return {
        "form": axle.form,
        "speed_ms": [speed for speed, *_ in axle.table],
        "s_per_s": [s for _, s, _ in axle.table],
        "measured": [measured for *_, measured in axle.table],
        "standstill_convection_fraction": axle.still,
        "covariance": axle.fit.covariance.tolist(),
        "residual_k": axle.fit.residual_k,
        "other_form_residual_k": axle.other_residual_k,
        "points": [
            {
                "speed_ms": point.speed_ms,
                "s_per_s": point.value,
                "standard_error": point.standard_error,
                "whole_s_per_s": point.whole,
                "whole_standard_error": point.whole_error,
                "configured_s_per_s": point.configured,
                "identified": point.identified,
                "why_not": point.doubt,
                "ten_pairs_s_per_s": _finite(point.ten_pairs),
                "ten_pairs_spread": _finite(point.ten_pairs_spread),
                "by_corner": {
                    corner: {"s_per_s": value, "standard_error": error}
                    for corner, (value, error) in point.by_corner.items()
                },
                "cool_downs": [
                    {
                        "log": one.down.log,
                        "role": one.down.role,
                        "start_s": one.down.start_s,
                        "time_s": one.time_s.tolist(),
                        "measured_k": one.measured_k.tolist(),
                        "model_k": one.model_k.tolist(),
                    }
                    for one in point.series
                ],
            }
            for point in axle.points
        ],
    }


def cool_down_text(start_s: float, log: str) -> str:
    """Return where a cool-down stands."""
    return f"{log} at {clock(start_s)}"


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None
