"""The brake corner as a network: what is heated, conducts, is refused."""

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.config.sections import Config, CornerConfig, DiscConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.model.thermal.brake_corner import (
    CornerSpec,
    build_corner,
    cooling_beyond,
    corner_spec,
)
from bstm_daemon.model.thermal.network import Network
from bstm_daemon.model.thermal.properties import (
    GREY_IRON_HEAT_CAPACITY_J_KGK,
    GREY_IRON_SMOOTH_HEAT_CAPACITY_J_KGK,
    PURE_IRON_HEAT_CAPACITY_J_KGK,
    REFERENCE_K,
    disc_heat_capacity,
)

INPUTS = ("speed_ms", "brake_on", "ambient_k", "brake_power_w")
MakeSpec = Callable[..., CornerSpec]
PAD = {"area_m2": 6.5e-3, "thickness_m": 0.011}


def no_network(net: Network, spec: CornerSpec) -> Network:
    """Stand in for a disc builder that forgets the node ``disc``."""
    del spec
    return net


def source_heats(net: Network, pad_front_k: float) -> dict[str, float]:
    """Return the heat of each source per watt of brake power."""
    heats = {}
    for source in net.sources:
        heats[source.name] = source.gain
        for factor in source.factors:
            if factor.table is not None:
                assert factor.a == "pad_front"
                heats[source.name] *= factor.table(pad_front_k)
    return heats


@pytest.mark.parametrize(
    ("x", "y", "speed_ms", "expected"),
    [
        # 4 to 9 is to the power 0.585 of 10 to 40
        ((0.0, 10.0, 40.0), (1.0, 4.0, 9.0), 80.0, 9.0 * 2.0**0.58496),
        # never steeper than proportional to the speed
        ((0.0, 10.0, 20.0), (1.0, 1.0, 9.0), 40.0, 18.0),
        # one that falls, or from 0, is held
        ((0.0, 10.0, 20.0), (1.0, 5.0, 4.0), 40.0, 4.0),
        ((0.0, 10.0, 20.0), (0.0, 0.0, 4.0), 40.0, 4.0),
        # of a straight line from rest the slope at its end goes on
        ((0.0, 20.0), (1.0, 4.0), 40.0, 4.0 * 2.0**0.75),
        ((0.0, 20.0), (4.0, 4.0), 40.0, 4.0),
    ],
)
def test_cooling_goes_on_as_a_power_of_the_speed(
    x: tuple[float, ...],
    y: tuple[float, ...],
    speed_ms: float,
    expected: float,
) -> None:
    assert cooling_beyond(x, y, speed_ms) == pytest.approx(expected, rel=1e-4)
    assert cooling_beyond(x, y, x[-1]) == pytest.approx(y[-1])


@pytest.mark.parametrize("exponent", [0.0, 0.5, 2.0])
def test_a_heat_capacity_bends_about_its_value_at_the_reference(
    exponent: float,
) -> None:
    plain = DiscConfig(mass_kg=7.0, swept_area_m2=0.06, total_area_m2=0.2)
    disc = plain.model_copy(update={"heat_capacity_exponent": exponent})
    straight = disc_heat_capacity(plain)

    found = disc_heat_capacity(disc)

    first = straight(REFERENCE_K)
    assert found(REFERENCE_K) == pytest.approx(first, rel=1e-3)
    for kelvin in (straight.x0, straight.x0 + 20.0 * straight.dx):
        ratio = straight(kelvin) / first
        assert found(kelvin) == pytest.approx(first * ratio**exponent)


@pytest.mark.parametrize(
    ("structure", "configured", "capacity_j_k"),
    [
        # two plates of 6 mm of steel, on 1.15 times the lining
        ("extended", 0.0, 2.0 * 6.5e-3 * 1.15 * 6e-3 * 7850.0 * 480.0),
        ("extended", 500.0, 500.0),
        ("thesis", 0.0, 0.0),
    ],
)
def test_a_backplate_has_the_heat_of_its_steel(
    make_spec: MakeSpec,
    structure: str,
    configured: float,
    capacity_j_k: float,
) -> None:
    spec = make_spec(
        {"pad": PAD},
        thermal={
            "structure": structure,
            "backplate_thermal_capacity_j_k": configured,
        },
    )

    (plate,) = (
        node
        for node in build_corner(spec, INPUTS).nodes
        if node.name == "backplate"
    )

    assert plate.capacity_j_k == pytest.approx(capacity_j_k, rel=0.01)


