"""The live service: one loop that drains, estimates, sends, saves, reports.

Everything happens on the steady axis of :mod:`~bstm_daemon.service.clock`.
A cycle reads the clock, then the buses; hands the engine the frames up to a
guard time before the reading, in order; ticks; sends what became due. The
same frames in a log give the same output.
"""

import gc
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from bstm_daemon import __version__
from bstm_daemon.bus.live.frame_records import FrameRecords
from bstm_daemon.bus.live.link import Frame, Link
from bstm_daemon.errors import BstmError, ConfigError
from bstm_daemon.estimator.state import RESUMABLE_US
from bstm_daemon.feed.server import FeedServer
from bstm_daemon.service import assembly, events, wake
from bstm_daemon.service.clock import SteadyAxis
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.intake import GUARD_US, Arrivals, Intake
from bstm_daemon.service.notify import Notifier
from bstm_daemon.service.persistence import Persistence, state_file
from bstm_daemon.service.reporting import ServiceReporter
from bstm_daemon.service.sender import Sender
from bstm_daemon.service.wake import SignalWaiter

REPORT_US: Final = 1_000_000
"""Interval of the reports: faults, validity, status line."""


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the command line beside the configuration."""

    config: Path
    state: Path | None = None
    override: assembly.BusOverride = field(
        default_factory=assembly.BusOverride
    )
    metrics_port: int | None = None
    forecast: bool = True
    """Whether to compute risk and forecast."""
    until_us: int | None = None
    """Stop after this time [us]; for tests and measurements."""


class Service:
    """One monitored car."""

    def __init__(
        self, options: Options, notifier: Notifier, log: ServiceLog
    ) -> None:
        """Read the configuration and take the state file.

        Raises:
            ConfigError: the configuration can not be used.
            FileAccessError: it can not be read.
            StateLockedError: another instance holds the state.
        """
        self._options = options
        self._notifier = notifier
        self._log = log
        self._monitor = assembly.build_monitor(
            options.config, options.override, forecast=options.forecast
        )
        self._build: assembly.MonitorBuild | None = None
        """The configuration of a reload under way."""
        self._reload_asked = False
        self._axis = SteadyAxis()
        with assembly.refusing(options.config):
            links = self._monitor.links()
        config = self._monitor.config
        file = state_file(config, options.config.parent, options.state)
        self._persistence = Persistence(file, self._axis, log)
        self._intake = Intake(links, self._axis)
        self._sender = self._new_sender()
        self._reporter = ServiceReporter(
            log, self._axis, file.parent, options.metrics_port
        )
        self._feed = FeedServer(self._note_feed)
        self._dropped = 0
        """Frames lost on links that a reload has replaced."""
        self._start_us = self._last_us = self._axis.read()
        self._steps_seen = self._axis.steps
        self._next_poll_us = self._next_report_us = 0
        self._next_watchdog_us = 0
        self._drain_us = round(config.daemon.drain_s * 1e6)

    def run(self, waiter: SignalWaiter) -> None:
        """Run until a signal ends the service, then save the state."""
        self._begin()
        deadline_us = self._start_us
        while True:
            signals = waiter.wait((deadline_us - self._axis.now_us) * 1e-6)
            if signals & wake.STOP or self._is_over():
                break
            self._reload_asked |= wake.RELOAD in signals
            self._reload()
            if wake.KEEP in signals:
                self._reporter.keep("request", self._last_us)
            deadline_us = self._cycle(deadline_us)
        self._end("signal" if signals else "time")

    def _is_over(self) -> bool:
        until_us = self._options.until_us
        return (
            until_us is not None and self._last_us - self._start_us > until_us
        )

    def _begin(self) -> None:
        monitor = self._monitor
        self._log.emit(
            events.STARTED,
            version=__version__,
            config=str(monitor.path),
            kernel="compiled"
            if monitor.engine.estimator.compiled
            else "reference",
        )
        for link in self._intake.links:
            link.open()
        self._persistence.resume(monitor.engine, self._axis.read())
        self._reporter.begin(monitor, self._intake, self._sender)
        self._feed.begin(monitor.config, monitor.path.parent)
        self._notifier.ready()
        _freeze_heap()

    def _cycle(self, deadline_us: int) -> int:
        """Do everything that is due; return when the next cycle is."""
        begin_us = self._axis.read()
        if self._axis.steps != self._steps_seen:
            self._steps_seen = self._axis.steps
            step_s = self._axis.last_step_us * 1e-6
            self._log.emit(events.CLOCK_STEPPED, step_s=step_s)
        until_us, arrivals = self._intake.read(begin_us)
        engine = self._monitor.engine
        self._ingest(arrivals)
        if until_us - self._last_us > RESUMABLE_US:
            self._note_sleep(until_us)
        self._last_us = max(until_us, self._last_us)
        engine.dropped_frames = self._dropped + sum(
            link.dropped for link in self._intake.links
        )
        published = engine.tick(until_us)
        self._sender.publish(published)
        if published:
            self._feed.publish(engine.estimate, begin_us)
        self._reporter.note_flags()
        self._persistence.poll(engine, begin_us)
        self._poll_and_report(begin_us)
        return self._finish(begin_us, deadline_us)

    def _ingest(self, arrivals: Arrivals) -> None:
        """Pass all frames to the engine; plain ones without examining each."""
        index, count = 0, len(arrivals)
        if isinstance(arrivals, FrameRecords) and self._is_plain(arrivals):
            frames = self._monitor.engine.frames
            while (index := frames(arrivals, index)) < count:
                self._ingest_one(*arrivals[index])
                index += 1
        while index < count:
            self._ingest_one(*arrivals[index])
            index += 1

    def _is_plain(self, arrivals: FrameRecords) -> bool:
        """Whether only the engine needs the frames."""
        if not arrivals or self._reporter.is_recording:
            return False
        last_us, _, _ = arrivals[len(arrivals) - 1]
        return last_us - self._last_us <= RESUMABLE_US

    def _ingest_one(self, time_us: int, bus: int, frame: Frame) -> None:
        if time_us - self._last_us > RESUMABLE_US:
            self._note_sleep(time_us)
        if self._sender.is_own(frame.can_id, extended=frame.extended) and (
            bus == self._monitor.publish_bus
            and not (frame.is_error or frame.is_remote)
        ):
            self._note_foreign(bus, frame.can_id)
            return
        self._reporter.record(time_us, bus, frame)
        self._monitor.engine.frame(
            bus,
            frame.can_id,
            frame.extended,
            frame.data,
            time_us,
            is_error=frame.is_error,
            is_remote=frame.is_remote,
        )
        self._last_us = time_us

    def _poll_and_report(self, now_us: int) -> None:
        """Poll links and report, at their intervals."""
        if now_us >= self._next_poll_us:
            reopen_s = self._monitor.config.daemon.reopen_s
            self._next_poll_us = now_us + round(reopen_s * 1e6)
            for link in self._intake.links:
                self._poll(link)
        if now_us >= self._next_report_us:
            self._next_report_us = now_us + REPORT_US
            self._reporter.report(self._persistence.status(now_us), now_us)
            self._notifier.status(self._reporter.line)

    def _poll(self, link: Link) -> None:
        """Poll *link*; an error is logged, for it could be opened before."""
        try:
            link.poll()
        except ConfigError as error:
            channel = link.channel
            fields = {"bus": "", "channel": channel, "error": str(error)}
            now_us = self._last_us
            self._log.repeat(events.BUS_MISSING, channel, now_us, **fields)

    def _finish(self, begin_us: int, deadline_us: int) -> int:
        """Feed the watchdog after a full cycle; return the next deadline.

        Deadlines follow multiples of the drain interval by the guard time,
        so that a grid line is published without waiting for a later frame.
        A missed deadline is due at once: of two publications due together,
        only the later would be sent.
        """
        end_us = self._axis.read()
        self._reporter.note_cycle(begin_us - deadline_us, end_us - begin_us)
        interval_s = self._notifier.watchdog_interval_s
        if interval_s is not None and end_us >= self._next_watchdog_us:
            self._next_watchdog_us = end_us + round(interval_s * 1e6 / 2)
            self._notifier.watchdog()
        line = (begin_us - GUARD_US) // self._drain_us + 1
        return line * self._drain_us + GUARD_US

    def _note_feed(self, error: str) -> None:
        self._log.repeat(
            events.FEED_FAILED, "feed", self._last_us, error=error
        )

    def _note_foreign(self, bus: int, can_id: int) -> None:
        if self._sender.note_foreign(can_id):
            self._log.emit(
                events.FOREIGN_FRAME,
                bus=self._monitor.config.bus[bus].name,
                can_id=f"0x{can_id:X}",
            )

    def _note_sleep(self, until_us: int) -> None:
        """Park the brakes for the time the computer slept, up to *until_us*.

        Marching hours on the grid would delay the frames.
        """
        asleep_us = until_us - self._last_us
        self._log.emit(events.SLEPT, asleep_s=asleep_us * 1e-6)
        engine = self._monitor.engine
        # process the earlier frames; their publications are outdated
        self._sender.leave_out(engine.tick(self._last_us))
        engine.park(asleep_us)
        self._last_us = until_us

    def _reload(self) -> None:
        """Build the configuration file as it is now, if asked, and apply it.

        Whatever fails, the old one goes on.
        """
        if self._build is None and not self._reload_asked:
            return
        try:
            with assembly.refusing(self._options.config):
                fresh = self._built()
                if fresh is None:
                    return
                links = self._prepared(fresh)
        except BstmError as error:
            self._build = None
            self._log.emit(
                events.CONFIG_REFUSED,
                config=str(self._options.config),
                problems=getattr(error, "problems", None) or [str(error)],
            )
            return
        self._build = None
        self._apply(fresh, links)

    def _built(self) -> assembly.Monitor | None:
        """Return the new monitor once it is built; begin to, if asked."""
        now_us = self._axis.now_us
        if self._build is not None:
            return self._build.outcome(now_us)
        self._reload_asked = False
        options = self._options
        self._build = assembly.MonitorBuild(
            lambda: assembly.build_monitor(
                options.config, options.override, forecast=options.forecast
            ),
            now_us,
        )
        return None

    def _prepared(self, fresh: assembly.Monitor) -> list[Link] | None:
        """Let *fresh* take over the brakes; return its links, opened, if new.

        Nothing of the running service changes.
        """
        links = self._links_for(fresh)
        try:
            self._hand_over(fresh)
            for link in links or ():
                link.open()
        except BaseException:
            for link in links or ():
                link.close()
            raise
        return links

    def _apply(
        self, fresh: assembly.Monitor, links: list[Link] | None
    ) -> None:
        """Go on with *fresh*, on *links* where there are new ones."""
        self._persistence.reloaded(self._monitor.engine, fresh.engine)
        self._monitor = fresh
        self._drain_us = round(fresh.config.daemon.drain_s * 1e6)
        if links is not None:
            self._dropped += sum(link.dropped for link in self._intake.links)
            self._intake.replace(links)
        self._sender = self._new_sender()
        self._reporter.begin(fresh, self._intake, self._sender)
        self._feed.begin(fresh.config, fresh.path.parent)
        _freeze_heap()
        self._log.emit(events.CONFIG_RELOADED, config=str(fresh.path))

    def _links_for(self, fresh: assembly.Monitor) -> list[Link] | None:
        """Return new links where the buses changed; None where they stay."""
        old = self._monitor
        same = fresh.config.bus == old.config.bus and all(
            fresh.wanted(bus) == old.wanted(bus)
            for bus in range(len(old.config.bus))
        )
        same = same and fresh.config.daemon == old.config.daemon
        return None if same else fresh.links()

    def _hand_over(self, fresh: assembly.Monitor) -> None:
        """Copy the running engine's memory to that of *fresh*."""
        if fresh.config.vehicle.id != self._monitor.config.vehicle.id:
            problem = (
                "[vehicle] id: another vehicle needs a restart, its brakes "
                "have a history of their own"
            )
            raise ConfigError([problem])
        document = self._monitor.engine.export_state()
        time_us = document["time_us"]
        if time_us is not None:
            fresh.engine.resume(document, 0, time_us)

    def _new_sender(self) -> Sender:
        bus = self._monitor.publish_bus
        link = None if bus is None else self._intake.links[bus]
        monitor = self._monitor
        return Sender(link, monitor.own_ids, monitor.engine.publication)

    def _end(self, reason: str) -> None:
        """Send the last frames, save, close."""
        self._notifier.stopping()
        self._log.emit(events.STOPPING, reason=reason)
        engine = self._monitor.engine
        # before the save: their counters are part of the state
        self._sender.send(engine.stop_frames())
        self._persistence.close(engine)
        self._intake.close()
        self._feed.close()
        self._reporter.close()


def _freeze_heap() -> None:
    """Exclude all objects so far from later garbage collections.

    A collection over a whole vehicle takes some 25 ms, a quarter of a
    publication; for the same reason none runs here, with frames waiting.
    """
    gc.freeze()
