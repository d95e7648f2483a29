"""What the estimator says of its own estimates, corner by corner."""

from __future__ import annotations

from array import array
from math import isclose
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.bus.output_layout import Validity
from bstm_daemon.bus.publication import Publication, Snapshot
from bstm_daemon.estimator import DEGRADED, VALID, Estimator
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config import Config, CornerConfig

SECOND = 1_000_000
TIMEOUT_US = 500_000


def validity_of(
    config: Config, values: dict[str, float], silent: str = "", **options: Any
) -> dict[str, list[int]]:
    """Validity over 4 s of held values; *silent* stops after 2 s."""
    roles = {ROLE_INDEX[name]: value for name, value in values.items()}
    estimator = Estimator(config, dict.fromkeys(roles, TIMEOUT_US), **options)
    times, numbers, given = array("q"), array("i"), array("d")
    for at in range(0, 4 * SECOND, 20_000):
        for role, value in roles.items():
            if at < 2 * SECOND or role != ROLE_INDEX.get(silent):
                times.append(at)
                numbers.append(role)
                given.append(value)
    found: dict[str, list[int]] = {}
    for block in estimator.advance(times, numbers, given):
        for name, codes in block.validity.items():
            found.setdefault(name, []).extend(codes)
    return found


@pytest.fixture
def front(
    make_car: Callable[..., Config], make_corner: Callable[..., CornerConfig]
) -> Callable[..., Config]:
    """Return the maker of a car with two front corners."""

    def make(circuit: str = "primary", **sections: Any) -> Config:
        corners = [make_corner(n, circuit=circuit) for n in ("FL", "FR")]
        return make_car(*corners, **sections)

    return make


def test_one_silent_wheel_pressure_degrades_its_corner_only(
    front: Callable[..., Config],
) -> None:
    """A brake that is not seen is not valid because another one is."""
    found = validity_of(
        front(),
        {
            "vehicle_speed": 20.0,
            "wheel_pressure_fl": 2e6,
            "wheel_pressure_fr": 2e6,
        },
        silent="wheel_pressure_fl",
        history_known=True,
    )

    assert found["FL"][5] == VALID
    assert found["FL"][-1] == DEGRADED
    assert set(found["FR"][1:]) == {VALID}


def test_the_secondary_circuit_is_enough_for_its_corners(
    front: Callable[..., Config],
) -> None:
    """Corners of the secondary circuit need no primary pressure."""
    found = validity_of(
        front("secondary"),
        {"vehicle_speed": 20.0, "secondary_pressure": 1e6},
        history_known=True,
    )

    assert set(found["FL"][1:]) == {VALID}


def test_a_lost_thermocouple_degrades_a_measured_disc(
    front: Callable[..., Config],
) -> None:
    """In mode measured a disc that is free again is an assumption."""
    found = validity_of(
        front(heat={"mode": "measured"}),
        {
            "vehicle_speed": 20.0,
            "primary_pressure": 0.0,
            "temp_fl_disc": 500.0,
            "temp_fr_disc": 500.0,
        },
        silent="temp_fl_disc",
        history_known=True,
    )

    assert found["FL"][5] == VALID
    assert found["FL"][-1] == DEGRADED
    assert found["FR"][-1] == VALID


def test_an_unknown_start_is_felt_as_long_as_the_slowest_lump(
    front: Callable[..., Config],
) -> None:
    """A single exponential, 150 K to 5 K: ln 30 time constants."""
    slow = {
        "fluid_caliper_thermal_capacity_j_k": 4000.0,
        "fluid_static_convection_w_k": 0.5,
        # nothing but the fluid is slow, and nothing but air takes its heat
        "pad_backplate_thermal_resistance_m2k_w": 1e3,
    }
    cooling = {"speed_ms": [0.0, 10.0], "s_per_s": [5e-3, 5e-3]}
    estimator = Estimator(front(thermal=slow, cooling=cooling), {})

    # the pads give their heat to nothing here but the disc
    expected_s = 4000.0 / 0.5 * 3.4012
    assert isclose(estimator.settling_s, expected_s, rel_tol=0.01)


def test_a_drum_is_published_as_not_available() -> None:
    """It is there, and says that it has no model; the status ignores it."""
    publication = Publication(["FL", "RL"], 0x5B0, modelled=["FL"])

    frames = {f.name: f for f in publication.encode(Snapshot(0, {}))}

    assert "BSTM_RL_Temperatures" in frames
    assert frames["BSTM_RL_Temperatures"].data[1] >> 4 == (
        Validity.NOT_AVAILABLE
    )
