"""Risk over a restart: from the document of a state file."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING, Any

from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.estimator.estimator import Estimator
    from bstm_daemon.forecast.monitor import RiskMonitor


def resume_risk(
    monitor: RiskMonitor,
    estimator: Estimator,
    document: Mapping[str, Any],
    parked_us: int | None,
    now_us: int,
) -> None:
    """Let *monitor* go on from *document*, which *estimator* has taken.

    Args:
        monitor: has not seen a publication yet.
        estimator: what it watches.
        document: a state that fits the car.
        parked_us: time since the save [us], None where it is not known.
        now_us: time now on the axis of the stamps [us].
    """
    states = {
        name: [state[key] for key in program.state_names]
        for name, program in estimator.programs.items()
        if (state := saved_state(document, name)) is not None
        and all(key in state for key in program.state_names)
    }
    air = None
    if parked_us is not None:
        ambient_k = saved_ambient_k(document, estimator)
        air = ambient_k, parked_us * 1e-6, now_us
    monitor.resume(document.get("risk"), states, air)


def saved_state(
    document: Mapping[str, Any], corner: str
) -> dict[str, float] | None:
    """Return nodes and memories of *corner* in *document*, if they are."""
    corners = document.get("corners")
    found = corners.get(corner) if isinstance(corners, dict) else None
    return found if isinstance(found, dict) else None


def saved_ambient_k(
    document: Mapping[str, Any], estimator: Estimator
) -> float:
    """Return the air of *document* [K], the configured where it has none."""
    found = document.get("ambient_k")
    if isinstance(found, float) and isfinite(found):
        return found
    return estimator.config.vehicle.ambient_c + KELVIN_OFFSET
