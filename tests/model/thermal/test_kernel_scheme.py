"""The scheme: order, stability, energy, and that both forms are one."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from itertools import pairwise
from math import cos, log, nan, sin, sqrt
from typing import TYPE_CHECKING

import pytest

from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.effects.catalogue import apply_effects
from bstm_daemon.model.effects.model import CornerModel
from bstm_daemon.model.thermal.brake_corner import CornerSpec, build_corner
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.model.thermal.network import Link, Network, Node, radiation
from bstm_daemon.model.thermal.program import Program, compile_network
from bstm_daemon.model.thermal.table import Table

from ...energy_ledger import read_ledger  # noqa: TID252  (no package)

if TYPE_CHECKING:
    from bstm_daemon.native.loader import Kernel

INPUTS = (
    *("speed_ms", "brake_on", "ambient_k", "brake_power_w", "pressure_pa"),
    "wetness",
)
WIDTH = len(INPUTS)
EFFECTS = (
    *("contact_conductance", "friction_history", "pad_pyrolysis"),
    *("shim_contact", "wet_disc", "caliper_fluid_split"),
)
MakeSpec = Callable[..., CornerSpec]


def radiating(kernel: Kernel | None, steps: int, *, table: bool) -> float:
    """Return a lump's temperature after 100 s of radiation to 0 K."""
    own = Table(0.0, 2000.0, (1e-9, 2.0)) if table else None  # C = T / 1000
    net = Network(
        ("space_k",),
        (
            Node("space", 0.0, boundary_input="space_k"),
            Node("lump", 1000.0, own),
        ),
        (Link("r", "lump", "space", 1e-8, (radiation("lump", "space"),)),),
    )
    batch = Batch([compile_network(net)], 1000.0, kernel=kernel)
    batch.state[0] = 0.0
    batch.march(array("d", [0.0] * steps), steps, 100.0 / steps)
    return batch.state[1]


@pytest.mark.parametrize("table", [False, True])
def test_second_order_in_the_step(
    kernel: Kernel | None, *, table: bool
) -> None:
    """Against the closed form, with constant and linear capacity."""
    if table:  # dT/dt = -k T^3
        exact = 1000.0 / sqrt(1.0 + 2.0 * 1e-8 * 1e6 * 100.0)
    else:  # dT/dt = -k T^4
        exact = 1000.0 * (1.0 + 3.0 * 1e-11 * 1e9 * 100.0) ** (-1.0 / 3.0)
    errors = [
        abs(radiating(kernel, steps, table=table) - exact)
        for steps in (40, 80, 160, 320)
    ]
    orders = [log(a / b) / log(2.0) for a, b in pairwise(errors)]
    assert errors[0] > 1e-3
    assert orders[1:] == pytest.approx([2.0, 2.0], abs=0.1)


def test_huge_steps_do_not_ring(kernel: Kernel | None) -> None:
    """L-stability: a stiff lump is at rest after one step, and stays."""
    net = Network(
        ("ambient_k",),
        (Node("ambient", 0.0, boundary_input="ambient_k"), Node("foil", 1.0)),
        (Link("h", "foil", "ambient", 1e4),),
    )
    batch = Batch([compile_network(net)], 300.0, kernel=kernel)
    batch.state[1] = 900.0
    apart = []
    for _ in range(3):
        batch.march(array("d", [300.0]), 1, 1000.0)
        apart.append(abs(batch.state[1] - 300.0))
    assert apart[0] < 600.0 * 1e-6
    assert apart[1] < apart[0] * 1e-5


def everything(spec: CornerSpec, **strength: float) -> Program:
    """Return the corner with gap, static loss and all six effects."""
    model = CornerModel(
        spec, build_corner(spec, INPUTS), heat_from_pressure=True
    )
    effects = [
        EffectConfig(
            name=name, parameters={"strength": strength.get(name, 1.0)}
        )
        for name in EFFECTS
    ]
    return compile_network(apply_effects(model, effects).network)


def rough_spec(make_spec: MakeSpec) -> CornerSpec:
    """Return a corner with every term of the thesis's network at work."""
    return make_spec(
        thermal={
            "gap_conductance_w_m2k": 200.0,
            "pad_static_loss_w_k": 0.5,
            "backplate_thermal_capacity_j_k": 250.0,
            "direct_air_fraction": 0.01,
            "hammerhead_sink": "fluid",
        }
    )


