"""The corner against SciPy's Radau, with an evaluation of its own."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from bstm_daemon.model.thermal.brake_corner import CornerSpec, build_corner
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.program import compile_network

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.model.thermal.network import Factor, Network
    from bstm_daemon.native.loader import Kernel

INPUTS = ("speed_ms", "brake_on", "ambient_k", "brake_power_w")
AMBIENT_K = 283.15

SEGMENTS = (  # s, m/s, brake on, W
    (60.0, 10.0, 1.0, 6_000.0),
    (6.0, 25.0, 1.0, 60_000.0),
    (30.0, 30.0, 0.0, 0.0),
    (8.0, 20.0, 1.0, 80_000.0),
    (200.0, 0.0, 0.0, 0.0),
)


def product(factors: tuple[Factor, ...], slots: dict[str, float]) -> float:
    """Multiply *factors*, read from the data with NumPy's interpolation."""
    total = 1.0
    for factor in factors:
        a = slots[factor.a]
        b = slots[factor.b] if factor.b is not None else a
        x = {
            "value": a,
            "difference": a - b,
            "mean": (a + b) / 2.0,
            "radiation": (a * a + b * b) * (a + b),
        }[factor.kind]
        if factor.table is not None:
            table = factor.table
            grid = table.x0 + table.dx * np.arange(len(table.values))
            x = float(np.interp(x, grid, table.values))
        total *= x
    return total


def right_hand_side(
    net: Network, row: dict[str, float]
) -> Callable[[float, Any], Any]:
    """Return dT/dt of the nodes with a capacity, the rest at ambient."""
    free = [n for n in net.nodes if n.boundary_input is None]
    number = {node.name: i for i, node in enumerate(free)}

    def rates(_: float, temperatures: Any) -> Any:
        slots = {node.name: AMBIENT_K for node in net.nodes} | row
        slots |= {n.name: float(temperatures[number[n.name]]) for n in free}
        flow = np.zeros(len(free))
        for link in net.links:
            conductance = link.conductance_w_k * product(link.factors, slots)
            heat = conductance * (slots[link.a] - slots[link.b])
            if link.a in number:
                flow[number[link.a]] -= heat
            if link.b in number:
                flow[number[link.b]] += heat
        for source in net.sources:
            if source.node in number:
                flow[number[source.node]] += source.gain * product(
                    source.factors, slots
                )
        for i, node in enumerate(free):
            capacity = node.capacity_j_k * product(node.factors, slots)
            if node.capacity_table is not None:
                own = node.capacity_table
                grid = own.x0 + own.dx * np.arange(len(own.values))
                capacity *= float(
                    np.interp(slots[node.name], grid, own.values)
                )
            flow[i] /= capacity
        return flow

    return rates


@pytest.fixture(scope="module")
def solved() -> dict[str, list[np.ndarray]]:
    """Return the ends of the phases by form, for both kernels."""
    return {}


def solve(net: Network, count: int) -> list[np.ndarray]:
    """Return the *count* temperatures at the end of each phase."""
    ends = [np.full(count, AMBIENT_K)]
    for seconds, speed, brake_on, power in SEGMENTS:
        row = (speed, brake_on, AMBIENT_K, power)
        solution = solve_ivp(
            right_hand_side(net, dict(zip(INPUTS, row, strict=True))),
            (0.0, seconds),
            ends[-1],
            method="Radau",
            rtol=1e-10,
            atol=1e-8,
        )
        ends.append(solution.y[:, -1])
    return ends[1:]


@pytest.mark.slow
@pytest.mark.parametrize("form", ["rate", "conductance"])
def test_default_step_within_two_millikelvin(
    kernel: Kernel | None,
    make_spec: Callable[..., CornerSpec],
    solved: dict[str, list[np.ndarray]],
    form: str,
) -> None:
    """All nodes at the end of each phase of hard braking and a stop."""
    spec = make_spec(
        {"pad": {"area_m2": 6.5e-3, "thickness_m": 0.011, "slabs": 6}},
        thermal={
            "backplate_thermal_capacity_j_k": 250.0,
            "gap_conductance_w_m2k": 150.0,
            "pad_static_loss_w_k": 0.5,
        },
        cooling={"form": form},
    )
    net = build_corner(spec, INPUTS)
    program = compile_network(net)
    batch = Batch([program], AMBIENT_K, kernel=kernel)
    free = [n.name for n in net.nodes if n.boundary_input is None]
    if form not in solved:
        solved[form] = solve(net, len(free))
    for segment, state in zip(SEGMENTS, solved[form], strict=True):
        seconds, speed, brake_on, power = segment
        values = (speed, brake_on, AMBIENT_K, power)
        steps = round(seconds / 0.05)
        batch.march(array("d", values * steps), steps, 0.05)
        found = dict(zip(program.state_names, batch.state, strict=True))
        assert [found[name] for name in free] == pytest.approx(
            list(state), rel=0, abs=0.002
        )
    assert state[free.index("disc")] > 400.0
