"""Reports of the service: log events, status line, record.

Once a second it compares the status with the one before and logs what has
changed. Nothing here influences the estimate.
"""

from collections import Counter
from dataclasses import replace
from functools import reduce
from math import isfinite
from operator import or_
from pathlib import Path
from typing import Final

from bstm_daemon.bus.live.link import Frame, Link, LinkEvent, LinkState
from bstm_daemon.bus.signals.reject_reason import RejectReason
from bstm_daemon.estimate import Reason, RiskLevel, Validity
from bstm_daemon.model.heat.plausibility import CONTRADICTIONS, reasons
from bstm_daemon.service import events
from bstm_daemon.service.assembly import Monitor
from bstm_daemon.service.clock import SteadyAxis
from bstm_daemon.service.events import Event, ServiceLog
from bstm_daemon.service.intake import Intake
from bstm_daemon.service.metrics_output import MetricsOutput
from bstm_daemon.service.recorder import Recorder
from bstm_daemon.service.sender import Sender
from bstm_daemon.service.status import (
    ServiceStatus,
    StateFileStatus,
    collected,
    loop_status,
    status_line,
)

KEPT_LEVELS: Final = (RiskLevel.HIGH, RiskLevel.CRITICAL)

_LINK_EVENTS: Final[dict[LinkState, Event]] = {
    LinkState.UP: events.BUS_UP,
    LinkState.DOWN: events.BUS_DOWN,
}


