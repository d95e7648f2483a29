"""Frames in, frames out: the whole monitor without a bus, clock or file.

:meth:`Engine.frame` takes a frame with the time it carries,
:meth:`Engine.tick` says how late it is now and returns what is due. The live
service, replay and tests are thin shells around these two.
"""

from __future__ import annotations

from array import array
from math import nan
from typing import TYPE_CHECKING, Final, NamedTuple

from bstm_daemon.bus.decoder import Decoder
from bstm_daemon.bus.output_layout import HeatMode, State, Validity
from bstm_daemon.bus.publication import (
    CornerSnapshot,
    OutputFrame,
    Publication,
    Snapshot,
    StatusSnapshot,
)
from bstm_daemon.bus.refusal import Refusal
from bstm_daemon.estimator import STEP_US, Estimator
from bstm_daemon.heat.sample_pass import TICK
from bstm_daemon.heat.sample_plan import FLAGS, VEHICLE_CHANNELS
from bstm_daemon.risk.boiling import wet_boiling_point_k
from bstm_daemon.roles import CORNERS, ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Collection

    from bstm_daemon.bus.signal_map import SignalMap
    from bstm_daemon.config import Config
    from bstm_daemon.estimator import Block

REJECTED: Final = (
    Refusal.ERROR_FRAME,
    Refusal.REMOTE_FRAME,
    Refusal.WRONG_LENGTH,
)
"""Frames of a wanted id that were refused whole."""

_SILENT: Final = FLAGS["speed_missing"]

_USED: Final = {
    "ff": ("speed", "pressure", "ambient"),
    "fb": ("speed", "pressure", "acceleration", "torque", "ambient"),
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
    ) -> None:
        """Build the engine of *config*.

        Args:
            config: the vehicle.
            signal_map: its extraction plan.
            history_known: whether the brakes are known to be at ambient
                temperature before the first frame.

        Raises:
            ConfigError: the model can not be built as configured.
        """
        roles = signal_map.roles()
        timeouts = signal_map.timeouts_us
        self.decoder = Decoder(signal_map)
        self.estimator = Estimator(
            config,
            {role: timeouts[role] for role in roles},
            history_known=history_known,
        )
        self.publication = Publication(
            [corner.name for corner in config.corner],
            config.publish.id_base,
            modelled=[corner.name for corner in config.disc_corners()],
        )
        self._boiling_k = wet_boiling_point_k(config.fluid.grade)
        self._heat_mode = HeatMode[config.heat.mode.upper()]
        self.blocks: list[Block] = []
        """The estimates of the last tick, for whoever tabulates them."""
        self._times = array("q")
        self._roles = array("i")
        self._values = array("d")
        self._line_us: int | None = None
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
        for role, value in self.decoder.decode(
            bus,
            can_id,
            extended,
            data,
            is_error=is_error,
            is_remote=is_remote,
        ):
            self._times.append(stamp_us)
            self._roles.append(role)
            self._values.append(value)

    def tick(self, time_us: int) -> list[Published]:
        """March to *time_us* [us] and return what became due, oldest first.

        The time must be on the axis that the frames' stamps are on. Frames
        stamped later than *time_us* are kept as they are: they move time.
        """
        self._pass_grid_line(time_us)
        blocks = self.estimator.advance(self._times, self._roles, self._values)
        self.blocks = blocks
        self._times = array("q")
        self._roles = array("i")
        self._values = array("d")
        return [
            Published(block.times_us[i], frame)
            for block in blocks
            for i in range(len(block.times_us))
            for frame in self.publication.encode(self._snapshot(block, i))
        ]

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

    def _snapshot(self, block: Block, i: int) -> Snapshot:
        corners = {
            name: self._corner(block, i, name, place)
            for name, place in self._places.items()
        }
        return Snapshot(block.times_us[i], corners, self._status(block, i))

    def _corner(
        self, block: Block, i: int, name: str, place: tuple[int, int]
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
        known = self.estimator.history_known
        worst = max((v[i] for v in block.validity.values()), default=nan)
        if flags & _SILENT:
            state = State.NO_INPUT
        else:
            state = State.RUNNING if worst == 0 else State.DEGRADED
        return StatusSnapshot(
            state=state,
            heat_mode=self._heat_mode,
            history_known=known,
            compiled_kernel=self.estimator.compiled,
            oldest_input_age_s=vehicle["input_age_s"],
            rejected_frames=sum(self.decoder.counts[r] for r in REJECTED),
            dropped_frames=self.estimator.counts["dropped"],
            clock_jump=bool(flags & FLAGS["clock_jump"]),
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
