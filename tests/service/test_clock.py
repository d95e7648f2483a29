"""The steady axis: clocks are functions handed in, so steps are data."""

import itertools
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.service.clock import (
    BOOT_ID,
    STEP_US,
    SteadyAxis,
    boot_id,
    wall_clock_ns,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

START_NS = 1_700_000_000_123_456_789
HOUR_US = 3_600_000_000
DRAIN_US = 10_000
READ_NS = 200
"""What a reading of a clock takes."""


class Machine:
    """A computer's two clocks; a reading takes ``READ_NS``."""

    def __init__(self) -> None:
        self.boot = 5_000_000_000_000
        self.offset = START_NS - self.boot
        self.held_up: Iterator[int] = itertools.repeat(0)
        """How long the process stands still after each reading of a wall."""

    def boot_ns(self) -> int:
        self.boot += READ_NS
        return self.boot

    def wall_ns(self) -> int:
        self.boot += READ_NS
        wall = self.boot + self.offset
        self.boot += next(self.held_up)
        return wall

    def pass_us(self, us: int) -> None:
        self.boot += us * 1000

    def step_us(self, us: int) -> None:
        self.offset += us * 1000

    def stamp(self) -> int:
        """Return the kernel's stamp of a frame now."""
        return self.boot + self.offset

    def true_us(self) -> int:
        """Return the time on a wall clock that was never set."""
        return (self.boot + START_NS - 5_000_000_000_000) // 1000

    def axis(self) -> SteadyAxis:
        return SteadyAxis(self.wall_ns, self.boot_ns)


@given(stamp_ns=st.integers(0, 2**63 - 1), reads=st.integers(0, 3))
def test_without_a_step_the_axis_is_the_stamp(
    stamp_ns: int, reads: int
) -> None:
    machine = Machine()
    axis = machine.axis()
    for _ in range(reads):
        machine.pass_us(DRAIN_US)
        axis.read()

    assert axis.of_stamp(stamp_ns) == stamp_ns // 1000
    assert axis.wall_of(stamp_ns // 1000) == stamp_ns // 1000
    assert axis.steps == 0


def test_now_and_stamps_are_of_one_clock() -> None:
    machine = Machine()
    axis = machine.axis()
    for _ in range(100):
        machine.pass_us(DRAIN_US // 2)
        before = machine.stamp()
        now_us = axis.read()
        after = machine.stamp()

        assert before // 1000 <= now_us <= after // 1000


@pytest.mark.parametrize("step_us", [HOUR_US, -HOUR_US, 50_000, -50_000])
def test_a_step_between_two_drains_moves_nothing(step_us: int) -> None:
    machine = Machine()
    axis = machine.axis()
    machine.pass_us(DRAIN_US)
    axis.read()
    machine.pass_us(DRAIN_US // 2)
    old, old_us = machine.stamp(), machine.true_us()
    machine.step_us(step_us)
    machine.pass_us(DRAIN_US // 2)
    new, new_us = machine.stamp(), machine.true_us()

    now_us = axis.read()

    assert abs(now_us - machine.true_us()) <= 1
    assert axis.steps == 1
    assert abs(axis.last_step_us - step_us) <= 1
    # both were waiting when the step was noticed
    assert abs(axis.of_stamp(old) - old_us) <= 1
    assert abs(axis.of_stamp(new) - new_us) <= 1


def test_a_step_is_noticed_by_a_stamp_made_after_the_reading() -> None:
    machine = Machine()
    axis = machine.axis()
    axis.read()
    other_bus, other_us = machine.stamp(), machine.true_us()
    machine.step_us(-HOUR_US)
    stamp, true_us = machine.stamp(), machine.true_us()

    assert abs(axis.of_stamp(stamp) - true_us) <= 1
    assert axis.steps == 1

    machine.pass_us(DRAIN_US)
    axis.read()

    # from before the step, on a bus that was drained before it came
    assert abs(axis.of_stamp(other_bus) - other_us) <= 1
    assert axis.steps == 1


def test_a_stamp_between_two_steps_stays_in_its_drain() -> None:
    machine = Machine()
    axis = machine.axis()
    axis.read()
    since_us = machine.true_us()
    machine.step_us(HOUR_US)
    stamp = machine.stamp()
    machine.step_us(HOUR_US)
    machine.pass_us(DRAIN_US)

    now_us = axis.read()

    assert since_us - 1 <= axis.of_stamp(stamp) <= now_us


def test_a_long_stop_of_the_process_is_no_step() -> None:
    """Suspended, or stopped by a debugger: frames waited meanwhile."""
    machine = Machine()
    axis = machine.axis()
    axis.read()
    machine.pass_us(HOUR_US)
    stamp = machine.stamp()
    machine.pass_us(HOUR_US)

    axis.read()

    assert axis.steps == 0
    assert axis.of_stamp(stamp) == stamp // 1000


def test_held_up_amid_a_reading_is_no_step() -> None:
    machine = Machine()
    axis = machine.axis()
    machine.held_up = itertools.repeat(50_000_000)

    axis.read()

    assert axis.steps == 0


def test_the_narrowest_reading_counts() -> None:
    machine = Machine()
    axis = machine.axis()
    machine.step_us(HOUR_US)
    machine.held_up = itertools.chain([30_000_000], itertools.repeat(0))

    axis.read()

    assert abs(axis.last_step_us - HOUR_US) <= 1


def test_small_steps_add_up_to_one() -> None:
    machine = Machine()
    axis = machine.axis()
    for _ in range(3):
        machine.step_us(STEP_US // 2)
        machine.pass_us(DRAIN_US)
        axis.read()

    assert axis.steps == 1
    assert abs(axis.read() - machine.true_us()) <= 1


def test_many_steps_do_not_add_up_errors() -> None:
    machine = Machine()
    axis = machine.axis()
    for n in range(200):
        machine.pass_us(DRAIN_US)
        machine.step_us((-1) ** n * (HOUR_US + 7 * n))
        axis.read()
    machine.pass_us(DRAIN_US)

    assert abs(axis.read() - machine.true_us()) <= 1
    assert axis.steps == 200


@given(
    moves=st.lists(
        st.tuples(st.integers(0, 1_000_000), st.integers(-(10**10), 10**10)),
        max_size=30,
    )
)
def test_the_axis_never_runs_back_and_stays_true(
    moves: list[tuple[int, int]],
) -> None:
    machine = Machine()
    axis = machine.axis()
    last_us = axis.read()
    for passed_us, step_us in moves:
        machine.pass_us(passed_us)
        machine.step_us(step_us)
        now_us = axis.read()

        assert now_us >= last_us
        assert abs(now_us - machine.true_us()) <= STEP_US + 1
        last_us = now_us


MOMENTS = st.lists(
    st.one_of(
        st.tuples(st.just("pass"), st.integers(1, 100_000)),
        st.tuples(st.just("frame"), st.just(0)),
        st.tuples(st.just("drain"), st.just(0)),
        st.tuples(
            st.just("step"),
            st.integers(60, 10**6).flatmap(
                lambda s: st.sampled_from([s * 10**6, -s * 10**6])
            ),
        ),
    ),
    max_size=60,
)


@given(moments=MOMENTS, amid=st.booleans())
def test_every_frame_keeps_its_time_through_steps(
    moments: list[tuple[str, int]],
    amid: bool,  # noqa: FBT001
) -> None:
    """At most one step from drain to drain, before or *amid* its reading."""
    machine = Machine()
    axis = machine.axis()
    waiting: list[tuple[int, int]] = []
    stepped = False
    for what, amount in [*moments, ("drain", 0)]:
        if what == "pass":
            machine.pass_us(amount)
        elif what == "frame":
            waiting.append((machine.stamp(), machine.true_us()))
        elif what == "step" and not stepped:
            stepped = True
            if amid:
                axis.read()
            machine.step_us(amount)
        elif what == "drain":
            if not (amid and stepped):
                axis.read()
            for stamp, true_us in waiting:
                assert abs(axis.of_stamp(stamp) - true_us) <= 1
            waiting.clear()
            stepped = False


def test_wall_of_gives_the_clock_on_the_wall_today() -> None:
    machine = Machine()
    axis = machine.axis()
    machine.step_us(-HOUR_US)

    now_us = axis.read()

    assert abs(axis.wall_of(now_us) - machine.stamp() // 1000) <= 2


def test_the_machines_own_clocks() -> None:
    before_us = wall_clock_ns() // 1000
    axis = SteadyAxis()
    now_us = axis.read()
    after_us = wall_clock_ns() // 1000

    assert axis.steps == 0
    assert before_us <= now_us <= after_us


def test_boot_id_is_the_same_within_a_boot() -> None:
    if not BOOT_ID.exists():
        pytest.skip(f"no {BOOT_ID}")

    first = boot_id()

    assert first is not None
    assert len(first) == 36
    assert boot_id() == first


@pytest.mark.parametrize("content", [None, b"", b"\n", b"\xff\xfe"])
def test_an_unknown_boot_id_is_none(
    content: bytes | None, tmp_path: Path
) -> None:
    path = tmp_path / "boot_id"
    if content is not None:
        path.write_bytes(content)

    assert boot_id(path) is None
