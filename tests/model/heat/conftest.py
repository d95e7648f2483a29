"""One pass over samples, in either form, for the tests of heat."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.channels import CHANNELS, FLAGS, VEHICLE_CHANNELS
from bstm_daemon.model.heat.sample_pass import (
    BACK,
    DONE,
    JUMP,
    LOST,
    SETTLE,
    TICK,
    SampleState,
    sample_pass,
)
from bstm_daemon.model.heat.sample_plan import SamplePlan, plan_samples
from bstm_daemon.native.loader import VARIABLE
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bstm_daemon.config.sections import Config
    from bstm_daemon.native.loader import Kernel

STEP_US = 50_000


@dataclass
class Run:
    """A pass with what it has written so far."""

    plan: SamplePlan
    kernel: Kernel | None
    room: int = 256
    state: SampleState = field(init=False)
    rows: array[float] = field(default_factory=lambda: array("d"))
    vehicle: array[float] = field(default_factory=lambda: array("d"))
    times: array[int] = field(default_factory=lambda: array("q"))
    codes: list[int] = field(default_factory=list)
    silences: list[tuple[int, int]] = field(default_factory=list)
    code: int = DONE
    """What the last call has returned."""

    def __post_init__(self) -> None:
        """Begin before the first sample."""
        self.state = SampleState.new()

    def feed(self, samples: Sequence[tuple[int, str | int, float]]) -> Run:
        """Consume (time [us], role or TICK, SI value) samples in one call.

        The pass is called again where it returns early, as the estimator
        does; the codes of moves of the axis are kept, and
        with their time [us] those of silences.
        """
        times = array("q", [s[0] for s in samples])
        roles = array("i", [_number(s[1]) for s in samples])
        values = array("d", [s[2] for s in samples])
        index = 0
        while index < len(times):
            index = self._call(times, roles, values, index)
        return self

    def _call(
        self,
        times: array[int],
        roles: array[int],
        values: array[float],
        first: int,
    ) -> int:
        corners = len(self.plan.corners)
        rows = array("d", bytes(8 * self.room * corners * len(CHANNELS)))
        vehicle = array("d", bytes(8 * self.room * len(VEHICLE_CHANNELS)))
        closed = array("q", bytes(8 * self.room))
        if self.kernel is None:
            index, steps, code = sample_pass(
                self.plan, self.state, times, roles, values, first,
                rows, vehicle, closed,
            )  # fmt: skip
        else:
            index, steps, code = self.kernel.sample_pass(
                self.plan.ints, self.plan.floats, self.state.times,
                self.state.numbers, self.state.flags, times, roles, values,
                rows, vehicle, closed, first,
            )  # fmt: skip
        self.code = code
        self.rows.extend(rows[: steps * corners * len(CHANNELS)])
        self.vehicle.extend(vehicle[: steps * len(VEHICLE_CHANNELS)])
        self.times.extend(closed[:steps])
        if code in {SETTLE, JUMP}:
            self.codes.append(code)
        if code in {LOST, BACK}:
            self.silences.append((code, self.state.times[0]))
        return index

    def column(self, channel: str, corner: int = 0) -> list[float]:
        """Return one channel of a corner over the steps."""
        width = len(self.plan.corners) * len(CHANNELS)
        first = corner * len(CHANNELS) + CHANNELS.index(channel)
        return list(self.rows[first::width])

    def of_car(self, channel: str) -> list[float]:
        """Return one channel of the vehicle over the steps."""
        first = VEHICLE_CHANNELS.index(channel)
        return list(self.vehicle[first :: len(VEHICLE_CHANNELS)])

    def flag(self, name: str) -> list[bool]:
        """Return whether the bit *name* is set, over the steps."""
        return [bool(int(f) & FLAGS[name]) for f in self.of_car("flags")]

    def count(self, name: str) -> int:
        """Return one of the counters late, dropped, jumps."""
        return self.state.times[("late", "dropped", "jumps").index(name) + 3]

    def bits(self) -> tuple[bytes, ...]:
        """Return all that was written and remembered, as bytes."""
        state = self.state
        return tuple(
            part.tobytes()
            for part in (
                *(self.rows, self.vehicle, self.times),
                *(state.times, state.numbers, state.flags),
            )
        )


def _number(role: str | int) -> int:
    return role if isinstance(role, int) else ROLE_INDEX[role]


@pytest.fixture(scope="session")
def start() -> Callable[..., Run]:
    """Return what starts a pass: (config, kernel, *roles with 0.5 s)."""

    def make(
        config: Config, kernel: Kernel | None, *roles: str, **timeouts: int
    ) -> Run:
        present = {ROLE_INDEX[role]: 500_000 for role in roles}
        present |= {ROLE_INDEX[r]: us for r, us in timeouts.items()}
        return Run(plan_samples(config, present, STEP_US), kernel)

    return make


@pytest.fixture(scope="session")
def tick() -> Any:
    """Return the role number of a tick."""
    return TICK


@pytest.fixture
def compiled_chosen(compiled: Kernel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Take the compiled form: these drives are hours of samples."""
    monkeypatch.setenv(VARIABLE, "compiled")
