"""The kernel, both forms, against solutions from heat transfer books."""

from array import array
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from math import cos, exp, inf, log, nan, pi, sin, sqrt, tan
from typing import Any

import pytest
from scipy.optimize import brentq

from bstm_daemon.model.thermal.brake_corner import (
    CornerSpec,
    build_corner,
    lumped_disc,
    slab_pads,
)
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.network import (
    Factor,
    Link,
    Memory,
    Network,
    Node,
    Source,
    difference,
    mean,
    radiation,
    value,
)
from bstm_daemon.model.thermal.program import compile_network
from bstm_daemon.model.thermal.table import Table
from bstm_daemon.native.loader import Kernel
from bstm_daemon.units import STEFAN_BOLTZMANN_W_M2K4

AMBIENT = Node("ambient", 0.0, boundary_input="ambient_k")
INPUTS = (
    *("speed_ms", "brake_on", "ambient_k", "brake_power_w", "pressure_pa"),
    *("wetness", "measured_disc_k"),
)
# points of one grid, so that the table holds each of them exactly
COOLING = {
    "speed_ms": [0.0, 5.0, 10.0, 25.0],
    "s_per_s": [4e-4, 1e-3, 1.6e-3, 3.4e-3],
}
MakeSpec = Callable[..., CornerSpec]


class March:
    """One member of a network with constant inputs."""

    def __init__(
        self, net: Network, kernel: Kernel | None, start_k: float
    ) -> None:
        """Start *net* at *start_k*."""
        self.program = compile_network(net)
        self.batch = Batch([self.program], start_k, kernel=kernel, sets=1)

    def run(self, row: Sequence[float], steps: int, dt_s: float) -> None:
        """March *steps* of *dt_s* with the input *row*."""
        self.batch.march(array("d", list(row) * steps), steps, dt_s)

    def __getitem__(self, name: str) -> float:
        """Return the state *name*."""
        return self.batch.state[self.program.state_names.index(name)]


@pytest.mark.parametrize("material", ["grey-iron", "pure-iron"])
@pytest.mark.parametrize("speed_ms", [5.0, 10.0, 25.0])
def test_disc_cools_exponentially_through_any_heat_capacity(
    kernel: Kernel | None, make_spec: MakeSpec, material: str, speed_ms: float
) -> None:
    """Eq 4.12 in the rate form: exp(-S t) from above the Curie peak."""
    disc = {"mass_kg": 7.5, "swept_area_m2": 0.085, "total_area_m2": 0.2}
    spec = make_spec({"disc": {**disc, "material": material}}, cooling=COOLING)
    net = lumped_disc(Network(("speed_ms", "ambient_k"), (AMBIENT,)), spec)
    march = March(net, kernel, 1073.0)
    march.run((speed_ms, 300.0), 1, 1e-9)  # the ambient ramps to its input
    march.run((speed_ms, 300.0), 6000, 0.2)
    s = dict(zip(spec.cooling.speed_ms, spec.cooling.s_per_s, strict=True))
    expected = 300.0 + 773.0 * exp(-s[speed_ms] * 1200.0)
    assert march["disc"] == pytest.approx(expected, abs=1e-3)


def test_conductance_form_slows_where_heat_capacity_rises(
    kernel: Kernel | None, make_spec: MakeSpec
) -> None:
    """Constant h A: in the first step the rate is S cp(20 C) / cp(T)."""
    rates = {}
    for form in ("rate", "conductance"):
        spec = make_spec(cooling={**COOLING, "form": form})
        net = lumped_disc(Network(("speed_ms", "ambient_k"), (AMBIENT,)), spec)
        march = March(net, kernel, 773.15)
        march.run((10.0, 293.15), 1, 1e-9)
        march.run((10.0, 293.15), 1, 0.1)
        rates[form] = log(480.0 / (march["disc"] - 293.15)) / 0.1
    assert rates["rate"] == pytest.approx(1.6e-3, rel=1e-4)
    assert rates["conductance"] == pytest.approx(
        1.6e-3 * 460.0 / 650.0, rel=1e-3
    )


def lining(
    make_spec: MakeSpec, thickness_m: float, slabs: int, cells: str = "half"
) -> tuple[Network, float]:
    """Return a chain of slabs with an ambient and its area."""
    spec = make_spec(
        {
            "pad": {
                "area_m2": 6.5e-3,
                "thickness_m": thickness_m,
                "slabs": slabs,
                "surface_cells": cells,
            }
        }
    )
    net = slab_pads(Network(("ambient_k",), (AMBIENT,)), spec)
    return net, spec.pads_area_m2


