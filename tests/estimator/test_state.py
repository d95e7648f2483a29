"""What a restart carries over: bits, names and the time parked."""

from __future__ import annotations

import json
from array import array
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.memory import StateError
from bstm_daemon.estimator.state import (
    _completed,
    correct_parked,
    export_state,
    keep_input_history,
    park,
    parked_before_us,
    restore_state,
)
from bstm_daemon.estimator.validity import HIGHEST_K, LOWEST_K
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.model.thermal.network import Link, Network, Node
from bstm_daemon.model.wear.dose import DOSE
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config.sections import Config, CornerConfig

SECOND = 1_000_000
SPEED, PRESSURE = ROLE_INDEX["vehicle_speed"], ROLE_INDEX["primary_pressure"]
PRESENT = {SPEED: 500_000, PRESSURE: 500_000}
AIR_K = 293.15

Samples = list[tuple[int, int, float]]


def braking(seconds: float, start_us: int, pressure_pa: float) -> Samples:
    return [
        (at, role, value)
        for at in range(start_us, start_us + round(seconds * 1e6), 20_000)
        for role, value in ((SPEED, 15.0), (PRESSURE, pressure_pa))
    ]


def feed(estimator: Estimator, samples: Samples) -> list[Any]:
    times, roles, values = zip(*samples, strict=True)
    return estimator.advance(
        array("q", times), array("i", roles), array("d", values)
    )


def silent(estimator: Estimator, seconds: float, every_us: int) -> None:
    """Let time pass on the grid, as a silent bus does."""
    now = estimator.samples.times[0]
    until = now + round(seconds * 1e6)
    ticks = [(at, TICK, 0.0) for at in range(now, until, every_us)]
    feed(estimator, [*ticks, (until, TICK, 0.0)])


@pytest.fixture(scope="session")
def config(
    make_car: Callable[..., Config], make_corner: Callable[..., CornerConfig]
) -> Config:
    return make_car(make_corner("FL"), make_corner("RL"))


def hot_car(config: Config) -> Estimator:
    """Return two corners after a minute of braking."""
    estimator = Estimator(config, PRESENT)
    feed(estimator, braking(60.0, 0, 2e6))
    at_rest = [(61 * SECOND, SPEED, 0.0), (61 * SECOND, PRESSURE, 0.0)]
    feed(estimator, at_rest)
    return estimator


def nodes_k(estimator: Estimator) -> dict[str, float]:
    """Return the temperatures of FL [K]."""
    state = estimator.state("FL")
    nodes = estimator.programs["FL"].network.nodes
    return {node.name: state[node.name] for node in nodes}


def copy_of(estimator: Estimator, document: dict[str, Any]) -> Estimator:
    """Return a new estimator of the same car, from a document in JSON."""
    fresh = Estimator(estimator.config, PRESENT)
    text = json.dumps(document, allow_nan=False)
    restored = restore_state(fresh, json.loads(text), resume=True)
    assert restored.resumed
    assert not restored.new
    return fresh


def states(estimator: Estimator, blocks: list[Any]) -> list[float]:
    """Return nodes and memories of every publication, not the energies."""
    (group,) = estimator.groups
    names = len(group.state_names)
    return [
        value
        for block in blocks
        for first in range(0, len(block.outputs[0]), group.size)
        for value in block.outputs[0][first : first + names]
    ]


@pytest.mark.slow
@settings(max_examples=10)
@given(cut=st.integers(min_value=1, max_value=499))
def test_a_restart_at_any_sample_changes_no_bit(
    config: Config, cut: int
) -> None:
    samples = braking(5.0, 61 * SECOND + 13, 1.5e6)
    whole = hot_car(config)
    first = hot_car(config)
    expected = states(whole, feed(whole, samples))

    before = feed(first, samples[:cut])
    second = copy_of(first, export_state(first))
    after = feed(second, samples[cut:])

    assert states(first, before) + states(second, after) == expected
    assert export_state(second) == export_state(whole)


@pytest.mark.slow
@pytest.mark.parametrize("minutes", [0.5, 10.0, 45.0])
def test_parking_is_standing_on_a_silent_bus(
    config: Config, minutes: float
) -> None:
    """Coarse steps agree with the grid's 50 ms to 0.05 K."""
    marched, parked = hot_car(config), hot_car(config)

    silent(marched, 60.0 * minutes, 10 * SECOND)
    park(parked, 60.0 * minutes)

    for corner in ("FL", "RL"):
        fine = marched.state(corner)
        for node, kelvin in parked.state(corner).items():
            assert kelvin == pytest.approx(fine[node], abs=0.05), node