def drive(steps: int) -> array[float]:
    """Return stops in quick succession on a road wet half of the time."""
    rows = array("d")
    for i in range(steps):
        braking = i % 200 < 130
        speed = max(20.0 + 20.0 * cos(0.031 * i), 0.0)
        pressure = 3e6 * (1.0 + 0.5 * sin(0.2 * i)) if braking else 0.0
        rows.extend(
            (
                speed,
                float(braking),
                283.15 + 5.0 * sin(0.001 * i),
                pressure * 0.02 * speed / 20.0,
                pressure,
                float(i % 400 < 200),
            )
        )
    return rows


def test_energy_is_conserved_with_everything_on(
    kernel: Kernel | None, make_spec: MakeSpec
) -> None:
    """Generated = given off + stored, through the Curie peak and back."""
    program = everything(rough_spec(make_spec))
    batch = Batch([program], 283.15, kernel=kernel)
    start = array("d", batch.state)
    hottest = 0.0
    for piece in range(4):
        rows = drive(2400)[piece * 600 * WIDTH : (piece + 1) * 600 * WIDTH]
        out = batch.march(rows, 600, 0.25)
        disc = program.state_names.index("disc")
        hottest = max(hottest, *out[disc :: len(out) // 600])
    ledger = read_ledger(program, batch.ledger, start, batch.state)
    assert hottest > 1100.0  # beyond the peak of cp
    for link in ("disc_pad_gap", "contact_conductance", "wet_disc"):
        assert abs(ledger.links[link]) > 1e-6 * ledger.generated
    assert ledger.sources["hot_pad_reduction"] > 0.0
    assert ledger.sources["pyrolysis_heat"] < 0.0
    assert ledger.given_off["dissolved"] > 0.0
    assert ledger.generated > 1e6
    assert abs(ledger.residual) < 1e-9 * ledger.generated


def test_ledger_refuses_a_capacity_that_depends_on_drivers() -> None:
    """Stored heat would not be a function of the state."""
    factor = (radiation("a", "a"),)
    program = compile_network(Network((), (Node("a", 1.0, None, factor),)))
    with pytest.raises(ValueError, match="node 'a'"):
        read_ledger(program, [], [300.0], [301.0])


def descent(dt_s: float) -> tuple[array[float], int]:
    """Return 25 min at 36 km/h and 6 kW, then 60 min parked."""
    down, soak = round(1500.0 / dt_s), round(3600.0 / dt_s)
    rows = array("d", [10.0, 1.0, 283.15, 6000.0, 0.75e6, 0.0] * down)
    rows.extend(array("d", [0.0, 0.0, 283.15, 0.0, 0.0, 0.0] * soak))
    return rows, down + soak


def test_both_forms_agree_over_a_descent(
    compiled: Kernel, make_spec: MakeSpec
) -> None:
    """Alpine descent and soak; 0.5 s steps for the sake of pure Python."""
    program = compile_network(build_corner(rough_spec(make_spec), INPUTS))
    rows, steps = descent(0.5)
    outputs = []
    for kernel in (None, compiled):
        batch = Batch([program], 283.15, kernel=kernel)
        outputs.append(batch.march(rows, steps, 0.5, 10))
    apart = max(abs(a - b) for a, b in zip(*outputs, strict=True))
    size = len(program.state_names) + len(program.network.sources)
    disc = outputs[0][program.state_names.index("disc") :: size]
    assert max(disc) > 700.0
    assert apart <= 1e-9


def test_both_forms_agree_with_everything_on(
    compiled: Kernel, make_spec: MakeSpec
) -> None:
    """States, memories and energies of the rough drive."""
    program = everything(rough_spec(make_spec))
    batches = [Batch([program], 283.15, kernel=k) for k in (None, compiled)]
    for batch in batches:
        batch.march(drive(1500), 1500, 0.25)
    one, two = batches
    assert list(two.state) == pytest.approx(list(one.state), rel=0, abs=1e-9)
    assert list(two.ledger) == pytest.approx(list(one.ledger), rel=1e-12)


@pytest.mark.parametrize("count", [2, 7, 23, 30])
def test_lanes_equal_single_members(
    compiled: Kernel, make_spec: MakeSpec, count: int
) -> None:
    """Blocks of four, eight and 16, the last not full, bit for bit."""
    spec = rough_spec(make_spec)
    programs = [
        everything(
            spec, wet_disc=0.07 * (i + 1), friction_history=2.3 - 0.07 * i
        )
        for i in range(count)
    ]
    rows, steps = drive(600), 600
    together = Batch(programs, 283.15, [0] * count, compiled, sets=1)
    out = together.march(rows, steps, 0.25, 7, 3)
    size = together.width + together.sources
    for i, program in enumerate(programs):
        alone = Batch([program], 283.15, kernel=compiled)
        mine = alone.march(rows, steps, 0.25, 7, 3)
        theirs = array("d")
        for k in range(len(mine) // size):
            first = (k * count + i) * size
            theirs.extend(out[first : first + size])
        assert mine.tobytes() == theirs.tobytes()
        width = together.ledger_width
        ledger = together.ledger[i * width : (i + 1) * width]
        assert ledger == alone.ledger


def test_a_node_is_forced_in_one_lane_and_free_in_another(
    compiled: Kernel, make_spec: MakeSpec
) -> None:
    """Temperatures and energies of each are those of pure Python alone."""
    network = build_corner(rough_spec(make_spec), INPUTS)
    program = compile_network(network.with_forced("disc"))
    steps, rows, own = 40, array("d"), (array("d"), array("d"))
    for i in range(steps):
        for lane, target in enumerate((300.0 + 5.0 * i, nan)):
            row = 20.0, 1.0, 283.15, 5000.0, 1e6, 0.0, target
            rows.extend(row)
            own[lane].extend(row)

    together = Batch([program] * 2, 300.0, [0, 1], compiled, sets=2)
    together.march(rows, steps, 0.25)

    for lane, inputs in enumerate(own):
        alone = Batch([program], 300.0, kernel=None)
        alone.march(inputs, steps, 0.25)
        for whole, part in (
            (together.state, alone.state),
            (together.ledger, alone.ledger),
        ):
            found = whole[lane * len(part) : (lane + 1) * len(part)]
            assert list(found) == pytest.approx(list(part), rel=1e-9)


def test_members_read_their_own_inputs(
    kernel: Kernel | None, make_spec: MakeSpec
) -> None:
    """Rows of one block: member i reads the set it names."""
    program = compile_network(build_corner(make_spec(), INPUTS))
    rows = array("d")
    for _ in range(20):
        for power in (0.0, 1000.0, 2000.0):
            rows.extend((10.0, 1.0, 283.15, power, 1e5, 0.0))
    batch = Batch([program] * 2, 283.15, [2, 0], kernel, sets=3)
    batch.march(rows, 20, 0.05)
    first = batch.ledger[: batch.ledger_width]
    second = batch.ledger[batch.ledger_width :]
    heated = program.ledger_names.index("disc_heat")
    disc = program.ledger_names.index("pad_heat")
    assert first[heated] + first[disc] == pytest.approx(2000.0)
    assert second[heated] == 0.0


def test_pieces_equal_the_whole(
    kernel: Kernel | None, make_spec: MakeSpec
) -> None:
    """State carries everything: any cut gives the same bits."""
    program = everything(rough_spec(make_spec))
    rows = drive(60)
    whole = Batch([program], 283.15, kernel=kernel)
    expected = whole.march(rows, 60, 0.25)
    pieces = Batch([program], 283.15, kernel=kernel)
    found = array("d")
    for first, last in ((0, 1), (1, 7), (7, 7), (7, 60)):
        found.extend(
            pieces.march(
                rows[first * WIDTH : last * WIDTH], last - first, 0.25
            )
        )
    assert found.tobytes() == expected.tobytes()
    assert pieces.ledger == whole.ledger


def test_settle_keeps_memories(
    kernel: Kernel | None, make_spec: MakeSpec
) -> None:
    """One member goes to the temperature, its neighbour stays."""
    program = everything(rough_spec(make_spec))
    batch = Batch([program] * 2, 283.15, [0, 0], kernel, sets=1)
    batch.march(drive(100), 100, 0.25)
    before = batch.state[:]
    batch.settle(290.0, 1)
    nodes = len(program.network.nodes)
    assert batch.state[: batch.width] == before[: batch.width]
    assert set(batch.state[batch.width : batch.width + nodes]) == {290.0}
    assert batch.state[batch.width + nodes :] == before[batch.width + nodes :]
    assert before[-2] > 0.0