def test_half_space_under_constant_flux(
    kernel: Kernel | None, make_spec: MakeSpec
) -> None:
    """Surface temperature rises as 2 q sqrt(alpha t / pi) / k."""
    net, area = lining(make_spec, 0.05, 60)
    flux = 40e3
    march = March(
        net.with_source(Source("q", "pad_front", flux * area)), kernel, 300.0
    )
    alpha = 1.2 / (2300.0 * 1000.0)
    for seconds in (50, 100):
        march.run((300.0,), 500, 0.1)
        rise = 2.0 * flux * sqrt(alpha * seconds / pi) / 1.2
        assert march["pad_front"] - 300.0 == pytest.approx(rise, rel=3e-3)


def plane_wall(biot: float, fourier: float, place: float) -> float:
    """Return theta* of a plane wall, convection at 1, insulated at 0.

    The whole series (Incropera, section 5.5).
    """
    total = 0.0
    for i in range(30):
        low, high = i * pi + 1e-12, (i + 0.5) * pi - 1e-12
        z: float = brentq(lambda x: x * tan(x) - biot, low, high)
        weight = 4.0 * sin(z) / (2.0 * z + sin(2.0 * z))
        total += weight * exp(-z * z * fourier) * cos(z * place)
    return total


def cooled_wall(
    make_spec: MakeSpec, kernel: Kernel | None, slabs: int, cells: str = "half"
) -> tuple[float, float, float]:
    """Return surface and back minus the series, and the surface's theta*."""
    thickness, h, seconds = 0.01, 240.0, 60.0
    net, area = lining(make_spec, thickness, slabs, cells)
    net = net.with_link(Link("h", "pad_front", "ambient", h * area))
    march = March(net, kernel, 500.0)
    march.run((300.0,), 1, 1e-9)
    march.run((300.0,), 600, seconds / 600)
    biot = h * thickness / 1.2
    fourier = 1.2 / 2.3e6 * seconds / thickness**2
    surface = plane_wall(biot, fourier, 1.0)
    return (
        (march["pad_front"] - 300.0) / 200.0 - surface,
        (march["pad_back"] - 300.0) / 200.0 - plane_wall(biot, fourier, 0.0),
        surface,
    )


def test_slab_with_convection(
    kernel: Kernel | None, make_spec: MakeSpec
) -> None:
    """Both faces within 0.3 K of 200 K after a minute at Biot 2."""
    surface, back, theta = cooled_wall(make_spec, kernel, 10)
    assert 0.2 < theta < 0.8
    assert abs(surface) * 200.0 < 0.3
    assert abs(back) * 200.0 < 0.3


def test_order_of_convergence_in_the_mesh(
    compiled: Kernel, make_spec: MakeSpec
) -> None:
    """Half cells at the surfaces: second order in dz."""
    errors = [
        abs(cooled_wall(make_spec, compiled, cells - 1)[0])
        for cells in (5, 10, 20)
    ]
    orders = [log(a / b) / log(2.0) for a, b in pairwise(errors)]
    assert orders == pytest.approx([2.0, 2.0], abs=0.15)


def test_full_cells_lag_at_the_surface(
    compiled: Kernel, make_spec: MakeSpec
) -> None:
    """The thesis's mesh calls a centre a surface: q dz / 2k off."""
    net, area = lining(make_spec, 0.011, 9, "full")
    march = March(
        net.with_source(Source("q", "pad_front", 40e3 * area)).with_link(
            Link("sink", "pad_back", "ambient", 1e9)
        ),
        compiled,
        300.0,
    )
    march.run((300.0,), 2000, 1.0)
    # eleven cells of 1 mm: ten distances between the first and last centre
    assert march["pad_front"] - 300.0 == pytest.approx(40e3 * 0.010 / 1.2)


def test_steady_conduction(kernel: Kernel | None, make_spec: MakeSpec) -> None:
    """Resistances in series from a hot face to the air."""
    spec = make_spec()
    net = build_corner(spec, INPUTS).with_forced("pad_front")
    march = March(net, kernel, 300.0)
    row = (0.0, 1.0, 300.0, 0.0, 0.0, 0.0, nan, 700.0)
    march.run(row, 200, 1000.0)
    area, thermal = spec.pads_area_m2, spec.thermal
    lining_k_w = 0.011 / (1.2 * area)
    shim_k_w = thermal.pad_backplate_thermal_resistance_m2k_w / area
    air_k_w = 1.0 / thermal.fluid_static_convection_w_k
    flow = 400.0 / (lining_k_w + shim_k_w + air_k_w)
    assert march["fluid"] == pytest.approx(300.0 + flow * air_k_w, rel=1e-9)
    assert march["pad_back"] == pytest.approx(
        300.0 + flow * (air_k_w + shim_k_w), rel=1e-9
    )
    middle = 0.5 * (march["pad_5"] + march["pad_6"])
    assert middle == pytest.approx(
        0.5 * (march["pad_front"] + march["pad_back"])
    )