def test_parking_runs_down_to_the_air_and_no_further(config: Config) -> None:
    estimator = hot_car(config)

    park(estimator, 10 * 24 * 3600.0, ambient_k=263.15)

    for kelvin in nodes_k(estimator).values():
        assert kelvin == pytest.approx(263.15, abs=0.02)


def test_parking_brings_the_bounds_of_an_unknown_start_together(
    config: Config,
) -> None:
    """The bound cools as the estimate does, and then is gone."""
    estimator = hot_car(config)
    bound_k = estimator.start.states()["FL"]["fluid"]

    park(estimator, 3600.0)

    later_k = estimator.start.states()["FL"]["fluid"]
    assert estimator.state("FL")["fluid"] + 20.0 < later_k < bound_k - 50.0
    assert not estimator.history_known

    park(estimator, 24 * 3600.0)

    assert estimator.history_known


def test_a_new_node_starts_between_its_neighbours(config: Config) -> None:
    before = hot_car(config)
    document = export_state(before)
    effect = EffectConfig(name="caliper_fluid_split")
    changed = config.model_copy(update={"effect": [effect]})
    after = Estimator(changed, PRESENT)
    added = set(after.state("FL")) - set(before.state("FL"))
    assert added

    restored = restore_state(after, document, resume=False)

    assert {n.split(".")[1] for n in restored.new} <= added
    old, new = before.state("FL"), after.state("FL")
    for node in set(old) & set(new):
        assert new[node] == old[node]
    nodes = {node.name for node in after.programs["FL"].network.nodes}
    for node in added & nodes:
        links = after.programs["FL"].network.links
        ends = [
            old[other]
            for link in links
            for this, other in ((link.a, link.b), (link.b, link.a))
            if this == node and other in old
        ]
        assert min(ends) <= new[node] <= max(ends)


def test_a_node_without_a_neighbour_that_is_known_waits_for_one() -> None:
    """The mean of those beside it, at either end of a link."""
    nodes = tuple(Node(name, 1.0) for name in "abcd")
    links = tuple(Link(f"{a}{b}", a, b, 1.0) for a, b in ("ab", "cb", "dc"))
    net = Network((), nodes, links)

    found = _completed(net, {"a": 400.0, "c": 300.0})
    chain = _completed(net, {"a": 400.0})

    assert found == {"a": 400.0, "b": 350.0, "c": 300.0, "d": 300.0}
    assert chain == dict.fromkeys("abcd", 400.0)


def test_another_layout_of_samples_is_not_resumed(config: Config) -> None:
    document = export_state(hot_car(config))
    document["samples"]["layout"] = "of another version"
    fresh = Estimator(config, PRESENT)

    assert not restore_state(fresh, document, resume=True).resumed


def restarted(
    config: Config, document: dict[str, Any], parked_s: float
) -> Estimator:
    estimator = Estimator(config, PRESENT)
    restore_state(estimator, document, resume=False)
    park(estimator, parked_s)
    return estimator


@pytest.mark.parametrize(
    ("assumed_s", "parked_s"), [(0.0, 2400.0), (600.0, 3600.0), (900.0, 60.0)]
)
def test_a_clock_set_late_corrects_a_car_that_stood(
    config: Config, assumed_s: float, parked_s: float
) -> None:
    document = export_state(hot_car(config))
    wrong = restarted(config, document, assumed_s)
    keep_input_history(wrong)
    right = restarted(config, document, parked_s)
    for car in (wrong, right):
        feed(car, [(0, TICK, 0.0)])
        silent(car, 120.0, SECOND)
    before_k = wrong.state("FL")["disc"] - right.state("FL")["disc"]
    assert abs(before_k) > 25.0

    correct_parked(wrong, document, parked_s)

    for node, kelvin in right.state("FL").items():
        assert wrong.state("FL")[node] == pytest.approx(kelvin, abs=0.05)
    # no speed came yet: the hole begins where the car was parked
    assert wrong.unseen.since_us == -parked_s * SECOND
    bound = right.start.states()["FL"]
    for node, kelvin in bound.items():
        found_k = wrong.start.states()["FL"][node]
        assert found_k == pytest.approx(kelvin, abs=0.1), node
    assert bound["fluid"] > right.state("FL")["fluid"] + 10.0


def test_a_clock_set_late_corrects_a_car_that_braked(config: Config) -> None:
    document = export_state(hot_car(config))
    wrong = restarted(config, document, 0.0)
    keep_input_history(wrong)
    right = restarted(config, document, 3600.0)
    for car in (wrong, right):
        feed(car, braking(60.0, 0, 3e6))
    before_k = wrong.state("FL")["disc"] - right.state("FL")["disc"]
    assert before_k > 50.0

    correct_parked(wrong, document, 3600.0)
    # once: what comes now is after the start that is known
    assert wrong.input_history is None
    with pytest.raises(StateError, match="no input history was kept"):
        correct_parked(wrong, document, 3600.0)

    for node, kelvin in nodes_k(right).items():
        assert wrong.state("FL")[node] == pytest.approx(kelvin, abs=1.0)
    assert wrong.state("FL")[DOSE] == pytest.approx(
        right.state("FL")[DOSE], rel=1e-4
    )


