"""Which pause is marched on, which one is parked, and by how much."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.channels import FLAGS
from bstm_daemon.estimate import Reason, Validity
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.memory import StateError, after_unseen_drive
from bstm_daemon.estimator.state import (
    export_state,
    parked_before_us,
    resume_state,
)
from bstm_daemon.estimator.unseen import coarse_steps
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config.sections import Config

SECOND = 1_000_000
SPEED, PRESSURE = ROLE_INDEX["vehicle_speed"], ROLE_INDEX["primary_pressure"]
PRESENT = {SPEED: 500_000, PRESSURE: 500_000}
SAVED_US = 10 * SECOND


@pytest.fixture(scope="module")
def config(make_car: Callable[..., Config]) -> Config:
    return make_car()


@pytest.fixture(scope="module")
def document(config: Config) -> dict[str, Any]:
    """Return a car's state after ten seconds of braking."""
    estimator = Estimator(config, PRESENT)
    times, roles, values = array("q"), array("i"), array("d")
    for at_us in range(0, SAVED_US + 1, 100_000):
        for role, value in ((SPEED, 15.0), (PRESSURE, 2e6)):
            times.append(at_us)
            roles.append(role)
            values.append(value)
    estimator.advance(times, roles, values)
    saved = export_state(estimator)
    assert saved["time_us"] == SAVED_US
    return saved


def disc_k(estimator: Estimator) -> float:
    return estimator.state("FL")["disc"]


@pytest.mark.parametrize(
    ("parked_us", "late_us", "resumed"),
    [
        (0, 0, True),
        (0, 10_000, True),
        (0, -10_000, True),
        (0, 10_001, False),
        (0, -10_001, False),
        (60 * SECOND, 0, True),
        (60 * SECOND + 1, 0, False),
        (-1, 0, False),
    ],
)
def test_a_pause_of_a_minute_on_the_same_axis_is_marched_on(
    config: Config,
    document: dict[str, Any],
    parked_us: int,
    late_us: int,
    *,
    resumed: bool,
) -> None:
    """The axes of two clocks may differ by 10 ms."""
    estimator = Estimator(config, PRESENT)
    now_us = SAVED_US + parked_us + late_us
    found = resume_state(estimator, document, parked_us, now_us)

    assert found.resumed is resumed
    assert (estimator.samples.times[0] == SAVED_US) is resumed
    cooled_k = document["corners"]["FL"]["disc"] - disc_k(estimator)
    # what is resumed cools as it is marched, not yet
    if resumed or parked_us <= 0:
        assert cooled_k == 0.0
    else:
        assert cooled_k > 0.05


def test_a_pause_that_no_clock_knows_leaves_the_brakes_hot(
    config: Config, document: dict[str, Any]
) -> None:
    estimator = Estimator(config, PRESENT)
    found = resume_state(estimator, document, None, SAVED_US)

    assert not found.resumed
    assert estimator.state("FL") == document["corners"]["FL"]
    held_s = estimator.trust.export()["_held_s"]
    assert min(held_s.values()) > 600.0


@pytest.mark.parametrize("saved_k", [280.0, 5.0, 5000.0])
def test_brakes_cool_to_the_air_that_was_saved(
    config: Config, document: dict[str, Any], saved_k: float
) -> None:
    """Where it is none, to that of the configuration."""
    own_k = config.vehicle.ambient_c + 273.15
    estimator = Estimator(config, PRESENT)
    state = document | {"ambient_k": saved_k}
    resume_state(estimator, state, 10**12, SAVED_US + 10**12)

    expected_k = saved_k if saved_k == 280.0 else own_k
    assert disc_k(estimator) == pytest.approx(expected_k, abs=0.02)
    assert estimator.history_known


