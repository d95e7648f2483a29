"""Bounds of an unknown start: they bound, meet, and the start is known."""

from __future__ import annotations

import json
from array import array
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.estimate import NO_REASON, Reason
from bstm_daemon.estimator.blocks import channels_at_rest
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.start import (
    AGREE_K,
    DESCENT_MS,
    HOTTEST_DISC_K,
    PUBLISHED_NODES,
    hottest_k,
)
from bstm_daemon.estimator.state import export_state, restore_state
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    import numpy.typing as npt

    from bstm_daemon.estimator.blocks import Block
    from bstm_daemon.native.loader import Kernel

SECOND = 1_000_000
AIR_K = 293.15
SPEED, PRESSURE = ROLE_INDEX["vehicle_speed"], ROLE_INDEX["primary_pressure"]
PRESENT = {SPEED: 2 * SECOND, PRESSURE: 2 * SECOND}

Samples = tuple["array[int]", "array[int]", "array[float]"]


def drive(seconds: int, brake_s: int = 6, period_s: int = 60) -> Samples:
    """Return a drive at 14 m/s, braking at the end of each period."""
    times, roles, values = array("q"), array("i"), array("d")
    for second in range(seconds):
        braking = second % period_s >= period_s - brake_s
        for role, value in ((SPEED, 14.0), (PRESSURE, 15e5 * braking)):
            times.append(second * SECOND)
            roles.append(role)
            values.append(value)
    return times, roles, values


def fed(estimator: Estimator, samples: Samples, first: int = 0) -> list[Block]:
    return estimator.advance(*(column[first:] for column in samples))


def courses(
    blocks: list[Block], corner: str, *, hottest: bool = False
) -> npt.NDArray[np.float64]:
    """Return the temperatures of *corner*, [publication, node]."""
    found = []
    for block in blocks:
        number, first, stride, group = block.layout.modelled[corner]
        flat = (block.bounds if hottest else block.outputs)[number]
        table = np.array(flat).reshape(-1, stride)
        found.append(table[:, first : first + group.nodes])
    return np.concatenate(found)


@pytest.fixture(scope="module")
def cars(make_car: Any, make_corner: Any) -> list[Any]:
    """Return the plain car, and one with all that is extended."""
    corners = make_corner("FL"), make_corner("RR")
    effects = ["hub_conduction", "caliper_fluid_split", "disc_hat"]
    return [
        make_car(*corners),
        make_car(*corners, effect=[{"name": name} for name in effects]),
        make_car(*corners, effect=[{"name": "friction_fade"}]),
    ]


@pytest.mark.slow
@settings(max_examples=6, deadline=None)
@given(
    which=st.integers(0, 2),
    shares=st.lists(st.floats(0.0, 1.0), min_size=40, max_size=40),
    brake_s=st.integers(0, 20),
)
def test_every_start_stays_between_the_bounds(
    cars: list[Any], which: int, shares: list[float], brake_s: int
) -> None:
    """Each node began anywhere between cold and as hot as the car gets."""
    if load_kernel() is None:
        pytest.skip("minutes in pure Python")
    unknown = Estimator(cars[which], PRESENT)
    real = Estimator(cars[which], PRESENT, history_known=True)
    hot = unknown.start.states()
    for batch, member, name in real.members():
        part = batch.part(member)
        for i, (key, kelvin) in enumerate(hot[name].items()):
            cold = batch.state[part][i]
            batch.state[part.start + i] = cold + shares[i] * (kelvin - cold)
            assert key in batch.programs[member].state_names
    samples = drive(240, brake_s)

    blocks, truths = fed(unknown, samples), fed(real, samples)

    for name in ("FL", "RR"):
        cold_k = courses(blocks, name)
        hot_k = courses(blocks, name, hottest=True)
        true_k = courses(truths, name)
        # friction that falls with temperature heats a hot brake less
        slack_k = 1.0 if which == 2 else 1e-6
        assert (true_k >= cold_k - slack_k).all()
        assert (true_k <= hot_k + 1e-6).all()


@pytest.mark.slow
def test_a_start_is_known_from_the_row_on_at_which_the_bounds_agree(
    make_car: Any, compiled: Kernel
) -> None:
    """To the row, by the published nodes, however the drive is cut."""
    assert compiled is not None
    samples = drive(5400)
    whole = Estimator(make_car(), PRESENT)
    blocks = fed(whole, samples)
    pieces = Estimator(make_car(), PRESENT)
    cut: list[Block] = []
    for first, last in pairwise([*range(0, len(samples[0]), 777), 10**9]):
        cut += pieces.advance(*(column[first:last] for column in samples))
    unknown = [b for b in blocks if b.bounds]
    for name, program in whole.programs.items():
        names = program.state_names
        published = [names.index(node) for node in PUBLISHED_NODES]
        apart_k = abs(
            courses(unknown, name, hottest=True) - courses(unknown, name)
        )[:, published].max(axis=1)
        known = int((apart_k <= AGREE_K).argmax())
        assert 0 < known < len(apart_k)
        # what is not published reaches nothing that is
        assert apart_k[known:].max() <= AGREE_K
        for parts in (blocks, cut):
            why = [code for b in parts for code in b.reasons[name]]
            # the start is one reason more
            start = [Reason(code) & Reason.START_UNKNOWN for code in why]
            assert set(start[:known]) == {Reason.START_UNKNOWN}
            assert set(start[known:]) == {NO_REASON}
    assert whole.history_known
    assert not whole.start.batches


