"""Packaged cars: what differs from the nominal one."""

from dataclasses import fields

import pytest

from bstm_daemon.errors import ConfigError, UsageError
from bstm_daemon.simulation import NOMINAL, load_vehicle, vehicle_names
from bstm_daemon.simulation.vehicle import parse_vehicle, scaled_car


def test_packaged_cars() -> None:
    assert vehicle_names() == ["half-worn", "nominal", "second"]
    assert load_vehicle("nominal") == NOMINAL


def test_half_worn_differs_in_its_pads_only() -> None:
    worn = load_vehicle("half-worn")
    changed = {
        f.name
        for f in fields(worn.front)
        if getattr(worn.front, f.name) != getattr(NOMINAL.front, f.name)
    }

    assert changed == {"pad_thickness_m", "friction_coefficient"}
    # half-way between 11 mm and the 2 mm of a worn pad
    assert worn.front.pad_thickness_m == pytest.approx(6.5e-3)


def test_second_has_the_same_disc_and_another_pad_and_caliper() -> None:
    second = load_vehicle("second")

    for name in ("ring_mass_kg", "face_area_m2", "cheek_thickness_m"):
        assert getattr(second.front, name) == getattr(NOMINAL.front, name)
    assert second.front.shim_resistance_m2k_w > 4.5e-3
    assert second.front.hammerhead_forced_w_k < 0.015
    assert second.front.body_capacity_j_k < NOMINAL.front.body_capacity_j_k
    left, right, *_ = second.corners
    assert left.friction_coefficient > right.friction_coefficient
    assert left.caliper_natural_w_k < right.caliper_natural_w_k
    # left and right together are the car's brake
    assert second.gains.sum() == pytest.approx(NOMINAL.gains.sum())


def test_unknown_car_lists_the_known() -> None:
    with pytest.raises(UsageError, match="half-worn"):
        load_vehicle("third")


def test_unknown_key_is_named() -> None:
    text = "[car]\nmass = 3.0\n[front]\npads = 2.0\n"

    with pytest.raises(ConfigError) as caught:
        parse_vehicle(text, "mine.toml")

    assert "mine.toml: car.mass" in str(caught.value)
    assert "mine.toml: front.pads" in str(caught.value)


def test_scale_multiplies() -> None:
    car = scaled_car(NOMINAL, {"front": {"vent_area_m2": 1.5}}, "d")

    assert car.front.vent_area_m2 == pytest.approx(0.225)
    assert car.rear == NOMINAL.rear
    with pytest.raises(ConfigError, match=r"drive\.scale\.rear\.air"):
        scaled_car(NOMINAL, {"rear": {"air": 1.5}}, "d")
