"""Which inputs of which cars nothing checks."""

from __future__ import annotations

from array import array
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimate import NO_INPUT, Input, Reason, Validity
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.estimator.verified import (
    MATCH,
    MATCH_ALIKE,
    STATED,
    THERMOCOUPLES,
    unverified_inputs,
    unverified_of_car,
    verification_table,
    verified_by,
)
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from bstm_daemon.config.sections import Config, CornerConfig

CONFIGS = Path(__file__).parents[2] / "config"
CORNERS = ("FL", "FR", "RL", "RR")
WHEELS = tuple(f"wheel_speed_{name.lower()}" for name in CORNERS)
MOTION = ("acceleration_longitudinal", "powertrain_torque")
THESIS = (*WHEELS, "primary_pressure", *MOTION)


@pytest.fixture
def car(
    make_car: Callable[..., Config], make_corner: Callable[..., CornerConfig]
) -> Callable[..., Config]:
    """Return the maker of a car with front corners and a heat mode.

    What is unknown of its model is given.
    """

    def make(mode: str, *matched: object, **heat: object) -> Config:
        corners = [make_corner(name) for name in ("FL", "FR")]
        return make_car(
            *corners,
            heat={"mode": mode, **heat},
            matched=[*matched],
            forecast={"uncertainty": 1.0},
        )

    return make


def unverified(config: Config, *roles: str) -> Input:
    """Return what nothing checks at any corner of *config*."""
    found = NO_INPUT
    for one in unverified_inputs(
        config, [ROLE_INDEX[role] for role in roles]
    ).values():
        found |= one
    return found


def shipped(name: str) -> Input:
    """Return what nothing checks at any corner of a shipped car."""
    config, signal_map = load_vehicle(CONFIGS / name)
    found = unverified_inputs(config, signal_map.roles())
    assert len(set(found.values())) == 1
    return found["FL"]


def test_of_the_example_car_nothing_is_unverified() -> None:
    assert shipped("example_vehicle.toml") == NO_INPUT


def test_what_verifies_each_input_is_told_in_words() -> None:
    """A row for each input, its corners, and every check that it has."""
    rows = {}
    for name in ("example_vehicle", "subaru_wrx_sti", "toyota_rav4"):
        config, _ = load_vehicle(CONFIGS / f"{name}.toml")
        rows[name] = verification_table(config, config.signals)

    nothing = "nothing: unverified, its corners are degraded"
    speed = "speed", "other speeds and acceleration"
    assert {
        name: [(words, by) for words, _, by in found]
        for name, found in rows.items()
    } == {
        "example_vehicle": [
            speed,
            ("pressure", "motion and torque"),
            ("acceleration", "changes of speed"),
            ("torque", "pressure and motion"),
            ("fluid", f"{STATED}; {THERMOCOUPLES}"),
            ("fluid", STATED),
        ],
        "subaru_wrx_sti": [speed, ("pressure", nothing), ("fluid", nothing)],
        "toyota_rav4": [speed, ("acceleration", nothing), ("fluid", nothing)],
    }
    corners = {where for found in rows.values() for _, where, _ in found}
    assert corners == {"FL FR RL RR", "FL FR", "RL RR"}


def test_feed_back_is_verified_by_the_pressure(
    car: Callable[..., Config],
) -> None:
    """Each of its two motions needs the other one beside it."""
    config = car("fb")

    def verified(roles: Iterable[str]) -> list[tuple[str, ...]]:
        found = verified_by(config, [*roles], "FL")
        return [
            found.get(one, ()) for one in (Input.ACCELERATION, Input.TORQUE)
        ]

    assert verified(THESIS) == [("pressure",), ("pressure",)]
    for missing in ("primary_pressure", *MOTION):
        assert verified({*THESIS} - {missing}) == [(), ()]


def test_the_cars_of_the_recordings_are_unverified() -> None:
    """No torque: neither the pressure nor the acceleration has a witness.

    Nor was either car matched.
    """
    assert shipped("subaru_wrx_sti.toml") == Input.PRESSURE | Input.FLUID
    assert shipped("toyota_rav4.toml") == Input.ACCELERATION | Input.FLUID


@pytest.mark.parametrize(
    ("mode", "roles", "expected"),
    [
        # one speed and one pressure
        (
            "ff",
            ("vehicle_speed", "primary_pressure"),
            Input.SPEED | Input.PRESSURE,
        ),
        # the four of the thesis check each other
        ("fused", THESIS, NO_INPUT),
        # a pressure that reads zero ends both of their sources
        ("ff", THESIS, Input.PRESSURE),
        ("fb", THESIS, Input.PRESSURE),
        # all wheels may be wrong by the same scale
        ("ff", (*WHEELS, "primary_pressure"), Input.SPEED | Input.PRESSURE),
        # one wheel has nothing beside it
        ("fused", (WHEELS[0], *THESIS[4:]), Input.SPEED),
        (
            "fused",
            ("vehicle_speed", "gnss_speed", *THESIS[4:]),
            Input.SPEED,
        ),
        # a switch knows of too much pressure, not of too little
        (
            "ff",
            (*WHEELS, "primary_pressure", MOTION[0], "brake_switch"),
            Input.PRESSURE,
        ),
        # without pressure nothing else has the brakes' force
        ("fb", (*WHEELS, *MOTION), Input.ACCELERATION | Input.TORQUE),
        ("measured", THESIS, Input.TEMPERATURE),
        ("measured", ("temp_fl_disc", "temp_fr_disc"), Input.TEMPERATURE),
        # not every structure has a caliper
        (
            "measured",
            (
                *("temp_fl_disc", "temp_fl_caliper"),
                *("temp_fr_disc", "temp_fr_caliper"),
            ),
            Input.TEMPERATURE,
        ),
        (
            "measured",
            (
                "temp_fl_disc",
                "temp_fl_disc_2",
                "temp_fr_disc",
                "temp_fr_fluid",
            ),
            NO_INPUT,
        ),
    ],
)
def test_what_no_mapped_role_contradicts_is_unverified(
    car: Callable[..., Config],
    mode: str,
    roles: tuple[str, ...],
    expected: Input,
) -> None:
    assert unverified(car(mode), *roles) == expected


