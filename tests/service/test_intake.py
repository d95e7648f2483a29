"""Frames of several buses in order of their stamps, none twice, none lost."""

from __future__ import annotations

import struct
from collections import Counter
from typing import Any, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.live.frame_records import RECORD_BYTES, FrameRecords
from bstm_daemon.bus.live.link import Frame
from bstm_daemon.bus.live.socketcan import SocketcanLink
from bstm_daemon.config.sections import BusConfig
from bstm_daemon.native.loader import VARIABLE, live_extension
from bstm_daemon.service.clock import SteadyAxis
from bstm_daemon.service.intake import GUARD_US, Intake

RECORD = struct.Struct("=qqIi4B")
"""Stamp [ns], time [us], id, bus; extended, length, error, remote."""

START_US = 1_700_000_000_000_000
DRAIN_US = 10_000


FORMS = ["reference"] if live_extension() is None else ["reference", "any"]
"""What decides between frames and records."""


class Wire(SocketcanLink):
    """A link whose frames arrive a while after their stamp."""

    def __init__(self, frames: list[tuple[int, int]], clock: Clock) -> None:
        """Take stamps and delays [us] of frames; their number is the id."""
        super().__init__(BusConfig(name="wire", channel="wire", dbc="none"))
        self._clock = clock
        # a socket is a queue: a frame waits for those before it
        self._waiting = [
            (at + delay, at, number)
            for number, (at, delay) in enumerate(sorted(frames))
        ]

    def drain(self) -> list[Frame]:
        came = []
        while self._waiting and self._waiting[0][0] <= self._clock.now_us:
            _, at_us, number = self._waiting.pop(0)
            came.append(Frame(at_us * 1000, number, False, b"", False, False))
        return came

    def drain_records(self, records: FrameRecords, bus: int) -> None:
        for frame in self.drain():
            RECORD.pack_into(
                records.store,
                records.filled * RECORD_BYTES,
                *(frame.stamp_ns, 0, frame.can_id, bus),
                *(frame.extended, 0, frame.is_error, frame.is_remote),
            )
            records.filled += 1


class Clock:
    """Time that the test sets; wall and boot time run alike."""

    def __init__(self) -> None:
        self.now_us = START_US

    def axis(self) -> SteadyAxis:
        return SteadyAxis(
            lambda: self.now_us * 1000,
            lambda: (self.now_us - START_US) * 1000,
        )


def intake_of(form: str, wires: list[Wire], axis: SteadyAxis) -> Intake:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(VARIABLE, form)
        made = Intake(wires, axis)
    assert (made._records is None) == (form == "reference")
    return made


def drained(
    form: str, wires: list[list[tuple[int, int]]], until_us: int
) -> tuple[Intake, list[tuple[int, int, int, int]]]:
    """Return what the drains gave: (limit, time, bus, id)."""
    clock = Clock()
    links = [Wire(frames, clock) for frames in wires]
    intake = intake_of(form, links, clock.axis())
    axis = intake._axis
    found = []
    while clock.now_us < START_US + until_us:
        clock.now_us += DRAIN_US
        limit_us, arrivals = intake.read(axis.read())
        found += [(limit_us, at, bus, f.can_id) for at, bus, f in arrivals]
    return intake, found


STAMPS = st.integers(min_value=1, max_value=80_000).map(
    lambda us: START_US + us
)


@pytest.mark.parametrize("form", FORMS)
@given(
    wires=st.lists(
        st.lists(st.tuples(STAMPS, st.integers(0, GUARD_US)), max_size=30),
        min_size=1,
        max_size=3,
    )
)
def test_frames_that_come_in_time_come_in_order(
    form: str, wires: list[list[tuple[int, int]]]
) -> None:
    intake, found = drained(form, wires, 200_000)

    assert intake.late == 0
    times = [at for _, at, _, _ in found]
    assert times == sorted(times)
    assert Counter((bus, number) for _, _, bus, number in found) == Counter(
        (bus, number)
        for bus, frames in enumerate(wires)
        for number in range(len(frames))
    )
    for limit_us, at, bus, number in found:
        assert at == sorted(wires[bus])[number][0]
        assert limit_us - DRAIN_US <= at <= limit_us or at > limit_us - 20_000


@pytest.mark.parametrize("form", FORMS)
def test_a_frame_that_comes_too_late_counts_from_now(form: str) -> None:
    late = START_US + 5_000
    frames = [(late, 30_000), (late + 60_000, 0)]
    intake, found = drained(form, [frames], 150_000)

    assert intake.late == 1
    times = [at for _, at, _, _ in found]
    assert times == sorted(times)
    assert times[0] > late
    assert len(times) == 2


