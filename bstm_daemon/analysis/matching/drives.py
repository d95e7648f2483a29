"""Recorded drives as the thermal model gets them: inputs and thermocouples.

Brake power, speed and air come from the estimator's own pass over the
samples, so that a matched model is the one that runs later; the grid is
coarser than the estimator's, with energies kept.
"""

from __future__ import annotations

from array import array
from collections import defaultdict
from collections.abc import (
    Callable,
    Collection,
    Iterable,
    Iterator,
    Mapping,
    Sequence,
)
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np

from bstm_daemon.analysis.matching.power_by import PowerBy
from bstm_daemon.analysis.matching.thermocouples import (
    NODE_OF,
    THERMOCOUPLES,
    Placement,
    Thermocouple,
    node_at,
    placements,
    thermocouples_of,
)
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.bus.signals.signal_map import SignalMap
from bstm_daemon.channels import CHANNELS
from bstm_daemon.config.sections import Config
from bstm_daemon.errors import LogError, UsageError
from bstm_daemon.estimator.blocks import Block
from bstm_daemon.estimator.estimator import STEP_US, Estimator
from bstm_daemon.estimator.input_history import InputHistory
from bstm_daemon.model.heat.memory import SampleState
from bstm_daemon.model.heat.needs import check_heat_inputs
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.program import Program, compile_network
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.replay.results import Collector, Results, ResultsBuilder
from bstm_daemon.roles import MEASURED_NODES, ROLE_INDEX
from bstm_daemon.units import KELVIN_OFFSET

GRID_S: Final = 0.5
"""Step of matching. Energies are exact at any step, as inputs are means."""

BEGIN_S: Final = 5.0
"""The first temperatures are means over this time; who brakes within it shifts
the start by half of what it heats."""

SETTLING_STEP_S: Final = 20.0
SETTLING_STEPS: Final = 60
"""Measured nodes are held so long for the others to follow."""

STEPS_A_ROW: Final = round(GRID_S * 1e6) // STEP_US

SEGMENT: Final = ".log.gz"
"""Ending of the files of a kept record."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """One log for matching.

    ``inputs`` (steps, corners, channels) are the rows of the estimator's
    pass, means over :data:`GRID_S`; ``corners`` names their second axis.
    ``measured`` has the thermocouples by corner and node. ``estimates`` are
    the estimator's own, where they were asked for; their ``time_s`` counts
    from ``start_s``. ``learned`` is what fused heat had learned at the end,
    ``roles`` the numbers of those that the log has a sample of. ``speed_ms``
    (steps, n) is the speed at the n estimator steps of each step, of which
    ``inputs`` has the mean; n is 0 where they were not kept. ``power_by``, by
    corner, replaces the brake power of ``inputs`` where a value of the heat is
    to be found.
    ``placed`` has the thermocouples, by corner and node, whose depth is known.
    """

    name: str
    start_s: float
    corners: tuple[str, ...]
    inputs: Column
    measured: Mapping[str, Mapping[str, Thermocouple]]
    estimates: Results | None = field(default=None, repr=False)
    learned: Sequence[float] | None = None
    roles: frozenset[int] = frozenset()
    speed_ms: Column = field(default_factory=lambda: np.zeros((0, 0)))
    power_by: Mapping[str, PowerBy] = field(default_factory=dict, repr=False)
    placed: Mapping[str, Mapping[str, Placement]] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.inputs)

    @property
    def time_s(self) -> Column:
        """End of each step since the start, (steps,)."""
        return GRID_S * np.arange(1.0, len(self.inputs) + 1.0)

    @property
    def duration_s(self) -> float:
        """Length of the drive."""
        return GRID_S * len(self.inputs)

    def channel(self, corner: str, name: str) -> Column:
        """Return the input *name* of *corner*, (steps,)."""
        column: Column = self.inputs[
            :, self.corners.index(corner), CHANNELS.index(name)
        ]
        return column

    def couples(
        self, corner: str, nodes: Collection[str]
    ) -> list[tuple[str, str]]:
        """Return thermocouples of *corner* and their nodes, of *nodes*."""
        pairs = [
            (name, NODE_OF.get(name, name))
            for name in self.measured.get(corner, {})
        ]
        return [pair for pair in pairs if pair[1] in nodes]

    def part(self, first: int, last: int) -> Drive:
        """Return the steps from *first* up to *last*, as a drive."""
        if (first, last) == (0, len(self)):
            return self
        begin_s, end_s = GRID_S * first, GRID_S * last
        measured: dict[str, dict[str, Thermocouple]] = {}
        for corner, couples in self.measured.items():
            for node, couple in couples.items():
                at = couple.time_s
                inside = (at >= begin_s) & (at <= end_s)
                if inside.any():
                    measured.setdefault(corner, {})[node] = Thermocouple(
                        at[inside] - begin_s, couple.temperature_k[inside]
                    )
        return replace(
            self,
            name=f"{self.name} from {begin_s:.0f} to {end_s:.0f} s",
            start_s=self.start_s + begin_s,
            inputs=self.inputs[first:last],
            speed_ms=self.speed_ms[first:last],
            measured=measured,
            estimates=None,
            power_by={
                corner: one.part(slice(first, last))
                for corner, one in self.power_by.items()
            },
        )

    def with_power_times(self, factor: float) -> Drive:
        """Return the drive with *factor* times its brake power."""
        inputs = self.inputs.copy()
        inputs[:, :, CHANNELS.index("brake_power_w")] *= factor
        return replace(self, inputs=inputs, estimates=None, power_by={})

    def with_extra_heat(self, heat_w: Column) -> Drive:
        """Return the drive with one more channel, (steps, corners) [W]."""
        inputs = np.concatenate((self.inputs, heat_w[:, :, None]), axis=2)
        return replace(self, inputs=inputs)


class Rows(InputHistory):
    """Takes the estimator's rows and keeps their means over the grid."""

    def __init__(self, corners: int) -> None:
        """Take how many *corners* a row has."""
        super().__init__(0, 1)
        self._shape = (corners, len(CHANNELS))
        self._rest = np.zeros((0, *self._shape))
        self.parts: list[Column] = []
        self.speeds: list[Column] = []

    def add(self, rows: memoryview, steps: int) -> None:
        """Take *steps* rows."""
        new = np.frombuffer(rows, np.float64).reshape(steps, *self._shape)
        new = np.concatenate((self._rest, new))
        whole = len(new) // STEPS_A_ROW * STEPS_A_ROW
        self._rest = new[whole:].copy()
        groups = new[:whole].reshape(-1, STEPS_A_ROW, *self._shape)
        self.parts.append(groups.mean(axis=1))
        self.speeds.append(groups[:, :, 0, CHANNELS.index("speed_ms")].copy())


