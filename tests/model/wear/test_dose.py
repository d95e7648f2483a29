"""The wear dose: Table 2.1, Fig 2.7, Eq 2.13."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.channels import CHANNELS
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.wear.dose import (
    DISTANCE,
    DOSE,
    disc_rate_m_j,
    hot_wear,
    pad_rate_m_j,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.config.sections import Config
    from bstm_daemon.native.loader import Kernel

MASS_KG = 2194.0
STEP_S = 0.05


def stop(
    car: Config, kernel: Kernel | None, speed_ms: float, **inputs: float
) -> dict[str, float]:
    """Brake FL evenly from *speed_ms* to 0 in 3 s, from 20 degC on."""
    batch = Batch([compile_corner(car, car.corner[0])], 293.15, [0], kernel, 1)
    steps = round(3.0 / STEP_S)
    rows = array("d")
    for step in range(steps):
        v = speed_ms * (1.0 - (step + 0.5) / steps)
        row = dict.fromkeys(CHANNELS, 0.0) | {
            "speed_ms": v,
            "brake_on": 1.0,
            "ambient_k": 293.15,
            "brake_power_w": 0.35 * MASS_KG * speed_ms / 3.0 * v,
            **inputs,
        }
        row |= {name: float("nan") for name in row if "measured" in name}
        rows.extend(row.values())
    batch.march(rows, steps, STEP_S)
    names = batch.programs[0].state_names
    return dict(zip(names, batch.state, strict=True))


@pytest.mark.parametrize(
    ("faster_kmh", "slower_kmh", "ratio"),
    [(40.0, 33.0, 1.469), (60.0, 40.0, 2.250), (60.0, 33.0, 3.306)],
)
def test_wear_goes_with_the_square_of_the_speed(
    make_car: Callable[..., Config],
    kernel: Kernel | None,
    faster_kmh: float,
    slower_kmh: float,
    ratio: float,
) -> None:
    """Table 2.1 with its columns the right way round: both ratios are v^2."""
    car = make_car()
    doses = [
        stop(car, kernel, kmh / 3.6)[DOSE] for kmh in (faster_kmh, slower_kmh)
    ]

    assert doses[0] / doses[1] == pytest.approx(ratio, abs=0.002)


def test_the_dose_of_a_cool_brake_is_its_friction_energy(
    make_car: Callable[..., Config], kernel: Kernel | None
) -> None:
    state = stop(make_car(), kernel, 20.0)

    assert state[DOSE] == pytest.approx(0.35 * MASS_KG * 20.0**2 / 2, rel=1e-3)
    assert state[DISTANCE] == pytest.approx(30.0)


def test_a_hot_face_wears_more(make_car: Callable[..., Any]) -> None:
    """Fig 2.7: no more up to 320 degC, steeply above, with an end."""
    weight = hot_wear(make_car().wear)

    assert weight(300.0) == 1.0
    assert weight(320.0 + 273.15) == 1.0
    assert weight(410.0 + 273.15) == pytest.approx(2.0, rel=1e-3)
    assert weight(500.0 + 273.15) == pytest.approx(4.0, rel=1e-3)
    # held where measurements end, however hot the model becomes
    assert weight(590.0 + 273.15) == weight(1500.0) == weight(3000.0) == 8.0


@pytest.mark.parametrize(
    ("doubling_k", "limit", "half_k"),
    [(90.0, 10.0, 90.0), (1000.0, 1.0, 500.0), (10.0, 1.5, 2.5)],
)
def test_the_weight_ends_at_its_limit(
    make_car: Callable[..., Any],
    doubling_k: float,
    limit: float,
    half_k: float,
) -> None:
    hot = {"hot_doubling_k": doubling_k, "hot_limit": limit}
    weight = hot_wear(make_car(wear=hot).wear)

    assert 1.0 <= weight(320.0 + 273.15 + half_k) <= limit
    assert weight(weight.x1 - 5.1) < limit or limit == 1.0
    assert weight(weight.x1) == weight(1e6) == limit


def test_no_temperature_wears_more_than_the_limit_allows(
    make_car: Callable[..., Any], kernel: Kernel | None
) -> None:
    """A brake that glows white: at most 8 times its energy."""
    car = make_car()
    energy_j = 0.35 * MASS_KG * 90.0**2 / 2

    dose_j = stop(car, kernel, 90.0)[DOSE]

    assert energy_j < dose_j <= 8.0 * energy_j


def test_archard_counts_pressure_times_sliding_speed(
    make_car: Callable[..., Any], kernel: Kernel | None
) -> None:
    """Eq 2.13: K p v t, from pressure and speed, whatever the heat is."""
    car = make_car(wear={"law": "archard"})
    corner = car.corner[0]
    speed_ms, pressure_pa = 20.0, 3.0e6

    state = stop(car, kernel, speed_ms, pressure_pa=pressure_pa)
    worn_m = pad_rate_m_j(car, corner) * state[DOSE]

    contact_pa = pressure_pa * corner.piston_area_m2 / corner.pad.area_m2
    slid_m = 30.0 * corner.effective_radius_m / car.vehicle.wheel_radius_m
    k_1_pa = 0.38 * 3e-13  # friction coefficient times the lining loss
    assert worn_m == pytest.approx(k_1_pa * contact_pa * slid_m, rel=1e-3)


def test_both_laws_agree_where_the_heat_is_of_the_pressure(
    make_car: Callable[..., Any], kernel: Kernel | None
) -> None:
    """Torque times wheel speed is both the heat and mu p v A."""
    pressure_pa = 3.0e6
    torque_nm = 2.0 * pressure_pa * 2.83e-3 * 0.38 * 0.13
    energy_j = torque_nm / 0.3418 * 30.0

    state = stop(
        make_car(wear={"law": "archard"}), kernel, 20.0, pressure_pa=3.0e6
    )

    assert state[DOSE] == pytest.approx(energy_j, rel=1e-3)


def test_rates_are_volumes_over_areas(make_car: Callable[..., Any]) -> None:
    car = make_car()

    assert pad_rate_m_j(car, car.corner[0]) == pytest.approx(3e-13 / 13e-3)
    assert disc_rate_m_j(car, car.corner[0]) == pytest.approx(1e-13 / 42.5e-3)
    bare = car.corner[0].model_copy(update={"pad": None, "disc": None})
    with pytest.raises(ValueError, match="corner FL: no pads"):
        pad_rate_m_j(car, bare)
    with pytest.raises(ValueError, match="corner FL: no disc"):
        disc_rate_m_j(car, bare)
