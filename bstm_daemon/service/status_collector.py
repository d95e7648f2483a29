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
    StateFileStatus,
)

if TYPE_CHECKING:
    from bstm_daemon.bus.live.link import Link
    from bstm_daemon.engine import Engine
    from bstm_daemon.service.assembly import Monitor
    from bstm_daemon.service.clock import SteadyAxis
    from bstm_daemon.service.intake import Intake
    from bstm_daemon.service.sender import Sender


class StatusCollector:
    """Collects the status of the service from one configuration's parts."""

    def __init__(
        self,
        monitor: Monitor,
        intake: Intake,
        sender: Sender,
        axis: SteadyAxis,
        start_us: int,
    ) -> None:
        """Collect from these; the service began at *start_us* of *axis*."""
        self._monitor, self._intake, self._sender = monitor, intake, sender
        self._axis = axis
        self._start_us = start_us

    def status(
        self,
        flags: int,
        state_file: StateFileStatus,
        lag_us: int,
        longest_us: int,
        now_us: int,
    ) -> ServiceStatus:
        """Return the status at *now_us*.

        Args:
            flags: bits of what was published since the last status.
            state_file: how saving goes.
            lag_us: how late the last cycle began [us].
            longest_us: the longest cycle since the last status [us].
            now_us: the time [us].
        """
        engine = self._monitor.engine
        estimate = engine.estimate
        counts = engine.estimator.counts
        usage = resource.getrusage(resource.RUSAGE_SELF)
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
            is_publishing=self._sender.is_sending,
            risk=None if estimate is None else estimate.risk,
            forecast_members=0 if engine.risk is None else engine.risk.members,
            corners={
                name: _corner(engine, name)
                for name in engine.estimator.programs
            },
            buses={
                bus.name: self._bus(number, link)
                for number, (bus, link) in enumerate(
                    zip(
                        self._monitor.config.bus,
                        self._intake.links,
                        strict=True,
                    )
                )
            },
            late_samples=counts["late"],
            dropped_samples=counts["dropped"],
            clock_jumps=counts["jumps"],
            clock_steps=self._axis.steps,
            state_file=state_file,
            loop=LoopStatus(
                drain_lag_s=lag_us * 1e-6,
                drain_max_s=longest_us * 1e-6,
                cpu_s=usage.ru_utime + usage.ru_stime,
                resident_bytes=_resident_bytes(),
                uptime_s=(now_us - self._start_us) * 1e-6,
            ),
        )

    def _bus(self, number: int, link: Link) -> BusStatus:
        engine = self._monitor.engine
        is_ours = number == self._monitor.publish_bus
        # the decoder does not know which bus a refused frame was on
        refused = (
            {str(r): count for r, count in engine.decoder.counts.items()}
            if number == 0
            else {}
        )
        return BusStatus(
            channel=link.channel,
            state=link.state,
            reason=link.reason,
            frames=self._intake.frames[number],
            refused=refused,
            dropped=link.dropped,
            events=dict(link.counts),
            sent=self._sender.sent if is_ours else 0,
            send_lost=self._sender.lost if is_ours else 0,
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
    corner = engine.estimate.corners[name]
    return CornerStatus(
        nodes_k,
        corner.margin_k,
        corner.level,
        corner.validity,
        corner.reasons,
        corner.risk,
        corner.sure_level,
    )


def _resident_bytes() -> int:
    """Return the memory in use now; 0 where unknown."""
    try:
        fields = Path("/proc/self/statm").read_text(encoding="ascii").split()
        return int(fields[1]) * resource.getpagesize()
    except (OSError, ValueError, IndexError):
        return 0
