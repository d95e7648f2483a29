"""A disc model of the user's own: a friction ring and a core."""

from __future__ import annotations

import sys
from array import array
from dataclasses import replace
from types import ModuleType
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.model.thermal.brake_corner import (
    CornerSpec,
    build_corner,
    lumped_disc,
)
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.network import Link, Network, Node
from bstm_daemon.model.thermal.program import compile_network

from ...energy_ledger import read_ledger  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.native.loader import Kernel

INPUTS = ("speed_ms", "brake_on", "ambient_k", "brake_power_w")
RING_SHARE = 0.4  # of the mass, in the friction faces
PATH_M = 0.007  # from the middle of a face to the middle of the core


def two_node_disc(net: Network, spec: CornerSpec) -> Network:
    """Friction ring ``disc`` in front of a core that is cooled."""
    net = lumped_disc(net, spec)
    whole = net.node("disc")

    def of_core(link: Link) -> Link:
        factors = tuple(
            replace(f, a="disc_core") if f.a == "disc" else f
            for f in link.factors
        )
        return replace(link, a="disc_core", factors=factors)

    ring, core = RING_SHARE, 1.0 - RING_SHARE
    conductance = (
        spec.disc.conductivity_w_mk * spec.disc.swept_area_m2 / PATH_M
    )
    return (
        net.edit_node(
            "disc", lambda n: replace(n, capacity_j_k=ring * n.capacity_j_k)
        )
        .with_node(
            Node("disc_core", core * whole.capacity_j_k, whole.capacity_table)
        )
        .edit_link("disc_convection", of_core)
        .edit_link("disc_radiation", of_core)
        .with_link(Link("disc-core", "disc", "disc_core", conductance))
    )


@pytest.fixture
def corner(
    monkeypatch: pytest.MonkeyPatch, make_spec: Callable[..., CornerSpec]
) -> CornerSpec:
    """Return a corner whose disc model is :func:`two_node_disc`."""
    module = ModuleType("my_disc")
    module.two_node_disc = two_node_disc  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "my_disc", module)
    disc: dict[str, Any] = {
        "model": "my_disc:two_node_disc",
        "mass_kg": 7.5,
        "swept_area_m2": 0.085,
        "total_area_m2": 0.2,
    }
    return make_spec({"disc": disc})


def test_ring_leads_the_core_and_energy_is_conserved(
    kernel: Kernel | None, corner: CornerSpec
) -> None:
    """A hard stop: q L / k A between ring and core, then they meet."""
    program = compile_network(build_corner(corner, INPUTS))
    batch = Batch([program], 300.0, kernel=kernel)
    start = batch.state[:]
    names = program.state_names

    def now(name: str) -> float:
        return batch.state[names.index(name)]

    batch.march(array("d", [20.0, 1.0, 300.0, 50e3] * 160), 160, 0.05)
    lead = now("disc") - now("disc_core")
    # quasi-steady: the core takes its part of the mass of the disc's heat
    heat = 50e3 * corner.disc_share * 0.6
    assert lead == pytest.approx(heat * 0.007 / (50.0 * 0.085), rel=0.05)
    batch.march(array("d", [0.0, 0.0, 300.0, 0.0] * 400), 400, 0.05)
    assert abs(now("disc") - now("disc_core")) < 0.5
    ledger = read_ledger(program, batch.ledger, start, batch.state)
    assert ledger.generated == pytest.approx(400e3)
    assert abs(ledger.residual) < 1e-9 * ledger.generated


def test_whole_disc_has_the_lump_s_heat_and_cooling(
    corner: CornerSpec, make_spec: Callable[..., CornerSpec]
) -> None:
    """Capacities add up to the lump; nothing but the split is new."""
    split = build_corner(corner, INPUTS)
    lump = build_corner(make_spec(), INPUTS)
    both = (
        split.node("disc").capacity_j_k + split.node("disc_core").capacity_j_k
    )
    assert both == pytest.approx(lump.node("disc").capacity_j_k)
    assert {k.name for k in split.links} - {k.name for k in lump.links} == {
        "disc-core"
    }
    assert split.link("disc_convection").a == "disc_core"
