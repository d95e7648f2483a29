"""Recorded drives that can be heated anew by another model of the heat.

Effects on friction, pressure and motion change the brake power, which the
estimator's pass forms from the samples: so the samples are kept.
"""

from __future__ import annotations

from array import array
from collections import Counter, defaultdict
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.matching.drives import (
    Drive,
    Rows,
    begin_as_measured,
    thermocouples_of,
)
from bstm_daemon.bus.opening import EventLog
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.channels import CHANNELS
from bstm_daemon.errors import LogError, UsageError
from bstm_daemon.estimator.blocks import Block
from bstm_daemon.estimator.corner_model import corner_model
from bstm_daemon.estimator.estimator import STEP_US, Estimator
from bstm_daemon.replay.columns import present_roles
from bstm_daemon.roles import ROLES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

PIECE: Final = 1 << 20
"""Samples that the estimator takes at a time."""

SEGMENT: Final = ".log.gz"
"""Ending of the files of a kept record."""

THIN_S: Final = 0.1
"""Time between samples of one role, where effects are tried."""

KEPT_ROLES: Final = frozenset(
    number
    for number, role in enumerate(ROLES)
    if role.name.startswith("temp_")
)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A drive, the samples that it was formed from, and what is present.

    ``present`` maps the number of each mapped role to its timeout [us];
    ``thin`` are fewer samples, for trials, and what they give by themselves.
    """

    drive: Drive
    events: Events = field(repr=False)
    present: Mapping[int, int] = field(repr=False)
    thin: Events = field(repr=False)
    thin_inputs: Column = field(repr=False)

    @property
    def name(self) -> str:
        """Name of the log."""
        return self.drive.name

    def inputs(self, config: Config) -> Column:
        """Return the inputs of the thermal model as *config* forms them.

        (steps, corners, channels), on the steps of ``drive``.
        """
        return _like(self.drive, _pass(config, self.present, self.events))

    def thin_inputs_of(self, config: Config) -> Column:
        """Return likewise what *config* forms from the ``thin`` samples."""
        return _like(self.drive, _pass(config, self.present, self.thin))

    def heated_by(self, config: Config) -> Drive:
        """Return the drive as *config* heats it.

        What *config* changes is taken from samples at :data:`THIN_S`.
        """
        change = self.thin_inputs_of(config) - self.thin_inputs
        # held temperatures are nan where there are none
        change[np.isnan(change)] = 0.0
        return replace(self.drive, inputs=self.drive.inputs + change)


def read_recording(
    path: Path,
    config: Config,
    signal_map: SignalMap,
    overrides: Mapping[str, str] | None = None,
    *,
    thermocouples: bool = True,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Read the log *path*; *thermocouples* is whether it must have some.

    A folder is a record that the service has kept: its segments in order.

    Raises:
        LogError: unusable, too short or without thermocouples.
        FileAccessError: it cannot be read.
        UsageError: the heat mode is ``measured``.
    """
    files = sorted(path.glob(f"*{SEGMENT}")) if path.is_dir() else [path]
    if not files:
        msg = f"{path}: no segment of a record (*{SEGMENT}) in this folder"
        raise LogError(msg)
    parts = []
    for number, file in enumerate(files):
        log = EventLog(file, signal_map, overrides)
        for events in log.events():
            parts.append(events)
            if progress is not None:
                progress((number + log.share) / len(files))
    return recorded(
        path.name,
        _joined(parts),
        config,
        present_roles(signal_map),
        thermocouples=thermocouples,
    )