@pytest.mark.parametrize(
    ("parked_us", "proven", "air_k"),
    [
        (2 * 3_600_000_000, True, 294.0),
        (2 * 3_600_000_000, False, 0.0),
        (None, True, 0.0),
    ],
)
def test_the_air_of_a_clear_evening_is_expected_after_a_known_time(
    config: Config,
    document: dict[str, Any],
    parked_us: int | None,
    proven: bool,  # noqa: FBT001
    air_k: float,
) -> None:
    """3 K/h lower; after an unknown time any air may be."""
    assert document["air_k"] <= 0.0  # none was read
    estimator = Estimator(config, PRESENT)
    now_us = SAVED_US + (parked_us or 0)
    state = document | {"air_k": 300.0}
    resume_state(estimator, state, parked_us, now_us, proven=proven)

    assert estimator.samples.air_k == pytest.approx(air_k)


@pytest.mark.parametrize(
    ("initial_k", "history_known", "air_k"),
    [
        (290.0, True, 290.0),
        (290.0, False, 0.0),
        (400.0, True, 0.0),  # hot brakes
        (None, True, 0.0),  # the configured air is no measurement
    ],
)
def test_a_known_start_tells_the_air(
    config: Config,
    initial_k: float | None,
    history_known: bool,  # noqa: FBT001
    air_k: float,
) -> None:
    estimator = Estimator(
        config, PRESENT, history_known=history_known, initial_k=initial_k
    )
    assert estimator.samples.air_k == air_k
    assert export_state(estimator)["air_k"] == air_k


@pytest.mark.parametrize("name", ["another", "zz"])
def test_the_state_of_another_vehicle_is_refused(
    config: Config, document: dict[str, Any], name: str
) -> None:
    estimator = Estimator(config, PRESENT)
    before = export_state(estimator)
    with pytest.raises(StateError, match=f"vehicle '{name}', not 'test'"):
        resume_state(estimator, document | {"vehicle_id": name}, 0, SAVED_US)
    assert export_state(estimator) == before


@pytest.mark.parametrize(
    ("wall_us", "first_us", "parked_us"),
    [(100, 350, 250), (350, 350, 0), (351, 350, None), (None, 350, None),
     ("100", 350, None)],
)  # fmt: skip
def test_time_parked_before_a_log(
    wall_us: object, first_us: int, parked_us: int | None
) -> None:
    """From the save to the first stamp; not of a log from before it."""
    assert parked_before_us({"wall_us": wall_us}, first_us) == parked_us
    assert parked_before_us({}, first_us) is None


@pytest.mark.parametrize(
    ("seconds", "steps"),
    [
        (0.0, []),
        (2.5, [1.0, 1.0, 0.5]),
        (60.0, [1.0] * 60),
        (75.0, [*[1.0] * 60, 10.0, 5.0]),
        (1870.0, [*[1.0] * 60, *[10.0] * 174, 60.0, 10.0]),
    ],
)
def test_steps_grow_with_the_time_parked(
    seconds: float, steps: list[float]
) -> None:
    """A second for a minute, ten for half an hour, then a minute."""
    assert list(coarse_steps(seconds)) == steps


def test_after_an_unseen_drive_nothing_is_known_of_the_temperatures(
    config: Config, document: dict[str, Any]
) -> None:
    """They begin as they were, bounded by the hottest start, and degraded."""
    marked = after_unseen_drive(document)
    now_us = SAVED_US + 30 * SECOND
    estimator = Estimator(config, PRESENT)
    assert parked_before_us(marked, now_us) is None

    found = resume_state(estimator, marked, None, now_us)

    assert not found.resumed
    assert disc_k(estimator) == document["corners"]["FL"]["disc"]
    assert estimator.start.unknown == set(document["corners"])
    times = array("q", range(now_us, now_us + SECOND, 100_000))
    roles, values = array("i", [SPEED] * 10), array("d", [0.0] * 10)
    first = estimator.advance(times, roles, values)[0]
    assert first.flags[0] & FLAGS["driven_unseen"]
    assert not first.flags[1] & FLAGS["driven_unseen"]
    assert first.reasons["FL"][0] & Reason.HEAT_UNKNOWN
    assert first.reasons["FL"][1] & Reason.START_UNKNOWN
    assert first.validity["FL"][1] == Validity.DEGRADED
