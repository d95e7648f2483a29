"""The default step against an exact solution of the same network.

Inputs at 100 Hz, constant from one to the next; the estimator's step gets
their means. SciPy's Radau, with an evaluation of the network of its own, is
too slow for a whole drive; so it covers the first part and vouches there for
a fine step of the kernel, which covers all of it.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace
from itertools import pairwise
from math import prod
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.integrate import solve_ivp
from side_by_side import Goal, Outcome, Table, three_digits

from bstm_daemon.config.reading import load_config
from bstm_daemon.estimator.estimator import STEP_US
from bstm_daemon.files import shipped_file
from bstm_daemon.model.thermal.brake_corner import build_corner, corner_spec
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.program import compile_network
from bstm_daemon.native.loader import load_kernel

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy.typing as npt

    from bstm_daemon.model.thermal.network import Factor, Network

    Series = npt.NDArray[np.float64]

INPUTS: Final = ("speed_ms", "brake_on", "ambient_k", "brake_power_w")
AMBIENT_K: Final = 283.15
SAMPLE_S: Final = 0.01
STEP_S: Final = STEP_US * 1e-6
FINE_S: Final = 0.0005
"""Checked against Radau in the run."""
DRIVE_S: Final = 1800.0
RTOL: Final = 1e-10
ATOL_K: Final = 1e-9
PADS_M: Final = (0.010, 0.002)
SLABS: Final = 10
FORCE_SHARE: Final = 0.35
"""Of one front brake in the braking force."""
ALL_NODES_K: Final = 0.05
SLOW_NODES_K: Final = 0.01
SLOW_NODES: Final = ("disc", "pad_back", "fluid")
INNER_SLABS: Final = frozenset(f"pad_{i}" for i in range(2, SLABS))
"""Not printed: their errors lie between those of the slabs beside them."""


@dataclass(frozen=True)
class Errors:
    """Largest difference [K] by node: step or fine step, against what."""

    step_fine: dict[str, float]
    step_radau: dict[str, float]
    fine_radau: dict[str, float]
    hottest_k: dict[str, float]


def run(*, full: bool) -> Outcome:
    """Compare on 30 min, with Radau on the first 5 min (quick: 20 s)."""
    radau_s = 300.0 if full else 20.0
    drive = stop_and_go(DRIVE_S)
    found = {
        thickness: compare(pad_network(thickness), drive, radau_s)
        for thickness in PADS_M
    }
    thick, thin = (found[thickness] for thickness in PADS_M)
    outcome = Outcome(
        "Step against Radau",
        f"Front corner of the example car without effects, {SLABS} slabs, "
        f"{DRIVE_S / 60:.0f} min of stop-and-go with all inputs at "
        f"{1 / SAMPLE_S:.0f} Hz, whose means the usual step of {STEP_S:g} s "
        "gets; compared at the end of every step. The reference is the kernel "
        f"at a step of {FINE_S * 1e3:g} ms, and in the first {radau_s:g} s "
        f"SciPy's Radau (rtol {RTOL:g}, own evaluation of the network, "
        "restarted at every change of the inputs).",
    )
    for title, errors, nodes, limit_k in (
        ("10 mm pad, every node", thick, tuple(thick.step_fine), ALL_NODES_K),
        ("10 mm pad, disc, pad back, fluid", thick, SLOW_NODES, SLOW_NODES_K),
        ("2 mm pad, disc, pad back, fluid", thin, SLOW_NODES, SLOW_NODES_K),
    ):
        worst = max(
            max(one[node] for node in nodes)
            for one in (errors.step_fine, errors.step_radau)
        )
        outcome.goals.append(
            Goal(
                f"{title}: {limit_k:g} K against the largest error",
                limit_k / worst,
                at_least=1.0,
                tolerance=0.0,
            )
        )
    for thickness, errors in found.items():
        outcome.tables.append(error_table(thickness, errors, radau_s))
    return outcome


def error_table(thickness_m: float, errors: Errors, radau_s: float) -> Table:
    """Return the largest differences of one pad, node by node."""
    return Table(
        f"Pad of {thickness_m * 1e3:g} mm, largest difference in K",
        (
            *("node", "hottest, K", "step, 30 min"),
            *(f"step, Radau {radau_s:g} s", f"{FINE_S * 1e3:g} ms, Radau"),
        ),
        tuple(
            (
                node,
                f"{errors.hottest_k[node]:.0f}",
                *(
                    three_digits(one[node])
                    for one in (
                        errors.step_fine,
                        errors.step_radau,
                        errors.fine_radau,
                    )
                ),
            )
            for node in errors.step_fine
            if node not in INNER_SLABS
        ),
    )


def stop_and_go(duration_s: float) -> Series:
    """Return [samples, INPUTS] at 100 Hz: drive off, roll, brake, stand.

    Braking begins and ends between the estimator's steps, sets in within
    0.15 s and carries the ripple of a pressure sensor.
    """
    config = load_config(shipped_file("config/example_vehicle.toml"))
    rng = np.random.default_rng(20_260_102)
    speeds: list[Series] = []
    brakes: list[Series] = []
    powers: list[Series] = []
    at_s = 0.0
    while at_s < duration_s:
        top_ms = rng.uniform(4.0, 22.0)
        slope = rng.uniform(1.5, 4.5)
        parts = (
            top_ms / rng.uniform(1.2, 2.5),
            rng.uniform(1.0, 25.0),
            top_ms / slope,
            rng.uniform(1.0, 15.0),
        )
        off, roll, brake, stand = (
            np.arange(1, max(round(part / SAMPLE_S), 1) + 1) * SAMPLE_S
            for part in parts
        )
        slowing = np.maximum(top_ms - slope * brake, 0.0)
        speed = (
            top_ms * off / off[-1],
            np.full(len(roll), top_ms),
            slowing,
            np.zeros(len(stand)),
        )
        force_n = config.vehicle.mass_kg * slope * FORCE_SHARE
        force = force_n * np.minimum(brake / 0.15, 1.0)
        force *= 1.0 + 0.03 * rng.standard_normal(len(brake))
        quiet = np.zeros(len(off) + len(roll))
        still = np.zeros(len(stand))
        speeds += speed
        brakes += [quiet, np.ones(len(brake)), still]
        powers += [quiet, force * slowing, still]
        at_s += sum(map(len, speed)) * SAMPLE_S
    count = round(duration_s / SAMPLE_S)
    table = np.empty((count, len(INPUTS)))
    table[:, 0] = np.concatenate(speeds)[:count]
    table[:, 1] = np.concatenate(brakes)[:count]
    table[:, 2] = AMBIENT_K
    table[:, 3] = np.concatenate(powers)[:count]
    return table


def pad_network(thickness_m: float) -> Network:
    """Return the example car's front corner with a pad of *thickness_m*."""
    config = load_config(shipped_file("config/example_vehicle.toml"))
    spec = corner_spec(config, config.disc_corners()[0])
    changed = {"thickness_m": thickness_m, "slabs": SLABS}
    return build_corner(
        replace(spec, pad=spec.pad.model_copy(update=changed)), INPUTS
    )


