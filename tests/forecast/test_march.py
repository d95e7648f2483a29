"""The ensemble's coarse steps against fine ones; what a course tells."""

from __future__ import annotations

from array import array
from math import inf, isnan, nan
from statistics import fmean, stdev
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.channels import CHANNELS
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.files import shipped_file
from bstm_daemon.forecast.corner_march import marched
from bstm_daemon.forecast.march import (
    DUTY_STEPS,
    HORIZON_S,
    NEAR_STEPS,
    PARKED_STEPS,
    Conditions,
    Course,
    DutyCourse,
    Job,
    median,
)
from bstm_daemon.forecast.members import Ensemble, Spread
from bstm_daemon.model.risk.sequence import normal_draws
from bstm_daemon.model.risk.vaporisation import Boiling
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from bstm_daemon.model.thermal.program import Program

AIR_K = 283.15
KERNEL = load_kernel()
EXACT = Spread().scaled(0.0)
PARKED = Conditions(AIR_K)
needs_kernel = pytest.mark.skipif(KERNEL is None, reason="slow in Python")


def program() -> Program:
    config, _ = load_vehicle(shipped_file("config/example_vehicle.toml"))
    return compile_corner(config, config.corner[0])


def hot(of: Program) -> list[float]:
    """Return a state as at the end of a descent: steep in the pads."""
    nodes = of.network.nodes
    named = {"disc": 920.0, "pad_front": 760.0, "pad_back": 480.0}
    named |= {"backplate": 440.0, "fluid": 375.0}
    named |= {f"pad_{i}": 760.0 - 26.0 * i for i in range(1, 11)}
    memories = list(of.initial_state(AIR_K))[len(nodes) :]
    return [named.get(node.name, AIR_K) for node in nodes] + memories


def rows(conditions: Conditions) -> array[float]:
    values = dict.fromkeys(CHANNELS, 0.0)
    values |= {name: nan for name in CHANNELS if name.startswith("measured")}
    values |= {
        "speed_ms": conditions.speed_ms,
        "pressure_pa": conditions.pressure_pa,
        "brake_on": conditions.brake_on,
        "ambient_k": conditions.ambient_k,
        "brake_power_w": conditions.power_w,
    }
    return array("d", values.values())


def job(
    of: Program,
    conditions: Conditions,
    steps: tuple[float, ...],
    *,
    spread: Spread = EXACT,
    count: int = 8,
) -> Job:
    return Job.of_members(
        Ensemble(of, count, spread),
        KERNEL,
        hot(of),
        conditions,
        steps,
        factor=1.0,
    )


@needs_kernel
@pytest.mark.parametrize(
    ("conditions", "steps"),
    [
        (Conditions(AIR_K), PARKED_STEPS),
        (Conditions(AIR_K, 10.0, 8e5, 1.0, 5600.0), DUTY_STEPS),
    ],
    ids=["parked", "duty"],
)
def test_coarse_steps_agree_with_the_estimator_s_own(
    conditions: Conditions, steps: tuple[float, ...]
) -> None:
    """Within 0.2 K all the way, against the estimator's 0.05 s."""
    corner = program()
    coarse = job(corner, conditions, steps)
    coarse.advance(len(steps))
    course = coarse.course()
    batch = Batch([corner], AIR_K, [0], KERNEL, 1)
    batch.state[:] = array("d", hot(corner))
    fluid = corner.state_names.index("fluid")
    row = rows(conditions)
    worst = 0.0
    for place, step_s in enumerate(steps):
        count = round(step_s / 0.05)
        batch.march(row * count, count, 0.05)
        found = course.fluid_k[0][place + 1]
        worst = max(worst, abs(found - batch.state[fluid]))

    assert worst < 0.2
    assert course.times_s[-1] >= HORIZON_S == sum(NEAR_STEPS)


@needs_kernel
def test_how_a_march_is_cut_changes_no_bit() -> None:
    """Step by step as without the kernel, or all at once."""
    corner = program()
    whole = job(corner, Conditions(AIR_K), PARKED_STEPS, spread=Spread())
    whole.advance(1000)
    cut = job(corner, Conditions(AIR_K), PARKED_STEPS, spread=Spread())
    while not cut.finished:
        cut.advance(1)

    assert cut.course() == whole.course()


