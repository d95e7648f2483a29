"""Strengths other than 1: so much more or less of what an effect does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.model.effects.catalogue import (
    edited_inputs,
    effect_class,
    effect_names,
)
from bstm_daemon.model.effects.entries.wet_disc import WetDisc
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.heat.friction_law import friction_factor
from bstm_daemon.model.thermal.brake_corner import CornerSpec, build_corner

from .conftest import INPUTS

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Corner

    Make = Callable[..., Corner]

PROPORTIONAL = {
    "backplate_loss": ("conductance_w_k",),
    "ambient_heat_soak": ("excess_k",),
    "bracket_conduction": ("conductance_w_k",),
    "caliper_bypass": ("conductance_w_k",),
    "caliper_radiation": ("area_m2",),
    "contact_conductance": ("conductance_w_m2k",),
    "convection_exponent": ("exponent",),
    "disc_caliper_radiation": ("view_m2",),
    "disc_capacity_hot": ("peak_j_kgk",),
    "disc_hat": ("conductance_w_k",),
    "disc_wear": ("lost_share",),
    "engine_heat": ("caliper_w",),
    "fluid_exchange": ("line_w_k", "pumping_w_k"),
    "fluid_latent_heat": ("heat_j",),
    "cooling_band": ("loss",),
    "friction_history": ("drop",),
    "friction_in_stop": ("rise",),
    "gap_conduction": ("conductance_w_m2k",),
    "hub_conduction": ("conductance_w_k",),
    "hub_heat": ("torque_nm",),
    "layer_opening": ("loss",),
    "pad_capacity": ("rise_per_k",),
    "pad_conductivity": ("rise",),
    "pad_pyrolysis": ("heat_j",),
    "pad_wear": ("worn_m",),
    "residual_drag": ("torque_nm", "contact_w_m2k"),
    "shim_contact": ("loss",),
    "speed_dependent_convection": ("conductance_w_k",),
    "wet_disc": ("evaporation_w_k",),
}
"""Effects on the network: what the strength multiplies."""

INVERSE = {
    "caliper_fluid_split": ("piston_w_k", "finger_w_k", "coupling_w_k"),
    "local_air": ("opening_m2", "parked_w_k"),
}
"""What it divides: a resistance is absent at 0."""

LAWS = {
    "friction_fade": ("drop",),
    "friction_pressure": ("exponent",),
    "friction_speed": ("exponent",),
}

SENSORS = ("thermocouple_lag",)
"""Tested with the inputs; the network has no part in them."""

OF_INPUTS = {
    "accelerometer_bias": ("bias_ms2",),
    "brake_share": ("share",),
    "hydraulic_lag": ("primary_s", "secondary_s"),
    "mass_error": ("share",),
    "powertrain_torque_error": ("share", "offset_nm"),
    "pushout_pressure": ("pressure_pa",),
    "thermocouple_offset": ("offset_k", "gain"),
    "clock_offset": ("offset_s", "drift_s_h"),
}

WITHOUT = {"brake_without_pressure", "disc_radiation_driving"}
"""The strength is all it has."""


def times(name: str, keys: tuple[str, ...], factor: float) -> dict[str, float]:
    """Return *keys* of the effect *name*, *factor* times the typical."""
    typical = {p.name: p.typical for p in effect_class(name).parameters()}
    return {key: factor * typical[key] for key in keys}


def test_every_effect_is_here() -> None:
    groups = (PROPORTIONAL, INVERSE, LAWS, SENSORS, OF_INPUTS, WITHOUT)
    names = [name for group in groups for name in group]

    assert sorted(names) == sorted(effect_names())


def toured(corner: Corner) -> dict[str, float]:
    """Brake from hot, roll in the rain, brake again, park."""
    lump = {"fluid", "caliper"} & set(corner.nodes())
    corner.warm(**dict.fromkeys(lump, 411.0))
    corner.warm(disc=1030.0, pad_front=720.0, pad_1=690.0)
    corner.drive(30, 30e3, speed_ms=20.0, pressure_pa=3e6)
    corner.drive(30, wetness=1.0, speed_ms=25.0)
    return corner.drive(30, 10e3).drive(200, speed_ms=0.0).nodes()


@pytest.mark.parametrize("name", [*PROPORTIONAL, *INVERSE])
def test_strength_is_a_factor_on_the_network(corner: Make, name: str) -> None:
    """Half the strength: half the conductance, or twice."""
    factor, keys = 0.5, PROPORTIONAL.get(name)
    if keys is None:
        factor, keys = 2.0, INVERSE[name]
    half = toured(corner(name, strength=0.5))

    assert half == pytest.approx(
        toured(corner(name, **times(name, keys, factor))), abs=1e-6
    )
    whole = toured(corner(name))
    assert max(abs(half[node] - whole[node]) for node in half) > 0.05


def law_of(
    make_spec: Callable[..., CornerSpec], name: str, **parameters: float
) -> list[float]:
    """Return the tables of the friction law with the effect *name*."""
    spec = make_spec()
    model = CornerModel(spec, build_corner(spec, INPUTS), True)
    return effect_class(name)(parameters).apply(model).friction.numbers()


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("strength", [0.5, 1.5])
def test_strength_is_a_factor_on_the_law(
    make_spec: Callable[..., CornerSpec], name: str, strength: float
) -> None:
    found = law_of(make_spec, name, strength=strength)

    scaled = times(name, LAWS[name], strength)
    assert found == law_of(make_spec, name, **scaled)
    assert found != law_of(make_spec, name)


@pytest.mark.parametrize(
    ("strength", "between_c", "factor"),
    [
        (0.5, 440.0, 0.93),
        (0.5, 700.0, 0.86),
        (2.0, 330.0, 1.0),
        (2.0, 440.0, 0.72),
        (2.0, 700.0, 0.44),
        (5.0, 700.0, 0.1),
    ],
)
def test_friction_fades_by_its_strength(
    make_spec: Callable[..., CornerSpec],
    strength: float,
    between_c: float,
    factor: float,
) -> None:
    """28 % over 180 K from 350 degC on, times the strength; 10 % is left."""
    law = law_of(make_spec, "friction_fade", strength=strength)

    found = friction_factor(law, between_c + 273.15, 1e6, 10.0)
    assert found == pytest.approx(factor, abs=0.01)


@pytest.mark.parametrize("name", OF_INPUTS)
def test_strength_is_a_factor_on_the_inputs(
    make_car: Any, make_corner: Any, name: str
) -> None:
    """Configuration and corrections, as of a typical effect so much off."""

    def edited(**parameters: float) -> tuple[dict[str, Any], Any, Any]:
        config = make_car(
            *(make_corner(n) for n in ("FL", "FR")),
            *(make_corner(n, circuit="secondary") for n in ("RL", "RR")),
            vehicle={"front_share": 0.7},
            heat={"mode": "fb", "slope": "accelerometer"},
            effect=[{"name": name, "parameters": parameters}],
        )
        found = edited_inputs(config)
        return (
            found.config.model_dump(exclude={"effect"}),
            found.corrections,
            found.clock_late,
        )

    half = edited(strength=0.5)
    assert half == edited(**times(name, OF_INPUTS[name], 0.5))
    assert half != edited()


def conductance_w_k(corner: Corner, link: str, **phase: float) -> float:
    """Return what *link* conducts over one step, per kelvin of the disc."""
    before = corner.ledger().links[link]
    corner.drive(0.25, **phase)
    flow_w = (corner.ledger().links[link] - before) / 0.25
    return flow_w / (corner["disc"] - 283.15)


@pytest.mark.parametrize(
    ("speed_ms", "factor"),
    [
        # (v / 10)^0.18, and below 5 m/s on to 1 at rest
        (0.0, 1.0),
        (1.0, 1.0 + 0.2 * (0.5**0.18 - 1.0)),
        (2.5, 1.0 + 0.5 * (0.5**0.18 - 1.0)),
        (5.0, 0.5**0.18),
        (10.0, 1.0),
        (40.0, 4.0**0.18),
    ],
)
def test_convection_with_another_power_of_speed(
    corner: Make, speed_ms: float, factor: float
) -> None:
    base, there = (
        conductance_w_k(
            corner(name).warm(disc=500.0), "disc_convection", speed_ms=speed_ms
        )
        for name in (None, "convection_exponent")
    )
    assert there / base == pytest.approx(factor, rel=1e-3)


def test_spray_at_every_speed(corner: Make) -> None:
    """5 W/K at 25 m/s above boiling, in proportion up to 50 m/s."""
    parameters = {p.name: p.typical for p in WetDisc.parameters()}
    assert parameters["evaporation_w_k"] == 5.0
    for strength, speed_ms, w_k in (
        (1.0, 5.0, 1.0),
        (1.0, 25.0, 5.0),
        (1.0, 40.0, 8.0),
        (1.0, 50.0, 10.0),
        (1.0, 70.0, 10.0),
        (0.4, 40.0, 3.2),
    ):
        there = corner("wet_disc", strength=strength).warm(disc=600.0)
        found = conductance_w_k(
            there, "wet_disc", speed_ms=speed_ms, wetness=1.0
        )
        assert found == pytest.approx(w_k, rel=3e-3)


@pytest.mark.parametrize("strength", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(
    ("pressed_rise", "brake_on", "w_k"),
    [(0.5, 0.0, 0.4), (0.5, 1.0, 0.6), (2.0, 0.0, 0.4), (2.0, 1.0, 1.2)],
)
def test_the_bracket_is_pressed_by_as_much_as_it_is_said(
    corner: Make,
    strength: float,
    pressed_rise: float,
    brake_on: float,
    w_k: float,
) -> None:
    """0.4 W/K of the ears, and so much of it more with the brake held."""
    there = corner(
        "bracket_conduction",
        thermal={"backplate_thermal_capacity_j_k": 1e6},
        strength=strength,
        pressed_rise=pressed_rise,
    ).warm(backplate=400.0)
    there.drive(0.25, speed_ms=0.0, pressure_pa=brake_on * 1e6)
    flow_w = there.ledger().links["bracket_conduction"] / 0.25
    excess_k = there["backplate"] - there["bracket"]
    assert flow_w == pytest.approx(strength * w_k * excess_k, rel=5e-3)