def compare(net: Network, drive: Series, radau_s: float) -> Errors:
    """Solve *net* over *drive* with the usual step, a fine one and Radau."""
    step, fine = march(net, drive, STEP_S), march(net, drive, FINE_S)
    exact = radau(net, drive[: round(radau_s / SAMPLE_S)])
    names = [node.name for node in net.nodes if node.boundary_input is None]
    rows = len(exact)

    def apart(one: Series, two: Series) -> dict[str, float]:
        largest = np.abs(one - two).max(axis=0)
        return dict(zip(names, largest.tolist(), strict=True))

    return Errors(
        apart(step, fine),
        apart(step[:rows], exact),
        apart(fine[:rows], exact),
        dict(zip(names, fine.max(axis=0).tolist(), strict=True)),
    )


def march(net: Network, drive: Series, step_s: float) -> Series:
    """Return the free nodes [K] every ``STEP_S``, by the kernel."""
    program = compile_network(net)
    batch = Batch([program], AMBIENT_K, kernel=load_kernel("compiled"))
    columns = [
        program.state_names.index(node.name)
        for node in net.nodes
        if node.boundary_input is None
    ]
    every = round(STEP_S / step_s)
    found = []
    for part in np.split(drive, range(6000, len(drive), 6000)):
        if step_s >= SAMPLE_S:
            per_step = round(step_s / SAMPLE_S)
            rows = part.reshape(-1, per_step, len(INPUTS)).mean(axis=1)
        else:
            rows = np.repeat(part, round(SAMPLE_S / step_s), axis=0)
        inputs = array("d")
        inputs.frombytes(rows.tobytes())
        out = np.array(batch.march(inputs, len(rows), step_s, every, every))
        found.append(out.reshape(-1, batch.width + batch.sources)[:, columns])
    return np.concatenate(found)


