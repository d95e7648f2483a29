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
    node_at,
    placements,
    thermocouples_of,
)
from bstm_daemon.config.sections import Config, SignalConfig
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.roles import ROLE_INDEX

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.tunables import Target


NAMES = ["pad_front", "pad_1", "pad_2", "pad_3", "pad_back"]


@pytest.mark.parametrize(
    ("slab", "kelvin"), [(0.0, 400.0), (0.5, 380.0), (2.25, 315.0), (4, 250.0)]
)
def test_between_slabs_the_reading_is_between(
    slab: float, kelvin: float
) -> None:
    at_k = dict(zip(NAMES, [400.0, 360.0, 320.0, 300.0, 250.0], strict=True))
    columns = {name: np.full((3, 2), k) for name, k in at_k.items()}

    assert InPad(slab).reading(columns) == pytest.approx(
        np.full((3, 2), kelvin)
    )


def test_the_node_that_is_forced_is_the_nearest() -> None:
    placed = {"pad_front": InPad(1.6), "disc": InDisc(1e-4, 1.0)}

    assert node_at("pad_front", placed, NAMES) == "pad_2"
    assert node_at("disc", placed, NAMES) == "disc"
    assert node_at("pad_front", {}, NAMES) == "pad_front"


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


def test_a_depth_is_a_place_in_the_chain_of_slabs(target: Target) -> None:
    """Half of the lining is the middle of the chain, whatever the mesh."""
    pad = target.corner.pad
    assert pad is not None
    corner = target.corner.name
    config = with_depth(
        target.config,
        f"temp_{corner.lower()}_pad_front",
        0.5 * pad.thickness_m,
    )

    placed = placements(config)[corner]["pad_front"]

    assert placed == InPad(pytest.approx(0.5 * (pad.slabs + 1)))
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
    placed = {corner: {"pad_front": InPad(1.5), "disc": InDisc(1e-3, 1.0)}}
    program = compile_corner(target.config, target.corner)
    start = initial_temperatures(program, drive, corner)
    nodes = march([program], drive, corner, start)
    read = march([program], replace(drive, placed=placed), corner, start)

    between = 0.5 * (nodes["pad_1"] + nodes["pad_2"])
    assert read["pad_front"] == pytest.approx(between)
    power_w = drive.channel(corner, "brake_power_w")
    excess = (read["disc"] - nodes["disc"])[:, 0]
    assert excess.max() == pytest.approx(1e-3 * power_w.max(), rel=0.02)
    assert read["fluid"] == pytest.approx(nodes["fluid"])
