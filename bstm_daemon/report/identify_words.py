"""What was identified, as lines of text and as plain data."""

from __future__ import annotations

from math import isfinite
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.report.timescale import clock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.identify.brakes import Brakes, Finding
    from bstm_daemon.identify.coastdown import CoastDown, Value

WIDTH: Final = 100

UNITS: Final = {
    "drag_area_m2": "m2",
    "friction_ns_m": "N s/m",
    "rolling_resistance": "-",
}
RUN_HEAD: Final = (
    *("run", "from", "km/h", "direction", "grade", "kinetic", "resistance"),
    *("climb", "left over", "v rms"),
)
STOP_HEAD: Final = (
    *("stop", "from", "km/h", "bar", "samples", "friction ratio"),
    *("disc before", "zero"),
)
_DIRECTIONS: Final = {1: "up", -1: "down", 0: "-"}


def columns(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return *rows* as aligned lines, the first column to the left."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def wrapped(lines: Sequence[str]) -> list[str]:
    """Return *lines* as a list, broken at the width of the screen."""
    found = []
    for line in lines:
        found += wrap(
            f"- {line}",
            WIDTH,
            subsequent_indent="  ",
            break_on_hyphens=False,
        )
    return found


def number(value: float, digits: int = 4) -> str:
    """Return *value* with so many digits, a dash where there is none."""
    return f"{value:.{digits}g}" if isfinite(value) else "-"


# ------------------------------------------------------------- coast-down


def value_rows(result: CoastDown) -> list[tuple[str, ...]]:
    """Return name, value, error, configured and verdict of each value."""
    return [
        (
            one.name,
            f"{number(one.value)} {UNITS[one.name]}",
            number(one.standard_error, 2),
            number(one.configured),
            "identified" if one.identified else one.doubt,
        )
        for one in result.values
    ]


def run_rows(result: CoastDown) -> list[tuple[str, ...]]:
    """Return a row a run, of :data:`RUN_HEAD`."""
    return [
        (
            str(i + 1),
            clock(run.stretch.start_s),
            f"{3.6 * run.speed_ms[0]:.0f} to {3.6 * run.speed_ms[-1]:.0f}",
            _DIRECTIONS[run.direction],
            f"{100 * run.grade:+.2f} %",
            f"{run.kinetic_j / 1e3:.1f} kJ",
            f"{run.resistance_j / 1e3:.1f} kJ",
            f"{run.climb_j / 1e3:.1f} kJ",
            f"{100 * run.miss:+.2f} %",
            f"{3.6 * run.residual_rms_ms:.2f} km/h",
        )
        for i, run in enumerate(result.runs)
    ]


def coast_down_text(result: CoastDown) -> str:
    """Return the result as text for the screen."""
    head = ("value", "found", "+-", "configured", "verdict")
    lines = columns([head, *value_rows(result)])
    lines += ["", *columns([RUN_HEAD, *run_rows(result)]), ""]
    lines.append(
        f"{result.windows} windows, residual {result.residual_ms2:.4f} m/s2; "
        f"correlation drag/C_fric {number(result.correlation[0, 1], 2)}, "
        f"drag/f_r {number(result.correlation[0, 2], 2)}, "
        f"C_fric/f_r {number(result.correlation[1, 2], 2)}"
    )
    if result.bias_ms2 is not None:
        lines.append(
            f"accelerometer bias {result.bias_ms2:+.3f} m/s2, if the grades "
            "cancel"
        )
    return "\n".join([*lines, *wrapped(result.remarks)])


def coast_down_json(result: CoastDown) -> dict[str, Any]:
    """Return the result as plain data, SI."""
    return {
        "values": {one.name: _value(one) for one in result.values},
        "correlation": [
            [_finite(float(cell)) for cell in row]
            for row in result.correlation
        ],
        "residual_ms2": result.residual_ms2,
        "windows": result.windows,
        "road": result.road,
        "accelerometer_bias_ms2": result.bias_ms2,
        "runs": [
            {
                "log": run.stretch.driving.name,
                "start_s": run.stretch.start_s,
                "duration_s": run.stretch.duration_s,
                "from_ms": float(run.speed_ms[0]),
                "to_ms": float(run.speed_ms[-1]),
                "direction": run.direction,
                "grade": run.grade,
                "kinetic_j": run.kinetic_j,
                "resistance_j": run.resistance_j,
                "climb_j": run.climb_j,
                "drive_j": run.drive_j,
                "energy_left_over": run.miss,
                "speed_rms_ms": run.residual_rms_ms,
            }
            for run in result.runs
        ],
        "searched": list(result.searched),
        "remarks": list(result.remarks),
    }


def _value(one: Value) -> dict[str, Any]:
    return {
        "value": _finite(one.value),
        "standard_error": _finite(one.standard_error),
        "configured": one.configured,
        "identified": one.identified,
        "why_not": one.doubt,
    }


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None


# ----------------------------------------------------------------- brakes


def brake_rows(result: Brakes) -> list[tuple[str, ...]]:
    """Return name, value, error and verdict of what the brakes have."""
    rows = [
        ("friction scale", result.scale, "{:.4f}", 1.0),
        ("front", result.front_scale, "{:.4f}", 1.0),
        ("rear", result.rear_scale, "{:.4f}", 1.0),
        ("push-out", result.pushout_pa, "{:.3f} bar", 1e-5),
        ("front share", result.front_share, "{:.3f}", 1.0),
        ("exponent of speed", result.lean_speed, "{:+.3f}", 1.0),
        ("exponent of pressure", result.lean_pressure, "{:+.3f}", 1.0),
        ("hydraulic lag", result.lag_s, "{:.2f} s", 1.0),
    ]
    return [
        (
            name,
            form.format(found.value * factor)
            if isfinite(found.value)
            else "-",
            number(found.standard_error * factor, 2),
            "identified" if found.identified else f"not: {found.doubt}",
        )
        for name, found, form, factor in rows
        if found is not None
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
    rows = brake_rows(result)
    told = [row for row in rows if row[3] == "identified"]
    lines = columns([("value", "found", "+-"), *(row[:3] for row in told)])
    lines.append(
        f"at {3.6 * result.speed_ms:.0f} km/h and "
        f"{result.pressure_pa / 1e5:.1f} bar; {result.samples} samples, "
        f"residual {result.residual_n:.0f} N; the released pressure reads "
        f"{result.rest_pa / 1e5:+.3f} bar"
    )
    lines += wrapped(brake_doubts(result))
    lines += ["", *columns([STOP_HEAD, *stop_rows(result)]), ""]
    return "\n".join([*lines, *wrapped(result.remarks)])


def brakes_json(result: Brakes) -> dict[str, Any]:
    """Return the result as plain data, SI."""
    return {
        "friction_scale": _finding(result.scale),
        "front_scale": _finding(result.front_scale),
        "rear_scale": _finding(result.rear_scale),
        "pushout_pressure_pa": _finding(result.pushout_pa),
        "released_pressure_pa": result.rest_pa,
        "front_share": _finding(result.front_share),
        "speed_exponent": _finding(result.lean_speed),
        "pressure_exponent": _finding(result.lean_pressure),
        "lag_s": _finding(result.lag_s),
        "at_speed_ms": result.speed_ms,
        "at_pressure_pa": result.pressure_pa,
        "residual_n": result.residual_n,
        "samples": result.samples,
        "stops": [
            {
                "log": stop.log,
                "start_s": stop.start_s,
                "duration_s": stop.duration_s,
                "from_ms": stop.from_ms,
                "to_ms": stop.to_ms,
                "zero_n": stop.zero_n,
                "initial_disc_c": stop.initial_c,
                "since_s": stop.since_s.tolist(),
                "speed_ms": stop.speed_ms.tolist(),
                "pressure_pa": stop.pressure_pa.tolist(),
                "force_n": stop.force_n.tolist(),
                "friction_ratio": result.ratio(stop).tolist(),
            }
            for stop in result.stops
        ],
        "searched": list(result.searched),
        "remarks": list(result.remarks),
    }


def _finding(found: Finding | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "value": _finite(found.value),
        "standard_error": _finite(found.standard_error),
        "identified": found.identified,
        "why_not": found.doubt,
    }