def read_drive(  # noqa: PLR0913
    path: Path,
    config: Config,
    signal_map: SignalMap,
    overrides: Mapping[str, str] | None = None,
    *,
    progress: Callable[[float], None] | None = None,
    estimates: bool = False,
    learned: Sequence[float] | None = None,
) -> Drive:
    """Read the log *path* for matching or, with *estimates*, to verify.

    *learned* is what earlier drives taught of the car, for fused heat.

    Raises:
        LogError: unusable, without what its heat is formed from, or its clock
            jumps.
        FileAccessError: it cannot be read.
        UsageError: the heat mode is ``measured``.
    """
    present = present_roles(signal_map)
    estimator = Estimator(config, present)
    if learned is not None:
        estimator.samples = SampleState.new(learned)
    kept = Collector()
    builder = ResultsBuilder(estimator, [kept])
    drive = drive_of(
        path.name,
        estimator,
        log_events(path, signal_map, overrides, progress),
        builder if estimates else None,
    )
    check_heat_inputs(str(path), drive.roles, present, config.heat.mode)
    if not estimates:
        return drive
    builder.finish()
    return replace(drive, estimates=_since(kept.results(), drive.start_s))


def log_events(
    path: Path,
    signal_map: SignalMap,
    overrides: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Iterator[Events]:
    """Yield the samples of the log *path*.

    A folder is a record that the service has kept: its segments in order.

    Raises:
        LogError: unusable.
        FileAccessError: it cannot be read.
    """
    files = sorted(path.glob(f"*{SEGMENT}")) if path.is_dir() else [path]
    if not files:
        msg = f"{path}: no segment of a record (*{SEGMENT}) in this folder"
        raise LogError(msg)
    for number, file in enumerate(files):
        log = EventLog(file, signal_map, overrides)
        for events in log.events():
            yield events
            if progress is not None:
                progress((number + log.share) / len(files))


def drive_of(
    name: str,
    estimator: Estimator,
    parts: Iterable[Events],
    builder: ResultsBuilder | None = None,
) -> Drive:
    """Return the drive *name* that *estimator* forms of *parts*.

    *builder* takes its estimates.

    Raises:
        LogError: the samples span no step, or their clock jumps.
        UsageError: the heat mode is ``measured``.
    """
    if estimator.config.heat.mode == "measured":
        msg = (
            '[heat] mode = "measured" forces the disc; this needs brake '
            "power: choose another mode"
        )
        raise UsageError(msg)
    temperatures: dict[int, list[tuple[Column, Column]]] = defaultdict(list)
    seen: set[int] = set()
    first_us: int | None = None

    def take(events: Events, blocks: list[Block]) -> None:
        nonlocal first_us
        if first_us is None and len(events):
            first_us = int(events.time_us[0])
        roles = set(np.unique(events.role).tolist())
        seen.update(roles)
        for role in THERMOCOUPLES & roles:
            own = events.role == role
            temperatures[role].append(
                (events.time_us[own] * 1e-6, events.value[own])
            )
        if builder is not None:
            builder.add(blocks)

    inputs, speed_ms = grid_inputs(estimator, parts, take)
    if estimator.counts["jumps"]:
        msg = f"{name}: its clock jumps; split the log there"
        raise LogError(msg)
    if not len(inputs):
        msg = f"{name}: too short"
        raise LogError(msg)
    # the estimator's steps end on whole multiples of theirs
    start_s = (first_us or 0) // STEP_US * STEP_US * 1e-6
    corners = estimator.plan.corners
    return Drive(
        name,
        start_s,
        corners,
        inputs,
        thermocouples_of(temperatures, corners, start_s),
        placed=placements(estimator.config),
        learned=estimator.samples.learned(),
        roles=frozenset(seen),
        speed_ms=speed_ms,
    )


def grid_inputs(
    estimator: Estimator,
    parts: Iterable[Events],
    take: Callable[[Events, list[Block]], None] | None = None,
) -> tuple[Column, Column]:
    """Return ``inputs`` and ``speed_ms`` of a drive that *parts* make.

    It begins at the temperatures measured first; *take* gets each part and
    the blocks of estimates.
    """
    rows = Rows(len(estimator.plan.corners))
    estimator.input_history = rows
    begun = False
    for events in parts:
        if not begun and len(events):
            begun = True
            begin_as_measured(estimator, events)
        blocks = estimator.advance(events.time_us, events.role, events.value)
        if take is not None:
            take(events, blocks)
    if not rows.parts:
        return np.zeros((0, 1, 1)), np.zeros((0, 0))
    return np.concatenate(rows.parts), np.concatenate(rows.speeds)


def read_drives(
    paths: Sequence[Path],
    config: Config,
    signal_map: SignalMap,
    overrides: Mapping[str, str] | None = None,
    progress: Callable[[float], None] | None = None,
) -> list[Drive]:
    """Read logs of one car for matching, in the order they were driven.

    With fused heat twice: the heat of the first drive is then formed with
    what all of them taught of mass and friction. Raises what
    :func:`read_drive` raises.
    """
    learned = None
    drives: list[Drive] = []
    for _ in range(2 if config.heat.mode == "fused" else 1):
        drives = []
        for path in paths:
            drives.append(
                read_drive(
                    path, config, signal_map, overrides,
                    progress=progress, learned=learned,
                )
            )  # fmt: skip
            learned = drives[-1].learned
    return drives


def begin_as_measured(estimator: Estimator, events: Events) -> None:
    """Let every corner begin at its first temperatures in *events*.

    A match, and what judges it, is of the model, not of a guessed start.
    """
    soon = events.time_us <= events.time_us[0] + round(BEGIN_S * 1e6)

    def first(role: str) -> float:
        own = soon & (events.role == ROLE_INDEX[role])
        return float(np.mean(events.value[own])) if own.any() else np.nan

    air_k = first("ambient_temperature")
    if np.isnan(air_k):
        air_k = estimator.config.vehicle.ambient_c + KELVIN_OFFSET
    placed = placements(estimator.config)
    for batch, names in estimator.batches:
        for member, corner in enumerate(names):
            network = estimator.programs[corner].network
            held = {
                node_at(node, placed.get(corner, {}), network): first(
                    f"temp_{corner.lower()}_{node}"
                )
                for node in MEASURED_NODES
            }
            known = {n: k for n, k in held.items() if np.isfinite(k)}
            start = settled(estimator.programs[corner], known, air_k)
            for i, temperature_k in enumerate(start.values()):
                batch.state[member * batch.width + i] = temperature_k
    estimator.start.end()


def settled(
    program: Program, held_k: Mapping[str, float], ambient_k: float
) -> dict[str, float]:
    """Return every node's temperature [K] as it settles in a parked car.

    Args:
        program: the corner.
        held_k: temperatures [K] of nodes that are known.
        ambient_k: of the air.
    """
    network = program.network
    nodes = [node.name for node in network.nodes]
    held = {node: k for node, k in held_k.items() if node in nodes}
    for node in held:
        network = network.with_forced(node)
    rows = np.zeros((SETTLING_STEPS, len(CHANNELS) + len(held)))
    rows[:, CHANNELS.index("ambient_k")] = ambient_k
    rows[:, len(CHANNELS) :] = list(held.values())
    batch = Batch([compile_network(network)], ambient_k, sets=1)
    batch.march(flat(rows), SETTLING_STEPS, SETTLING_STEP_S)
    return dict(zip(nodes, batch.state, strict=False))


def flat(rows: Column) -> array[float]:
    """Return *rows* as the kernel takes them."""
    numbers = array("d")
    numbers.frombytes(rows.tobytes())
    return numbers


def _since(results: Results, start_s: float) -> Results:
    columns = {
        **results.columns,
        "time_s": results.columns["time_s"] - start_s,
    }
    return replace(results, columns=columns)
