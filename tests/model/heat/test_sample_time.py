"""Time in the pass: ageing, late samples, jumps, chunks, both forms."""

from __future__ import annotations

from itertools import pairwise
from math import inf, nan
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.channels import CHANNELS, VEHICLE_CHANNELS
from bstm_daemon.model.heat.memory import SampleState
from bstm_daemon.model.heat.sample_pass import BACK, DONE, JUMP, LOST, SETTLE
from bstm_daemon.model.heat.sample_plan import PlanNumbers
from bstm_daemon.native import layout
from bstm_daemon.roles import ROLES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bstm_daemon.native.loader import Kernel

    from .conftest import Run

SECOND = 1_000_000
HOUR = 3600 * SECOND
BOTH = ("vehicle_speed", "primary_pressure")


def driving(
    first_us: int, count: int, speed: float = 10.0
) -> list[tuple[int, str | int, float]]:
    """Return *count* samples of speed and 1 MPa, 10 ms apart."""
    return [
        (first_us + 10_000 * i, role, value)
        for i in range(count)
        for role, value in (
            ("vehicle_speed", speed),
            ("primary_pressure", 1e6),
        )
    ]


@pytest.fixture
def run(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> Run:
    """Return a pass of one corner after 1 s at 10 m/s and 1 MPa."""
    begun = start(make_car(), kernel, *BOTH)
    return begun.feed(driving(0, 101))


def test_grid_is_whole_multiples_of_the_step(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any
) -> None:
    """Also for stamps below zero and a start between two steps."""
    for first in (17_000, -1_234_567, 7 * HOUR + 1):
        run = start(make_car(), kernel, *BOTH).feed(driving(first, 50))
        assert {at % 50_000 for at in run.times} == {0}
        assert run.times[0] - first <= 50_000
        assert run.times == type(run.times)(
            "q", range(run.times[0], run.times[-1] + 1, 50_000)
        )


def test_last_value_is_held_until_its_timeout(run: Run, tick: Any) -> None:
    """0.5 s after the last sample speed and pressure are gone, and flagged."""
    assert not any(run.flag("speed_missing") + run.flag("pressure_missing"))
    run.feed([(1_800_000, tick, 0.0)])
    pressure = run.column("pressure_pa")
    missing = run.flag("pressure_missing")
    for at, p, gone in zip(run.times, pressure, missing, strict=True):
        # the step that begins at 1.5 s still sees an age of just 0.5 s
        assert p == pytest.approx(1e6 if at <= 1_550_000 else 0.0)
        assert gone is (at > 1_500_000)
    assert run.flag("speed_missing") == missing
    assert run.column("brake_power_w")[-1] == 0.0


def test_roles_that_are_not_mapped_are_flagged(run: Run) -> None:
    """Acceleration, torque and ambient have no signal in this car."""
    for name in ("acceleration_missing", "torque_missing", "ambient_missing"):
        assert all(run.flag(name))


@pytest.mark.parametrize("at_us", [200_000, 999_999])
def test_late_sample_counts_from_now(run: Run, at_us: int) -> None:
    """Up to 1 s behind: no step is redone, the value is used at once."""
    before = run.column("speed_ms")
    run.feed([(at_us, "vehicle_speed", 30.0), (1_050_000, -1, 0.0)])
    assert run.count("late") == 1
    assert run.column("speed_ms")[: len(before)] == before
    assert run.column("speed_ms")[-1] == pytest.approx(30.0)


def test_one_odd_stamp_is_dropped(run: Run) -> None:
    """A single stamp far off, both ways, repeated or not."""
    for odd in (-100 * SECOND, 2 * HOUR, 2 * HOUR, 10**17, 2**61, -(2**62)):
        run.feed([(odd, "vehicle_speed", 99.0)])
        # the call is done, though its last sample was not taken
        assert run.code == DONE
        run.feed([(1_010_000, "vehicle_speed", 10.0)])
    assert run.count("dropped") == 6
    assert run.count("jumps") == 0
    assert run.codes == []
    assert max(run.column("speed_ms")) < 11.0


def test_a_silence_ends_the_call_twice(run: Run, tick: Any) -> None:
    """At the first silent step, and at the first speed after it."""
    run.feed([(30 * SECOND, tick, 0.0), (40 * SECOND, tick, 0.0)])
    assert run.silences == [(LOST, 2_050_000)]
    assert run.state.last_sample_us == SECOND
    assert run.flag("silent").index(True) == run.times.index(2_050_000)

    run.feed([(45 * SECOND, "primary_pressure", 1e6)])
    assert len(run.silences) == 1
    assert run.state.last_speed_ms == 10.0
    run.feed([(46 * SECOND, "vehicle_speed", 7.0)])
    run.feed([(46 * SECOND + 1, "vehicle_speed", 8.0)])
    assert run.silences[1:] == [(BACK, 46 * SECOND)]
    assert run.state.speed_after_ms == 7.0


PARKED = {"vehicle_speed": 0.0, "park_brake": 1.0, "temp_fl_disc": 350.0}


def parked(
    last_us: Mapping[str, int], tick: int
) -> list[tuple[int, str | int, float]]:
    """Return a parked car every 100 ms until *last_us*; ticks for 80 s."""
    found: list[tuple[int, str | int, float]] = []
    for at in range(0, 80 * SECOND, 100_000):
        found.append((at, tick, 0.0))
        found += [
            (at, role, value)
            for role, value in PARKED.items()
            if at <= last_us[role]
        ]
    return found


def test_a_bus_sleeps_after_a_minute_parked(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any, tick: int
) -> None:
    """The thermocouples of a logger go on; the silence ends the call."""
    run = start(make_car(), kernel, *PARKED)
    ends = dict.fromkeys(PARKED, 80 * SECOND)
    ends |= {"vehicle_speed": 60 * SECOND, "park_brake": 61 * SECOND}
    run.feed(parked(ends, tick))

    assert run.silences == [(LOST, 62_050_000)]
    asleep = run.flag("asleep")
    assert run.times[asleep.index(True)] == 62_050_000
    assert all(asleep[asleep.index(True) :])
    assert not any(run.flag("silent"))
    run.feed([(80 * SECOND, "vehicle_speed", 0.0), (81 * SECOND, tick, 0.0)])
    assert run.silences[1:] == [(BACK, 80 * SECOND)]
    assert not any(run.flag("asleep")[-19:])


def test_a_clock_that_is_set_wakes_no_sleeping_bus(
    kernel: Kernel | None, start: Callable[..., Run], make_car: Any, tick: int
) -> None:
    """The stamps move with it: no message has come."""
    run = start(make_car(), kernel, *PARKED)
    run.feed(parked(dict.fromkeys(PARKED, 62 * SECOND), tick))
    back = -500 * SECOND
    run.feed([(back + i * SECOND, tick, 0.0) for i in range(9)])

    assert run.codes == [JUMP]
    assert run.flag("asleep")[-1]


@pytest.mark.slow
@settings(deadline=None, max_examples=10)
@given(
    seconds=st.lists(st.floats(58.0, 66.0), min_size=3, max_size=3),
    braked=st.sampled_from([0.0, 0.0, 1.0]),
)
def test_both_forms_agree_on_what_sleeps(
    compiled: Kernel,
    start: Callable[..., Run],
    make_car: Any,
    seconds: list[float],
    braked: float,
) -> None:
    """Whatever ends when, to the bit."""
    ends = {
        role: round(s * SECOND)
        for role, s in zip(PARKED, seconds, strict=True)
    }
    samples = [(0, "brake_switch", braked), *parked(ends, -1)]
    forms = [
        start(make_car(), form, "brake_switch", *PARKED).feed(samples)
        for form in (None, compiled)
    ]
    assert forms[0].bits() == forms[1].bits()


def test_a_long_jump_is_a_silence_before_it_settles(run: Run) -> None:
    run.feed(driving(100 * HOUR, 10))
    assert run.silences == [(LOST, SECOND), (BACK, 100 * HOUR + 10_000)]
    assert run.codes == [SETTLE]


def test_jump_back_moves_the_axis(run: Run) -> None:
    """The clock was set back: values stay, energy goes on, no march."""
    steps, energy = len(run.times), run.column("brake_energy_ff_j")[-1]
    run.feed(driving(-500 * SECOND, 101))
    assert run.codes == [JUMP]
    assert run.count("dropped") == 2  # both samples of the first stamp
    assert run.flag("clock_jump").count(True) == 1
    assert run.flag("clock_jump")[steps]
    assert run.times[steps] == -500 * SECOND + 50_000
    assert len(run.times) - steps == 20
    assert not any(run.flag("speed_missing"))
    grown = run.column("brake_energy_ff_j")[-1] - energy
    assert grown == pytest.approx(energy, rel=0.02)


@pytest.mark.parametrize("days", [-31, -1, 31, 400])
def test_a_value_is_no_older_after_a_jump(run: Run, days: int) -> None:
    """Its stamp moves with the axis: 0.5 s more, neither now nor for days."""
    steps, at = len(run.times), days * 24 * HOUR
    run.feed([(at + 10_000 * i, BOTH[0], 10.0) for i in range(150)])
    assert run.codes == [JUMP]
    for time_us, pressure_pa, missing in zip(
        run.times[steps:],
        run.column("pressure_pa")[steps:],
        run.flag("pressure_missing")[steps:],
        strict=True,
    ):
        since_us = time_us - at
        # the first stamp of the jump, 10 ms before, was waited for
        assert missing is (since_us > 510_000)
        # a step that saw the value die holds it for a part
        if since_us <= 500_000 and since_us > 50_000:
            assert pressure_pa == pytest.approx(1e6)
        if since_us > 560_000:
            assert pressure_pa == 0.0


@pytest.mark.slow
def test_hours_of_silence_are_marched(run: Run) -> None:
    """Hours ahead, below 12: cold air flows past, step by step."""
    for hours in (0.3,) if run.kernel is None else (2, 11):
        ahead = run.times[-1] + round(hours * HOUR)
        run.feed(driving(ahead, 3))
        steps = round(hours * 3600 * 20)
        assert run.codes == []
        assert len(run.times) >= steps
        assert run.times[-1] - run.times[0] == 50_000 * (len(run.times) - 1)
        assert run.of_car("speed_ms")[-10] == 0.0


@pytest.mark.parametrize("days", [0.51, 29.0])
def test_parked_settles(run: Run, days: float) -> None:
    """Above 12 h and up to 30 days: all is at ambient, nothing marched."""
    steps = len(run.times)
    ahead = round(days * 24) * HOUR + HOUR
    run.feed(driving(ahead, 50))
    assert run.codes == [SETTLE]
    assert run.times[steps] == ahead + 10_000 - (ahead + 10_000) % 50_000 + (
        50_000
    )
    assert run.flag("settled")[steps]
    assert not any(run.flag("settled")[steps + 1 :])
    assert not any(run.flag("clock_jump"))


def test_clock_set_moves_the_axis(run: Run) -> None:
    """Beyond 30 days the clock was set: nothing cools."""
    steps = len(run.times)
    run.feed(driving(31 * 24 * HOUR, 50))
    assert run.codes == [JUMP]
    assert run.flag("clock_jump")[steps]
    assert not any(run.flag("speed_missing"))


def test_what_is_no_number_is_no_sample(run: Run) -> None:
    """Nan and infinity let the role age; nothing is poisoned."""
    for value in (nan, inf, -inf):
        run.feed([(1_010_000, "vehicle_speed", value)])
        run.feed([(1_010_000, "primary_pressure", value)])
    run.feed([(1_200_000, len(ROLES) + 3, 1.0), (1_600_000, -1, 0.0)])
    assert run.flag("speed_missing")[-1]
    assert run.of_car("distance_m")[-1] == pytest.approx(15.0, abs=0.6)


def car_of(make_car: Any, make_corner: Any) -> Any:
    """Return a car that uses every branch of the pass."""
    return make_car(
        make_corner("FL"),
        make_corner("FR", circuit="secondary", pushout_pressure_pa=5e4),
        make_corner("RR"),
        heat={
            "mode": "fb",
            "primary_lag_s": 0.1,
            "front_pressure_pa": [0.0, 1e6, 5e6],
            "rear_pressure_pa": [0.0, 1e6, 2e6],
        },
    )


MAPPED = (
    *("vehicle_speed", "primary_pressure", "secondary_pressure"),
    *("acceleration_longitudinal", "powertrain_torque", "external_force"),
    *("ambient_temperature", "rain", "brake_switch", "esc_active"),
    *("motor_torque", "acceleration_lateral", "yaw_rate", "gear"),
    *("clutch_open", "abs_active", "tc_active", "altitude", "gnss_speed"),
    *("wheel_speed_fl", "wheel_speed_rr", "wheel_pressure_fr"),
    *("temp_fl_disc", "temp_rr_fluid"),
)
GAPS = st.one_of(
    st.integers(0, 40_000),
    st.integers(-300_000, 900_000),
    st.sampled_from([-100 * SECOND, 3 * SECOND, 40 * 24 * HOUR]),
    st.sampled_from([13 * HOUR, 10**18]),
)
STREAMS = st.lists(
    st.tuples(
        GAPS,
        st.sampled_from([*MAPPED, "gear", -1]),
        st.one_of(st.floats(-5.0, 60.0), st.floats(0.0, 1e7), st.floats()),
    ),
    max_size=60,
)


def stamped(
    stream: list[tuple[int, str | int, float]],
) -> list[tuple[int, str | int, float]]:
    """Turn gaps into stamps that stay an int64."""
    at, samples = 1_000_000, []
    for gap, role, value in stream:
        at = max(min(at + gap, 2**62), -(2**62))
        samples.append((at, role, value))
    return samples


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(stream=STREAMS)
def test_both_forms_give_the_same_bits(
    compiled: Kernel,
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
    stream: list[tuple[int, str | int, float]],
) -> None:
    """Random roles, jitter, jumps, values: rows and state are equal."""
    car = car_of(make_car, make_corner)
    samples = stamped(stream)
    one, two = (
        start(car, form, *MAPPED).feed(samples) for form in (None, compiled)
    )
    assert one.bits() == two.bits()
    assert one.codes == two.codes


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(
    stream=STREAMS,
    cuts=st.lists(st.integers(0, 60), max_size=6),
    room=st.integers(1, 9),
)
def test_chunks_never_change_a_bit(  # noqa: PLR0917
    kernel: Kernel | None,
    start: Callable[..., Run],
    make_car: Any,
    make_corner: Any,
    stream: list[tuple[int, str | int, float]],
    cuts: list[int],
    room: int,
) -> None:
    """Any split of the stream and any room for rows."""
    samples = stamped(stream)
    car = car_of(make_car, make_corner)
    whole = start(car, kernel, *MAPPED).feed(samples)
    pieces = start(car, kernel, *MAPPED)
    pieces.room = room
    places = sorted({0, len(samples), *(min(c, len(samples)) for c in cuts)})
    for first, last in pairwise(places):
        pieces.feed(samples[first:last])
    assert pieces.bits() == whole.bits()
    assert pieces.codes == whole.codes


def test_sizes_that_do_not_fit(
    compiled: Kernel, start: Callable[..., Run], make_car: Any
) -> None:
    """The compiled pass checks each buffer before it runs."""
    plan = start(make_car(), compiled, *BOTH).plan

    def call(**changes: Any) -> Any:
        state = SampleState.new()
        table: dict[str, Any] = {
            "ints": plan.ints,
            "floats": plan.floats,
            "times": state.times,
            "numbers": state.numbers,
            "flags": state.flags,
            "stamps": type(state.times)("q", [0]),
            "roles": type(state.flags)("i", [0]),
            "values": type(state.numbers)("d", [0.0]),
            "rows": type(state.numbers)("d", bytes(16 * len(CHANNELS))),
            "vehicle": type(state.numbers)(
                "d", bytes(16 * len(VEHICLE_CHANNELS))
            ),
            "closed": type(state.times)("q", bytes(16)),
            "first": 0,
        }
        return compiled.sample_pass(*{**table, **changes}.values())

    assert call()[0] == 1
    with pytest.raises(ValueError, match="first sample"):
        call(first=2)
    for name in ("floats", "times", "numbers", "stamps", "values", "rows"):
        short = {"times": "q", "stamps": "q"}.get(name, "d")
        empty = type(plan.floats)(short, [])
        with pytest.raises(ValueError, match="wrong size"):
            call(**{name: empty})
    with pytest.raises(ValueError, match="another layout"):
        call(ints=plan.ints[:-1])
    # modes and switches may have any number: nothing is read by them
    for name in ("corners", "points", "has_laws", "step_us", "place"):
        for number in (-2, 2**40):
            ints = plan.ints[:]
            ints[layout.first(PlanNumbers, name)] = number
            with pytest.raises(ValueError, match=r"range|size"):
                call(ints=ints)


@pytest.mark.parametrize("corners", [1, 2, 4])
def test_a_state_is_what_was_exported_of_it(corners: int) -> None:
    """Of fewer corners there are fewer entries, and the others stay new."""
    state = SampleState.new()
    fresh = SampleState.new()
    for i in range(len(state.times)):
        state.times[i] = i
    for i in range(len(state.numbers)):
        state.numbers[i] = float(i)
    times, numbers = state.exported(corners)

    found = SampleState.imported(corners, times, numbers, [5])

    whole = len(state.times), len(state.numbers)
    assert ((len(times), len(numbers)) == whole) is (corners == 4)
    assert times == sorted(set(times))
    assert numbers == sorted(set(numbers))
    for i, time_us in enumerate(found.times):
        assert time_us == (i if i in times else fresh.times[i])
    for i, number in enumerate(found.numbers):
        assert number == (i if i in numbers else fresh.numbers[i])
    assert found.flags[0] == 5
    with pytest.raises(ValueError, match="argument"):
        SampleState.imported(corners, times[:-1], numbers, [0])
    with pytest.raises(ValueError, match="argument"):
        SampleState.imported(corners, times, [*numbers, 0.0], [0])
