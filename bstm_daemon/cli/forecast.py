"""``bstm forecast``: what the brake fluid will do, from a saved state."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from math import isinf
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bstm_daemon.cli.arguments import check_targets, option, shared
from bstm_daemon.cli.vehicle import read_state
from bstm_daemon.config.reading import load_config
from bstm_daemon.errors import UsageError
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.memory import StateError
from bstm_daemon.estimator.state import restore_state
from bstm_daemon.forecast.offline_forecast import SHARES, outlook
from bstm_daemon.report.json_file import write_json
from bstm_daemon.report.text import percent, table
from bstm_daemon.units import to_celsius

if TYPE_CHECKING:
    import argparse

    from bstm_daemon.forecast.offline_forecast import CornerOutlook, Outlook

HEADING = (
    *("corner", "fluid [degC]", "vapour now", "hottest [degC]", "after"),
    *("vapour in 30 min", "safe after", "level"),
)
NOTICE = "Estimate and advice, not a safety function."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of ``bstm forecast``."""
    shared(parser, "config")
    option(
        parser,
        "--now STATE",
        "state file of the daemon; the car parks at its save. It is only read",
        Path,
        required=True,
    )
    shared(parser, "json")


def run(args: argparse.Namespace) -> int:
    """Print the forecast and write it where that is asked for."""
    check_targets((args.json,), (args.config, args.now))
    config = load_config(args.config)
    document = read_state(args.now, "--now")
    vehicle_id = document.get("vehicle_id")
    if vehicle_id != config.vehicle.id:
        msg = (
            f"--now {args.now}: it is of vehicle {vehicle_id!r}, not "
            f"{config.vehicle.id!r}"
        )
        raise UsageError(msg)
    estimator = Estimator(config, {})
    try:
        restore_state(estimator, document, resume=False)
    except StateError as error:
        msg = f"--now {args.now}: the state does not match: {error}"
        raise UsageError(msg) from error
    found = outlook(config, estimator, document)
    print("\n".join(_lines(config.vehicle.id, args.now, found)))
    if args.json is not None:
        write_json(args.json, _document(config.vehicle.id, found))
        print(args.json)
    return 0


def _lines(vehicle_id: str, path: Path, found: Outlook) -> list[str]:
    low, middle, _ = (to_celsius(kelvin) for kelvin in found.boiling_k)
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
    return [
        f"{vehicle_id}: {since}; this is 'now', and times count from it",
        surroundings,
        water,
        "",
        *table(HEADING, [_row(corner) for corner in found.corners]),
        "",
        NOTICE,
    ]


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


def _document(vehicle_id: str, found: Outlook) -> dict[str, Any]:
    """Return *found* for a JSON file; infinity, a time beyond it, is null."""
    return {
        "vehicle_id": vehicle_id,
        "saved_us": found.saved_us,
        "history_known": found.history_known,
        "ambient_c": _rounded(to_celsius(found.ambient_k)),
        "water_percent": _rounded(found.water_percent),
        "boiling_c": {
            f"{share:g}": _rounded(to_celsius(kelvin))
            for share, kelvin in zip(SHARES, found.boiling_k, strict=True)
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
