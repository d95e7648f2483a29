"""The steady axis: clocks are functions handed in, so steps are data."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.service import persistence
from bstm_daemon.service.clock import (
    BOOT_ID,
    STEP_US,
    Moment,
    ParkedTime,
    SteadyAxis,
    boot_id,
    parked_time,
    wall_clock_ns,
)
from bstm_daemon.service.events import ServiceLog
from bstm_daemon.service.persistence import Outcome, Persistence
from bstm_daemon.service.state_file import Loaded, StateLock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

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


SECOND = 1_000_000
HOUR = 3600 * SECOND
DAY = 24 * HOUR
START_US = 1_790_000_000 * SECOND
BUILD_US = 1_780_000_000 * SECOND
SLACK_US = STEP_US + 2
"""A step this small is not noticed; times are cut to microseconds."""

SAVED = Moment("one", 50 * SECOND, START_US, 2 * SECOND)
NEXT = Moment("two", 30 * SECOND, START_US + HOUR, SECOND)


@pytest.mark.parametrize(
    ("saved", "start", "expected"),
    [
        (SAVED, NEXT, (HOUR - 3 * SECOND, True)),
        # the computer has been up for 30 s, whatever the wall clock says
        (SAVED, replace(NEXT, wall_us=START_US), (30 * SECOND, True)),
        (SAVED, replace(NEXT, wall_error_us=None), (30 * SECOND, False)),
        (replace(SAVED, wall_error_us=None), NEXT, (30 * SECOND, False)),
        # of one boot, only its clock counts
        (SAVED, replace(NEXT, boot_id="one", boot_us=57 * SECOND), (7e6, 1)),
        (SAVED, replace(NEXT, boot_id="one"), (0, True)),
        # unnamed boots may be one
        (
            replace(SAVED, boot_id=None, wall_error_us=None),
            replace(NEXT, boot_id=None),
            (0, False),
        ),
        (SAVED, replace(NEXT, boot_id=None), (HOUR - 3 * SECOND, True)),
        (None, NEXT, (0, False)),
    ],
)
def test_the_shortest_time_that_the_clocks_allow(
    saved: Moment | None, start: Moment, expected: tuple[int, bool]
) -> None:
    assert parked_time(saved, start) == ParkedTime(*expected)


@pytest.mark.parametrize(
    ("document", "expected"),
    [
        ({"boot_id": "one", "boot_us": 1, "wall_us": 2}, ("one", 1, 2, None)),
        ({"boot_us": 1, "wall_us": 2, "wall_error_us": 3}, (None, 1, 2, 3)),
        (
            {"boot_id": 7, "boot_us": 1, "wall_us": 2, "wall_error_us": -3},
            (None, 1, 2, None),
        ),
        ({"boot_us": "1", "wall_us": 2}, None),
        ({"boot_us": 1}, None),
    ],
)
def test_the_moment_of_a_document(
    document: dict[str, Any], expected: tuple[Any, ...] | None
) -> None:
    moment = Moment.saved(document)
    assert moment == (None if expected is None else Moment(*expected))


class Computer:
    """A car's computer: true time, its clocks and its medium."""

    def __init__(self) -> None:
        self.true_us = START_US
        self.medium: dict[str, Any] | None = None
        self.boots = 0
        self.off_us = self.boot_us = 0
        self.error_us: int | None = None

    def run(self, us: int) -> None:
        self.true_us += us
        self.boot_us += us

    def boot(self, off_us: int, wall_us: int | None, up_us: int) -> None:
        """Power on after *off_us*; the clock then shows *wall_us*.

        None is what it showed last: it was written to the medium.
        """
        before_us = self.true_us + self.off_us
        self.true_us += off_us
        shown_us = before_us if wall_us is None else wall_us
        self.off_us = shown_us - self.true_us
        self.boots += 1
        self.boot_us, self.error_us = 0, None
        self.run(up_us)

    def axis(self) -> SteadyAxis:
        return SteadyAxis(
            lambda: (self.true_us + self.off_us) * 1000,
            lambda: self.boot_us * 1000,
            lambda: self.error_us,
        )


