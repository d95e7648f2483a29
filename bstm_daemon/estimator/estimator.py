"""The estimator: samples to estimates, for live, replay and matching.

:meth:`Estimator.advance` is called with one row live and with whole columns
in replay; chunking never changes the numbers, because the pass over samples
and the march of the network are sequential and keep all their memory in
this object.
"""

from __future__ import annotations

from array import array
from functools import partial
from itertools import groupby
from math import isfinite
from typing import TYPE_CHECKING, Any, Final

from bstm_daemon.channels import CHANNELS, FLAGS, VEHICLE_CHANNELS
from bstm_daemon.estimator.blocks import (
    Block,
    BlockLayout,
    Group,
    channels_at_rest,
)
from bstm_daemon.estimator.corner_model import (
    compile_corner,
    compiled_model,
    corner_model,
)
from bstm_daemon.estimator.coupling import Coupling
from bstm_daemon.estimator.model_check import ModelCheck
from bstm_daemon.estimator.start import StartBound
from bstm_daemon.estimator.trust import Trust
from bstm_daemon.estimator.unseen import DROVE_MS, Unseen
from bstm_daemon.estimator.validity import (
    HIGHEST_K,
    LOWEST_K,
    judge,
    needs_of_corners,
)
from bstm_daemon.model.effects.catalogue import edited_inputs
from bstm_daemon.model.effects.model import corrected, corrections_by_role
from bstm_daemon.model.heat.memory import NEVER, SampleState
from bstm_daemon.model.heat.sample_pass import (
    BACK,
    JUMP,
    LOST,
    SETTLE,
    SETTLED_US,
)
from bstm_daemon.model.heat.sample_plan import plan_samples
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.settling import settling_time_s
from bstm_daemon.model.wear.car import REFIT_US, CarWear, exchange, keep_totals
from bstm_daemon.model.wear.dose import DISTANCE, DOSE
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import TypeAlias

    import numpy.typing as npt

    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimator.coupling import Outputs
    from bstm_daemon.estimator.input_history import InputHistory
    from bstm_daemon.model.heat.friction_law import FrictionLaw
    from bstm_daemon.model.thermal.program import Program

    Ints: TypeAlias = Sequence[int] | npt.NDArray[Any]
    Floats: TypeAlias = Sequence[float] | npt.NDArray[Any]

STEP_US: Final = 50_000
"""Step of the grid, in the frames' own time."""

PUBLISH_US: Final = 100_000
"""Period of publication."""

MINUTE_US: Final = 60_000_000

WARMEST_AIR_K: Final = 323.15
"""No air is warmer: brakes that are were not parked."""

ROWS: Final = 4096
"""Steps marched at a time; it limits memory and does not change results."""