@given(
    pad_k=st.floats(250.0, 1200.0),
    air=st.floats(0.0, 1.0),
    gamma=st.floats(0.0, 5.0),
    factor=st.floats(0.0, 1.0),
)
def test_every_joule_of_brake_power_is_booked(
    make_spec: MakeSpec, pad_k: float, air: float, gamma: float, factor: float
) -> None:
    """Disc, pads, air and what "dissolves" are the whole at any setting."""
    spec = make_spec(
        thermal={
            "direct_air_fraction": air,
            "heat_partition_correction_factor": gamma,
            "hot_pad_factor": factor,
        }
    )
    heats = source_heats(build_corner(spec, INPUTS), pad_k)
    assert sum(heats.values()) == pytest.approx(1.0)
    assert all(heat >= 0.0 for heat in heats.values())
    assert heats["air_heat"] == pytest.approx(air)


def test_hot_pads_take_sixty_percent(make_spec: MakeSpec) -> None:
    """Section 5.2.2: below 390 C all, above 410 C 0.6, the disc untouched."""
    net = build_corner(make_spec(), INPUTS)
    cold, hot = source_heats(net, 660.0), source_heats(net, 690.0)
    assert hot["pad_heat"] == pytest.approx(0.6 * cold["pad_heat"])
    assert hot["disc_heat"] == cold["disc_heat"]
    assert cold["hot_pad_reduction"] == 0.0


@pytest.mark.parametrize("cells", ["half", "full"])
@pytest.mark.parametrize("slabs", [1, 10, 60])
def test_lining_keeps_mass_and_resistance(
    make_spec: MakeSpec, cells: str, slabs: int
) -> None:
    """Any mesh has the pad's heat capacity; half cells its resistance."""
    spec = make_spec({"pad": {**PAD, "slabs": slabs, "surface_cells": cells}})
    net = build_corner(spec, INPUTS)
    lumps = [n for n in net.nodes if n.name.startswith("pad_")]
    assert len(lumps) == slabs + 2
    capacity = sum(n.capacity_j_k for n in lumps)
    assert capacity == pytest.approx(2300.0 * 1000.0 * 0.013 * 0.011)
    chain = [k for k in net.links if k.b.startswith("pad_") and "-" in k.name]
    resistance = sum(1.0 / k.conductance_w_k for k in chain)
    path = 0.011 if cells == "half" else 0.011 * (slabs + 1) / (slabs + 2)
    assert resistance == pytest.approx(path / (1.2 * 0.013))


def test_shim_and_plate_hold_the_configured_resistance(
    make_spec: MakeSpec,
) -> None:
    """R of Eq 4.18 is per area of the pads, from pad back to fluid."""
    net = build_corner(make_spec(), INPUTS)
    both = sum(
        1.0 / net.link(name).conductance_w_k
        for name in ("pad_back-backplate", "shim")
    )
    assert both == pytest.approx(4e-3 / 0.013)


@pytest.mark.parametrize(
    ("celsius", "expected"), [(20, 460), (100, 490), (500, 650), (750, 1100)]
)
def test_grey_iron(celsius: float, expected: float) -> None:
    """Handbook points, the peak included, are hit."""
    table = GREY_IRON_HEAT_CAPACITY_J_KGK
    assert table(celsius + 273.15) == pytest.approx(expected)


def test_grey_iron_without_its_peak() -> None:
    """The same to 600 C, then on as it rose."""
    table = GREY_IRON_SMOOTH_HEAT_CAPACITY_J_KGK
    for celsius in range(20, 601, 20):
        both = (
            table(celsius + 273.15),
            GREY_IRON_HEAT_CAPACITY_J_KGK(celsius + 273.15),
        )
        assert both[0] == pytest.approx(both[1])
    assert table(750 + 273.15) == pytest.approx(835.0)


def test_pure_iron() -> None:
    """The thesis's line through 449 at 20 C and 685 at 500 C."""
    table = PURE_IRON_HEAT_CAPACITY_J_KGK
    assert table(293.15) == pytest.approx(449.0)
    assert table(773.15) == pytest.approx(685.0)


