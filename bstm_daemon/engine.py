"""Frames in, frames out: the whole monitor without a bus, clock or file.

:meth:`Engine.frame` takes a frame with the time it carries,
:meth:`Engine.tick` says how late it is now and returns what is due. The live
service, replay and tests are thin shells around these two.
"""

from __future__ import annotations

from array import array
from contextlib import suppress
from math import nan
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.advice.advisor import Advisor
from bstm_daemon.advice.conditions import HeldRoles
from bstm_daemon.bus.decoder import Decoder
from bstm_daemon.bus.e2e_guard import E2eGuard
from bstm_daemon.bus.output_layout import (
    HeatMode,
    State,
    Validity,
)
from bstm_daemon.bus.publication import (
    CornerSnapshot,
    OutputFrame,
    Publication,
    Snapshot,
    StatusSnapshot,
)
from bstm_daemon.bus.record_decoder import RecordDecoder
from bstm_daemon.carry_over import (
    StateError,
    correct_parked,
    export_state,
    park,
    resume_state,
)
from bstm_daemon.driver_side import conditions_of, wear_of
from bstm_daemon.estimator import STEP_US, Estimator
from bstm_daemon.forecast.monitor import RiskMonitor
from bstm_daemon.forecast.resuming import resume_risk
from bstm_daemon.forecast.snapshots import car_snapshot, corner_snapshot
from bstm_daemon.heat.plausibility import SUBSTITUTED, SUSPECT
from bstm_daemon.heat.sample_pass import TICK
from bstm_daemon.heat.sample_plan import FLAGS, VEHICLE_CHANNELS
from bstm_daemon.model_check import ModelCheck
from bstm_daemon.risk.boiling import wet_boiling_point_k
from bstm_daemon.roles import CORNERS, ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping
    from typing import Any

    from bstm_daemon.bus.frame_records import FrameRecords
    from bstm_daemon.bus.signal_map import SignalMap
    from bstm_daemon.carry_over import Restored
    from bstm_daemon.config import Config
    from bstm_daemon.estimator import Block
    from bstm_daemon.forecast.records import CarRisk

_STRAY_US: Final = 1_000_000
"""A rejected frame stamped further ahead than this is counted at once."""

FOREVER_US: Final = 2**63

_USED: Final = {
    "ff": ("speed", "pressure", "ambient"),
    "fb": ("speed", "pressure", "acceleration", "torque", "ambient"),
    "fused": ("speed", "pressure", "acceleration", "torque", "ambient"),
    "measured": ("speed", "ambient"),
}
"""Inputs by heat mode: only these are reported stale."""

_ROLES: Final = {
    "pressure": (
        "primary_pressure",
        "secondary_pressure",
        *(f"wheel_pressure_{name.lower()}" for name in CORNERS),
    ),
    "acceleration": ("acceleration_longitudinal",),
    "torque": ("powertrain_torque",),
    "ambient": ("ambient_temperature",),
}
"""Inputs that may be left out: one that nothing is mapped to is not stale."""


class Published(NamedTuple):
    """A frame and the grid time it belongs to [us]."""

    time_us: int
    frame: OutputFrame


