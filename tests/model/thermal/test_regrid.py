"""What is worn leaves with its heat, and nothing else does."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bstm_daemon.channels import CHANNELS
from bstm_daemon.model.thermal.brake_corner import build_corner
from bstm_daemon.model.thermal.regrid import follow_wear, heat_above_j

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.model.thermal.brake_corner import CornerSpec
    from bstm_daemon.model.thermal.network import Network

AIR_K = 283.15
CURVE = {
    "temperature_c": [0.0, 300.0, 700.0],
    "value": [900.0, 1200.0, 1300.0],
}


def network(
    make_spec: Callable[..., CornerSpec],
    thickness_m: float,
    heat_capacity: Any = 1000.0,
    **pad: Any,
) -> Network:
    """Return a corner with a lining of *thickness_m*."""
    table = {
        "area_m2": 6.5e-3,
        "thickness_m": thickness_m,
        "heat_capacity_j_kgk": heat_capacity,
        **pad,
    }
    return build_corner(make_spec({"pad": table}), CHANNELS)


def lining(net: Network, temperatures_k: list[float]) -> list[float]:
    """Return the temperatures of the slabs, friction face first."""
    by_name = dict(
        zip((n.name for n in net.nodes), temperatures_k, strict=True)
    )
    inner = [f"pad_{i}" for i in range(1, 11)]
    return [by_name[name] for name in ("pad_front", *inner, "pad_back")]


@settings(max_examples=50)
@given(
    slabs_k=st.lists(st.floats(280.0, 900.0), min_size=12, max_size=12),
    worn_m=st.floats(0.0, 0.008),
    curve=st.booleans(),
    cells=st.sampled_from(["half", "full"]),
)
def test_heat_left_and_heat_worn_are_the_heat_before(
    make_spec: Callable[..., CornerSpec],
    slabs_k: list[float],
    worn_m: float,
    curve: bool,  # noqa: FBT001
    cells: str,
) -> None:
    """The worn layer's heat, by hand, is all that is missing."""
    capacity: Any = CURVE if curve else 1000.0
    old = network(make_spec, 0.011, capacity, surface_cells=cells)
    new = network(make_spec, 0.011 - worn_m, capacity, surface_cells=cells)
    names = [node.name for node in old.nodes]
    chain = ["pad_front", *(f"pad_{i}" for i in range(1, 11)), "pad_back"]
    before = [AIR_K] * len(names)
    for name, kelvin in zip(chain, slabs_k, strict=True):
        before[names.index(name)] = kelvin

    after = follow_wear(old, new, before)

    worn_j, left_m = 0.0, worn_m
    table = old.node("pad_front").capacity_table
    for name, kelvin in zip(chain, slabs_k, strict=True):
        share = old.node(name).capacity_j_k / sum(
            old.node(n).capacity_j_k for n in chain
        )
        depth_m = min(left_m, share * 0.011)
        left_m -= depth_m
        rise = (
            kelvin - AIR_K
            if table is None
            else table.integral(kelvin) - table.integral(AIR_K)
        )
        size = old.node(name).capacity_j_k * depth_m / (share * 0.011)
        worn_j += size * rise
    lost_j = heat_above_j(old, before, AIR_K) - heat_above_j(new, after, AIR_K)
    assert lost_j == pytest.approx(worn_j, abs=1e-6 * 2e5)
    assert min(slabs_k) - 1e-6 <= min(lining(new, after))
    assert max(lining(new, after)) <= max(slabs_k) + 1e-6


def test_a_gradient_keeps_its_place_in_the_material(
    make_spec: Callable[..., CornerSpec],
) -> None:
    """Worn from the hot face, the new face is as hot as it was inside."""
    old, new = (network(make_spec, z) for z in (0.011, 0.0055))
    names = [node.name for node in old.nodes]
    before = [300.0] * len(names)
    chain = ["pad_front", *(f"pad_{i}" for i in range(1, 11)), "pad_back"]
    for i, name in enumerate(chain):
        before[names.index(name)] = 600.0 - 20.0 * i

    after = lining(new, follow_wear(old, new, before))

    assert after[0] == pytest.approx(490.0, abs=10.1)
    assert after[-1] == pytest.approx(380.0, abs=10.1)
    assert after == sorted(after, reverse=True)


def test_a_lighter_disc_keeps_its_temperature(
    make_spec: Callable[..., CornerSpec],
) -> None:
    disc = {"swept_area_m2": 0.085, "total_area_m2": 0.2}
    old, new = (
        build_corner(make_spec({"disc": {"mass_kg": kg, **disc}}), CHANNELS)
        for kg in (7.5, 7.0)
    )
    before = [500.0] * len(old.nodes)

    assert follow_wear(old, new, before) == before
    lost_j = heat_above_j(old, before, AIR_K) - heat_above_j(
        new, before, AIR_K
    )
    table = old.node("disc").capacity_table
    assert table is not None
    rise = table.integral(500.0) - table.integral(AIR_K)
    assert lost_j == pytest.approx(0.5 * rise)


def test_a_thicker_lining_is_no_wear(
    make_spec: Callable[..., CornerSpec],
) -> None:
    old, new = (network(make_spec, z) for z in (0.006, 0.011))
    before = [400.0 + i for i in range(len(old.nodes))]

    assert follow_wear(old, new, before) == before