class Cooling:
    """An engine that knows how long its brakes cooled, and should have."""

    def __init__(self, computer: Computer) -> None:
        self.computer = computer
        self.config = SimpleNamespace(
            state=SimpleNamespace(
                trust_wall_clock=False, interval_s=10.0, idle_interval_s=300.0
            )
        )
        self.estimator = SimpleNamespace(
            plan=SimpleNamespace(corners=()),
            input_history=None,
            unseen=SimpleNamespace(driven=0),
        )
        self.now_us = 0
        self.cooled_us: int | None = None
        self.parked_us = 0

    def resume(
        self,
        document: Mapping[str, Any],
        parked_us: int,
        _: int,
        *,
        proven: bool,
    ) -> SimpleNamespace:
        self.proven = proven
        self.cooled_us = parked_us
        self.parked_us = self.computer.true_us - document["true_us"]
        return SimpleNamespace(new=())

    def correct_parked(self, _: Mapping[str, Any], parked_us: int) -> None:
        assert self.estimator.input_history is not None
        self.estimator.input_history = None
        self.cooled_us = parked_us

    def tick(self, now_us: int) -> None:
        self.now_us = now_us

    def temperatures_k(self) -> list[float]:
        return []

    def export_state(self) -> dict[str, Any]:
        return {"time_us": self.now_us, "true_us": self.computer.true_us}


class Run:
    """The service from its start until it is killed."""

    def __init__(self, computer: Computer) -> None:
        self.engine: Any = Cooling(computer)
        self.axis = computer.axis()
        quiet: Any = SimpleNamespace(info=_no, warning=_no)
        log = ServiceLog(quiet)
        self.persistence = Persistence(Path("car.state"), self.axis, log)
        self.persistence.resume(self.engine, self.axis.read())

    def cycle(self) -> None:
        now_us = self.axis.read()
        self.engine.tick(now_us)
        self.persistence.poll(self.engine, now_us)


def _no(*_: object, **__: object) -> None:
    """Log nothing."""


@pytest.fixture
def computer(monkeypatch: pytest.MonkeyPatch) -> Callable[[], Computer]:
    """Give new computers, with everything kept in memory."""
    current: list[Computer] = []

    class Writer:
        def __init__(self, _: Path) -> None:
            pass

        @staticmethod
        def submit(document: dict[str, Any], _: int) -> None:
            current[-1].medium = document

        @staticmethod
        def outcome() -> Outcome:
            return Outcome()

    for name, value in (
        ("StateWriter", Writer),
        ("lock", lambda _: StateLock(None)),
        ("load", lambda _: Loaded(current[-1].medium)),
        ("boot_id", lambda: f"boot {current[-1].boots}"),
    ):
        monkeypatch.setattr(persistence, name, value)

    def new() -> Computer:
        current.append(Computer())
        return current[-1]

    return new


SPANS_US = st.one_of(
    st.integers(0, 20 * SECOND), st.integers(0, HOUR), st.integers(0, 9 * DAY)
)
STEPS_US = st.one_of(
    st.sampled_from([20_000, -20_000, 9_000, -9_000]),
    st.integers(-9 * DAY, 9 * DAY),
)


@dataclass(frozen=True)
class Drive:
    """The service works for *us*."""

    us: int


@dataclass(frozen=True)
class Restart:
    """It is killed, and started again after *us*."""

    us: int


@dataclass(frozen=True)
class PowerCut:
    """No power for *off_us*; *up_us* after it is back, the service starts."""

    off_us: int
    wall_us: int | str | None
    up_us: int


@dataclass(frozen=True)
class Step:
    """Somebody sets the clock, which nothing vouches for then."""

    us: int


@dataclass(frozen=True)
class Synchronise:
    """The clock is right but for *wrong* parts of *error_us*."""

    error_us: int
    wrong: float


