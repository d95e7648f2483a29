"""What each effect of the network moves, which way, and where it rests."""

from __future__ import annotations

from math import exp, tanh
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.model.effects.catalogue import effect_class
from bstm_daemon.units import STEFAN_BOLTZMANN_W_M2K4

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Corner

    Make = Callable[..., Corner]

AMBIENT_K = 283.15
PADS_M2 = 0.013
FREE_M2 = 0.2 - PADS_M2
Phase = dict[str, float]

BRAKED: Phase = {"seconds": 300.0, "power_w": 8e3}
FAST: Phase = {"seconds": 60.0, "speed_ms": 30.0}
SLOW: Phase = {"seconds": 60.0, "speed_ms": 6.0}
PARKED: Phase = {"seconds": 600.0, "speed_ms": 0.0}
HOT_DISC: Phase = {"disc": 900.0}
HOT_FLUID: Phase = {"fluid": 430.0}
HOT_PADS: Phase = {"pad_front": 700.0, "pad_1": 690.0, "pad_2": 680.0}

MOVES: list[tuple[str, Phase, Phase, dict[str, int]]] = [
    ("gap_conduction", HOT_DISC, PARKED, {"disc": -1, "pad_front": 1}),
    ("gap_conduction", HOT_DISC, FAST, {"disc": -1, "pad_front": 1}),
    ("gap_conduction", HOT_DISC, BRAKED, {"disc": 0, "fluid": 0}),
    ("disc_capacity_hot", {"disc": 980.0}, BRAKED | {"power_w": 3e4},
     {"disc": -1}),
    ("disc_capacity_hot", {"disc": 1060.0}, FAST, {"disc": 1}),
    ("disc_capacity_hot", {"disc": 600.0}, FAST, {"disc": 0}),
    ("disc_radiation_driving", HOT_DISC, FAST, {"disc": -1}),
    ("disc_radiation_driving", HOT_DISC, PARKED, {"disc": 0}),
    ("convection_exponent", HOT_DISC, FAST, {"disc": -1}),
    ("convection_exponent", HOT_DISC, SLOW, {"disc": 1}),
    ("convection_exponent", HOT_DISC, FAST | {"speed_ms": 10.0},
     {"disc": 0}),
    ("local_air", HOT_DISC, PARKED, {"disc": 1, "pad_back": 1, "fluid": 1}),
    ("local_air", HOT_DISC, SLOW, {"disc": 1, "fluid": 1}),
    ("hub_conduction", HOT_DISC, PARKED, {"disc": -1}),
    ("disc_wear", {}, BRAKED, {"disc": 1}),
    ("disc_wear", HOT_DISC, FAST, {"disc": -1}),
    ("disc_hat", {}, BRAKED, {"disc": -1, "fluid": -1}),
    ("pad_conductivity", HOT_PADS, PARKED | {"seconds": 5.0},
     {"pad_front": -1}),
    ("pad_conductivity", {"pad_front": 320.0}, SLOW, {"pad_front": 1}),
    ("pad_capacity", {}, BRAKED, {"pad_front": 1, "disc": -1}),
    ("pad_capacity", HOT_PADS, PARKED, {"pad_front": 1}),
    ("pad_wear", {}, BRAKED, {"pad_back": 1, "fluid": 1}),
    ("backplate_loss", HOT_PADS, PARKED, {"pad_back": -1, "fluid": -1}),
    ("bracket_conduction", {}, BRAKED, {"pad_back": -1, "fluid": -1}),
    ("caliper_bypass", {}, BRAKED, {"pad_back": -1, "fluid": 1}),
    ("disc_caliper_radiation", HOT_DISC, PARKED, {"disc": -1, "fluid": 1}),
    ("caliper_radiation", HOT_FLUID, PARKED, {"fluid": -1}),
    ("fluid_exchange", HOT_FLUID, PARKED, {"fluid": -1}),
    ("fluid_latent_heat", {"fluid": 418.0}, PARKED, {"fluid": 1}),
    ("fluid_latent_heat", {"fluid": 360.0}, PARKED, {"fluid": 0}),
    ("speed_dependent_convection", HOT_DISC, FAST, {"disc": -1}),
    ("speed_dependent_convection", HOT_DISC, PARKED, {"disc": 0}),
    ("residual_drag", {}, FAST, {"disc": 1, "pad_front": 1}),
    ("residual_drag", HOT_DISC, PARKED, {"disc": 0}),
    ("residual_drag", {}, BRAKED, {"disc": 0}),
    ("hub_heat", {}, FAST | {"seconds": 600.0}, {"disc": 1}),
    ("hub_heat", {}, PARKED, {"disc": 0}),
    ("engine_heat", {}, FAST | {"seconds": 600.0}, {"fluid": 1}),
    ("engine_heat", {}, PARKED, {"fluid": 0}),
    ("friction_in_stop", {}, PARKED, {"disc": 0}),
    ("layer_opening", HOT_PADS | {"pad_back": 520.0, "backplate": 520.0},
     PARKED | {"seconds": 60.0}, {"fluid": -1, "pad_back": 1}),
    ("layer_opening", {"backplate": 340.0}, PARKED, {"fluid": 0}),
    ("cooling_band", HOT_DISC, FAST | {"speed_ms": 20.0}, {"disc": 1}),
    ("cooling_band", HOT_DISC, FAST | {"speed_ms": 45.0}, {"disc": 0}),
    ("friction_in_stop", {}, BRAKED, {"disc": 1}),
    ("friction_in_stop", HOT_DISC, FAST, {"disc": 0}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "warm", "phase", "expected"), MOVES)
