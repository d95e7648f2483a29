"""The state of the running service in numbers.

The loop fills one :class:`ServiceStatus` every few seconds; the metrics and
the line that ``systemctl status`` shows are written from it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import isfinite, nan
from typing import TYPE_CHECKING, Final

from bstm_daemon.estimate import (
    NO_INPUT,
    CornerEstimate,
    HeatMode,
    Input,
    RiskLevel,
    State,
)
from bstm_daemon.model.heat.plausibility import WORDS
from bstm_daemon.units import to_celsius

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.bus.live.link import LinkEvent, LinkState
    from bstm_daemon.estimate import CarRisk

_IN_LINE: Final = (
    "speed_suspect",
    "wheel_speed_suspect",
    "pressure_suspect",
    "acceleration_suspect",
    "torque_suspect",
    "temperature_suspect",
    "heat_substituted",
    "heat_unknown",
)
"""Faults that the status line names."""


@dataclass(frozen=True, slots=True)
class CornerStatus:
    """One corner with a thermal model.

    ``nodes_k`` is the temperature [K] by node name, NaN where there is none,
    ``estimate`` what was published last.
    """

    nodes_k: Mapping[str, float]
    estimate: CornerEstimate = field(default_factory=CornerEstimate)


@dataclass(frozen=True, slots=True)
class BusStatus:
    """One bus; all counts since the start of the service.

    ``reason`` says why nothing can come in or go out, empty if all is well.
    ``refused`` counts frames and samples by reason, ``dropped`` the frames
    lost because they were not read in time, ``events`` what the link counts
    (error frames, bus-off, restarts), ``send_lost`` frames that were due and
    that the driver did not take.
    """

    channel: str
    state: LinkState
    reason: str = ""
    frames: int = 0
    refused: Mapping[str, int] = field(default_factory=dict)
    dropped: int = 0
    events: Mapping[LinkEvent, int] = field(default_factory=dict)
    sent: int = 0
    send_lost: int = 0


@dataclass(frozen=True, slots=True)
class StateFileStatus:
    """The state file; ``age_s`` is that of the last save, NaN before it."""

    saves: int = 0
    failures: int = 0
    age_s: float = nan


@dataclass(frozen=True, slots=True)
class LoopStatus:
    """The loop and the process.

    ``drain_lag_s`` is how late the last drain began, ``drain_max_s`` the
    longest one since the last status; ``cpu_s`` user and system time.
    """

    drain_lag_s: float = 0.0
    drain_max_s: float = 0.0
    cpu_s: float = 0.0
    resident_bytes: int = 0
    uptime_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ServiceStatus:
    """Everything an operator wants to know, at one moment."""

    version: str
    compiled_kernel: bool
    state: State = State.STARTING
    heat_mode: HeatMode = HeatMode.NOT_AVAILABLE
    history_known: bool = False
    faults: tuple[str, ...] = ()
    """What is wrong with the inputs or the heat: names of
    :data:`~bstm_daemon.model.heat.plausibility.FAULTS`."""
    unverified: Input = NO_INPUT
    """Inputs that no mapped role can check."""
    disagreements: tuple[str, ...] = ()
    """What the model disagrees with: ``heat``, or corner and thermocouple."""
    force_difference: float = nan
    """Braking work by pressure minus work by motion, over the larger."""
    residuals_k: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """Running mean of measured less estimated, by corner and node."""
    is_publishing: bool = False
    risk: CarRisk | None = None
    """None where no risk is computed."""
    forecast_members: int = 0
    """Members of its ensemble."""
    corners: Mapping[str, CornerStatus] = field(default_factory=dict)
    """By name (FL, FR, RL, RR)."""
    buses: Mapping[str, BusStatus] = field(default_factory=dict)
    """By name of the ``[[bus]]``."""
    late_samples: int = 0
    dropped_samples: int = 0
    clock_jumps: int = 0
    """Jumps in the time of the inputs, as the estimator saw them."""
    clock_steps: int = 0
    """Steps of the wall clock against the monotonic one."""
    state_file: StateFileStatus = StateFileStatus()
    loop: LoopStatus = LoopStatus()


def status_line(status: ServiceStatus) -> str:
    """Return *status* in one line, for ``STATUS=`` of ``sd_notify``."""
    parts = [status.state.name.lower()]
    parts += [bus.reason for bus in status.buses.values() if bus.reason]
    parts += [WORDS[name] for name in status.faults if name in _IN_LINE]
    if status.unverified:
        parts.append(f"unverified: {', '.join(status.unverified.words)}")
    if status.disagreements:
        parts.append(f"model disagrees: {', '.join(status.disagreements)}")
    most = "" if status.history_known else "at most "
    parts += _hottest(status.corners, most)
    if status.risk is not None and isfinite(status.risk.probability):
        percent = 100.0 * status.risk.probability
        parts.append(f"vapour {most}{percent:.1f} %")
        if not status.compiled_kernel:
            parts.append(f"{status.forecast_members} members")
    if not status.history_known:
        parts.append("history unknown")
    frames = sum(bus.frames for bus in status.buses.values())
    parts.append(f"{frames} frames")
    lost = sum(bus.dropped for bus in status.buses.values())
    if lost:
        parts.append(f"{lost} lost")
    return ", ".join(parts)


def _hottest(corners: Mapping[str, CornerStatus], most: str) -> list[str]:
    parts = []
    for node, label in (("disc", "disc"), ("fluid", "fluid")):
        hottest = max(
            (
                (corner.nodes_k[node], name)
                for name, corner in corners.items()
                if isfinite(corner.nodes_k.get(node, nan))
            ),
            default=None,
        )
        if hottest is not None:
            kelvin, name = hottest
            parts.append(f"{label} {name} {to_celsius(kelvin):.0f} degC")
    if corners:
        parts.append(_risk(list(corners.values()), most))
    return parts


def _risk(corners: Sequence[CornerStatus], most: str) -> str:
    estimates = [corner.estimate for corner in corners]
    known = [c.level for c in estimates if c.level is not RiskLevel.UNKNOWN]
    # one unknown corner does not hide a raised level of another, but neither
    # do three normal ones answer for it
    worst = max(known, default=RiskLevel.UNKNOWN)
    if worst is RiskLevel.NORMAL and len(known) < len(corners):
        worst = RiskLevel.UNKNOWN
    margins = [c.margin_k for c in estimates if isfinite(c.margin_k)]
    margin = f", margin {min(margins):.0f} K" if margins else ""
    if worst is RiskLevel.UNKNOWN:
        most = ""
    return f"risk {most}{worst.name.lower()}{margin}"