@pytest.mark.parametrize("form", ["grey-plates", "product"])
def test_steady_exchange_of_plates(
    kernel: Kernel | None, make_spec: MakeSpec, form: str
) -> None:
    """What the disc radiates to the pads, the fluid gives to the air."""
    spec = make_spec(thermal={"disc_pad_radiation": form})
    net = build_corner(spec, INPUTS, force_measured=True)
    march = March(net, kernel, 300.0)
    march.run((0.0, 0.0, 300.0, 0.0, 0.0, 0.0, 900.0), 300, 1000.0)
    eps_d, eps_p = spec.thermal.disc_emissivity, spec.thermal.pad_emissivity
    both = {
        "grey-plates": 1.0 / (1.0 / eps_d + 1.0 / eps_p - 1.0),
        "product": eps_d * eps_p,
    }[form]
    exchange = STEFAN_BOLTZMANN_W_M2K4 * both * spec.pads_area_m2
    into_pads = exchange * (900.0**4 - march["pad_front"] ** 4)
    to_air = spec.thermal.fluid_static_convection_w_k * (
        march["fluid"] - 300.0
    )
    assert march["pad_front"] > 310.0
    assert into_pads == pytest.approx(to_air, rel=1e-6)


def test_node_without_capacity(kernel: Kernel | None) -> None:
    """It takes the weighted mean at once; untouched it stays."""
    net = Network(
        ("hot_k", "cold_k", "speed_ms"),
        (
            Node("hot", 0.0, boundary_input="hot_k"),
            Node("cold", 0.0, boundary_input="cold_k"),
            Node("plate", 0.0),
        ),
        (
            Link("h", "hot", "plate", 1.0, (value("speed_ms"),)),
            Link("c", "plate", "cold", 3.0, (value("speed_ms"),)),
        ),
    )
    march = March(net, kernel, 350.0)
    march.run((700.0, 300.0, 0.0), 2, 1.0)
    assert march["plate"] == 350.0
    march.run((700.0, 300.0, 1.0), 1, 0.05)
    assert march["plate"] == pytest.approx(400.0)
    march.run((700.0, 300.0, 0.0), 1, 0.05)
    assert march["plate"] == pytest.approx(400.0)


STEEP = Table(0.0, 1.0, (0.0, 10.0))


@pytest.mark.parametrize(
    ("factor", "conductance_w_k"),
    [
        (value("x"), 0.2),
        (value("x", STEEP), 2.0),
        (difference("y", "x"), 0.5),
        (difference("y", "x", STEEP), 5.0),
        (mean("x", "y"), 0.45),
        (mean("y", "x", STEEP), 4.5),
        (radiation("x", "y"), (0.04 + 0.49) * 0.9),
    ],
)
def test_drivers(
    kernel: Kernel | None, factor: Factor, conductance_w_k: float
) -> None:
    """A plate between 1 W/K to 700 K and what is driven to 300 K."""
    net = Network(
        ("hot_k", "cold_k", "x", "y"),
        (
            Node("hot", 0.0, boundary_input="hot_k"),
            Node("cold", 0.0, boundary_input="cold_k"),
            Node("plate", 0.0),
        ),
        (
            Link("h", "hot", "plate", 1.0),
            Link("c", "plate", "cold", 1.0, (factor,)),
        ),
    )
    march = March(net, kernel, 350.0)
    march.run((700.0, 300.0, 0.2, 0.7), 2, 0.05)
    assert march["plate"] == pytest.approx(
        (700.0 + 300.0 * conductance_w_k) / (1.0 + conductance_w_k), rel=1e-12
    )


@pytest.mark.parametrize("steps", [1, 7])
@pytest.mark.parametrize(
    ("start_k", "energy_j", "end_k"),
    [
        # 1 J/K up to 300 K, 2 at 400 K, 3 at 500 K and above
        (550.0, -60.0, 530.0),
        (550.0, -150.0, 500.0),
        (550.0, -150.0 - 250.0, 400.0),
        (550.0, -150.0 - 250.0 - 150.0 - 50.0, 250.0),
        (250.0, 50.0 + 150.0 + 250.0 + 150.0, 550.0),
        (450.0, 137.5 + 30.0, 510.0),
        # from a point of the table, to either side
        (400.0, -150.0 - 50.0, 250.0),
        (400.0, 250.0 + 30.0, 510.0),
    ],
)
def test_heat_walks_the_cells_of_a_capacity(
    kernel: Kernel | None,
    steps: int,
    start_k: float,
    energy_j: float,
    end_k: float,
) -> None:
    """Into the table and out of it on both sides, in one step or some."""
    own = Table(300.0, 100.0, (1.0, 2.0, 3.0))
    net = Network((), (Node("disc", 1.0, own),)).with_extra_heat("disc")
    march = March(net, kernel, start_k)
    march.run((energy_j,), steps, 1.0 / steps)
    assert march["disc"] == pytest.approx(end_k, abs=1e-9)


