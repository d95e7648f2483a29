"""What a thermocouple below the friction face reads."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.matching.march import (
    initial_temperatures,
    march,
)
from bstm_daemon.analysis.matching.thermocouples import (
    InDisc,
    InPad,
    lagged,
    lining_of,
    node_at,
    placements,
    thermocouples_of,
)
from bstm_daemon.config.sections import Config, EffectConfig, SignalConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.model.thermal.network import Network, Node
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.tunables import Target


LINING = Network(
    (),
    tuple(
        Node(name, 1.0, depth_m=depth_m)
        for name, depth_m in [
            ("disc", None),
            ("pad_front", 0.001),
            ("pad_1", 0.003),
            ("pad_2", 0.005),
            ("pad_back", 0.007),
        ]
    ),
)
"""Whole cells, whose middles the nodes are."""


@pytest.mark.parametrize(
    ("depth_m", "kelvin"),
    [(0.0, 400.0), (0.002, 380.0), (0.0055, 312.5), (0.008, 290.0)],
)
def test_between_slabs_the_reading_is_between(
    depth_m: float, kelvin: float
) -> None:
    kelvins = [500.0, 400.0, 360.0, 320.0, 290.0]
    at_k = {n.name: k for n, k in zip(LINING.nodes, kelvins, strict=True)}
    shares = InPad(depth_m).shares(LINING)

    assert sum(shares.values()) == pytest.approx(1.0)
    assert sum(share * at_k[name] for name, share in shares.items()) == (
        pytest.approx(kelvin)
    )


def test_the_node_that_is_forced_is_the_nearest() -> None:
    placed = {"pad_front": InPad(0.0043), "disc": InDisc(1e-4, 1.0)}

    assert node_at("pad_front", placed, LINING) == "pad_2"
    assert node_at("disc", placed, LINING) == "disc"
    assert node_at("pad_front", {}, LINING) == "pad_front"


@pytest.mark.parametrize("count", [1, 2])
def test_a_pad_model_with_too_few_depths_is_told(count: int) -> None:
    """LINING's first node is a disc, which has none."""
    shallow = replace(LINING, nodes=LINING.nodes[:count])
    place = InPad(0.002)
    words = rf"depth_m: pad\.model gives {count - 1} of its nodes a depth_m"

    with pytest.raises(ConfigError, match=words):
        node_at("pad_front", {"pad_front": place}, shallow)
    with pytest.raises(ConfigError, match=words):
        place.shares(shallow)


def test_a_lining_is_in_order_whatever_its_nodes_are() -> None:
    turned = replace(LINING, nodes=LINING.nodes[::-1])

    assert list(lining_of(turned)) == [one.name for one in LINING.nodes[1:]]


def test_excess_in_a_disc_is_that_of_a_plate() -> None:
    """Against the heat equation in a plate: one side heated, one insulated.

    20 kW on a disc of 1 kg per 0.01 m2 of face; 0.1 s after the begin and
    when the profile is there.
    """
    power_w, area_m2, mass_kg = 20e3, 0.09, 7.8
    k_w_mk, density, cp = 48.0, 7200.0, 470.0
    cells = 60
    dx = mass_kg / density / area_m2 / cells
    thickness_m = dx * cells
    depth_m = 0.002
    dt = 0.2 * dx**2 * density * cp / k_w_mk
    rise_k = np.zeros(cells)
    excess = []
    for _ in range(round(12.0 / dt)):
        flux = np.concatenate(
            ([power_w / area_m2], -k_w_mk * np.diff(rise_k) / dx, [0.0])
        )
        rise_k -= np.diff(flux) * dt / (density * cp * dx)
        at = np.interp(depth_m, (np.arange(cells) + 0.5) * dx, rise_k)
        excess.append(at - rise_k.mean())
    part = depth_m / thickness_m
    place = InDisc(
        (1 / 3 - part + part**2 / 2) * thickness_m / (k_w_mk * area_m2),
        thickness_m**2 / (np.pi**2 * k_w_mk / (density * cp)),
    )

    found = place.excess_k(np.full(24, power_w), 0.5)

    assert found[-1] == pytest.approx(excess[-1], rel=1e-2)
    for step in (1, 3, 7):
        at = excess[round((step + 1) * 0.5 / dt) - 1]
        assert found[step] == pytest.approx(at, abs=0.2 * excess[-1])


def with_depth(config: Config, role: str, depth_m: float) -> Config:
    """Return *config* with a thermocouple of that depth."""
    signal = SignalConfig(
        message="M", signal="S", unit="degC", depth_m=depth_m
    )
    signals = {**config.signals, role: signal}
    return config.model_copy(update={"signals": signals})


@pytest.mark.parametrize("cells", ["half", "full"])
def test_nodes_lie_where_the_mesh_has_them(target: Target, cells: str) -> None:
    """Half cells have a node on each face, whole ones in their middle."""
    pad = target.corner.pad
    assert pad is not None
    pad = pad.model_copy(update={"surface_cells": cells})
    corner = target.corner.model_copy(update={"pad": pad})

    network = compile_corner(target.config, corner).network

    depth_m = list(lining_of(network).values())
    if cells == "half":
        expected = np.linspace(0.0, pad.thickness_m, pad.slabs + 2)
    else:
        edges = np.linspace(0.0, pad.thickness_m, pad.slabs + 3)
        expected = 0.5 * (edges[1:] + edges[:-1])
    assert depth_m == pytest.approx(expected)