def test_moves(
    corner: Make,
    name: str,
    warm: Phase,
    phase: dict[str, Any],
    expected: dict[str, int],
) -> None:
    """Each node by more than 10 mK, or by less than 10 uK where it rests."""
    base, there = (
        corner(one).warm(**warm).drive(**phase) for one in (None, name)
    )
    for node, sign in expected.items():
        moved = there[node] - base[node]
        if sign:
            assert sign * moved > 0.01, node
        else:
            assert abs(moved) < 1e-5, node


def flow_w(corner: Corner, link: str, **phase: float) -> float:
    """Return the heat flow [W] of *link* over one step of 0.25 s."""
    before = corner.ledger().links[link]
    corner.drive(0.25, **phase)
    return (corner.ledger().links[link] - before) / 0.25


def test_gap_is_a_conductance(corner: Make) -> None:
    """Of both pads: the difference times the conductivity of air, not T^4.

    130 W/m2K at 500 K; air has 0.0303 W/mK at 350 K, 0.0407 at 500 K and
    0.0476 at 610 K.
    """
    for disc_k, conductivity in ((380.0, 0.0303), (900.0, 0.0476)):
        there = corner("gap_conduction")
        there.warm(**dict.fromkeys(there.nodes(), 320.0) | {"disc": disc_k})
        found = flow_w(there, "gap_conduction", speed_ms=0.0)
        exact = 130.0 * conductivity / 0.0407 * PADS_M2 * (disc_k - 320.0)
        assert found == pytest.approx(exact, rel=0.05)


def test_the_bracket_takes_more_while_the_brake_is_held(corner: Make) -> None:
    flows = []
    for pressure_pa in (0.0, 0.75e6):
        there = corner("bracket_conduction").warm(backplate=400.0)
        found = flow_w(
            there,
            "bracket_conduction",
            speed_ms=0.0,
            pressure_pa=pressure_pa,
        )
        flows.append(found)
    assert flows[1] == pytest.approx(1.5 * flows[0], rel=0.02)


def test_disc_radiates_by_stefan_and_boltzmann(corner: Make) -> None:
    """At speed eps sigma A T^4; the blend divides it below 18 km/h."""
    for speed, share in ((20.0, 1.0), (2.5, 0.5)):
        there = corner("disc_radiation_driving").warm(disc=900.0)
        found = flow_w(there, "disc_radiation_driving", speed_ms=speed)
        grey = STEFAN_BOLTZMANN_W_M2K4 * 0.55 * FREE_M2
        exact = share * grey * (900.0**4 - AMBIENT_K**4)
        assert found == pytest.approx(exact, rel=5e-3)