def test_forced_node_follows_and_is_free_at_nan(kernel: Kernel | None) -> None:
    """Ramp to each value of the series; with nan it cools as exp(-t/tau)."""
    net = Network(
        ("ambient_k",),
        (AMBIENT, Node("disc", 100.0)),
        (Link("h", "disc", "ambient", 2.0),),
    ).with_forced("disc")
    march = March(net, kernel, 300.0)
    for target in (310.0, 305.5, 600.0):
        march.run((300.0, target), 1, 0.5)
        assert march["disc"] == pytest.approx(target, rel=1e-14)
    march.run((300.0, nan), 500, 0.1)
    assert march["disc"] == pytest.approx(300.0 + 300.0 * exp(-1.0), rel=1e-6)


def test_extra_heat(kernel: Kernel | None) -> None:
    """P t / C on top of everything else."""
    net = Network((), (Node("disc", 3000.0),)).with_extra_heat("disc")
    march = March(net, kernel, 300.0)
    march.run((6000.0,), 100, 0.05)
    march.run((-3000.0,), 20, 0.05)
    expected = 300.0 + (6000.0 * 5.0 - 3000.0 * 1.0) / 3000.0
    assert march["disc"] == pytest.approx(expected)


def test_memories(kernel: Kernel | None) -> None:
    """Integral with decay, bounds on both sides, and the largest value."""
    left = value("fading", Table(0.0, 1.0, (1.0, 0.0)))
    net = Network(
        ("q",),
        (Node("disc", 10.0),),
        sources=(Source("q_w", "disc", 1.0, (value("q"),)),),
        memories=(
            Memory("fading", "integral", 0.2, (left,)),
            Memory("sum", "integral", 1.0, (value("q"),), 0.0, -3.0, 12.0),
            Memory("hottest", "latch", 1.0, (value("disc"),), 0.0, 0.0, inf),
            Memory("capped", "latch", 1.0, (value("disc"),), 0.0, 0.0, 301.0),
        ),
    )
    march = March(net, kernel, 300.0)
    march.run((1.0,), 100, 0.05)
    assert march["sum"] == pytest.approx(5.0)
    march.run((2.0,), 100, 0.05)
    assert march["sum"] == 12.0
    march.run((-4.0,), 200, 0.05)
    assert march["sum"] == -3.0
    # 1 - exp(-k t): a law that feeds back on the memory itself
    assert march["fading"] == pytest.approx(1.0 - exp(-4.0), abs=1e-5)
    assert march["disc"] == pytest.approx(300.0 + (5 + 10 - 40) / 10.0)
    assert march["hottest"] == pytest.approx(301.5)
    assert march["capped"] == 301.0


def test_capacity_factor_and_table_multiply(kernel: Kernel | None) -> None:
    """C = constant x table(T) x factor: the rise of a linear capacity."""
    own = Table(0.0, 1000.0, (0.0 + 1e-9, 1000.0))  # C grows as T
    net = Network(
        ("share", "q"),
        (Node("disc", 2.0, own, (value("share"),)),),
        sources=(Source("q_w", "disc", 1.0, (value("q"),)),),
    )
    march = March(net, kernel, 300.0)
    march.run((0.5, 1000.0), 100, 0.1)
    # 2 * 0.5 * (T^2 - T0^2) / 2 = q t
    assert march["disc"] == pytest.approx(sqrt(300.0**2 + 2.0 * 10_000.0))


def test_capacity_zero_with_a_table_is_algebraic(
    kernel: Kernel | None,
) -> None:
    """A table times nothing is nothing: the node follows its neighbour."""
    net: Any = Network(
        ("ambient_k",),
        (AMBIENT, Node("skin", 0.0, Table(0.0, 1.0, (1.0, 1.0)))),
        (Link("h", "skin", "ambient", 2.0),),
    )
    march = March(net, kernel, 300.0)
    march.run((400.0,), 1, 0.05)
    assert march["skin"] == pytest.approx(400.0)
    heavy = net.edit_node("skin", lambda n: replace(n, capacity_j_k=1e6))
    march = March(heavy, kernel, 300.0)
    march.run((400.0,), 1, 0.05)
    assert march["skin"] == pytest.approx(300.0, abs=1e-3)