def test_in_worn_linings_a_thermocouple_is_as_deep(
    made: Callable[..., Drive], target: Target
) -> None:
    """So it is at a larger share of the thickness, and cooler."""
    pad = target.corner.pad
    assert pad is not None
    worn_m = 0.5 * pad.thickness_m
    worn = EffectConfig(name="pad_wear", parameters={"worn_m": worn_m})
    drive, corner = made(), target.corner.name
    # a node of the worn chain, the second of the whole one
    depth_m = 0.5 * pad.thickness_m / (pad.slabs + 1) * 2
    placed = {corner: {"pad_front": InPad(depth_m)}}
    program = compile_corner(
        target.config.model_copy(update={"effect": [worn]}), target.corner
    )
    start = initial_temperatures(program, drive, corner)
    nodes = march([program], drive, corner, start)
    read = march([program], replace(drive, placed=placed), corner, start)

    assert read["pad_front"] == pytest.approx(nodes["pad_2"])


def test_only_a_configured_depth_is_a_place(target: Target) -> None:
    corner = target.corner.name
    role = f"temp_{corner.lower()}_pad_front"
    config = with_depth(target.config, role, 0.002)

    assert placements(config) == {corner: {"pad_front": InPad(0.002)}}
    assert placements(target.config) == {}


def test_a_disc_reads_more_near_its_face_and_less_deep_in_it(
    target: Target,
) -> None:
    corner = target.corner.name
    role = f"temp_{corner.lower()}_disc"
    disc = target.corner.disc
    assert disc is not None
    thickness_m = disc.mass_kg / (disc.density_kg_m3 * disc.swept_area_m2)

    near, deep = (
        placements(with_depth(target.config, role, depth_m))[corner]["disc"]
        for depth_m in (0.0, thickness_m)
    )

    assert isinstance(near, InDisc)
    assert isinstance(deep, InDisc)
    # 1/3 at the face, -1/6 at the insulated side
    assert near.excess_k_w == pytest.approx(-2.0 * deep.excess_k_w)
    # the slowest of the plate's own: b^2 / (pi^2 alpha)
    diffusivity = disc.conductivity_w_mk / (
        disc.density_kg_m3 * disc.effusivity_heat_capacity_j_kgk
    )
    assert near.lag_s == pytest.approx(
        thickness_m**2 / (np.pi**2 * diffusivity)
    )


def test_samples_are_put_in_the_order_of_their_times() -> None:
    """By corner and node; those of one time stay as they came."""
    disc, fluid = (ROLE_INDEX[f"temp_fl_{node}"] for node in ("disc", "fluid"))
    samples = {
        disc: [
            (np.array([12.0, 11.0]), np.array([300.0, 301.0])),
            (np.array([10.0, 11.0]), np.array([302.0, 303.0])),
        ],
        fluid: [(np.array([15.0]), np.array([310.0]))],
    }

    found = thermocouples_of(samples, ("FL", "FR"), 10.0)

    assert found.keys() == {"FL"}
    assert found["FL"].keys() == {"disc", "fluid"}
    one = found["FL"]["disc"]
    assert one.time_s.tolist() == [0.0, 1.0, 1.0, 2.0]
    assert one.temperature_k.tolist() == [302.0, 301.0, 303.0, 300.0]
    assert found["FL"]["fluid"].time_s.tolist() == [5.0]


def test_a_march_reads_where_the_thermocouple_is(
    made: Callable[..., Drive], target: Target
) -> None:
    drive = made()
    corner = target.corner.name
    program = compile_corner(target.config, target.corner)
    _, above_m, below_m, *_ = lining_of(program.network).values()
    between = InPad(0.5 * (above_m + below_m))
    placed = {corner: {"pad_front": between, "disc": InDisc(1e-3, 1.0)}}
    start = initial_temperatures(program, drive, corner)
    nodes = march([program], drive, corner, start)
    read = march([program], replace(drive, placed=placed), corner, start)

    mean_k = 0.5 * (nodes["pad_1"] + nodes["pad_2"])
    assert read["pad_front"] == pytest.approx(mean_k)
    power_w = drive.channel(corner, "brake_power_w")
    excess = (read["disc"] - nodes["disc"])[:, 0]
    assert excess.max() == pytest.approx(1e-3 * power_w.max(), rel=0.02)
    assert read["fluid"] == pytest.approx(nodes["fluid"])


@pytest.mark.parametrize("time_s", [0.05, 15.0, 400.0])
def test_what_follows_late_is_behind_by_rate_times_time(time_s: float) -> None:
    """A ramp after rest: behind by s tau (1 - exp(-t / tau)), to the bit."""
    time = np.arange(0.0, 500.0, 0.5)
    ramp = np.maximum(time - 10.0, 0.0)
    values = 300.0 + np.outer(ramp, [0.2, -1.5])

    behind = values - lagged(values, time_s, 0.5)

    expected = np.outer(time_s * (1 - np.exp(-ramp / time_s)), [0.2, -1.5])
    assert behind == pytest.approx(expected, abs=1e-9)


def test_what_is_not_late_is_shown_as_it_is() -> None:
    values = np.array([[300.0], [301.0]])

    assert lagged(values, 0.0, 0.5) is values
