"""Frames of several buses in order of their stamps, none twice, none lost."""

from __future__ import annotations

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.bus.link import Frame, LinkEvent, LinkState, SendResult
from bstm_daemon.daemon.clock import SteadyAxis
from bstm_daemon.daemon.intake import GUARD_US, Intake

START_US = 1_700_000_000_000_000
DRAIN_US = 10_000


class Wire:
    """A link whose frames arrive a while after their stamp."""

    def __init__(self, frames: list[tuple[int, int]], clock: Clock) -> None:
        """Take stamps and delays [us] of frames; their number is the id."""
        self.channel, self.state, self.reason = "wire", LinkState.UP, ""
        self.receive_buffer_bytes, self.dropped = None, 0
        self.counts: Counter[LinkEvent] = Counter()
        self._clock = clock
        # a socket is a queue: a frame waits for those before it
        self._waiting = [
            (at + delay, at, number)
            for number, (at, delay) in enumerate(sorted(frames))
        ]

    def open(self) -> bool:
        return True

    def drain(self) -> list[Frame]:
        came = []
        while self._waiting and self._waiting[0][0] <= self._clock.now_us:
            _, at_us, number = self._waiting.pop(0)
            came.append(Frame(at_us * 1000, number, False, b"", False, False))
        return came

    def poll(self) -> None:
        pass

    def send(
        self,
        can_id: int,
        extended: bool,  # noqa: FBT001
        data: bytes,
    ) -> SendResult:
        return SendResult.LOST

    def close(self) -> None:
        pass


class Clock:
    """Time that the test sets; wall and boot time run alike."""

    def __init__(self) -> None:
        self.now_us = START_US

    def axis(self) -> SteadyAxis:
        return SteadyAxis(
            lambda: self.now_us * 1000,
            lambda: (self.now_us - START_US) * 1000,
        )


def drained(
    wires: list[list[tuple[int, int]]], until_us: int
) -> tuple[Intake, list[tuple[int, int, int, int]]]:
    """Return what the drains gave: (limit, time, bus, id)."""
    clock = Clock()
    intake = Intake([Wire(frames, clock) for frames in wires], clock.axis())
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


@given(
    wires=st.lists(
        st.lists(st.tuples(STAMPS, st.integers(0, GUARD_US)), max_size=30),
        min_size=1,
        max_size=3,
    )
)
def test_frames_that_come_in_time_come_in_order(
    wires: list[list[tuple[int, int]]],
) -> None:
    intake, found = drained(wires, 200_000)

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


def test_a_frame_that_comes_too_late_counts_from_now() -> None:
    late = START_US + 5_000
    intake, found = drained([[(late, 30_000), (late + 60_000, 0)]], 150_000)

    assert intake.late == 1
    times = [at for _, at, _, _ in found]
    assert times == sorted(times)
    assert times[0] > late
    assert len(times) == 2


def test_a_drain_that_is_held_up_moves_no_frame() -> None:
    """The process waits for the processor between clock and sockets."""
    clock = Clock()
    stamps = [[START_US + 30_000, START_US + 31_000], [START_US + 30_500]]
    wires = [Wire([(stamp, 0) for stamp in one], clock) for one in stamps]
    intake = Intake(wires, clock.axis())
    clock.now_us += DRAIN_US
    now_us = intake._axis.read()
    clock.now_us += 4 * DRAIN_US

    assert intake.read(now_us) == (now_us - GUARD_US, [])
    _, arrivals = intake.read(intake._axis.read())

    assert [(at - START_US, bus) for at, bus, _ in arrivals] == [
        (30_000, 0),
        (30_500, 1),
        (31_000, 0),
    ]


def test_a_stamp_of_the_future_is_brought_to_now() -> None:
    clock = Clock()
    ahead_us = START_US + 3_600_000_000
    wire = Wire([(START_US + 1, 0)], clock)
    wire._waiting = [(START_US, ahead_us, 0)]
    intake = Intake([wire], clock.axis())
    clock.now_us += DRAIN_US
    now_us = intake._axis.read()

    intake.read(now_us)
    clock.now_us += DRAIN_US
    _, arrivals = intake.read(intake._axis.read())

    assert [at for at, _, _ in arrivals] == [now_us]