def recorded(
    name: str,
    events: Events,
    config: Config,
    present: Mapping[int, int],
    *,
    thermocouples: bool = True,
) -> Recording:
    """Return the recording of *events*.

    *thermocouples* is whether it must have some.

    Raises:
        LogError: too short or without thermocouples.
        UsageError: the heat mode is ``measured``.
    """
    if config.heat.mode == "measured":
        msg = (
            '[heat] mode = "measured" forces the disc; a gap needs brake '
            "power: choose another mode"
        )
        raise UsageError(msg)
    if not len(events):
        msg = f"{name}: no samples of the roles that are mapped"
        raise LogError(msg)
    inputs = _pass(config, present, events)
    if not len(inputs):
        msg = f"{name}: too short"
        raise LogError(msg)
    start_s = int(events.time_us[0]) // STEP_US * STEP_US * 1e-6
    corners = Estimator(config, present).plan.corners
    temperatures: dict[int, list[tuple[Column, Column]]] = defaultdict(list)
    for role in KEPT_ROLES & set(np.unique(events.role).tolist()):
        own = events.role == role
        temperatures[role].append(
            (events.time_us[own] * 1e-6, events.value[own])
        )
    measured = thermocouples_of(temperatures, corners, start_s)
    if thermocouples and not measured:
        msg = (
            f"{name}: no measured temperature: a gap needs roles "
            "temp_<corner>_<node>"
        )
        raise LogError(msg)
    drive = Drive(name, start_s, corners, inputs, measured)
    thin = thinned(events)
    thin_inputs = _like(drive, _pass(config, present, thin))
    return Recording(drive, events, present, thin, thin_inputs)


def thinned(events: Events) -> Events:
    """Return the first sample of each role in each :data:`THIN_S`."""
    slot = events.time_us // round(THIN_S * 1e6)
    keep = np.zeros(len(events), bool)
    for role in np.unique(events.role):
        own = np.flatnonzero(events.role == role)
        new = np.diff(slot[own], prepend=slot[own[0]] - 1) != 0
        keep[own[new]] = True
    return Events(
        events.time_us[keep], events.role[keep], events.value[keep], Counter()
    )


def inputs_of(
    config: Config, present: Mapping[int, int], events: Events
) -> tuple[Column, tuple[str, ...]]:
    """Return what *config* makes of *events*, and the corners' names.

    (steps, corners, channels), as ``Drive.inputs`` has them.
    """
    corners = Estimator(config, present).plan.corners
    return _pass(config, present, events), corners


def _like(drive: Drive, rows: Column) -> Column:
    """Return *rows* with as many steps as *drive*."""
    steps = len(drive)
    if len(rows) < steps:
        missing = np.repeat(rows[-1:], steps - len(rows), axis=0)
        rows = np.concatenate((rows, missing))
    return rows[:steps]


class _Heating(Estimator):
    """An estimator whose rows are wanted and whose estimates are not."""

    def leave_nodes(self) -> None:
        """March no temperatures where no friction depends on them."""
        corners = self.config.disc_corners()
        if all(
            set(corner_model(self.config, one).friction.temperature) == {1.0}
            for one in corners
        ):
            self.batches = []
            self._coupling.coupled = False

    def _block(self, steps: int, outputs: tuple[array[float], ...]) -> Block:
        """Keep the rows; judging each estimate would take most of the time.

        Temperatures that no brake can have begin anew, as live: friction
        goes by them.
        """
        del outputs
        wide = len(self.plan.corners) * len(CHANNELS)
        if self.input_history is not None:
            rows = memoryview(self._coupling.rows)[: steps * wide]
            self.input_history.add(rows, steps)
        self.history_left_steps -= steps
        self._reset_impossible()
        none = array("d")
        return Block(
            *(self.layout, array("q"), none, none, (), array("q"), {}, 0, {})
        )


def _pass(
    config: Config, present: Mapping[int, int], events: Events
) -> Column:
    estimator = _Heating(config, dict(present))
    rows = Rows(len(estimator.plan.corners))
    estimator.input_history = rows
    begin_as_measured(estimator, events)
    estimator.leave_nodes()
    for first in range(0, len(events), PIECE):
        part = slice(first, first + PIECE)
        estimator.advance(
            events.time_us[part], events.role[part], events.value[part]
        )
    if estimator.counts["jumps"]:
        msg = "the log's clock jumps; split it there"
        raise LogError(msg)
    return np.concatenate(rows.parts or [np.zeros((0, 1, 1))])


def _joined(parts: list[Events]) -> Events:
    if not parts:
        none = np.zeros(0)
        return Events(
            none.astype(np.int64), none.astype(np.int32), none, Counter()
        )
    return Events(
        np.concatenate([one.time_us for one in parts]),
        np.concatenate([one.role for one in parts]),
        np.concatenate([one.value for one in parts]),
        Counter(),
    )
