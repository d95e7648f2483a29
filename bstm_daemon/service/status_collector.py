"""Collects the status of the service from all its parts."""

from __future__ import annotations

import resource
from pathlib import Path
from typing import TYPE_CHECKING

from bstm_daemon import __version__
from bstm_daemon.estimate import State
from bstm_daemon.model.heat.plausibility import fault_names
from bstm_daemon.service.status import (
    BusStatus,
    CornerStatus,
    LoopStatus,
    ServiceStatus,
)

if TYPE_CHECKING:
    from bstm_daemon.engine import Engine
    from bstm_daemon.service.assembly import Monitor
    from bstm_daemon.service.intake import Intake
    from bstm_daemon.service.sender import Sender


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
