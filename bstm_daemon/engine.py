"""Frames in, frames out: the whole monitor without a bus, clock or file.

:meth:`Engine.frame` takes a frame with the time it carries,
:meth:`Engine.tick` takes the time now and returns what is due. The live
service, replay and tests are thin shells around these two.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from bstm_daemon.advice.advisor import Advisor
from bstm_daemon.bus.live.frame_records import FrameRecords, RecordDecoder
from bstm_daemon.bus.output.publication import OutputFrame, Publication
from bstm_daemon.bus.signals.decoder import Decoder
from bstm_daemon.bus.signals.e2e_guard import E2eGuard
from bstm_daemon.estimate import (
    Advice,
    CarRisk,
    CornerEstimate,
    Estimate,
    HeatMode,
    State,
    Status,
    Validity,
)
from bstm_daemon.estimator.corner_estimates import corner_estimates
from bstm_daemon.estimator.estimator import STEP_US, Estimator
from bstm_daemon.estimator.memory import Int64, Saved, checked
from bstm_daemon.estimator.state import (
    Restored,
    correct_parked,
    export_state,
    park,
    resume_state,
)
from bstm_daemon.estimator.verified import (
    stale_flags_of_car,
    unverified_of_car,
)
from bstm_daemon.forecast.monitor import RiskMonitor
from bstm_daemon.model.heat.plausibility import SUBSTITUTED, SUSPECT
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.model.risk.boiling import wet_boiling_point_k

if TYPE_CHECKING:
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimator.blocks import Block, Instant
    from bstm_daemon.model.wear.car import CarWear

_STRAY_US: Final = 1_000_000
"""A rejected frame stamped further ahead than this is counted at once."""

FOREVER_US: Final = 2**63


class SavedCounters(Saved):
    """The counters of the frames in a saved state."""

    counters: dict[str, Int64]


class Published(NamedTuple):
    """A frame and the grid time it belongs to [us]."""

    time_us: int
    frame: OutputFrame


class Following:
    """Risk and advice that follow from the estimates of one car.

    The engine and a replay along columns share it.
    """

    def __init__(
        self,
        config: Config,
        estimator: Estimator,
        present: Mapping[int, int],
        *,
        forecast: bool = True,
    ) -> None:
        """Begin parked.

        Args:
            config: the vehicle.
            estimator: its estimator.
            present: role number to time-out [us] of each mapped role.
            forecast: whether risk and forecast are made.
        """
        self.risk = RiskMonitor(config, estimator) if forecast else None
        self.advisor = Advisor(config, present)
        self._boiling_k = wet_boiling_point_k(config.fluid.grade)

    def advise(
        self, instant: Instant, risk: CarRisk | None, wear: CarWear | None
    ) -> tuple[dict[str, CornerEstimate], Advice]:
        """Return corners and advice; to be called for every publication.

        Args:
            instant: the publication.
            risk: the car's then; None without a forecast.
            wear: that of the pads, if the corners are to have it.
        """
        corners = corner_estimates(instant, self._boiling_k, risk, wear)
        return corners, self.advisor.update(instant, corners)

    def export(self) -> dict[str, Any]:
        """Return the memory as plain values, for the state file."""
        advice = {"advice": self.advisor.export()}
        if self.risk is None:
            return advice
        return advice | {"risk": self.risk.export()}

    def resume(
        self,
        document: Mapping[str, Any],
        parked_us: int | None,
        now_us: int,
        *,
        same_drive: bool,
    ) -> None:
        """Continue from *document*, a state that the estimator has restored.

        Args:
            document: the state.
            parked_us: time since the save [us], None where not known.
            now_us: time now on the axis of the stamps [us].
            same_drive: whether the drive goes on, and the advice with it.
        """
        if same_drive:
            self.advisor = self.advisor.resumed(document.get("advice"))
        if self.risk is not None:
            self.risk.resume(document, parked_us, now_us)


class Engine:
    """One car: decoder, estimator and publication."""

    def __init__(
        self,
        config: Config,
        signal_map: SignalMap,
        *,
        history_known: bool = False,
        initial_k: float | None = None,
        forecast: bool = True,
    ) -> None:
        """Build the engine of *config*.

        Args:
            config: the vehicle.
            signal_map: its extraction plan.
            history_known: whether the brakes are known to be at *initial_k*
                before the first frame.
            initial_k: temperature [K] at the start; default: the configured
                ambient.
            forecast: whether risk and forecast are made; without them the
                level is that of the margin.

        Raises:
            ConfigError: the model can not be built as configured.
        """
        roles = signal_map.roles()
        timeouts = signal_map.timeouts_us
        self.decoder = Decoder(signal_map)
        self._guard = E2eGuard(signal_map)
        present = {role: timeouts[role] for role in roles}
        self.estimator = Estimator(
            config, present, history_known=history_known, initial_k=initial_k
        )
        self._following = Following(
            config, self.estimator, present, forecast=forecast
        )
        self.risk = self._following.risk
        self.publication = Publication(
            [corner.name for corner in config.corner],
            config.publish.id_base,
            requests=config.publish.requests,
        )
        self._record_decoder = RecordDecoder(
            signal_map, self._following.advisor.roles.names
        )
        self.config = config
        self.heat_mode = HeatMode[config.heat.mode.upper()]
        self.estimate: Estimate | None = None
        """What was published last."""
        self.blocks: list[Block] = []
        """The estimates of the last tick, for tables."""
        self.risks: list[list[CarRisk]] | None = None
        """The risk at each publication of these; None without a forecast."""
        self._times = array("q")
        self._roles = array("i")
        self._values = array("d")
        self._line_us: int | None = None
        self._rejected = 0
        self._rejected_at: list[int] = []
        self.dropped_frames = 0
        """Frames lost before they came here, as the shell counts them."""
        self._stale = stale_flags_of_car(config, roles)
        self.unverified = unverified_of_car(config, roles)
        """Inputs that no mapped role can check."""

    def frame(  # noqa: PLR0913
        self,
        bus: int,
        can_id: int,
        extended: bool,  # noqa: FBT001  (the third part of a frame's key)
        data: bytes | bytearray | memoryview,
        stamp_us: int,
        *,
        is_error: bool = False,
        is_remote: bool = False,
    ) -> None:
        """Take one frame of bus number *bus*, stamped *stamp_us* [us]."""
        decoder = self.decoder
        if not (is_error or is_remote):
            reject_reason = self._guard.refusal(bus, can_id, extended, data)
            if reject_reason is not None:
                decoder.counts[reject_reason] += 1
                self._rejected_at.append(stamp_us)
                return
        before = decoder.rejected
        times, roles, values = self._times, self._roles, self._values
        driver = self._following.advisor.roles
        for role, value in decoder.decode(
            bus, can_id, extended, data, is_error=is_error, is_remote=is_remote
        ):
            times.append(stamp_us)
            roles.append(role)
            values.append(value)
            if role in driver.names:
                driver.note(stamp_us, role, value)
        if decoder.rejected != before:
            self._rejected_at.append(stamp_us)

    def frames(self, records: FrameRecords, first: int) -> int:
        """Take the ready frames from *first* on that are plain, all at once.

        Returns:
            The first one that was not taken: give it to :meth:`frame`.
        """
        decoder = self._record_decoder
        counts = self.decoder.counts
        held = self._following.advisor.roles.waiting
        while True:
            position = decoder.decode(records, first, counts, held)
            if position == first:
                return position
            count = decoder.count
            self._times += decoder.times_us[:count]
            self._roles += decoder.roles[:count]
            self._values += decoder.values[:count]
            if position == records.ready:
                return position
            first = position

    def tick(self, time_us: int) -> list[Published]:
        """March to *time_us* [us] and return what became due, oldest first.

        The time must be on the axis that the frames' stamps are on. Frames
        stamped later than *time_us* are kept as they are: they move time.
        """
        published: list[Published] = []
        blocks: list[Block] = []
        risks: list[list[CarRisk]] = []
        for part in self.parts_of_tick(time_us):
            published += part
            blocks += self.blocks
            risks += self.risks or []
        self.blocks = blocks
        self.risks = None if self.risk is None else risks
        return published

    def parts_of_tick(self, time_us: int) -> Iterator[list[Published]]:
        """Tick as :meth:`tick`, a minute of the drive at a time.

        What became due over a gap of hours is hundreds of megabytes.

        Yields:
            What became due, in parts; ``blocks`` and ``risks`` are those of
            the part. All must be taken before the next frame.
        """
        self._pass_grid_line(time_us)
        samples = self._times, self._roles, self._values
        self._times = array("q")
        self._roles = array("i")
        self._values = array("d")
        self.blocks, self.risks = [], None
        if self.risk is not None:
            self.risks = []
            self.risk.ingest(*samples)
        for block in self.estimator.blocks(*samples):
            self.blocks = [block]
            if self.risk is not None:
                self.risks = [self.risk.add(block)]
            yield [
                Published(time_us, frame)
                for i, time_us in enumerate(block.times_us)
                for frame in self.publication.encode(self._advance(block, i))
            ]
        # what is stamped far ahead has no publication of its own
        self._count_rejected(time_us, time_us + _STRAY_US)

    def stop_frames(self) -> list[OutputFrame]:
        """Return the last frames of a service that stops: not available."""
        unknown = Estimate(
            0,
            {name: CornerEstimate() for name in self.estimator.programs},
            Status(
                State.STOPPING,
                self.heat_mode,
                compiled_kernel=self.estimator.compiled,
            ),
        )
        return self.publication.encode_all(unknown)

    def temperatures_k(self) -> list[float]:
        """Return the temperature [K] of every node of every corner."""
        found = []
        for name, program in self.estimator.programs.items():
            state = self.estimator.state(name)
            found += [state[node.name] for node in program.network.nodes]
        return found

    def export_state(self) -> dict[str, Any]:
        """Return the memory as plain values, for the state file."""
        return {
            "counters": self.publication.counters,
            "model_check": self.estimator.model_check.export(),
            **export_state(self.estimator),
            **self._following.export(),
        }

    def resume(
        self,
        document: Mapping[str, Any],
        parked_us: int | None,
        now_us: int,
        *,
        proven: bool = True,
    ) -> Restored:
        """Take over *document* before the first frame and tick.

        Args:
            document: what :meth:`export_state` gave.
            parked_us: time since then [us]; None if no clock knows it,
                then the brakes are as hot as they were.
            now_us: time now on the axis of the stamps [us].
            proven: whether the time since then was no longer.

        Raises:
            StateError: it is no state of this car; nothing was taken.
        """
        counters = checked(SavedCounters, document).counters
        restored = resume_state(
            self.estimator, document, parked_us, now_us, proven=proven
        )
        self.publication.continue_from(counters)
        self.estimator.model_check.resume(
            document,
            None if restored.resumed else max(parked_us or 0, 0) * 1e-6,
        )
        self._following.resume(
            document, parked_us, now_us, same_drive=restored.resumed
        )
        return restored

    def correct_parked(
        self, document: Mapping[str, Any], parked_us: int
    ) -> None:
        """Correct the parked time given to :meth:`resume`, once known.

        Needs :func:`~bstm_daemon.estimator.state.keep_input_history` since.
        The next publication has its clock-jump flag set.
        """
        correct_parked(self.estimator, document, parked_us * 1e-6)
        if self.risk is not None:
            now_us = self.estimator.samples.times[0]
            self.risk.look_back(document, parked_us, now_us)

    def park(self, parked_us: int) -> None:
        """Let the brakes stand for *parked_us*: the computer slept.

        The inputs begin anew.
        """
        park(self.estimator, parked_us * 1e-6)
        self.estimator.model_check.park(parked_us * 1e-6)

    def _pass_grid_line(self, time_us: int) -> None:
        """Let time pass up to the last grid line before *time_us*.

        Steps end on the grid only, so a tick between two lines has nothing
        to add, and how often one ticks changes no number. Neither has one
        whose line the frames have passed already.
        """
        line_us = time_us // STEP_US * STEP_US
        if line_us == self._line_us:
            return
        self._line_us = line_us
        if self._times and 0 <= self._times[-1] - line_us < STEP_US:
            return
        self._times.append(line_us)
        self._roles.append(TICK)
        self._values.append(0.0)

    def _count_rejected(self, time_us: int, horizon_us: int) -> None:
        """Count what was rejected up to *time_us*, or beyond *horizon_us*.

        A publication counts up to its own time, however far the frames read
        with it reach.
        """
        if not self._rejected_at:
            return
        later = [t for t in self._rejected_at if time_us < t <= horizon_us]
        self._rejected += len(self._rejected_at) - len(later)
        self._rejected_at = later

    def _advance(self, block: Block, i: int) -> Estimate:
        """Move on to publication *i* of *block* and return its estimate."""
        instant = block.at(i)
        self._count_rejected(instant.time_us, FOREVER_US)
        risk = None if self.risks is None else self.risks[0][i]
        corners, advice = self._following.advise(
            instant, risk, self.estimator.wear
        )
        self.estimate = Estimate(
            instant.time_us, corners, self._status(instant), advice, risk
        )
        return self.estimate

    def _status(self, instant: Instant) -> Status:
        flags = instant.flags
        worst = max(
            map(instant.validity, self.estimator.programs), default=None
        )
        if instant.is_silent:
            state = State.NO_INPUT
        else:
            is_well = worst is Validity.VALID
            state = State.RUNNING if is_well else State.DEGRADED
        return Status(
            state=state,
            heat_mode=self.heat_mode,
            history_known=instant.history_known,
            compiled_kernel=self.estimator.compiled,
            oldest_input_age_s=instant.vehicle("input_age_s"),
            rejected_frames=self._rejected,
            dropped_frames=self.dropped_frames,
            clock_jump=instant.clock_jumped,
            input_suspect=bool(flags & SUSPECT),
            heat_substituted=bool(flags & SUBSTITUTED),
            model_disagrees=instant.model_disagrees,
            unverified=self.unverified,
            **{
                f"{name}_stale": bool(flags & bit)
                for name, bit in self._stale.items()
            },
        )