def test_disc_radiates_from_what_sees_the_surroundings(corner: Make) -> None:
    """Parked and driving alike; the effect's strength is of driving."""
    for link, speed, strength in (
        ("disc_radiation", 0.0, 1.0),
        ("disc_radiation_driving", 20.0, 0.5),
    ):
        there = corner(
            "disc_radiation_driving",
            strength=0.5,
            thermal={"disc_view_factor": 0.6},
        ).warm(disc=900.0)
        found = flow_w(there, link, speed_ms=speed)
        grey = STEFAN_BOLTZMANN_W_M2K4 * 0.55 * 0.6 * FREE_M2
        exact = strength * grey * (900.0**4 - AMBIENT_K**4)
        assert found == pytest.approx(exact, rel=5e-3)


def test_radiation_is_whole_at_any_speed(corner: Make) -> None:
    """Base model and effect together: one law, no step in the blend."""
    found = []
    for speed in (0.0, 1.0, 4.0, 30.0):
        there = corner("disc_radiation_driving").warm(disc=900.0)
        first = there.ledger().links
        there.drive(0.25, speed_ms=speed)
        links = there.ledger().links
        found.append(
            sum(
                links[k] - first[k]
                for k in ("disc_radiation", "disc_radiation_driving")
            )
        )
    assert found == pytest.approx([found[0]] * 4, rel=2e-3)


def test_air_of_the_wheel_house(corner: Make) -> None:
    """Warmer by what all parts give it over what the wind carries off."""
    there = corner("local_air").warm(disc=900.0)
    there.drive(60, speed_ms=10.0)
    rise = there["air"] - AMBIENT_K
    carried = flow_w(there, "air_exchange", speed_ms=10.0)
    wind = (13.0**2 + (0.02 * 1210.0 * 10.0) ** 2) ** 0.5
    assert carried == pytest.approx(wind * rise, rel=1e-2)
    net = there.program.network
    into = {k.name for k in net.links if k.b == "air"}
    assert into >= {"disc_convection", "hammerhead", "fluid_static"}
    assert net.link("disc_radiation").b == "ambient"


def test_order_of_entries_does_not_matter(
    make_spec: Callable[..., Any],
) -> None:
    """What moves links comes last, what makes nodes comes first."""
    from bstm_daemon.config.sections import EffectConfig  # noqa: PLC0415
    from bstm_daemon.model.effects.catalogue import apply_effects  # noqa: PLC0415
    from bstm_daemon.model.effects.model import CornerModel  # noqa: PLC0415
    from bstm_daemon.model.thermal.brake_corner import (  # noqa: PLC0415
        build_corner,
    )

    inputs = (
        *("speed_ms", "brake_on", "ambient_k", "brake_power_w"),
        *("pressure_pa", "wetness"),
    )
    spec = make_spec()
    base = CornerModel(spec, build_corner(spec, inputs), True)
    names = [
        *("local_air", "disc_hat", "disc_caliper_radiation"),
        *("caliper_fluid_split", "backplate_loss", "caliper_radiation"),
        *("hub_conduction", "ambient_heat_soak"),
    ]
    ends = []
    for order in (names, names[::-1]):
        entries = [EffectConfig(name=name) for name in order]
        net = apply_effects(base, entries).network
        ends.append({k.name: (k.a, k.b) for k in net.links})
    assert ends[0] == ends[1]
    assert ends[0]["hat_convection"] == ("hat", "air")
    assert ends[0]["backplate_loss"] == ("backplate", "air")
    assert ends[0]["disc_caliper_radiation"] == ("disc", "caliper")
    assert ends[0]["fluid_static"] == ("caliper", "air")


def test_disc_radiates_to_what_the_caliper_shows_it(corner: Make) -> None:
    """32 cm2 of it, with the disc's emissivity."""
    there = corner("disc_caliper_radiation", thermal={"disc_emissivity": 0.3})
    there.warm(disc=900.0)

    found = flow_w(there, "disc_caliper_radiation", speed_ms=0.0)

    seen = 3.2e-3 * 0.3 * STEFAN_BOLTZMANN_W_M2K4
    expected = seen * (900.0**4 - AMBIENT_K**4)
    assert found == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize(
    ("speed_ms", "w_m2k"), [(0.0, 5.0), (20.0, 75.0), (130.0, 425.0)]
)
def test_wind_cools_the_hat(
    corner: Make, speed_ms: float, w_m2k: float
) -> None:
    """5 W/m2K at rest and 3.5 more for each m/s, up to 120 m/s."""
    there = corner("disc_hat").warm(hat=500.0)

    found = flow_w(there, "hat_convection", speed_ms=speed_ms)

    expected = 0.06 * w_m2k * (500.0 - AMBIENT_K)
    assert found == pytest.approx(expected, rel=5e-3)


