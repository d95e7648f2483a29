"""Each effect of the catalogue: absent at 0, signature, conservation."""

from __future__ import annotations

from math import exp
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.model.effects.catalogue import effect_class, effect_names

if TYPE_CHECKING:
    from collections.abc import Callable

    from .conftest import Corner

    Make = Callable[..., Corner]

INPUTS_ONLY = {
    *("pushout_pressure", "hydraulic_lag", "brake_share", "mass_error"),
    *("powertrain_torque_error", "accelerometer_bias"),
    *("friction_fade", "friction_speed", "friction_pressure"),
    "brake_without_pressure",
}
"""Effects that leave the network of a corner as it is."""

EVERY = pytest.mark.parametrize(
    "name",
    [
        name
        for name in effect_names()
        if effect_class(name).kind != "measurement"
        and not INPUTS_ONLY & {name}
    ],
)


def tour(corner: Corner) -> Corner:
    """Begin hot, brake hard, roll in the rain, brake again, park."""
    lump = {"fluid", "caliper"} & set(corner.nodes())
    corner.warm(**dict.fromkeys(lump, 411.0))
    corner.warm(disc=1030.0, pad_front=720.0, pad_1=690.0)
    corner.drive(60, 30e3, speed_ms=20.0, pressure_pa=3e6)
    corner.drive(30, wetness=1.0, speed_ms=25.0)
    return corner.drive(60, 10e3).drive(300, speed_ms=0.0)


@pytest.fixture(scope="session")
def base(corner: Make) -> dict[str, float]:
    """Return the nodes of a corner without an effect after the tour."""
    return tour(corner(None)).nodes()


@EVERY
def test_strength_zero_is_absence(
    corner: Make, base: dict[str, float], name: str
) -> None:
    """Not a bit of any node differs."""
    assert tour(corner(name, strength=0.0)).nodes() == base


@EVERY
def test_typical_strength_shows_and_conserves(
    corner: Make, base: dict[str, float], name: str
) -> None:
    """Something moves by more than 0.1 K, and the ledger closes."""
    there = tour(corner(name))
    found = there.nodes()
    assert max(abs(found[k] - base[k]) for k in base) > 0.1
    ledger = there.ledger()
    assert abs(ledger.residual) < 1e-9 * ledger.generated


@EVERY
def test_stronger_moves_further(
    corner: Make, base: dict[str, float], name: str
) -> None:
    """More strength goes the same way, further, somewhere."""
    once, twice = (tour(corner(name, strength=s)).nodes() for s in (0.5, 1.0))
    ratios = [
        (twice[k] - base[k]) / (once[k] - base[k])
        for k in base
        if abs(once[k] - base[k]) > 0.1
    ]
    assert max(ratios) > 1.05


def test_wet_disc_only_when_wet_and_rolling(corner: Make) -> None:
    """Dry or parked: not a joule. Wet: with speed, more above boiling."""

    def evaporated(disc_k: float, speed: float, wetness: float) -> float:
        there = corner("wet_disc").warm(disc=disc_k)
        there.drive(0.25, speed_ms=speed, wetness=wetness)
        return there.ledger().links["wet_disc"] / (disc_k - 283.15)

    assert evaporated(600.0, 25.0, 0.0) == 0.0
    assert evaporated(600.0, 0.0, 1.0) == 0.0
    # 5 W/K at 25 m/s above boiling, a quarter of it below 80 C
    hot = evaporated(600.0, 25.0, 1.0)
    assert hot == pytest.approx(5.0 * 0.25, rel=2e-3)
    assert evaporated(600.0, 12.5, 1.0) == pytest.approx(hot / 2, rel=2e-3)
    assert evaporated(600.0, 25.0, 0.5) == pytest.approx(hot / 2, rel=2e-3)
    assert evaporated(340.0, 25.0, 1.0) == pytest.approx(hot / 4, rel=2e-3)