@needs_kernel
@pytest.mark.parametrize(("safe_c", "points"), [(128.0, 68), (115.0, 98)])
def test_a_march_ends_at_the_horizon_where_it_is_safe(
    safe_c: float, points: int
) -> None:
    """In no more portions, and with what the whole march finds."""
    corner, boiling = program(), sharp(safe_c)
    conditions = Conditions(AIR_K)
    job_ = job(corner, conditions, NEAR_STEPS, spread=Spread())
    portions = [marched(job_, 25, boiling) for _ in range(-(-points // 25))]
    found = portions.pop()
    assert found is not None
    assert portions == [None] * (2 if points == 68 else 3)
    whole = job(corner, conditions, PARKED_STEPS, spread=Spread())
    whole.advance(1000)
    course = whole.course()

    assert found.fluid_k == [s[:points] for s in course.fluid_k]
    assert found.peak(HORIZON_S) == course.peak(HORIZON_S)
    safe_in_s = found.safe_in_s(boiling, 0.01)
    assert safe_in_s == course.safe_in_s(boiling, 0.01)
    assert safe_in_s > 0.0


@needs_kernel
def test_spread_is_about_what_a_larger_ensemble_finds() -> None:
    """64 even draws are not far from 512."""

    def deviation(count: int) -> float:
        many = job(
            program(),
            Conditions(AIR_K),
            PARKED_STEPS,
            spread=Spread(),
            count=count,
        )
        many.advance(1000)
        peaks = many.course().peaks_k(HORIZON_S)
        mean = sum(peaks) / count
        return float(sum((p - mean) ** 2 for p in peaks) / count) ** 0.5

    assert deviation(64) == pytest.approx(deviation(512), rel=0.15)


def course(*celsius: float) -> Course:
    """Return a course of two members, a kelvin apart, a point a minute."""
    one = tuple(c + KELVIN_OFFSET for c in celsius)
    other = tuple(kelvin - 1.0 for kelvin in one)
    times = tuple(60.0 * i for i in range(len(celsius)))
    return Course(times, [one, other])


def sharp(celsius: float) -> Boiling:
    """Return a fluid that boils at *celsius*."""
    kelvin = celsius + KELVIN_OFFSET
    return Boiling([kelvin - 0.01, kelvin, kelvin + 0.01])


def test_the_peak_lies_between_points_where_it_does() -> None:
    top_k, top_s = course(90.0, 100.0, 110.0, 108.0, 100.0).peak(HORIZON_S)

    assert top_k == pytest.approx(110.0 + KELVIN_OFFSET - 0.5 + 0.7, abs=0.2)
    assert 120.0 < top_s < 180.0


def test_the_peak_is_that_of_a_parabola_through_three_points() -> None:
    """Uneven times: 400 - (t - 70)^2 / 100 at 30, 60 and 90 s and others."""
    times = (0.0, 30.0, 60.0, 90.0, 150.0)
    series = tuple(400.0 - (t - 70.0) ** 2 / 100.0 for t in times)
    found = Course(times, [series]).peak(HORIZON_S)
    assert found == pytest.approx((400.0, 70.0))

    uneven = (0.0, 20.0, 65.0, 90.0)
    series = tuple(400.0 - (t - 70.0) ** 2 / 100.0 for t in uneven)
    found = Course(uneven, [series]).peak(HORIZON_S)
    assert found == pytest.approx((400.0, 70.0))


@pytest.mark.parametrize(
    ("celsius", "over"),
    [
        ((90.0, 100.0, 110.0, 108.0), True),
        ((90.0, 80.0, 85.0, 95.0), False),
        # it falls, and may still boil
        ((160.0, 170.0, 180.0, 179.0), False),
    ],
)
def test_a_course_is_over_where_it_cools_and_is_safe(
    celsius: tuple[float, ...], *, over: bool
) -> None:
    assert course(*celsius).is_over(sharp(150.0), 0.01) is over


def test_the_median_of_an_even_and_an_odd_number() -> None:
    assert median([3.0, 1.0, 2.0]) == 2.0
    assert median([4.0, 1.0, 3.0, 2.0]) == 2.5


def test_a_fluid_that_cools_peaks_now() -> None:
    assert course(100.0, 90.0, 80.0).peak(HORIZON_S)[1] == 0.0


def test_a_peak_beyond_the_horizon_is_left_out() -> None:
    found = course(*range(100, 145))

    assert max(found.peaks_k(HORIZON_S)) == 130.0 + KELVIN_OFFSET


def test_when_it_is_safe_and_when_it_is_reached() -> None:
    found = course(100.0, 120.0, 150.0, 145.0, 130.0, 110.0)

    assert found.safe_in_s(sharp(125.0), 0.01) == 300.0
    assert found.safe_in_s(sharp(200.0), 0.01) == 0.0
    assert found.safe_in_s(sharp(100.0), 0.01) == inf


def test_when_vapour_is_likely_on_duty() -> None:
    """By the deviation too: a tenth are 1.28 deviations above."""
    fluid_k = tuple(c + KELVIN_OFFSET for c in (100.0, 120.0, 150.0, 145.0))
    draws = [one for (one,) in normal_draws(64, 1)]

    def reached_s(celsius: float, std_k: float) -> float:
        times_s = 0.0, 60.0, 120.0, 180.0
        course = DutyCourse(times_s, fluid_k, lambda _: std_k)
        return course.reached_in_s(sharp(celsius), draws, 0.1)

    assert reached_s(125.0, 0.1) == 120.0
    assert reached_s(200.0, 0.1) == inf
    assert reached_s(90.0, 0.1) == 0.0
    assert reached_s(125.0, 5.0) == 60.0
    assert reached_s(160.0, 5.0) == inf
    assert reached_s(160.0, 10.0) == 120.0
    fluid_k = (nan,) * 4
    assert isnan(reached_s(125.0, 5.0))


@needs_kernel
def test_corners_march_as_the_member_without_spread() -> None:
    """Each with its own state and conditions, bit by bit."""
    corner = program()
    cold = list(corner.initial_state(AIR_K))
    duty = Conditions(AIR_K, 10.0, 8e5, 1.0, 5600.0)
    lanes = [(hot(corner), duty), (cold, duty), (hot(corner), PARKED)]
    job_ = Job.of_corners(
        Batch([corner] * 3, 0.0, None, KERNEL),
        [state for state, _ in lanes],
        [conditions for _, conditions in lanes],
        DUTY_STEPS,
    )
    job_.advance(1000)
    for series, (state, conditions) in zip(
        job_.course().fluid_k, lanes, strict=True
    ):
        alone = Job.of_members(
            *(Ensemble(corner, 1, EXACT), KERNEL, state),
            *(conditions, DUTY_STEPS),
            factor=1.0,
        )
        alone.advance(1000)
        assert alone.course().fluid_k == [series]


@needs_kernel
@pytest.mark.parametrize("factor", [1.0, 2.0])
@pytest.mark.parametrize("speed_ms", [12.0, 25.0])
def test_the_deviation_on_duty_is_about_the_members(
    factor: float, speed_ms: float
) -> None:
    """To first order: within a quarter of what 64 members find."""
    corner = program()
    state = list(corner.initial_state(AIR_K))
    for i, node in enumerate(corner.network.nodes):
        if not node.boundary_input:
            state[i] += 150.0 if node.name == "disc" else 60.0
    duty = Conditions(AIR_K, speed_ms, 1e6, 0.3, 5000.0)
    ensemble = Ensemble(corner, 64, Spread())
    air_k = ensemble.ambients_k(AIR_K, factor)
    width = factor * ensemble.spread.duty_heat
    members = array("d")
    for one_k, draw in zip(air_k, ensemble.draws, strict=True):
        power_w = duty.power_w * (1.0 + width * draw["duty_heat"])
        members += rows(duty._replace(ambient_k=one_k, power_w=power_w))
    many = Job(
        ensemble.batch(KERNEL),
        ensemble.fluid,
        ensemble.states(state, AIR_K, factor),
        members,
        DUTY_STEPS,
    )
    pair = Job.of_corners(
        Batch([corner] * 2, 0.0, None, KERNEL),
        [state] * 2,
        [duty, duty._replace(power_w=0.0)],
        DUTY_STEPS,
    )
    for one in (many, pair):
        one.advance(1000)
    with_k, without_k = pair.course().fluid_k
    for place in (15, 30, 50, 71):
        found = [series[place] for series in many.course().fluid_k]
        told_k = ensemble.duty_deviation_k(
            without_k[place] - AIR_K, with_k[place] - without_k[place], factor
        )
        assert told_k == pytest.approx(stdev(found), rel=0.25)
        assert with_k[place] == pytest.approx(fmean(found), abs=2.0)