def test_hub_gives_back_late(corner: Make) -> None:
    """After half an hour of wind the hub is warmer than the disc."""
    there = corner("hub_conduction").warm(disc=900.0)
    there.drive(1800, speed_ms=25.0)
    assert there["hub"] > there["disc"] + 5.0


def test_worn_disc_keeps_what_it_gives_off(corner: Make) -> None:
    """8 % less mass, the same W/K: the rate of cooling rises by 8.7 %."""
    base, worn = (
        corner(name).warm(disc=500.0) for name in (None, "disc_wear")
    )
    flows = [
        flow_w(one, "disc_convection", speed_ms=20.0) for one in (base, worn)
    ]
    assert flows[1] == pytest.approx(flows[0], rel=1e-3)
    nodes = [one.program.network.node("disc") for one in (base, worn)]
    assert nodes[1].capacity_j_k == pytest.approx(0.92 * nodes[0].capacity_j_k)


def test_worn_pads_are_thinner(corner: Make) -> None:
    """6.5 of 11 mm left: capacity in proportion, conductance inverse."""
    nets = [corner(name).program.network for name in (None, "pad_wear")]
    left = 6.5 / 11.0
    for node in ("pad_front", "pad_1", "pad_back"):
        ratio = (
            nets[1].node(node).capacity_j_k / nets[0].node(node).capacity_j_k
        )
        assert ratio == pytest.approx(left)
    slab = [net.link("pad_1-pad_2").conductance_w_k for net in nets]
    assert slab[1] / slab[0] == pytest.approx(1.0 / left)
    worn = corner("pad_wear", strength=5.0).program.network
    assert worn.link("pad_1-pad_2").conductance_w_k == pytest.approx(
        11.0 * slab[0]  # 1 mm is left of it at least
    )
    shim = [net.link("shim").conductance_w_k for net in nets]
    assert shim[1] == shim[0]


@pytest.mark.parametrize("name", ["pad_capacity", "pad_conductivity"])
def test_linings_share_goes_with_their_effusivity(
    corner: Make, name: str
) -> None:
    """Eq 2.3 at the face's temperature; what the pads gain the disc loses."""
    face_k = 573.15
    # 9e-4 a kelvin over 280 K; 22 % at 180 K above 220 degC
    relative = {
        "pad_capacity": 1.0 + 9e-4 * 280.0,
        "pad_conductivity": 1.0 + 0.22 * 80.0 / 180.0,
    }[name]
    there = corner(name)
    there.warm(**dict.fromkeys(there.nodes(), face_k)).drive(0.25, 2e3)
    share = 1.0 - there.spec.disc_share
    ratio = relative**0.5
    expected = share * ratio / (1.0 - share + share * ratio)
    sources = there.ledger().sources
    pads = sources["pad_heat"] + sources[f"{name}_pads"]
    assert pads / there.ledger().generated == pytest.approx(expected, rel=2e-3)
    assert sources[f"{name}_pads"] == -sources[f"{name}_disc"]
    assert there.ledger().generated == pytest.approx(2e3 * 0.25)


@pytest.mark.parametrize("wanted", [0.5, 5.0])
def test_a_linings_conductivity_stays_above_0(
    corner: Make, wanted: float
) -> None:
    """22 % each way and up to five times that; a fifth is left at least."""
    net = corner("pad_conductivity", strength=wanted).program.network
    (factor,) = net.link("pad_1-pad_2").factors
    assert factor.table is not None
    low, middle, high = factor.table.values
    assert low == pytest.approx(max(1.0 - 0.22 * wanted, 0.2))
    assert (middle, high) == (1.0, pytest.approx(1.0 + 0.22 * wanted))