def test_wet_disc_cools_the_disc_first(corner: Make) -> None:
    """The disc leads; the fluid hardly knows after a minute."""
    base, wet = (
        corner(name).warm(disc=600.0).drive(60, speed_ms=25.0, wetness=1.0)
        for name in (None, "wet_disc")
    )
    assert base["disc"] - wet["disc"] > 15.0
    assert abs(base["fluid"] - wet["fluid"]) < 1.0


def test_contact_conducts_while_pressed(corner: Make) -> None:
    """h_c A (Td - Tp) p^0.95 under pressure; not a joule released."""

    def crossed(pressure_pa: float) -> float:
        there = corner("contact_conductance", conductance_w_m2k=30.0)
        there.warm(**dict.fromkeys(there.nodes(), 400.0) | {"disc": 500.0})
        there.drive(0.25, pressure_pa=pressure_pa)
        return there.ledger().links["contact_conductance"]

    # the pad's face warms a little within the step
    expected = 30.0 * 0.013 * 100.0 * 0.25
    assert crossed(1e6) == pytest.approx(expected, rel=6e-3)
    assert crossed(2e6) / crossed(1e6) == pytest.approx(2.0**0.95, rel=6e-3)
    assert crossed(0.0) == 0.0


def test_contact_evens_the_temperatures_in_a_long_drag(corner: Make) -> None:
    """The hotter disc gives to the pads: no constant share."""
    base, there = (
        corner(name).drive(1200, 6e3) for name in (None, "contact_conductance")
    )
    assert base["disc"] > base["pad_front"]
    assert there["disc"] < base["disc"]
    assert there["pad_front"] > base["pad_front"]


def test_friction_falls_with_the_heat_taken_up(corner: Make) -> None:
    """Heat of a run: E0-weighted closed form; the third run is flat."""
    there = corner("friction_history").drive(0.25, 20e3)
    assert there.ledger().generated == pytest.approx(5e3, rel=1e-3)
    there = corner("friction_history")
    power, energies, before = 20e3, [], 0.0
    for _ in range(3):
        there.drive(500, power)
        energies.append(there.ledger().generated - before)
        before += energies[-1]
        there.drive(3600, speed_ms=25.0)
    # mu/mu0 = 1 - 0.33 (1 - exp(-E/E0)), E = P t of the unchanged friction
    taken, bedding = power * 500.0, 5e6
    faded = bedding * (1.0 - exp(-taken / bedding))
    assert energies[0] == pytest.approx(
        taken - 0.33 * (taken - faded), rel=1e-3
    )
    assert energies[0] > energies[1] > energies[2]
    assert energies[2] == pytest.approx(0.67 * taken, rel=0.01)


def test_friction_scales_all_heat_alike(corner: Make) -> None:
    """Disc and pads keep their shares: all input in proportion."""
    there = corner("friction_history").drive(100, 20e3)
    base = corner(None).drive(100, 20e3)
    ours, theirs = there.ledger().sources, base.ledger().sources
    ratio = ours["disc_heat"] / theirs["disc_heat"]
    assert ratio < 0.97
    assert ours["pad_heat"] / theirs["pad_heat"] == pytest.approx(ratio)


def test_friction_leaves_measured_power_alone(corner: Make) -> None:
    """Feed-Back has measured the heat: there is nothing to correct."""
    base = corner(None).drive(100, 20e3)
    there = corner("friction_history", from_pressure=False).drive(100, 20e3)
    assert there.nodes() == base.nodes()