def radau(net: Network, drive: Series) -> Series:
    """Return the free nodes [K] every ``STEP_S``, by SciPy's Radau."""
    free = [node for node in net.nodes if node.boundary_input is None]
    state = np.full(len(free), AMBIENT_K)
    changes = np.flatnonzero(np.diff(drive, axis=0).any(axis=1)) + 1
    edges = [0, *changes.tolist(), len(drive)]
    per_step = round(STEP_S / SAMPLE_S)
    found = []
    for first, last in pairwise(edges):
        row = dict(zip(INPUTS, drive[first].tolist(), strict=True))
        asked = [
            end
            for end in range(first + 1, last + 1)
            if end % per_step == 0 or end == last
        ]
        # from zero: the exact solution does not know the time of day
        solution = solve_ivp(
            right_hand_side(net, row),
            (0.0, (last - first) * SAMPLE_S),
            state,
            method="Radau",
            t_eval=[(end - first) * SAMPLE_S for end in asked],
            rtol=RTOL,
            atol=ATOL_K,
            vectorized=True,
        )
        if not solution.success:
            raise AssertionError(solution.message)
        state = solution.y[:, -1]
        found += [
            solution.y[:, place]
            for place, end in enumerate(asked)
            if end % per_step == 0
        ]
    return np.array(found)


def right_hand_side(
    net: Network, row: dict[str, float]
) -> Callable[[float, Any], Any]:
    """Return dT/dt of the free nodes, at one state or at columns of them."""
    free = [node for node in net.nodes if node.boundary_input is None]
    number = {node.name: i for i, node in enumerate(free)}
    fixed = row | {
        node.name: AMBIENT_K for node in net.nodes if node.name not in number
    }

    links = [
        (link.a, link.b, *split(link.conductance_w_k, link.factors, fixed))
        for link in net.links
    ]
    sources = [
        (source.node, *split(source.gain, source.factors, fixed))
        for source in net.sources
        if source.node in number
    ]

    def rates(_: float, temperatures: Any) -> Any:
        slots = fixed | dict(zip(number, temperatures, strict=True))
        flow = np.zeros_like(temperatures)
        for a, b, amount, factors in links:
            heat = amount * product(factors, slots) * (slots[a] - slots[b])
            if a in number:
                flow[number[a]] -= heat
            if b in number:
                flow[number[b]] += heat
        for source, amount, factors in sources:
            flow[number[source]] += amount * product(factors, slots)
        for place, node in enumerate(free):
            capacity = node.capacity_j_k * product(node.factors, slots)
            if node.capacity_table is not None:
                capacity = capacity * looked_up(
                    node.capacity_table, temperatures[place]
                )
            flow[place] /= capacity
        return flow

    return rates


def split(
    amount: float, factors: tuple[Factor, ...], known: dict[str, float]
) -> tuple[float, tuple[Factor, ...]]:
    """Take factors of *known* slots alone into *amount*; return the rest.

    They are constant from one change of the inputs to the next.
    """
    given = [one for one in factors if {one.a, one.b or one.a} <= set(known)]
    rest = tuple(one for one in factors if one not in given)
    return amount * float(product(tuple(given), known)), rest


def product(factors: tuple[Factor, ...], slots: dict[str, Any]) -> Any:
    """Multiply *factors*."""
    return prod(factor_value(factor, slots) for factor in factors)


def factor_value(factor: Factor, slots: dict[str, Any]) -> Any:
    """Return one factor, read from the data."""
    a = slots[factor.a]
    b = slots[factor.b] if factor.b is not None else a
    if factor.kind == "value":
        x = a
    elif factor.kind == "difference":
        x = a - b
    elif factor.kind == "mean":
        x = (a + b) / 2.0
    else:
        x = (a * a + b * b) * (a + b)
    return x if factor.table is None else looked_up(factor.table, x)


def looked_up(table: Any, x: Any) -> Any:
    """Return *table* at *x*, by NumPy's interpolation."""
    grid = table.x0 + table.dx * np.arange(len(table.values))
    return np.interp(x, grid, table.values)