def test_conductivity_of_a_cold_lining_may_be_as_configured(
    corner: Make,
) -> None:
    """One form has k so at 50 degC, and the usual slope above."""
    (form,) = (
        one
        for one in effect_class("pad_conductivity").forms
        if one["middle_c"] == 50.0
    )
    net = corner("pad_conductivity", **form).program.network
    (factor,) = net.link("pad_1-pad_2").factors
    assert factor.table is not None
    at = {c: factor.table(c + 273.15) for c in (50.0, 230.0)}
    assert at[50.0] == pytest.approx(1.0)
    # 22 % in 180 K
    assert at[230.0] == pytest.approx(1.22, abs=0.002)


def test_a_disc_that_takes_more_leaves_the_linings_less(
    corner: Make,
) -> None:
    """Eq 2.3 of a disc with another cp: its effusivity, not the linings'."""
    there = corner("disc_capacity_hot")
    centre_k = 755.0 + 273.15
    there.warm(**dict.fromkeys(there.nodes(), centre_k)).drive(0.25, 2e3)
    cp = corner(None).program.network.node("disc").capacity_table
    assert cp is not None
    share = 1.0 - there.spec.disc_share
    ratio = (1.0 + 380.0 / cp(centre_k)) ** -0.5
    sources = there.ledger().sources
    left = 1.0 + sources["disc_capacity_hot_pads"] / sources["pad_heat"]
    assert left == pytest.approx(
        ratio / (1.0 - share + share * ratio), rel=5e-3
    )


def test_pumping_cools_the_fluid(corner: Make) -> None:
    """0.4 W/K for each MPa/s: pulses cool more than the same held."""
    found, fluid_k = [], 0.0
    for pulses in (True, False):
        there = corner("fluid_exchange").warm(fluid=430.0)
        for _ in range(60):
            first, second = (4e6, 0.0) if pulses else (2e6, 2e6)
            there.drive(1, speed_ms=0.0, pressure_pa=first)
            there.drive(1, speed_ms=0.0, pressure_pa=second)
        found.append(there.ledger().links["fluid_pumping"])
        fluid_k = there["fluid"] if pulses else fluid_k
    assert found[0] > 20.0 * found[1] > 0.0
    # 120 jumps of 4 MPa, each followed for two time constants
    excess = 0.5 * (430.0 + fluid_k) - AMBIENT_K
    expected = 120 * 0.4 * 4.0 * tanh(1.0) * excess
    assert found[0] == pytest.approx(expected, rel=0.1)


def test_boiling_takes_its_heat_and_gives_it_back(corner: Make) -> None:
    """8 kJ between 126 and 150 degC, up and down."""
    capacity = corner("fluid_latent_heat").program.network.node("fluid")
    table = capacity.capacity_table
    assert table is not None
    base_j_k = capacity.capacity_j_k
    taken = base_j_k * (
        table.integral(430.0) - table.integral(390.0) - (430.0 - 390.0)
    )
    assert taken == pytest.approx(8e3, rel=1e-3)


def test_drag_is_torque_times_turns(corner: Make) -> None:
    """35 % of 5 Nm when cold, all of it hot, shared as friction heat."""
    speed = 20.0
    for pad_k, share in ((293.15, 0.35), (403.15, 1.0), (600.0, 1.0)):
        factor = 1.7
        thermal = {"heat_partition_correction_factor": factor}
        there = corner("residual_drag", thermal=thermal)
        there.warm(**dict.fromkeys(there.nodes(), pad_k))
        there.drive(0.25, speed_ms=speed)
        sources = there.ledger().sources
        found = (
            sources["residual_drag_disc"] + sources["residual_drag_pads"]
        ) / 0.25
        assert found == pytest.approx(share * 5.0 * speed / 0.33, rel=2e-2)
        pads = sources["residual_drag_pads"] / (0.25 * found)
        assert pads == pytest.approx((1.0 - there.spec.disc_share) * factor)


