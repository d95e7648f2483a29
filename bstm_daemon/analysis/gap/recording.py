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
    GRID_S,
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
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from bstm_daemon.analysis.statistics.series import Column, Indices, Mask
    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config
    from bstm_daemon.estimator.coupling import Outputs
    from bstm_daemon.model.thermal.kernel import Batch

PIECE: Final = 1 << 16
"""Samples that the estimator takes at a time."""

HOLD_S: Final = 0.6
"""A role without a sample for longer is not known."""

THIN_S: Final = 0.1
"""Time between samples of one role, where effects are tried."""

THIN_COUPLING_US: Final = 500_000
"""Where friction gets its temperature anew in a trial: what a trial takes is
the difference of two passes, and a pass goes back to Python each time."""

MOST_BYTES: Final = 1 << 25
"""Of the trials of a drive that are kept."""


class Packed:
    """Samples in file order, kept bit for bit in a third of the memory.

    A bus sends few different values: each is kept once.
    """

    def __init__(self, events: Events) -> None:
        """Keep the samples of *events*."""
        bits, which = np.unique(
            events.value.view(np.int64), return_inverse=True
        )
        self._values = bits.view(np.float64)
        self._which = which.astype(np.min_scalar_type(len(bits)))
        self._role = events.role.astype(np.min_scalar_type(len(ROLE_INDEX)))
        self._start_us = int(events.time_us[0]) if len(events) else 0
        ahead_us = np.diff(events.time_us, prepend=self._start_us)
        small = np.abs(ahead_us).max(initial=0) <= np.iinfo(np.int32).max
        self._ahead_us = ahead_us.astype(np.int32 if small else np.int64)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self._role)

    def pieces(self, samples: int = PIECE) -> Iterator[Events]:
        """Return the samples, so many at a time."""
        time_us = self._start_us
        for first in range(0, len(self), samples):
            part = slice(first, first + samples)
            times_us = time_us + np.cumsum(
                self._ahead_us[part], dtype=np.int64
            )
            time_us = int(times_us[-1])
            yield Events(
                times_us,
                self._role[part].astype(np.int32),
                self._values[self._which[part]],
            )

    def of_role(self, number: int) -> tuple[Indices, Column]:
        """Return stamps [us] and values in SI of a role, (n,) each."""
        found = [
            (one.time_us[own], one.value[own])
            for one in self.pieces()
            for own in [one.role == number]
        ]
        if not found:
            return np.zeros(0, np.int64), np.zeros(0)
        stamps, values = zip(*found, strict=True)
        return np.concatenate(stamps), np.concatenate(values)


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A drive, some samples that it was formed from, and what is present.

    ``present`` maps the number of each mapped role to its timeout [us];
    ``thin`` are samples for trials, and ``thin_inputs`` what they give by
    themselves.
    """

    drive: Drive
    present: Mapping[int, int] = field(repr=False)
    thin: Packed = field(repr=False)
    thin_inputs: Column = field(repr=False)
    _tried: dict[str, tuple[Mask, Column]] = field(
        default_factory=dict, repr=False
    )
    """By configuration: which columns are others than ``thin_inputs``, and
    these. Both axles and the forces ask for the same trials."""

    _means: dict[int, Column | None] = field(default_factory=dict, repr=False)
    """By role: its means over the steps. Every trial asks for the same."""

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

    def step_means(self, number: int) -> Column | None:
        """Return the mean of role *number* over each step, (steps,).

        Held where it is sparse, None where it has no sample.
        """
        if number not in self._means:
            time_us, value = self.thin.of_role(number)
            self._means[number] = (
                _step_means(self.drive, time_us, value) if len(value) else None
            )
        return self._means[number]

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
    thin = Packed(
        thinned(
            Events(
                np.concatenate([one.time_us for one in kept]),
                np.concatenate([one.role for one in kept]),
                np.concatenate([one.value for one in kept]),
            )
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
    return Events(events.time_us[keep], events.role[keep], events.value[keep])


def inputs_of(
    config: Config, present: Mapping[int, int], samples: Packed
) -> tuple[Column, tuple[str, ...]]:
    """Return what *config* makes of *samples*, and the corners' names.

    (steps, corners, channels), as ``Drive.inputs`` has them.
    """
    estimator = _Trial(config, present)
    inputs, _ = grid_inputs(estimator, samples.pieces())
    return inputs, estimator.plan.corners


def _step_means(drive: Drive, time_us: Indices, value: Column) -> Column:
    """Return the mean over each step of *drive*, held where it is sparse."""
    time_s = time_us * 1e-6 - drive.start_s
    step = (time_s / GRID_S).astype(int)
    inside = (step >= 0) & (step < len(drive))
    count = np.bincount(step[inside], minlength=len(drive))
    total = np.bincount(step[inside], value[inside], minlength=len(drive))
    found = np.full(len(drive), np.nan)
    has = count > 0
    found[has] = total[has] / count[has]
    middle = drive.time_s - 0.5 * GRID_S
    last = np.searchsorted(time_s, middle, side="right") - 1
    near = (last >= 0) & (middle - time_s[np.maximum(last, 0)] <= HOLD_S)
    return np.where(
        has, found, np.where(near, value[np.maximum(last, 0)], np.nan)
    )


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