def test_pyrolysis_happens_once(corner: Make) -> None:
    """A sink in the pad's face, its heat bounded, gone on a second run."""
    there, base = corner("pad_pyrolysis"), corner(None)
    sinks, lags = [], []
    for _ in range(2):
        before = there.ledger().sources["pyrolysis_heat"]
        for one in (there, base):
            one.drive(900, 9e3)
        sinks.append(there.ledger().sources["pyrolysis_heat"] - before)
        lags.append(base["pad_front"] - there["pad_front"])
        for one in (there, base):
            one.drive(7200, speed_ms=25.0)
    assert base["disc"] < 300.0
    assert -3.5e4 < sinks[0] < -2.4e4
    assert abs(sinks[1]) < 0.4 * abs(sinks[0])
    assert lags[0] > 2.0 * lags[1] > 0.0
    # heat and decomposed share are the same integral
    total = there.ledger().sources["pyrolysis_heat"]
    assert total == pytest.approx(-3.5e4 * there["pyrolysis"], rel=1e-6)


def test_no_pyrolysis_below_its_onset(corner: Make) -> None:
    """Up to 340 C nothing decomposes."""
    there = corner("pad_pyrolysis").drive(900, 6e3)
    assert 450.0 < there["pad_front"] < 613.0
    assert there["pyrolysis"] == 0.0


def test_pyrolysis_sets_in_over_60_k(corner: Make) -> None:
    """Half its rate at 370 degC, none 30 K below, all of it 30 K above."""
    net = corner("pad_pyrolysis").program.network
    (memory,) = net.memories
    onset = memory.factors[0].table
    assert onset is not None
    for above_k, share in ((-30.0, 0.0), (15.0, 0.75), (30.0, 1.0)):
        at_k = 370.0 + 273.15 + above_k
        assert onset(at_k) == pytest.approx(share, abs=1e-9)


def test_a_split_that_is_as_good_as_none_is_none(corner: Make) -> None:
    there = corner("caliper_fluid_split", strength=1e-7)

    assert there.program == corner(None).program


def test_shim_is_loose_only_when_released(corner: Make) -> None:
    """Pressed above 3 bar nothing changes; released 65 % is left."""

    def into_fluid(name: str | None, pressure_pa: float) -> float:
        there = corner(
            name, thermal={"backplate_thermal_capacity_j_k": 1e6}
        ).warm(backplate=450.0, fluid=300.0)
        there.drive(0.25, pressure_pa=pressure_pa)
        return there.ledger().links["shim"]

    pressed = into_fluid(None, 5e5)
    assert into_fluid("shim_contact", 5e5) == pressed
    assert into_fluid("shim_contact", 0.0) == pytest.approx(
        0.65 * into_fluid(None, 0.0), rel=1e-3
    )
    half = into_fluid("shim_contact", 1.5e5)
    assert half == pytest.approx(0.825 * pressed, rel=1e-3)


def test_fluid_and_caliper_part(corner: Make) -> None:
    """The fluid is ahead of the caliper by what flows over the coupling."""
    there = corner("caliper_fluid_split", coupling_w_k=10.0)
    there.drive(899, 6e3)
    before = there["fluid"]
    there.drive(1, 6e3)
    base = corner(None).drive(900, 6e3)
    lead = there["fluid"] - there["caliper"]
    net = there.program.network
    shim = net.link("shim").conductance_w_k
    flow = shim * (there["backplate"] - there["fluid"])
    own = net.node("fluid").capacity_j_k * (there["fluid"] - before)
    assert lead == pytest.approx((flow - own) / 10.0, rel=1e-3)
    assert lead > 1.0
    assert there["pad_back"] > base["pad_back"] + 1.0
    whole = sum(net.node(n).capacity_j_k for n in ("fluid", "caliper"))
    assert whole == base.program.network.node("fluid").capacity_j_k


def test_losses_start_at_the_caliper(corner: Make) -> None:
    """All but the shim has moved, the hammerheads' sink included."""
    there = corner("caliper_fluid_split", thermal={"hammerhead_sink": "fluid"})
    net = there.program.network
    touching = {k.name for k in net.links if "fluid" in (k.a, k.b)}
    assert touching == {"shim", "fluid-caliper"}
    assert net.link("hammerhead").b == "caliper"