EVENTS = st.lists(
    st.one_of(
        st.builds(Drive, SPANS_US),
        st.builds(Restart, SPANS_US),
        st.builds(
            PowerCut,
            SPANS_US,
            st.one_of(
                st.sampled_from([0, BUILD_US, None, "right"]),
                st.integers(START_US - 30 * DAY, START_US + 30 * DAY),
            ),
            st.integers(0, 600 * SECOND),
        ),
        st.builds(Step, STEPS_US),
        st.builds(
            Synchronise, st.integers(0, 16 * SECOND), st.floats(-1.0, 1.0)
        ),
    ),
    max_size=14,
)


def play(computer: Computer, events: list[Any]) -> Run:
    """Let *events* happen; the brakes never cool for longer than parked."""
    computer.boot(0, BUILD_US, 30 * SECOND)
    run = Run(computer)
    for event in events:
        match event:
            case Drive(us):
                for part in (1, 9, 90):
                    computer.run(us * part // 100)
                    run.cycle()
            case Restart(us):
                computer.run(us)
                run = Run(computer)
            case PowerCut(off_us, wall_us, up_us):
                if wall_us == "right":
                    wall_us = computer.true_us + off_us
                computer.boot(off_us, wall_us, up_us)
                run = Run(computer)
            case Step(us):
                computer.off_us += us
                computer.error_us = None
                run.cycle()
            case Synchronise(error_us, wrong):
                computer.off_us = int(error_us * wrong)
                computer.error_us = error_us
                run.cycle()
        cooled_us = run.engine.cooled_us or 0
        assert 0 <= cooled_us <= run.engine.parked_us + SLACK_US
    return run


@pytest.mark.parametrize(
    "count",
    [200, pytest.param(20_000, marks=[pytest.mark.slow, pytest.mark.full])],
)
def test_the_brakes_never_cool_for_longer_than_they_stood(
    computer: Callable[[], Computer], count: int
) -> None:
    @settings(max_examples=count, deadline=None, database=None)
    @given(EVENTS)
    def sequences(events: list[Any]) -> None:
        play(computer(), events)

    sequences()


@pytest.mark.slow
def test_a_clock_right_at_both_ends_gives_the_time(
    computer: Callable[[], Computer],
) -> None:
    """Whatever was before, and wherever the clock stood in between."""

    @settings(max_examples=200, deadline=None, database=None)
    @given(
        EVENTS,
        SPANS_US,
        st.integers(0, HOUR - SECOND),
        st.integers(0, 16 * SECOND),
    )
    def sequences(
        events: list[Any], off_us: int, late_us: int, error_us: int
    ) -> None:
        right = Synchronise(error_us, 0.0)
        save = Drive(1000 * SECOND)
        cut = PowerCut(off_us, 0, 30 * SECOND)
        events = [*events, right, save, cut, Drive(late_us), right]
        run = play(computer(), events)
        short_us = run.engine.parked_us - run.engine.cooled_us
        assert short_us <= 2 * (error_us + STEP_US) + SLACK_US

    sequences()


@pytest.mark.parametrize(
    "events",
    [
        # days late at the save and over the cut, then set right
        [PowerCut(300 * SECOND, None, 30 * SECOND), Synchronise(0, 0.0)],
        # a wrong step that is taken back
        [
            Synchronise(0, 0.0),
            Drive(20 * SECOND),
            PowerCut(300 * SECOND, "right", 30 * SECOND),
            Step(3 * DAY),
            Step(-3 * DAY),
            Synchronise(0, 0.0),
        ],
        # right when the service starts, days late when it saved
        [
            PowerCut(300 * SECOND, None, 0),
            PowerCut(300 * SECOND, "right", 0),
            Synchronise(0, 0.0),
            Restart(SECOND),
        ],
    ],
)
def test_known_sequences(
    computer: Callable[[], Computer], events: list[Any]
) -> None:
    run = play(computer(), events)
    assert run.engine.cooled_us > 0
