"""Recorded drives that can be heated anew by another model of the heat.

Effects on friction, pressure and motion change the brake power, which the
estimator's pass forms from the samples: so the samples are kept.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.matching.drives import (
    Drive,
    drive_of,
    grid_inputs,
    log_events,
)
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.channels import CHANNELS
from bstm_daemon.estimator.corner_model import corner_model
from bstm_daemon.estimator.coupling import Coupling
from bstm_daemon.estimator.estimator import PUBLISH_US, ROWS, Estimator
from bstm_daemon.model.wear.car import REFIT_US, CarWear
from bstm_daemon.replay.columns import present_roles

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from bstm_daemon.analysis.statistics.series import Column, Mask
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimator.coupling import Outputs
    from bstm_daemon.model.thermal.kernel import Batch

PIECE: Final = 1 << 20
"""Samples that the estimator takes at a time."""

THIN_S: Final = 0.1
"""Time between samples of one role, where effects are tried."""

THIN_COUPLING_US: Final = 500_000
"""Where friction gets its temperature anew in a trial: what a trial takes is
the difference of two passes, and a pass goes back to Python each time."""

MOST_BYTES: Final = 1 << 25
"""Of the trials of a drive that are kept."""


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A drive, some samples that it was formed from, and what is present.

    ``present`` maps the number of each mapped role to its timeout [us];
    ``thin`` are samples for trials, and ``thin_inputs`` what they give by
    themselves.
    """

    drive: Drive
    present: Mapping[int, int] = field(repr=False)
    thin: Events = field(repr=False)
    thin_inputs: Column = field(repr=False)
    _tried: dict[str, tuple[Mask, Column]] = field(
        default_factory=dict, repr=False
    )
    """By configuration: which columns are others than ``thin_inputs``, and
    these. Both axles and the forces ask for the same trials."""

    @property
    def name(self) -> str:
        """Name of the log."""
        return self.drive.name

    def thin_inputs_of(self, config: Config) -> Column:
        """Return what *config* forms from the ``thin`` samples.

        (steps, corners, channels), on the steps of ``drive``.
        """
        # what a match learned heats nothing
        key = config.model_copy(update={"matched": []}).model_dump_json()
        if key not in self._tried:
            rows, _ = inputs_of(config, self.present, self.thin)
            found, base = _like(self.drive, rows), self.thin_inputs
            alike = (found == base) | (np.isnan(found) & np.isnan(base))
            other = ~alike.all(axis=0)
            kept = sum(columns.nbytes for _, columns in self._tried.values())
            if kept > MOST_BYTES:
                return found
            self._tried[key] = other, found[:, other]
        other, columns = self._tried[key]
        found = self.thin_inputs.copy()
        found[:, other] = columns
        return found

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
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Read the log *path*, or the folder of a record that was kept.

    Raises:
        LogError: unusable or too short, or its clock jumps.
        FileAccessError: it cannot be read.
        UsageError: the heat mode is ``measured``.
    """
    parts = log_events(path, signal_map, overrides, progress)
    return recorded(path.name, parts, config, present_roles(signal_map))


def recorded(
    name: str,
    parts: Iterable[Events],
    config: Config,
    present: Mapping[int, int],
) -> Recording:
    """Return the recording of *parts*, of which few samples are kept.

    Raises:
        LogError: too short, or the clock jumps.
        UsageError: the heat mode is ``measured``.
    """
    kept: list[Events] = []

    def passed() -> Iterator[Events]:
        for part in parts:
            kept.append(thinned(part))
            yield part

    drive = drive_of(name, _Heating(config, present), passed())
    # the first in each slot again: parts end within one
    thin = thinned(
        Events(
            np.concatenate([one.time_us for one in kept]),
            np.concatenate([one.role for one in kept]),
            np.concatenate([one.value for one in kept]),
        )
    )
    rows, _ = inputs_of(config, present, thin)
    return Recording(drive, present, thin, _like(drive, rows))


def thinned(events: Events) -> Events:
    """Return the first sample of each role in each :data:`THIN_S`."""
    slot = events.time_us // round(THIN_S * 1e6)
    keep = np.zeros(len(events), bool)
    for role in np.unique(events.role):
        own = np.flatnonzero(events.role == role)
        new = np.diff(slot[own], prepend=slot[own[0]] - 1) != 0
        keep[own[new]] = True
    return _some(events, keep)


def inputs_of(
    config: Config, present: Mapping[int, int], events: Events
) -> tuple[Column, tuple[str, ...]]:
    """Return what *config* makes of *events*, and the corners' names.

    (steps, corners, channels), as ``Drive.inputs`` has them.
    """
    estimator = _Trial(config, present)
    inputs, _ = grid_inputs(estimator, _pieces(events))
    return inputs, estimator.plan.corners


def _like(drive: Drive, rows: Column) -> Column:
    """Return *rows* with as many steps as *drive*."""
    steps = len(drive)
    if len(rows) < steps:
        missing = np.repeat(rows[-1:], steps - len(rows), axis=0)
        rows = np.concatenate((rows, missing))
    return rows[:steps]


class _Heating(Estimator):
    """An estimator whose rows are wanted and whose estimates are not."""

    def __init__(self, config: Config, present: Mapping[int, int]) -> None:
        """March no temperatures where no friction depends on them."""
        super().__init__(config, dict(present), history_known=True)
        if all(
            set(corner_model(config, one).friction.temperature) == {1.0}
            for one in config.disc_corners()
        ):
            self.batches = []
            self._coupling.coupled = False

    def _block(self, steps: int, outputs: Outputs) -> None:
        """Keep the rows; judging each estimate would take most of the time.

        Temperatures that no brake can have begin anew, as live: friction
        goes by them.
        """
        del outputs
        wide = len(self.plan.corners) * len(CHANNELS)
        if self.input_history is not None:
            rows = memoryview(self._coupling.rows)[: steps * wide]
            self.input_history.add(rows, steps)
        self._reset_impossible()
        self.start.end()


class _Trial(_Heating):
    """Takes samples that are thin, the pads as they are configured."""

    def __init__(self, config: Config, present: Mapping[int, int]) -> None:
        super().__init__(config, present)
        self._coupling = _Coarse(
            *(self.plan, self.kernel, ROWS, (PUBLISH_US, REFIT_US)),
            coupled=self._coupling.coupled,
        )
        self._coupling.coupling_us = THIN_COUPLING_US
        self.wear = CarWear(self.config, ())


class _Coarse(Coupling):
    """Marches in one step of the mean inputs: for friction laws only."""

    def _march(
        self,
        batches: Sequence[tuple[Batch, Sequence[str]]],
        first: int,
        steps: int,
    ) -> Outputs:
        if steps and batches:
            rows = np.frombuffer(self.rows).reshape(-1, self._width)
            mean = memoryview(
                np.add.reduce(rows[first : first + steps]) / steps
            )
            dt_s = steps * (self.plan.step_us * 1e-6)
            for batch, _ in batches:
                batch.march(mean, 1, dt_s, output_phase=2)
        return (array("d"),) * len(batches)


def _pieces(events: Events) -> Iterator[Events]:
    for first in range(0, len(events), PIECE):
        yield _some(events, slice(first, first + PIECE))


def _some(events: Events, which: slice | Mask) -> Events:
    """Return the samples of *events* at *which*."""
    return Events(
        events.time_us[which], events.role[which], events.value[which]
    )