class Estimator:
    """Brake temperatures of one car."""

    def __init__(
        self,
        config: Config,
        present: Mapping[int, int],
        *,
        history_known: bool = False,
        initial_k: float | None = None,
        judged: bool = True,
    ) -> None:
        """Build the model of *config*.

        Args:
            config: the vehicle.
            present: role number to timeout [us] of each mapped role.
            history_known: whether the brakes are known to have been at
                *initial_k* before the first sample.
            initial_k: starting temperature [K]; default: the configured
                ambient.
            judged: whether the validity of each estimate is wanted.

        Raises:
            ConfigError: the configuration asks for a part, effect or share
                that does not exist.
            UsageError: ``BSTM_KERNEL`` asks for a kernel that is not there.
        """
        self.config = config
        self.kernel = load_kernel()
        """The compiled kernel; None: the pure-Python form runs."""
        start_k = initial_k or config.vehicle.ambient_k
        models = {
            corner.name: corner_model(config, corner)
            for corner in config.disc_corners()
        }
        self.programs: dict[str, Program] = {
            name: compiled_model(model) for name, model in models.items()
        }
        laws: dict[str, FrictionLaw] = {
            name: model.friction
            for name, model in models.items()
            if not model.friction.nominal
        }
        self.settling_s = self._settling_time_s()
        """How long the slowest brake remembers heat [s]."""
        inputs = edited_inputs(config)
        self._corrections = corrections_by_role(inputs.corrections)
        self.plan = plan_samples(
            inputs.config,
            present,
            STEP_US,
            self.settling_s,
            laws,
            inputs.unpressed_share,
        )
        self.samples = SampleState.new()
        if history_known and initial_k and initial_k < WARMEST_AIR_K:
            self.samples.know_air(initial_k)
        self.batches = self._batches(start_k)
        self.layout = BlockLayout(
            tuple(self.plan.corners),
            tuple(
                Group(
                    tuple(names),
                    batch.programs[0].state_names,
                    len(batch.programs[0].network.nodes),
                    batch.width + batch.sources,
                )
                for batch, names in self.batches
            ),
        )
        self.start = StartBound(self.batches, config, self.kernel)
        if not history_known:
            self.start.begin(self.programs)
        self._needs = needs_of_corners(config, present)
        self.trust = Trust(
            self.layout.corners,
            self.settling_s,
            compares=config.heat.mode == "fused",
            has_switch=ROLE_INDEX["brake_switch"] in present,
        )
        self.unproven = Trust(
            self.layout.corners,
            self.settling_s,
            compares=False,
            has_switch=False,
        )
        self._judged = judged
        self.model_check = ModelCheck(
            config, self.layout, present, self.settling_s
        )
        self.unseen = Unseen(
            self.plan.numbers.force_share[: len(self.plan.corners)],
            config.vehicle.mass_kg,
            MINUTE_US // PUBLISH_US,
        )
        self._coupling = Coupling(
            self.plan,
            self.kernel,
            ROWS,
            (PUBLISH_US, REFIT_US),
            coupled=bool(laws),
        )
        self.wear = CarWear(config, present)
        self.open_flags = 0
        self.input_history: InputHistory | None = None
        """Callback for the rows of every step, or None."""
        self.resets = 0
        """Count of corners reset since the start."""

    @property
    def compiled(self) -> bool:
        """Whether the compiled kernel runs."""
        return self.kernel is not None

    @property
    def history_known(self) -> bool:
        """Whether the start of no corner has an effect any more."""
        return not self.start.unknown

    @property
    def counts(self) -> dict[str, int]:
        """Samples that came late, were dropped as outliers; clock jumps."""
        return dict(
            zip(
                ("late", "dropped", "jumps"),
                self.samples.times[3:6],
                strict=True,
            )
        )

    @property
    def groups(self) -> tuple[Group, ...]:
        """The groups of :attr:`Block.outputs`, in its order."""
        return self.layout.groups

    def state(self, corner: str) -> dict[str, float]:
        """Nodes [K] and memories of *corner* now, by name.

        Raises:
            KeyError: *corner* has no thermal model.
        """
        found = {name: (batch, i) for batch, i, name in self.members()}
        batch, member = found[corner]
        return batch.named_state(member)

    def members(self) -> Iterator[tuple[Batch, int, str]]:
        """Give batch, place in it and name of each corner with a model."""
        for batch, names in self.batches:
            for member, name in enumerate(names):
                yield batch, member, name

    def advance(
        self, times_us: Ints, roles: Ints, values: Floats
    ) -> list[Block]:
        """Consume samples and march to the last one's time.

        Args:
            times_us: stamps [us], a buffer of int64 [n].
            roles: role numbers, a buffer of int32 [n]; TICK moves time only.
            values: SI values, a buffer of float64 [n].

        Returns:
            One block per contiguous run of rows that holds a publication.
        """
        return list(self.blocks(times_us, roles, values))

    def blocks(
        self, times_us: Ints, roles: Ints, values: Floats
    ) -> Iterator[Block]:
        """As :meth:`advance`, a block at a time: a gap of hours is many.

        Yields:
            The blocks of :meth:`advance`; all must be consumed before the
            next samples.
        """
        index, count = 0, len(times_us)
        if self._corrections:
            values = corrected(self._corrections, roles, values)
        self.wear.note(times_us, roles, values)
        if self.kernel is None:
            times_us, roles = _plain(times_us), _plain(roles)
            values = _plain(values)
        while index < count:
            # the bounds have no names: no friction law goes by them
            batches = [*self.batches, *((b, ()) for b in self.start.batches)]
            index, steps, code, outputs = self._coupling.fill(
                self.samples, batches, times_us, roles, values, index
            )
            if steps:
                block = self._block(steps, outputs)
                if block is not None and len(block.times_us):
                    yield block
                # after it was taken: within a block the networks are one
                if self._coupling.times[steps - 1] % REFIT_US == 0:
                    self._fit_to_wear(steps - 1)
            self._follow(code)

    def _follow(self, code: int) -> None:
        """Do what the pass ended for with *code*."""
        if code == LOST:
            self.begin_unseen(*self.last_seen())
        elif code == SETTLE:
            self._settle()
        elif code == JUMP and self.unseen.is_open:
            self.unseen.move(self.samples.times[0], proven=False)
        elif code == BACK:
            self._end_unseen()

    def _batches(self, start_k: float) -> list[tuple[Batch, list[str]]]:
        """Group the corners by structure; each group is one batch."""
        order = list(self.plan.corners)
        by_structure = sorted(
            self.programs, key=lambda name: self.programs[name].ints.tobytes()
        )
        groups = []
        for _, members in groupby(
            by_structure, lambda name: self.programs[name].ints.tobytes()
        ):
            names: list[str] = sorted(members, key=order.index)
            batch = Batch(
                [self.programs[name] for name in names],
                start_k,
                [order.index(name) for name in names],
                self.kernel,
                len(order),
            )
            groups.append((batch, names))
        return groups

    def _block(self, steps: int, outputs: Outputs) -> Block | None:
        """Return the publications of *steps* marched rows, if wanted."""
        every = PUBLISH_US // STEP_US
        coupling = self._coupling
        phase = coupling.phase()
        row = len(self.plan.corners) * len(CHANNELS)
        if self.input_history is not None:
            self.input_history.add(
                memoryview(coupling.rows)[: steps * row], steps
            )
        wide = len(VEHICLE_CHANNELS)
        times = coupling.times[phase - 1 : steps : every]
        rows, vehicle = array("d"), array("d")
        for step in range(phase - 1, steps, every):
            rows.extend(coupling.rows[step * row : (step + 1) * row])
            vehicle.extend(coupling.vehicle[step * wide : (step + 1) * wide])
        flags = self._published_flags(steps, phase, every)
        groups = len(self.batches)
        outputs, bounds = outputs[:groups], outputs[groups:]
        known_from = self.start.known_from(
            self.layout, outputs, bounds, len(times)
        )
        block = Block(
            *(self.layout, times, rows, vehicle, outputs, flags),
            validity={},
            reasons={},
            disagrees=array("b"),
            known_from=known_from,
            bounds=bounds,
            wear={},
        )
        block.wear.update(self.wear.laws(times, partial(_totals, block)))
        self.unseen.add(block)
        if self._judged:
            checks = self.trust, self.unproven, self.model_check
            judge(block, self._needs, checks, PUBLISH_US * 1e-6)
        self._reset_impossible()
        return block

    def _reset_impossible(self) -> None:
        """Reset corners in an impossible state, with their start unknown.

        A node that is NaN would stay so for ever.
        """
        for batch, member, name in self.members():
            program = batch.programs[member]
            state = batch.state[batch.part(member)]
            nodes = state[: len(program.network.nodes)]
            if isfinite(sum(nodes)) and max(nodes) < HIGHEST_K:
                continue
            air_k = self.config.vehicle.ambient_k
            fresh = program.initial_state(air_k)
            keep_totals(fresh, program.state_names, state)
            batch.state[batch.part(member)] = fresh
            self.start.begin([name])
            self.resets += 1

    def _fit_to_wear(self, row: int) -> None:
        """Rebuild the networks of linings and discs that became thinner.

        *row* is the last step; new linings are as warm as its air.
        """
        first = row * len(self.plan.corners) * len(CHANNELS)
        air_k = self._coupling.rows[first + CHANNELS.index("ambient_k")]
        for batch, member, name in self.members():
            refit = self.wear.refit(name, self.state(name)[DOSE])
            if refit is not None:
                program = compile_corner(self.config, refit.corner)
                self.programs[name] = program
                self.start.exchange(name, program, refit.change, air_k)
                self.wear.worn_heat_j[name] += exchange(
                    batch, member, program, refit.change, air_k
                )

    def _published_flags(
        self, steps: int, phase: int, every: int
    ) -> array[int]:
        """Return per publication the bits of all steps since the last one."""
        wide = len(VEHICLE_CHANNELS)
        flags = array("q")
        for step, bits in enumerate(
            self._coupling.vehicle[wide - 1 : steps * wide : wide]
        ):
            self.open_flags |= int(bits)
            if (step + 1 - phase) % every == 0:
                flags.append(self.open_flags)
                self.open_flags = 0
        return flags

    def _settling_time_s(self) -> float:
        """Return how long a hot start affects the slowest brake [s]."""
        air_k = self.config.vehicle.ambient_k
        row = array("d", channels_at_rest(air_k).values())
        return settling_time_s(self.programs.values(), row, air_k, self.kernel)

    def air_k(self) -> float:
        """Return the last known temperature of the air [K]."""
        known = self.samples.last_air_k
        if known is not None and LOWEST_K < known < HIGHEST_K:
            return known
        return self.config.vehicle.ambient_k

    def last_seen(self) -> tuple[int, float]:
        """Return the time of the last sample [us] and the speed then."""
        since_us = self.samples.last_sample_us
        if since_us == NEVER:
            since_us = self.samples.times[0]
        return since_us, self.samples.last_speed_ms

    def begin_unseen(self, since_us: int, before_ms: float) -> None:
        """Begin a hole in the data, unless one lasts.

        Args:
            since_us: time of the last sample [us].
            before_ms: the last known speed [m/s].
        """
        nodes_k = {
            name: list(batch.state[batch.part(member)])[
                : len(batch.programs[member].network.nodes)
            ]
            for batch, member, name in self.members()
        }
        self.unseen.begin(nodes_k, since_us, before_ms)
        self.samples.await_speed()

    def _end_unseen(self) -> None:
        """End the hole: the first speed after it is known."""
        hole = self.unseen.end(
            self.samples.times[0],
            self.samples.speed_after_ms,
            self.batches,
            self.air_k(),
        )
        drove = max(hole.before_ms, hole.after_ms) > DROVE_MS
        if hole.driven or (hole.marched and drove):
            self.trust.count(hole.seconds)
            if not hole.driven and hole.after_ms <= DROVE_MS:
                # what it did since is forgotten as in a parked car
                self.park_doubts(hole.seconds)
        if hole.driven:
            self._coupling.heat_interfaces(self.samples, self.batches)
            self.start.begin(self.start.unknown)
            self.open_flags |= FLAGS["driven_unseen"]

    def park_doubts(self, seconds: float) -> None:
        """Let what was found against the heat have stood for *seconds*."""
        self.trust.park(seconds)
        self.unproven.park(seconds)

    def _settle(self) -> None:
        air_k = self.air_k()
        for batch, member, _ in self.members():
            batch.settle(air_k, member)
        self._coupling.heat_interfaces(self.samples, self.batches)
        self.start.end()
        self.park_doubts(SETTLED_US * 1e-6)
        self.model_check.park(SETTLED_US * 1e-6)


def _totals(block: Block, corner: str, i: int) -> tuple[float, float]:
    """Dose [J] and distance [m] of *corner* at publication *i*."""
    state = block.at(i).state(corner)
    return state[DOSE], state[DISTANCE]


def _plain(column: Any) -> Any:
    """Numbers of their own: reading an array one by one makes each anew."""
    return column.tolist() if hasattr(column, "tolist") else column