def test_pads_that_rub_are_heated_by_the_disc(corner: Make) -> None:
    """100 W/m2K: hot pads all of it, cold ones 35 %."""
    for pad_k, share in ((293.15, 0.35), (403.15, 1.0)):
        there = corner("residual_drag", contact_w_m2k=100.0)
        nodes = dict.fromkeys(there.nodes(), pad_k)
        there.warm(**nodes | {"disc": pad_k + 200.0})
        there.drive(0.25, speed_ms=0.0)
        found = there.ledger().links["rubbing"] / (0.25 * 200.0 * PADS_M2)
        assert found == pytest.approx(share * 100.0, rel=0.02)


def test_heat_of_the_engine_comes_and_goes_with_the_drive(
    corner: Make,
) -> None:
    """60 W after 10 min, half of it after 5, 37 % after 10 min at rest."""
    there = corner("engine_heat")
    watts = []
    for seconds, speed in ((300.0, 10.0), (900.0, 10.0), (600.0, 0.0)):
        there.drive(seconds, speed_ms=speed)
        before = there.ledger().sources["engine_caliper"]
        there.drive(0.25, speed_ms=speed)
        watts.append(
            (there.ledger().sources["engine_caliper"] - before) / 0.25
        )
    assert watts == pytest.approx([30.0, 60.0, 60.0 * 0.3679], rel=2e-3)


def test_hub_heat_follows_the_turns_late(corner: Make) -> None:
    """5 Nm times the turns, 63 % of it after 5 min; parked it goes on."""
    for exponent, share in ((0.0, 0.5), (1.0, 0.25)):
        there = corner("hub_heat", exponent=exponent, time_s=300.0)
        watts = []
        for seconds, speed in ((300.0, 10.0), (2000.0, 10.0), (150.0, 0.0)):
            there.drive(seconds, speed_ms=speed)
            before = there.ledger().sources["hub_heat"]
            there.drive(0.25, speed_ms=speed)
            watts.append((there.ledger().sources["hub_heat"] - before) / 0.25)
        whole = share * 5.0 * 20.0 / 0.33
        late = [1.0 - 0.3679, 1.0, 0.6065]
        expected = [whole * x ** (1.0 + exponent) for x in late]
        assert watts == pytest.approx(expected, rel=2e-3)


def test_layers_open_and_stay_open_where_latched(corner: Make) -> None:
    """40 % less shim above 160 degC; cold again, less or whole."""
    for latched, again in ((0.0, 1.0), (1.0, 0.6)):
        left = []
        for kelvin in (360.0, 520.0, 360.0):
            if not left:
                there = corner("layer_opening", latched=latched)
                base = corner(None)
            shims = []
            for one in (there, base):
                one.warm(**dict.fromkeys(one.nodes(), kelvin))
                # fluid behind, so that heat flows
                one.warm(fluid=kelvin - 50.0)
                one.drive(0.25)
                flow = flow_w(one, "shim")
                shims.append(flow / (one["backplate"] - one["fluid"]))
            left.append(shims[0] / shims[1])
        assert left == pytest.approx([1.0, 0.6, again], abs=0.02)


def test_cooling_is_lost_around_one_speed(corner: Make) -> None:
    """35 % at 20 m/s, 1/e of it six further; flat within the band alone."""
    for flat, shares in (
        (0.0, (0.65, 1.0 - 0.35 / 2.718, 1.0)),
        (1.0, (0.65, 0.65, 1.0)),
    ):
        for speed, left in zip((20.0, 25.9, 45.0), shares, strict=True):
            flows = [
                flow_w(one.warm(disc=600.0), "disc_convection", speed_ms=speed)
                for one in (corner("cooling_band", flat=flat), corner(None))
            ]
            assert flows[0] / flows[1] == pytest.approx(left, abs=0.01)


def test_friction_rises_with_the_seconds_of_a_stop(corner: Make) -> None:
    """15 % (1 - exp(-t / 3 s)), anew in each stop, either sign."""
    for strength in (1.0, -1.0):
        there = corner("friction_in_stop", strength=strength)
        for _ in range(2):
            before = there.ledger().generated
            there.drive(9.0, 10e3)
            taken = there.ledger().generated - before
            risen = 9.0 - 3.0 * (1.0 - 2.71828**-3.0)
            expected = 10e3 * (9.0 + strength * 0.15 * risen)
            assert taken == pytest.approx(expected, rel=5e-3)
            held = there["stop_length"]
            assert held == pytest.approx(1.0 - exp(-3.0), rel=2e-3)
            there.drive(2.0)
            assert there["stop_length"] == pytest.approx(
                held * exp(-1.0), rel=5e-3
            )
            there.drive(20.0)
    measured = corner("friction_in_stop", from_pressure=False).drive(9.0, 1e4)
    assert measured.nodes() == corner(None).drive(9.0, 1e4).nodes()
    assert "stop_length" not in measured.program.state_names