class Engine:
    """One car: decoder, estimator and publication."""

    def __init__(
        self,
        config: Config,
        signal_map: SignalMap,
        *,
        history_known: bool = False,
        forecast: bool = True,
    ) -> None:
        """Build the engine of *config*.

        Args:
            config: the vehicle.
            signal_map: its extraction plan.
            history_known: whether the brakes are known to be at ambient
                temperature before the first frame.
            forecast: whether to tell risk and forecast; without them the
                level is that of the margin.

        Raises:
            ConfigError: the model can not be built as configured.
        """
        roles = signal_map.roles()
        timeouts = signal_map.timeouts_us
        self.decoder = Decoder(signal_map)
        self._guard = E2eGuard(signal_map)
        self.estimator = Estimator(
            config,
            {role: timeouts[role] for role in roles},
            history_known=history_known,
        )
        self.risk = RiskMonitor(config, self.estimator) if forecast else None
        self.publication = Publication(
            [corner.name for corner in config.corner],
            config.publish.id_base,
            modelled=[corner.name for corner in config.disc_corners()],
            requests=config.publish.requests,
        )
        self.model_check = ModelCheck(config, self.estimator, roles)
        self._advisor = Advisor(config)
        self._held = HeldRoles(
            {role: timeouts[role] for role in roles}, ROLE_INDEX
        )
        self._record_decoder = RecordDecoder(signal_map, self._held.names)
        self.config = config
        self._boiling_k = wet_boiling_point_k(config.fluid.grade)
        self.heat_mode = HeatMode[config.heat.mode.upper()]
        self.snapshot: Snapshot | None = None
        """What was published last."""
        self.blocks: list[Block] = []
        """The estimates of the last tick, for whoever tabulates them."""
        self.risks: list[list[CarRisk]] | None = None
        """The risk at each publication of these, if it is told."""
        self._times = array("q")
        self._roles = array("i")
        self._values = array("d")
        self._line_us: int | None = None
        self._rejected = 0
        self._rejected_at: list[int] = []
        self.dropped_frames = 0
        """Frames lost before they came here, told by the shell."""
        self._stale = _stale_flags(config.heat.mode, roles)
        self._places = {
            name: (number, member)
            for number, group in enumerate(self.estimator.groups)
            for member, name in enumerate(group.corners)
        }

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
            refusal = self._guard.refusal(bus, can_id, extended, data)
            if refusal is not None:
                decoder.counts[refusal] += 1
                self._rejected_at.append(stamp_us)
                return
        before = decoder.rejected
        times, roles, values = self._times, self._roles, self._values
        held = self._held.numbers
        for role, value in decoder.decode(
            bus,
            can_id,
            extended,
            data,
            is_error=is_error,
            is_remote=is_remote,
        ):
            times.append(stamp_us)
            roles.append(role)
            values.append(value)
            if role in held:
                self._held.note(stamp_us, role, value)
        if decoder.rejected != before:
            self._rejected_at.append(stamp_us)

    def frames(self, records: FrameRecords, first: int) -> int:
        """Take the ready frames from *first* on that are plain, all at once.

        Returns:
            The first one that was not taken: give it to :meth:`frame`.
        """
        decoder = self._record_decoder
        counts, held = self.decoder.counts, self._held.waiting
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
            self.risk.hear(*samples)
        for block in self.estimator.stretches(*samples):
            self.blocks = [block]
            if self.risk is not None:
                self.risks = [self.risk.add(block)]
            yield [
                Published(block.times_us[i], frame)
                for i in range(len(block.times_us))
                for frame in self.publication.encode(
                    self._snapshot(block, i, 0)
                )
            ]
        # what is stamped far ahead has no publication of its own
        self._count_rejected(time_us, time_us + _STRAY_US)

    def farewell(self) -> list[OutputFrame]:
        """Return the last frames of a service that stops: not available."""
        return self.publication.stopping(
            self.heat_mode, compiled=self.estimator.compiled
        )

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
            "advice": {
                "machines": self._advisor.export(),
                "roles": self._held.export(),
            },
            "model_check": self.model_check.export(),
            **export_state(self.estimator),
            **({} if self.risk is None else {"risk": self.risk.export()}),
        }

    def resume(
        self, document: Mapping[str, Any], parked_us: int | None, now_us: int
    ) -> Restored:
        """Take over *document* before the first frame and tick.

        Args:
            document: what :meth:`export_state` gave.
            parked_us: time since then [us]; None where no clock can tell,
                then the brakes are as hot as they were.
            now_us: time now on the axis of the stamps [us].

        Raises:
            StateError: it is no state of this car; nothing was taken.
        """
        counters = document.get("counters")
        if not isinstance(counters, dict) or not all(
            isinstance(count, int) for count in counters.values()
        ):
            msg = "counters: not a table of numbers"
            raise StateError(msg)
        restored = resume_state(self.estimator, document, parked_us, now_us)
        self.publication.continue_from(counters)
        if restored.resumed and "advice" in document:
            self._resume_advice(document["advice"])
        if restored.resumed and "model_check" in document:
            # one that can not be read begins anew
            with suppress(KeyError, TypeError, ValueError, AttributeError):
                self.model_check.restore(document["model_check"])
        if self.risk is not None:
            resume_risk(self.risk, self.estimator, document, parked_us, now_us)
        return restored

    def _resume_advice(self, saved: Any) -> None:
        """Go on with the advice of a moment ago; else it begins parked."""
        advisor = Advisor(self.config)
        try:
            advisor.restore(saved["machines"])
            self._held.restore(saved["roles"])
        except (KeyError, TypeError, ValueError, AttributeError):
            return
        self._advisor = advisor

    def correct_parked(
        self, document: Mapping[str, Any], parked_us: int
    ) -> None:
        """Change the parked time that :meth:`resume` was told, once known.

        Needs :func:`~bstm_daemon.carry_over.doubt_parked_time` since. The
        next publication says so with its clock-jump flag.
        """
        correct_parked(self.estimator, document, parked_us * 1e-6)
        self.estimator.open_flags |= FLAGS["clock_jump"]

    def park(self, parked_us: int) -> None:
        """Let the brakes stand for *parked_us*: the computer slept.

        The inputs begin anew.
        """
        park(self.estimator, parked_us * 1e-6)

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

        A publication tells of its own time, however far the frames read
        with it reach.
        """
        if not self._rejected_at:
            return
        later = [t for t in self._rejected_at if time_us < t <= horizon_us]
        self._rejected += len(self._rejected_at) - len(later)
        self._rejected_at = later

    def _snapshot(self, block: Block, i: int, number: int) -> Snapshot:
        time_us = block.times_us[i]
        self._count_rejected(time_us, FOREVER_US)
        risk = None if self.risks is None else self.risks[number][i]
        corners = {
            name: self._corner(block, i, name, place, risk)
            for name, place in self._places.items()
        }
        self.model_check.take(block, i, history_known=i >= block.known_from)
        status = self._status(block, i)
        now = conditions_of(
            block,
            i,
            corners,
            self.estimator.plan.corners,
            self._held.at(block.times_us[i]),
            history_known=status.history_known,
        )
        self.snapshot = Snapshot(
            time_us,
            corners,
            status,
            self._advisor.update(now),
            None if risk is None else car_snapshot(risk),
        )
        return self.snapshot

    def _corner(
        self,
        block: Block,
        i: int,
        name: str,
        place: tuple[int, int],
        risk: CarRisk | None,
    ) -> CornerSnapshot:
        number, member = place
        group = self.estimator.groups[number]
        first = (i * len(group.corners) + member) * group.size
        output = block.outputs[number]
        state = dict(
            zip(
                group.state_names,
                output[first : first + len(group.state_names)],
                strict=True,
            )
        )
        fluid_k = state["fluid"]
        return CornerSnapshot(
            disc_k=state["disc"],
            pad_front_k=state["pad_front"],
            pad_back_k=state["pad_back"],
            fluid_k=fluid_k,
            margin_k=self._boiling_k - fluid_k,
            wet_boiling_k=self._boiling_k,
            validity=Validity(block.validity[name][i]),
            wear=wear_of(self.estimator.wear, name, block, i, state),
            risk=None
            if risk is None
            else corner_snapshot(risk, name, block.times_us[i]),
        )

    def _status(self, block: Block, i: int) -> StatusSnapshot:
        flags = block.flags[i]
        wide = len(VEHICLE_CHANNELS)
        vehicle = dict(
            zip(
                VEHICLE_CHANNELS,
                block.vehicle[i * wide : (i + 1) * wide],
                strict=True,
            )
        )
        worst = max((v[i] for v in block.validity.values()), default=nan)
        if flags & FLAGS["silent"]:
            state = State.NO_INPUT
        else:
            state = State.RUNNING if worst == 0 else State.DEGRADED
        return StatusSnapshot(
            state=state,
            heat_mode=self.heat_mode,
            history_known=i >= block.known_from,
            compiled_kernel=self.estimator.compiled,
            oldest_input_age_s=vehicle["input_age_s"],
            rejected_frames=self._rejected,
            dropped_frames=self.dropped_frames,
            clock_jump=bool(flags & FLAGS["clock_jump"]),
            input_suspect=bool(flags & SUSPECT),
            heat_substituted=bool(flags & SUBSTITUTED),
            model_disagrees=bool(self.model_check.disagreements),
            **{
                f"{name}_stale": bool(flags & bit)
                for name, bit in self._stale.items()
            },
        )


def _stale_flags(mode: str, roles: Collection[int]) -> dict[str, int]:
    """Bit of each input that counts as stale when it is missing."""
    return {
        name: FLAGS[f"{name}_missing"]
        for name in _USED[mode]
        if name not in _ROLES
        or any(ROLE_INDEX[role] in roles for role in _ROLES[name])
    }
