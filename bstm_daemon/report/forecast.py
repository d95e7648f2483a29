"""The forecast of parked brakes as text and as JSON."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from math import isinf
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.report.text import Columns, percent
from bstm_daemon.units import to_celsius

if TYPE_CHECKING:
    from bstm_daemon.forecast.offline_forecast import CornerOutlook, Outlook

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
        *CORNERS.lines(found.corners, None),
        "",
        NOTICE,
    ]
    return "\n".join(lines)


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


def _fluid(one: CornerOutlook) -> str:
    return f"{to_celsius(one.fluid_k):.0f} +- {one.risk.fluid_deviation_k:.0f}"


CORNERS: Final[Columns[CornerOutlook]] = Columns(
    ("corner", lambda one: one.corner),
    ("fluid [degC]", _fluid),
    ("vapour now", lambda one: percent(one.risk.probability_now)),
    ("hottest [degC]", lambda one: f"{to_celsius(one.risk.peak_k):.0f}"),
    ("after", lambda one: _minutes(one.risk.peak_in_s)),
    ("vapour in 30 min", lambda one: percent(one.risk.probability)),
    ("safe after", lambda one: _minutes(one.risk.safe_in_s)),
    ("level", lambda one: one.risk.level.name.lower()),
)


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
