"""The state of the running service in numbers.

The loop fills one :class:`ServiceStatus` every few seconds; the metrics and
the line that ``systemctl status`` shows are written from it.
"""

import resource
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite, nan
from pathlib import Path
from typing import Final

from bstm_daemon import __version__
from bstm_daemon.bus.live.link import LinkEvent, LinkState
from bstm_daemon.engine import Engine
from bstm_daemon.estimate import (
    NO_INPUT,
    CarRisk,
    CornerEstimate,
    HeatMode,
    Input,
    RiskLevel,
    State,
)
from bstm_daemon.model.heat.plausibility import WORDS, fault_names
from bstm_daemon.service.assembly import Monitor
from bstm_daemon.service.intake import Intake
from bstm_daemon.service.sender import Sender
from bstm_daemon.units import to_celsius

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


def collected(
    monitor: Monitor, intake: Intake, sender: Sender, flags: int
) -> ServiceStatus:
    """Return the status of these parts, *flags* since the last one.

    That of clock, state file and loop is not theirs.
    """
    engine = monitor.engine
    estimate = engine.estimate
    counts = engine.estimator.counts
    published = estimate.status if estimate is not None else None
    return ServiceStatus(
        version=__version__,
        compiled_kernel=engine.estimator.compiled,
        state=State.STARTING if published is None else published.state,
        heat_mode=engine.heat_mode,
        history_known=published is not None and published.history_known,
        faults=fault_names(flags),
        unverified=engine.unverified,
        disagreements=engine.estimator.model_check.disagreements,
        force_difference=engine.estimator.model_check.force_difference,
        residuals_k={
            (one.corner, one.node): one.mean_k
            for one in engine.estimator.model_check.couples
        },
        is_publishing=sender.is_sending,
        risk=None if estimate is None else estimate.risk,
        forecast_members=0 if engine.risk is None else engine.risk.members,
        corners={
            name: _corner(engine, name) for name in engine.estimator.programs
        },
        buses={
            bus.name: _bus(monitor, intake, sender, number)
            for number, bus in enumerate(monitor.config.bus)
        },
        late_samples=counts["late"],
        dropped_samples=counts["dropped"],
        clock_jumps=counts["jumps"],
    )


def loop_status(lag_us: int, longest_us: int, uptime_us: int) -> LoopStatus:
    """Return the status of the loop and of this process.

    Args:
        lag_us: how late the last cycle began [us].
        longest_us: the longest cycle since the last status [us].
        uptime_us: time since the start [us].
    """
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return LoopStatus(
        drain_lag_s=lag_us * 1e-6,
        drain_max_s=longest_us * 1e-6,
        cpu_s=usage.ru_utime + usage.ru_stime,
        resident_bytes=_resident_bytes(),
        uptime_s=uptime_us * 1e-6,
    )


def _bus(
    monitor: Monitor, intake: Intake, sender: Sender, number: int
) -> BusStatus:
    link = intake.links[number]
    is_ours = number == monitor.publish_bus
    # the decoder does not know which bus a refused frame was on
    counts = monitor.engine.decoder.counts if number == 0 else {}
    return BusStatus(
        channel=link.channel,
        state=link.state,
        reason=link.reason,
        frames=intake.frames[number],
        refused={str(reason): count for reason, count in counts.items()},
        dropped=link.dropped,
        events=dict(link.counts),
        sent=sender.sent if is_ours else 0,
        send_lost=sender.lost if is_ours else 0,
    )


def _corner(engine: Engine, name: str) -> CornerStatus:
    program = engine.estimator.programs[name]
    state = engine.estimator.state(name)
    nodes_k = {
        node.name: state[node.name]
        for node in program.network.nodes
        if node.boundary_input is None
    }
    if engine.estimate is None:
        return CornerStatus(nodes_k)
    return CornerStatus(nodes_k, engine.estimate.corners[name])


def _resident_bytes() -> int:
    """Return the memory in use now; 0 where unknown."""
    try:
        fields = Path("/proc/self/statm").read_text(encoding="ascii").split()
        return int(fields[1]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        return 0


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
