"""The forecast of parked brakes as text and as JSON."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from math import isinf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bstm_daemon.report.text import percent, table
from bstm_daemon.units import to_celsius

if TYPE_CHECKING:
    from bstm_daemon.forecast.offline_forecast import CornerOutlook, Outlook

HEADING = (
    *("corner", "fluid [degC]", "vapour now", "hottest [degC]", "after"),
    *("vapour in 30 min", "safe after", "level"),
)
NOTICE = "Estimate and advice, not a safety function."


def forecast_text(vehicle_id: str, path: Path, found: Outlook) -> str:
    """Return *found*, of the state file *path*, for a terminal."""
    low, middle, _ = (
        to_celsius(kelvin) for kelvin in found.boiling_k.values()
    )
    known = "known" if found.history_known else "unknown: at most as below"
    water = (
        f"fluid: {found.water_percent:.1f} % water (median), boils at "
        f"{middle:.0f} degC (median), 1 % of such fluids below {low:.0f} degC"
    )
    surroundings = (
        f"history {known}; outside {to_celsius(found.ambient_k):.0f} degC; "
        f"{found.members} members"
    )
    since = f"parked since the save of {path}{_when(found)}"
    lines = [
        f"{vehicle_id}: {since}; this is 'now', and times count from it",
        surroundings,
        water,
        "",
        *table(HEADING, [_row(corner) for corner in found.corners]),
        "",
        NOTICE,
    ]
    return "\n".join(lines)


def _row(corner: CornerOutlook) -> tuple[str, ...]:
    risk = corner.risk
    return (
        corner.corner,
        f"{to_celsius(corner.fluid_k):.0f} +- {risk.fluid_deviation_k:.0f}",
        percent(risk.probability_now),
        f"{to_celsius(risk.peak_k):.0f}",
        _minutes(risk.peak_in_s),
        percent(risk.probability),
        _minutes(risk.safe_in_s),
        risk.level.name.lower(),
    )


def _when(found: Outlook) -> str:
    if found.saved_us is None:
        return ""
    saved = datetime.fromtimestamp(found.saved_us * 1e-6, UTC)
    age_s = time.time() - found.saved_us * 1e-6
    ago = f", {_minutes(age_s)} ago" if age_s >= 0.0 else ""
    return f" ({saved:%Y-%m-%d %H:%M} UTC{ago})"


def _minutes(seconds: float) -> str:
    if isinf(seconds):
        return "> 90 min"
    minutes = seconds / 60.0
    if minutes < 120.0:
        return f"{minutes:.0f} min"
    hours = minutes / 60.0
    return f"{hours:.0f} h" if hours < 48.0 else f"{hours / 24.0:.0f} days"


def forecast_json(vehicle_id: str, found: Outlook) -> dict[str, Any]:
    """Return *found* for a JSON file; infinity, a time beyond it, is null."""
    return {
        "vehicle_id": vehicle_id,
        "saved_us": found.saved_us,
        "history_known": found.history_known,
        "ambient_c": _rounded(to_celsius(found.ambient_k)),
        "water_percent": _rounded(found.water_percent),
        "boiling_c": {
            f"{share:g}": _rounded(to_celsius(kelvin))
            for share, kelvin in found.boiling_k.items()
        },
        "members": found.members,
        "corners": {
            c.corner: {
                "fluid_c": _rounded(to_celsius(c.fluid_k)),
                "fluid_std_k": _rounded(c.risk.fluid_deviation_k),
                "risk_now": c.risk.probability_now,
                "risk": c.risk.probability,
                "level": c.risk.level.name.lower(),
                "peak_c": _rounded(to_celsius(c.risk.peak_k)),
                "peak_in_s": _rounded(c.risk.peak_in_s),
                "safe_in_s": _rounded(c.risk.safe_in_s),
            }
            for c in found.corners
        },
    }


def _rounded(value: float) -> float:
    return round(value, 2)