@pytest.mark.slow
def test_a_restart_goes_on_with_the_same_bits(
    make_car: Any, compiled: Kernel
) -> None:
    """The bound is in the state file, until it is needed no more."""
    assert compiled is not None
    samples = drive(5400)
    whole = Estimator(make_car(), PRESENT)
    expected = fed(whole, samples)
    for cut_s in (300, 5000):
        first = Estimator(make_car(), PRESENT)
        first.advance(*(column[: 2 * cut_s] for column in samples))
        document = json.loads(json.dumps(export_state(first)))
        second = Estimator(make_car(), PRESENT)
        assert restore_state(second, document, resume=True).resumed
        assert bool(document["start_bound"]) == (cut_s == 300)

        found = fed(second, samples, 2 * cut_s)

        count = sum(len(block.times_us) for block in found)
        for name in whole.programs:
            codes = [c for b in found for c in b.validity[name]]
            assert (
                codes
                == [c for b in expected for c in b.validity[name]][-count:]
            )
            assert (
                courses(found, name) == courses(expected, name)[-count:]
            ).all()
        assert export_state(second) == export_state(whole)


def test_a_restart_keeps_every_bit_of_the_bound(
    make_car: Any, compiled: Kernel
) -> None:
    assert compiled is not None
    samples = drive(600)
    whole = Estimator(make_car(), PRESENT)
    fed(whole, samples)
    first, second = (Estimator(make_car(), PRESENT) for _ in range(2))
    first.advance(*(column[:600] for column in samples))
    document = json.loads(json.dumps(export_state(first)))
    assert restore_state(second, document, resume=True).resumed

    fed(second, samples, 600)

    assert export_state(second) == export_state(whole)
    bound = export_state(second)["start_bound"]
    assert bound["FL"]["fluid"] > second.state("FL")["fluid"] + 50.0


def test_a_state_without_a_corner_leaves_its_start_unknown(
    cars: list[Any],
) -> None:
    known = Estimator(cars[0], PRESENT, history_known=True)
    document = export_state(known)
    del document["corners"]["RR"]
    estimator = Estimator(cars[0], PRESENT)

    restore_state(estimator, document, resume=False)

    assert estimator.start.unknown == {"RR"}
    assert set(estimator.start.states()) == {"RR"}


def test_a_corner_that_begins_anew_is_unknown_alone(
    cars: list[Any], compiled: Kernel
) -> None:
    assert compiled is not None
    estimator = Estimator(cars[0], PRESENT, history_known=True)
    batch, member, name = next(iter(estimator.members()))
    batch.state[batch.part(member).start + 2] = float("nan")
    fed(estimator, drive(2))
    assert estimator.start.unknown == {name}

    *_, block = estimator.advance(
        array("q", [3 * SECOND]), array("i", [TICK]), array("d", [0.0])
    )

    instant = block.at(len(block.times_us) - 1)
    assert not instant.start_known(name)
    assert not instant.history_known
    assert instant.state(name, hottest=True)["fluid"] > 350.0
    for other in set(estimator.programs) - {name}:
        assert instant.start_known(other)
        assert instant.state(other, hottest=True) == instant.state(other)


@pytest.mark.parametrize("minutes", [10, 30, 90])
def test_no_descent_is_hotter_than_the_hottest(
    make_car: Any, minutes: int
) -> None:
    """Any length, until the disc has its limit, then parked."""
    kernel = load_kernel()
    program = Estimator(make_car(), PRESENT).programs["FL"]
    nodes = [node.name for node in program.network.nodes]
    hottest = hottest_k(program, HOTTEST_DISC_K, AIR_K, kernel)
    assert hottest["disc"] == pytest.approx(HOTTEST_DISC_K)
    reached_k = dict.fromkeys(nodes, 0.0)
    for power_w in (2e3, 5e3, 1e4, 2e4, 4e4):
        batch = Batch([program], AIR_K, [0], kernel, 1)
        down = channels_at_rest(AIR_K) | {
            "speed_ms": DESCENT_MS,
            "brake_on": 1.0,
            "brake_power_w": power_w,
        }
        for _ in range(60 * minutes):
            batch.march(array("d", down.values()), 1, 1.0)
            if batch.state[nodes.index("disc")] > HOTTEST_DISC_K - 15.0:
                break
        row = array("d", channels_at_rest(AIR_K).values())
        size = batch.width + batch.sources
        soak = batch.march(row * 90, 90, 20.0)
        for i, name in enumerate(nodes):
            peak_k = max(batch.state[i], *soak[i::size])
            reached_k[name] = max(reached_k[name], peak_k)

    assert reached_k["disc"] > 800.0
    for name, kelvin in reached_k.items():
        assert kelvin <= hottest[name] + 1.0, name


def test_both_forms_find_the_same_hottest_start(
    make_car: Any, compiled: Kernel
) -> None:
    program = Estimator(make_car(), PRESENT).programs["FL"]

    assert hottest_k(program, 950.0, AIR_K, None) == hottest_k(
        program, 950.0, AIR_K, compiled
    )


def test_a_network_that_can_not_be_marched_is_as_hot_as_its_disc(
    make_car: Any,
) -> None:
    program = Estimator(make_car(), PRESENT).programs["FL"]

    hottest = hottest_k(program, 900.0, float("nan"), load_kernel())

    assert set(hottest.values()) == {900.0}