def test_a_save_by_a_clock_that_was_not_right_dates_no_log() -> None:
    """But a log that goes on within a minute is of the same axis."""
    document: dict[str, Any] = {"wall_us": 100 * SECOND, "wall_error_us": None}
    right = document | {"wall_error_us": 0}
    assert parked_before_us(right, 4000 * SECOND) == 3900 * SECOND
    assert parked_before_us(document, 4000 * SECOND) is None
    assert parked_before_us(document, 160 * SECOND) == 60 * SECOND
    assert parked_before_us(right, 99 * SECOND) is None
    assert parked_before_us({}, 4000 * SECOND) is None


def test_impossibles_begin_anew(config: Config) -> None:
    estimator = hot_car(config)
    document = export_state(estimator)
    fresh = copy_of(estimator, document)
    corners = fresh.layout.corners
    for batch, member, _ in fresh.members():
        batch.state[batch.part(member).start] = float("nan")

    feed(fresh, braking(1.0, 61 * SECOND, 1e6))

    assert fresh.resets == len(corners) > 1
    assert not fresh.history_known
    nodes = nodes_k(fresh).values()
    assert all(LOWEST_K < kelvin < HIGHEST_K for kelvin in nodes)
    # a lining is not new because its temperature is unknown
    assert fresh.state("FL")[DOSE] > document["corners"]["FL"][DOSE] > 0.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"corners": []}, r"corners = \[\]: must be a table"),
        ({"corners": {}}, "no node of it has the name"),
        ({"corners": {"FL": {"wheel": 300.0}}}, "corner FL: no node"),
        ({"corners": {"FL": {"disc": 5.0}}}, "no brake's temperature"),
        (
            {"corners": {"FL": {"disc": "hot"}}},
            'disc = "hot": must be a number',
        ),
        ({"start_bound": None}, "start_bound"),
        (
            {"start_bound": {"FL": {"disc": 5.0}}},
            "no brake's temperature",
        ),
        ({"samples": None}, "samples = None: must be a table"),
        ({"trust": {}}, "trust: not what this version saves"),
        ({"unseen": {}}, "unseen: not what this version saves"),
    ],
)
def test_what_is_no_state_is_refused_whole(
    config: Config, change: dict[str, Any], words: str
) -> None:
    estimator = Estimator(config, PRESENT)
    before = export_state(estimator)
    document = export_state(hot_car(config)) | change

    with pytest.raises(StateError, match=words):
        restore_state(estimator, document, resume=True)

    assert export_state(estimator) == before


def test_flags_of_more_than_64_bits_are_refused(config: Config) -> None:
    estimator = hot_car(config)
    document = export_state(estimator)
    document["samples"]["open_flags"] = 1 << 70

    with pytest.raises(
        StateError,
        match="samples: open_flags = 1180591620717411303424: must be",
    ):
        restore_state(estimator, document, resume=True)


@pytest.mark.slow
@given(
    document=st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(max_size=8),
        lambda inner: (
            st.dictionaries(
                st.sampled_from(
                    [
                        *("corners", "FL", "RL", "disc", "fluid", "samples"),
                        *("start_bound", "times", "numbers", "layout"),
                    ]
                ),
                inner,
                max_size=6,
            )
            | st.lists(inner, max_size=3)
        ),
        max_leaves=20,
    )
)
def test_no_document_does_worse_than_be_refused(
    config: Config, document: Any
) -> None:
    estimator = Estimator(config, PRESENT)
    if not isinstance(document, dict):
        document = {"corners": document}
    with suppress(StateError):
        restore_state(estimator, document, resume=True)
    for kelvin in nodes_k(estimator).values():
        assert LOWEST_K < kelvin < HIGHEST_K


@pytest.mark.parametrize(("new", "known"), [("FL", "RL"), ("RL", "FL")])
def test_a_new_corner_takes_nothing_from_the_others(
    config: Config, new: str, known: str
) -> None:
    """Whichever comes first, the one that was saved is as it was."""
    hot = hot_car(config)
    document = export_state(hot)
    del document["corners"][new]
    fresh = Estimator(config, PRESENT)

    assert [*restore_state(fresh, document, resume=True).new] == [new]

    assert fresh.state(known)["disc"] == hot.state(known)["disc"] > 300.0
