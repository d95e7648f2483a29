"""Coupling of the pass over samples and the march of the thermal networks.

Without a friction law power does not depend on temperature: as many rows as
fit are computed, then marched. With one the two alternate, and the pass gets
the temperatures on whole multiples of
:data:`COUPLING_US`, however the samples are cut into calls.
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any, Final, cast

from bstm_daemon.channels import CHANNELS, VEHICLE_CHANNELS
from bstm_daemon.model.heat import sample_pass as reference_pass
from bstm_daemon.model.heat.memory import NEVER
from bstm_daemon.model.heat.sample_pass import FULL

if TYPE_CHECKING:
    from collections.abc import MutableSequence, Sequence
    from typing import TypeAlias

    from bstm_daemon.model.heat.memory import SampleState
    from bstm_daemon.model.heat.sample_plan import SamplePlan
    from bstm_daemon.model.thermal.kernel import Batch
    from bstm_daemon.native.loader import Kernel

    Outputs: TypeAlias = tuple[array[float], ...]

COUPLING_US: Final = 200_000
"""A friction law gets the temperature between disc and pads on whole
multiples of this; in a hard stop it rises by 4 K in between."""


class Coupling:
    """Buffer of rows, with the pass that fills and the march that reads it."""

    def __init__(
        self,
        plan: SamplePlan,
        kernel: Kernel | None,
        room: int,
        lines_us: tuple[int, int],
        *,
        coupled: bool,
    ) -> None:
        """Make room for *room* rows of *plan*.

        Args:
            plan: of the pass.
            kernel: the compiled one; None runs the reference.
            room: rows, at least the steps of :data:`COUPLING_US`.
            lines_us: outputs of the march are wanted on whole multiples of
                the first; a call of :meth:`fill` ends on those of the second,
                where the networks may be exchanged; that is a whole multiple
                of :data:`COUPLING_US`.
            coupled: whether a friction law needs the temperatures.
        """
        self.plan, self.coupled = plan, coupled
        self.coupling_us = COUPLING_US
        """Where a friction law gets its temperature anew."""
        self._kernel = kernel
        self._room = room
        publish_us, self._line_us = lines_us
        self._every = publish_us // plan.step_us
        self._width = len(plan.corners) * len(CHANNELS)
        self.rows = array("d", bytes(8 * room * self._width))
        self.vehicle = array("d", bytes(8 * room * len(VEHICLE_CHANNELS)))
        self.times = array("q", bytes(8 * room))
        self._space = self._rows_from(0, room)

    def phase(self, first: int = 0) -> int:
        """Return the steps from row *first* to the next output, inclusive."""
        return -(self.times[first] // self.plan.step_us) % self._every + 1

    def fill(
        self,
        state: SampleState,
        batches: Sequence[tuple[Batch, Sequence[str]]],
        times_us: Any,
        roles: Any,
        values: Any,
        index: int,
    ) -> tuple[int, int, int, Outputs]:
        """Form rows from sample *index* on and march *batches* over them.

        Args:
            state: of the pass; changed.
            batches: with the names of their corners; marched.
            times_us: stamps [us], int64.
            roles: role numbers, int32.
            values: SI values.
            index: the first sample.

        Returns:
            (next sample, rows, code of the pass, outputs of each batch); the
            rows are contiguous and end on a line of the exchange at the
            latest.
        """
        samples = times_us, roles, values
        interfaces = self._interfaces(batches) if self.coupled else []
        for corner, own, disc, pad in interfaces:
            if not state.interface_k(corner) > 0.0:
                state.heat_interface(corner, 0.5 * (own[disc] + own[pad]))
        each_us = self.coupling_us if self.coupled else self._line_us
        outputs = tuple(array("d") for _ in batches)
        done, code = 0, FULL
        while code == FULL and done < self._room:
            room = min(self._until(each_us, state), self._room - done)
            index, steps, code = self._pass(state, samples, index, done, room)
            marched = self._march(batches, done, steps)
            if done:
                for output, more in zip(outputs, marched, strict=True):
                    output.extend(more)
            else:
                outputs = marched
            done += steps
            if not steps:
                break
            last_us = self.times[done - 1]
            if self.coupled and last_us % self.coupling_us == 0:
                for corner, own, disc, pad in interfaces:
                    state.heat_interface(corner, 0.5 * (own[disc] + own[pad]))
            if last_us % self._line_us == 0:
                break
        return index, done, code, outputs

    def heat_interfaces(
        self,
        state: SampleState,
        batches: Sequence[tuple[Batch, Sequence[str]]],
    ) -> None:
        """Give the friction laws the mean of disc and face of the pads."""
        for corner, own, disc, pad in self._interfaces(batches):
            state.heat_interface(corner, 0.5 * (own[disc] + own[pad]))

    def _interfaces(
        self, batches: Sequence[tuple[Batch, Sequence[str]]]
    ) -> list[tuple[int, array[float], int, int]]:
        """Return number and state of each corner, and disc and pad in it."""
        found = []
        for batch, names in batches:
            disc, pad = map(batch.names.index, ("disc", "pad_front"))
            for first, name in zip(
                range(0, len(batch.state), batch.width), names, strict=False
            ):
                corner = self.plan.corners.index(name)
                found.append((corner, batch.state, first + disc, first + pad))
        return found

    def _until(self, line_us: int, state: SampleState) -> int:
        """Return the rows up to the next multiple of *line_us*, inclusive."""
        now, ends_us = state.times[:2]
        if now == NEVER:
            return 1
        return -ends_us % line_us // self.plan.step_us + 1

    def _pass(
        self,
        state: SampleState,
        samples: tuple[Any, Any, Any],
        index: int,
        done: int,
        room: int,
    ) -> tuple[int, int, int]:
        """Write up to *room* rows after those that are *done*."""
        whole = room == self._room
        space = self._space if whole else self._rows_from(done, room)
        if self._kernel is None:
            rows, vehicle, times = cast(
                "tuple[MutableSequence[float], MutableSequence[float], "
                "MutableSequence[int]]",
                space,
            )
            return reference_pass.sample_pass(
                self.plan, state, *samples, index, rows, vehicle, times
            )
        return self._kernel.sample_pass(
            self.plan.ints, self.plan.floats, state.times, state.numbers,
            state.flags, *samples, *space, index,
        )  # fmt: skip

    def _rows_from(self, done: int, room: int) -> tuple[Any, Any, Any]:
        wide, last = len(VEHICLE_CHANNELS), done + room
        return (
            memoryview(self.rows)[done * self._width : last * self._width],
            memoryview(self.vehicle)[done * wide : last * wide],
            memoryview(self.times)[done:last],
        )

    def _march(
        self,
        batches: Sequence[tuple[Batch, Sequence[str]]],
        first: int,
        steps: int,
    ) -> Outputs:
        """March *steps* rows from *first* on; the outputs of each batch."""
        if not steps:
            return tuple(array("d") for _ in batches)
        inputs = memoryview(self.rows)[
            first * self._width : (first + steps) * self._width
        ]
        phase = self.phase(first)
        return tuple(
            batch.march(
                inputs, steps, self.plan.step_us * 1e-6, self._every, phase
            )
            for batch, _ in batches
        )