def test_a_turning_disc_knocks_the_pads_back(corner: Make) -> None:
    """Of the parked gap's conductance 40 % is left, driving."""
    flows = []
    for speed in (0.0, 1.0, 20.0):
        there = corner("gap_conduction", turning_share=0.4)
        there.warm(disc=500.0, pad_front=400.0)
        flows.append(flow_w(there, "gap_conduction", speed_ms=speed))
    assert flows[1:] == pytest.approx([0.4 * flows[0]] * 2, rel=0.02)


@pytest.mark.parametrize(("exponent", "ratio"), [(0.95, 3.73), (0.0, 1.0)])
def test_contact_grows_with_the_pressure_or_not(
    corner: Make, exponent: float, ratio: float
) -> None:
    """10 W/m2K at 1 MPa, times 4^0.95 at 4 MPa; alike through debris."""
    flows = []
    for pressure_pa in (1e6, 4e6):
        there = corner(
            "contact_conductance", exponent=exponent, conductance_w_m2k=10.0
        )
        pads = {"disc": 500.0}
        there.warm(**dict.fromkeys(there.nodes(), 400.0) | pads)
        flows.append(
            flow_w(
                there,
                "contact_conductance",
                pressure_pa=pressure_pa,
                speed_ms=0.0,
            )
        )
    assert flows[0] == pytest.approx(10.0 * PADS_M2 * 100.0, rel=0.01)
    assert flows[1] / flows[0] == pytest.approx(ratio, rel=0.01)


def test_backplates_lose_half_by_radiation(corner: Make) -> None:
    """0.22 W/K; of the half that radiates 4 T^3 is that of 400 K."""
    for kelvin in (350.0, 500.0):
        there = corner("backplate_loss", radiated_share=0.5)
        everywhere = dict.fromkeys(there.nodes(), kelvin)
        flows = [
            flow_w(there.warm(**everywhere).drive(0.25), link, speed_ms=0.0)
            for link in ("backplate_loss", "backplate_radiation")
        ]
        glow = (kelvin**4 - AMBIENT_K**4) / (4.0 * 400.0**3)
        exact = [0.11 * (kelvin - AMBIENT_K), 0.11 * glow]
        assert flows == pytest.approx(exact, rel=0.02)


def test_hot_air_beside_the_piston_conducts_better(corner: Make) -> None:
    """0.5 W/K at 500 K; air has 0.0303 W/mK at 350 K and 0.0407 at 500 K."""
    for kelvin, conductivity in ((350.0, 0.0303), (500.0, 0.0407)):
        there = corner("caliper_bypass", air_share=1.0)
        behind = {"fluid": kelvin - 10.0}
        there.warm(**dict.fromkeys(there.nodes(), kelvin + 10.0) | behind)
        there.drive(0.25)
        flow = flow_w(there, "caliper_bypass", speed_ms=0.0)
        conductance = flow / (there["backplate"] - there["fluid"])
        exact = 0.5 * conductivity / 0.0407
        assert conductance == pytest.approx(exact, rel=0.04)


@pytest.mark.parametrize("unchanged_ms", [10.0, 25.0])
def test_convection_is_as_measured_at_its_speed(
    corner: Make, unchanged_ms: float
) -> None:
    """Above it rises as v^0.18, and below it falls."""
    for speed in (12.0, 25.0, 50.0):
        flows = [
            flow_w(one.warm(disc=600.0), "disc_convection", speed_ms=speed)
            for one in (
                corner("convection_exponent", unchanged_ms=unchanged_ms),
                corner(None),
            )
        ]
        exact = (speed / unchanged_ms) ** 0.18
        assert flows[0] / flows[1] == pytest.approx(exact, rel=2e-3)