class ServiceReporter:
    """Reports on one running service."""

    def __init__(
        self,
        log: ServiceLog,
        axis: SteadyAxis,
        state_folder: Path,
        metrics_port: int | None,
    ) -> None:
        """Log to *log*; records go below *state_folder* by default."""
        self._log = log
        self._axis = axis
        self._state_folder = state_folder
        self._metrics = MetricsOutput(log, metrics_port)
        self._start_us = axis.read()
        self._recorder: Recorder | None = None
        self._record_failures = 0
        self._links: dict[str, tuple[LinkState, Counter[LinkEvent], int]] = {}
        self._refused: Counter[str] = Counter()
        self._faults: set[str] = set()
        self._disagreements: set[str] = set()
        self._validity: dict[str, tuple[Validity, Reason]] = {}
        self._levels: dict[str, RiskLevel] = {}
        self._flags = self._reported_flags = 0
        self._resets = self._send_lost = 0
        self._lag_us = self._longest_us = 0
        self.line = "starting"
        """The status in one line."""

    def begin(self, monitor: Monitor, intake: Intake, sender: Sender) -> None:
        """Report on *monitor* from now on."""
        self._monitor, self._intake, self._sender = monitor, intake, sender
        self._close_recorder()
        config = monitor.config
        if config.record.enabled:
            folder = self._state_folder / "record"
            if config.record.folder is not None:
                folder = monitor.path.parent / config.record.folder
            channels = [bus.channel for bus in config.bus]
            try:
                self._recorder = Recorder(config.record, folder, channels)
            except RuntimeError as error:  # there can be no more threads
                self._log.emit(events.RECORD_FAILED, error=str(error))
        self._metrics.begin(config.metrics, monitor.path.parent)
        unverified = monitor.engine.unverified
        if unverified:
            inputs = ", ".join(unverified.words)
            self._log.emit(events.INPUTS_UNVERIFIED, inputs=inputs)
        self._links = {}
        self._refused = Counter()
        self._resets = self._send_lost = 0
        if sender.is_sending and monitor.publish_bus is not None:
            self._log.emit(
                events.PUBLISHING_STARTED,
                bus=config.bus[monitor.publish_bus].name,
                id_base=f"0x{config.publish.id_base:X}",
            )

    @property
    def is_recording(self) -> bool:
        """Whether :meth:`record` needs every frame."""
        return self._recorder is not None

    def record(self, time_us: int, bus: int, frame: Frame) -> None:
        """Add a frame to the record."""
        if self._recorder is not None:
            self._recorder.frame(bus, frame, time_us)

    def keep(self, reason: str, time_us: int) -> None:
        """Keep the part of the record around *time_us*."""
        if self._recorder is not None:
            self._recorder.keep(reason, time_us)
            self._log.repeat(
                events.RECORD_KEPT, reason, time_us, reason=reason
            )

    def note_flags(self) -> None:
        """Remember the flags of what was published in this cycle."""
        for block in self._monitor.engine.blocks:
            self._flags = reduce(or_, block.flags, self._flags)

    def note_cycle(self, lag_us: int, duration_us: int) -> None:
        """Remember how late a cycle began and how long it took."""
        self._lag_us = max(lag_us, 0)
        self._longest_us = max(self._longest_us, duration_us)

    def report(self, state_file: StateFileStatus, now_us: int) -> None:
        """Log what changed; update status line and metrics."""
        status = replace(
            collected(self._monitor, self._intake, self._sender, self._flags),
            clock_steps=self._axis.steps,
            state_file=state_file,
            loop=loop_status(
                *(self._lag_us, self._longest_us, now_us - self._start_us)
            ),
        )
        self._report_links(now_us)
        self._report_inputs(now_us)
        self._report_model(status, now_us)
        self._report_corners(status, now_us)
        self._report_losses(now_us)
        if self._longest_us > events.LATE_US:
            lag_s = self._longest_us * 1e-6
            self._log.repeat(events.LOOP_LATE, "loop", now_us, lag_s=lag_s)
        self._longest_us = 0
        self.line = status_line(status)
        if not self._sender.is_sending and self._sender.foreign_id >= 0:
            self.line += (
                ", NOT PUBLISHING: another sender of "
                f"0x{self._sender.foreign_id:X}"
            )
        if self._recorder is not None:
            self._recorder.tick(now_us)
            outcome = self._recorder.outcome()
            if outcome.failures > self._record_failures:
                self._record_failures = outcome.failures
                error = outcome.last_error or ""
                self._log.repeat(
                    events.RECORD_FAILED, "record", now_us, error=error
                )
        self._metrics.update(status, now_us)

    def close(self) -> None:
        """End record and metrics."""
        self._close_recorder()
        self._metrics.close()

    def _report_links(self, now_us: int) -> None:
        for bus, link in zip(
            self._monitor.config.bus, self._intake.links, strict=True
        ):
            state, counts, dropped = self._links.get(
                bus.name, (None, Counter[LinkEvent](), 0)
            )
            place = {"bus": bus.name, "channel": link.channel}
            if link.state is not state:
                self._report_link(bus.name, link, place)
            for kind, event in (
                (LinkEvent.BUS_OFF, events.BUS_OFF),
                (LinkEvent.RESTARTED, events.BUS_RESTARTED),
            ):
                if link.counts[kind] > counts[kind]:
                    self._log.repeat(event, bus.name, now_us, **place)
            if link.dropped > dropped:
                lost = {"bus": bus.name, "count": link.dropped - dropped}
                self._log.repeat(
                    events.FRAMES_DROPPED, bus.name, now_us, **lost
                )
            self._links[bus.name] = (
                link.state,
                Counter(link.counts),
                link.dropped,
            )

    def _report_link(
        self, bus: str, link: Link, place: dict[str, str]
    ) -> None:
        event = _LINK_EVENTS.get(link.state)
        if event is None:
            self._log.emit(events.BUS_MISSING, **place, error=link.reason)
            return
        self._log.emit(event, **place)
        if link.receive_buffer_bytes is not None:
            self._log.emit(
                events.RECEIVE_BUFFER,
                bus=bus,
                asked_bytes=self._monitor.config.daemon.receive_buffer_bytes,
                given_bytes=link.receive_buffer_bytes,
            )

    def _report_inputs(self, now_us: int) -> None:
        """Log input faults that came and went; keep disagreement."""
        names = [corner.name for corner in self._monitor.config.corner]
        faults = set(reasons(self._flags, names))
        both = events.INPUT_FAULT, events.INPUT_FAULT_OVER
        self._report_changes("fault", self._faults, faults, both)
        self._faults = faults
        if self._flags & ~self._reported_flags & CONTRADICTIONS:
            self.keep("disagreement", now_us)
        self._reported_flags, self._flags = self._flags, 0

    def _report_changes(
        self,
        field: str,
        old: set[str],
        now: set[str],
        both: tuple[Event, Event],
    ) -> None:
        """Log what has come since *old*, and what has gone."""
        for event, names in zip(both, (now - old, old - now), strict=True):
            for name in sorted(names):
                self._log.emit(event, **{field: name})

    def _report_model(self, status: ServiceStatus, now_us: int) -> None:
        """Log where the model began or ceased to disagree; keep the record."""
        now = set(status.disagreements)
        both = events.MODEL_DISAGREES, events.MODEL_AGREES
        self._report_changes("what", self._disagreements, now, both)
        if now - self._disagreements:
            self.keep("model", now_us)
        self._disagreements = now

    def _report_corners(self, status: ServiceStatus, now_us: int) -> None:
        for name, corner in status.corners.items():
            estimate = corner.estimate
            validity = estimate.validity, estimate.reasons
            if self._validity.get(name) != validity:
                self._validity[name] = validity
                self._log.emit(
                    events.VALIDITY_CHANGED,
                    corner=name,
                    validity=estimate.validity.name.lower(),
                    reasons=", ".join(estimate.reasons.words),
                )
            before = self._levels.get(name, RiskLevel.UNKNOWN)
            risk = estimate.sure_level
            if risk is before:
                continue
            self._levels[name] = risk
            known = RiskLevel.UNKNOWN not in {before, risk}
            rose = risk in {RiskLevel.ELEVATED, *KEPT_LEVELS}
            if known:
                rose = risk > before
            self._log.emit(
                events.RISK_ROSE if rose else events.RISK_FELL,
                corner=name,
                level=risk.name.lower(),
                # JSON has no NaN
                margin_k=round(estimate.margin_k, 1)
                if isfinite(estimate.margin_k)
                else None,
            )
            if rose and risk in KEPT_LEVELS:
                self.keep("risk", now_us)

    def _report_losses(self, now_us: int) -> None:
        engine = self._monitor.engine
        refused = Counter(
            {str(r): count for r, count in engine.decoder.counts.items()}
        )
        news = refused - self._refused
        # without a filter in the kernel every other frame is one of these
        news.pop(str(RejectReason.UNKNOWN_ID), None)
        for reason, count in news.items():
            found = {"reason": reason, "count": count}
            self._log.repeat(events.FRAMES_REFUSED, reason, now_us, **found)
        self._refused = refused
        if self._sender.lost > self._send_lost:
            bus = self._monitor.config.bus[self._monitor.publish_bus or 0]
            error = f"{self._sender.lost - self._send_lost} frames lost"
            failed = {"bus": bus.name, "error": error}
            self._log.repeat(events.SEND_FAILED, "send", now_us, **failed)
            self._send_lost = self._sender.lost
        if engine.estimator.resets > self._resets:
            self._resets = engine.estimator.resets
            self._log.emit(events.ESTIMATE_RESET, count=self._resets)

    def _close_recorder(self) -> None:
        if self._recorder is not None:
            self._recorder.close()
            self._recorder = None
        self._record_failures = 0