@pytest.mark.parametrize("form", FORMS)
def test_a_drain_that_is_held_up_moves_no_frame(form: str) -> None:
    """The process waits for the processor between clock and sockets."""
    clock = Clock()
    stamps = [[START_US + 30_000, START_US + 31_000], [START_US + 30_500]]
    wires = [Wire([(stamp, 0) for stamp in one], clock) for one in stamps]
    intake = intake_of(form, wires, clock.axis())
    clock.now_us += DRAIN_US
    now_us = intake._axis.read()
    clock.now_us += 4 * DRAIN_US

    until_us, arrivals = intake.read(now_us)
    assert (until_us, list(arrivals)) == (now_us - GUARD_US, [])
    _, arrivals = intake.read(intake._axis.read())

    assert [(at - START_US, bus) for at, bus, _ in arrivals] == [
        (30_000, 0),
        (30_500, 1),
        (31_000, 0),
    ]


@pytest.mark.parametrize("form", FORMS)
def test_a_stamp_of_the_future_is_brought_to_now(form: str) -> None:
    clock = Clock()
    ahead_us = START_US + 3_600_000_000
    wire = Wire([(START_US + 1, 0)], clock)
    wire._waiting = [(START_US, ahead_us, 0)]
    intake = intake_of(form, [wire], clock.axis())
    clock.now_us += DRAIN_US
    now_us = intake._axis.read()

    intake.read(now_us)
    clock.now_us += DRAIN_US
    _, arrivals = intake.read(intake._axis.read())

    assert [at for at, _, _ in arrivals] == [now_us]


class Step(NamedTuple):
    """A drain: what passes before it, amid it, and the frames it finds."""

    pass_us: int
    held_up_us: int
    clock_step_us: int
    ages_us: list[list[int]]
    """Of each bus the time from stamp to drain, by the wall clock."""


class SteppedClock:
    """Boot time that runs, and wall time that may be set."""

    def __init__(self) -> None:
        self.boot_us = 5_000_000
        self.offset_us = START_US

    @property
    def wall_us(self) -> int:
        return self.boot_us + self.offset_us

    def axis(self) -> SteadyAxis:
        return SteadyAxis(
            lambda: self.wall_us * 1000 + 7, lambda: self.boot_us * 1000
        )


class StampedWire(Wire):
    """A link that has what the test puts into it."""

    def __init__(self) -> None:
        super().__init__([], Clock())
        self.frames: list[Frame] = []

    def drain(self) -> list[Frame]:
        frames, self.frames = self.frames, []
        return frames


AGES = st.one_of(
    st.integers(-3_000, 60_000),
    st.sampled_from([-(10**10), -20_000, 10**7, 3 * 10**10]),
)
STEPS = st.builds(
    Step,
    st.one_of(st.just(50_000), st.integers(0, 200_000)),
    st.sampled_from([0, 0, 0, 30, 40_000]),
    st.sampled_from(
        [0, 0, 0, 0, 9_000, 15_000, -15_000, -3_600_000_000, 3_600_000_000]
    ),
    st.lists(st.lists(AGES, max_size=12), min_size=3, max_size=3),
)


def outcome_of(form: str, steps: list[Step]) -> tuple[Any, ...]:
    clock = SteppedClock()
    axis = clock.axis()
    wires = [StampedWire() for _ in range(3)]
    intake = intake_of(form, list(wires), axis)
    number = 0
    seen = []
    for step in steps:
        clock.boot_us += step.pass_us
        now_us = axis.read()
        clock.boot_us += step.held_up_us
        for wire, ages_us in zip(wires, step.ages_us, strict=True):
            for age_us in ages_us:
                stamp_ns = (clock.wall_us - age_us) * 1000 + 999
                number += 1
                wire.frames.append(
                    Frame(stamp_ns, number, True, b"", False, False)
                )
        clock.offset_us += step.clock_step_us
        until_us, arrivals = intake.read(now_us)
        indexed = [arrivals[i] for i in range(len(arrivals))]
        assert indexed == list(arrivals)
        seen.append((until_us, indexed))
    return seen, intake.late, intake.frames, axis.steps, axis.now_us


@pytest.mark.skipif(len(FORMS) == 1, reason="not installed")
@given(steps=st.lists(STEPS, max_size=8))
def test_records_come_as_frames_do(steps: list[Step]) -> None:
    """Late ones, stamps of any time and clocks that are set included."""
    frames, records = (outcome_of(form, steps) for form in FORMS)

    assert records == frames


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("step_us", [-3_600_000_000, -15_000, 15_000, 10**9])
def test_stamps_go_on_as_if_the_clock_had_not_been_set(
    form: str, step_us: int
) -> None:
    """A step, small or large, is taken off every later stamp."""
    clock = SteppedClock()
    axis = clock.axis()
    wire = StampedWire()
    intake = intake_of(form, [wire], axis)
    begin_us = clock.boot_us
    clock.offset_us += step_us
    for _ in range(2):
        clock.boot_us += 100_000
        intake.read(axis.read())
    assert axis.steps == 1

    for number, age_us in enumerate((95_000, 50_000, 30_000)):
        stamp_us = clock.wall_us + 100_000 - age_us
        wire.frames.append(
            Frame(stamp_us * 1000, number, True, b"", False, False)
        )
    clock.boot_us += 100_000
    _, arrivals = intake.read(axis.read())

    assert intake.late == 0
    assert [at - START_US - begin_us for at, *_ in arrivals] == [
        300_000 - age_us for age_us in (95_000, 50_000, 30_000)
    ]