def test_a_declared_torque_verifies_nothing(
    car: Callable[..., Config],
) -> None:
    """The pressure could be half and so the heat."""
    config = car("fused", assume_powertrain_torque_nm=0.0)

    assert unverified(config, *THESIS[:-1]) == Input.PRESSURE


def test_a_flat_road_leaves_fusion_without_motion(
    car: Callable[..., Config],
) -> None:
    """Nothing is formed from the motion: nothing is compared with it."""
    config = car("fused", slope="flat")

    assert unverified(config, *THESIS) == (
        Input.SPEED | Input.PRESSURE | Input.TORQUE
    )


def test_a_thermocouple_verifies_no_heat(car: Callable[..., Config]) -> None:
    """The model may be off by 60 K of the disc before it is seen there."""
    roles = "vehicle_speed", "primary_pressure", "temp_fl_disc"

    assert unverified(car("ff"), *roles) == Input.SPEED | Input.PRESSURE


def matched(*nodes: str, corner: str = "FL") -> dict[str, object]:
    """Return ``[[matched]]`` of *corner*, its *nodes* compared."""
    return {
        "corners": [corner],
        "names": ["thermal.disc_mass_correction_factor"],
        "values": [1.0],
        "factor": [[0.1]],
        "form_k": dict.fromkeys(nodes, 1.0),
    }


@pytest.mark.parametrize(
    ("nodes", "more", "expected"),
    [
        (("disc",), (), ()),
        (("disc", "pad_back"), (), ()),
        ((), (), ()),
        (("disc", "fluid"), (), (MATCH,)),
        (("disc", "caliper"), (), (MATCH,)),
        (("disc",), ("temp_fl_fluid",), (THERMOCOUPLES,)),
        # of the other side
        (("disc",), ("temp_fr_fluid",), ()),
    ],
)
def test_a_match_without_the_fluid_leaves_it_unverified(
    car: Callable[..., Config],
    nodes: tuple[str, ...],
    more: tuple[str, ...],
    expected: tuple[str, ...],
) -> None:
    """What leads from the disc to the fluid is as typical as before."""
    config, roles = car("fused", matched(*nodes)), (*THESIS, *more)

    assert verified_by(config, roles, "FL")[Input.FLUID] == expected
    # nobody has matched this one, but its uncertainty is given
    assert verified_by(config, roles, "FR")[Input.FLUID][0] == STATED
    found = unverified_of_car(config, [ROLE_INDEX[role] for role in roles])
    assert found == (NO_INPUT if expected else Input.FLUID)


def test_what_nobody_matched_is_unverified(car: Callable[..., Config]) -> None:
    """But one that has the values of a corner like it."""

    def fluids(*alike: str, nodes: tuple[str, ...]) -> list[tuple[str, ...]]:
        config = car("fused", matched(*nodes) | {"alike": [*alike]})
        unset = config.forecast.model_copy(update={"uncertainty": None})
        config = config.model_copy(update={"forecast": unset})
        return [
            verified_by(config, THESIS, one)[Input.FLUID]
            for one in ("FL", "FR")
        ]

    assert fluids(nodes=("disc", "fluid")) == [(MATCH,), ()]
    assert fluids("FR", nodes=("disc", "fluid")) == [(MATCH,), (MATCH_ALIKE,)]
    assert fluids("FR", nodes=("disc",)) == [(), ()]


@pytest.mark.parametrize(
    ("mode", "nodes", "sound"),
    [
        ("ff", ("disc", "fluid"), False),
        ("fused", ("disc", "fluid"), True),
        ("fused", ("disc",), False),
    ],
)
def test_what_is_unverified_degrades_from_the_start(
    car: Callable[..., Config],
    mode: str,
    nodes: tuple[str, ...],
    *,
    sound: bool,
) -> None:
    """Nothing else is wrong: it is the only reason, and it stays."""
    roles = [ROLE_INDEX[role] for role in THESIS]
    estimator = Estimator(
        car(mode, matched(*nodes)),
        dict.fromkeys(roles, 500_000),
        history_known=True,
    )
    times = array("q")
    for at_us in range(0, 3_000_000, 20_000):
        times.extend([at_us] * len(roles))
    columns = array("i", roles * (len(times) // len(roles)))

    (block,) = estimator.advance(
        times, columns, array("d", [0.0] * len(times))
    )

    expected = Validity.VALID if sound else Validity.DEGRADED
    assert set(block.validity["FL"][1:]) == {expected}
    why = {Reason(code) for code in block.reasons["FL"][1:]}
    assert why == ({Reason(0)} if sound else {Reason.UNVERIFIED})