def test_own_curves(make_spec: MakeSpec) -> None:
    """A curve for disc and lining reaches nodes and links."""
    curve = {"temperature_c": [0.0, 500.0], "value": [400.0, 900.0]}
    conductivity = {"temperature_c": [0.0, 500.0], "value": [1.0, 2.0]}
    spec = make_spec(
        {
            "disc": {
                "mass_kg": 5.0,
                "swept_area_m2": 0.085,
                "total_area_m2": 0.2,
                "material": "own",
                "heat_capacity_j_kgk": curve,
            },
            "pad": {**PAD, "conductivity_w_mk": conductivity},
        }
    )
    net = build_corner(spec, INPUTS)
    disc = net.node("disc").capacity_table
    assert disc is not None
    assert disc(523.15) == pytest.approx(650.0)
    lining = net.link("pad_1-pad_2").factors[0]
    assert (lining.kind, lining.a, lining.b) == ("mean", "pad_1", "pad_2")
    assert lining.table is not None
    assert lining.table(523.15) == pytest.approx(1.5)


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 2.0])
def test_hammerhead_exponent(make_spec: MakeSpec, exponent: float) -> None:
    """The factor v^n of h v^n A at a speed of the table's grid."""
    spec = make_spec(thermal={"pad_dynamic_convection_exponent": exponent})
    (factor,) = build_corner(spec, INPUTS).link("hammerhead").factors
    value = 16.0 if factor.table is None else factor.table(16.0)
    assert value == pytest.approx(16.0**exponent)


@pytest.mark.parametrize("structure", ["thesis", "extended"])
@pytest.mark.parametrize(
    ("exponent", "at_5_ms", "at_80_ms"),
    [(0.5, 10.0, 40.0), (1.0, 5.0, 80.0), (2.0, 1.25, 320.0)],
)
def test_the_wind_at_the_caliper_is_a_power_about_20_ms(
    structure: str,
    exponent: float,
    at_5_ms: float,
    at_80_ms: float,
    make_spec: MakeSpec,
) -> None:
    """A match moves it: where it may, exponent 1 has a table as well."""
    spec = make_spec(
        thermal={
            "fluid_dynamic_convection_exponent": exponent,
            "structure": structure,
        }
    )
    (factor,) = build_corner(spec, INPUTS).link("fluid_dynamic").factors
    if factor.table is None:
        assert (structure, exponent) == ("thesis", 1.0)
        return
    assert factor.table(5.0) == pytest.approx(at_5_ms)
    assert factor.table(20.0) == pytest.approx(20.0)
    assert factor.table(80.0) == pytest.approx(at_80_ms)


def test_correction_factors(make_spec: MakeSpec) -> None:
    """Mass factor on the disc, gamma on the pads' share only."""
    plain = build_corner(make_spec(), INPUTS)
    tuned = build_corner(
        make_spec(
            thermal={
                "disc_mass_correction_factor": 1.2,
                "heat_partition_correction_factor": 1.5,
            }
        ),
        INPUTS,
    )
    assert tuned.node("disc").capacity_j_k == pytest.approx(1.2 * 7.5)
    assert tuned.source("pad_heat").gain == pytest.approx(
        1.5 * plain.source("pad_heat").gain
    )


@pytest.mark.parametrize(
    ("model", "named"),
    [
        ("lumpd", "lumped"),
        ("no_such_module:f", "no_such_module"),
        ("math:no_such_function", "no_such_function"),
        ("math:pi", "no function"),
        ("os:getcwd", "failed with TypeError"),
        ("builtins:divmod", "failed with TypeError"),
        ("operator:is_", "returned bool, not a Network"),
        (":f", "module:function"),
        (".relative:f", "module:function"),
    ],
)
def test_unknown_builder(make_spec: MakeSpec, model: str, named: str) -> None:
    """The message names corner, key and what is allowed."""
    disc: dict[str, Any] = {
        "model": model,
        "mass_kg": 7.5,
        "swept_area_m2": 0.085,
        "total_area_m2": 0.2,
    }
    with pytest.raises(ConfigError, match=named) as caught:
        build_corner(make_spec({"disc": disc}), INPUTS)
    assert "[[corner]] FL disc.model" in str(caught.value)


def test_builder_without_its_node(
    make_spec: MakeSpec, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forcing a disc that is not there names the corner."""
    monkeypatch.setattr(
        "bstm_daemon.model.thermal.brake_corner.DISC_MODELS",
        {"lumped": no_network},
    )
    with pytest.raises(ConfigError, match="FL: no node 'disc'"):
        build_corner(make_spec(), INPUTS, force_measured=True)


def test_too_much_heat_for_the_pads(make_spec: MakeSpec) -> None:
    """More than all of the heat is a configuration error."""
    spec = make_spec(thermal={"heat_partition_correction_factor": 500.0})
    with pytest.raises(ConfigError, match="FL: heat_partition"):
        build_corner(spec, INPUTS)


def test_drum_has_no_model(
    make_car: Callable[..., Config], make_corner: Callable[..., CornerConfig]
) -> None:
    """A drum corner is refused by name."""
    drum = make_corner("RL", type="drum", disc=None, pad=None)
    with pytest.raises(ConfigError, match="RL: a drum is not modelled"):
        corner_spec(make_car(drum), drum)
