"""The compiled step of the thermal network against the pure-Python one."""

from __future__ import annotations

from array import array
from functools import partial
from math import cos
from typing import TYPE_CHECKING

from side_by_side import Goal, Outcome, Table, Work, take_turns, three_digits

from bstm_daemon.channels import CHANNELS
from bstm_daemon.config.reading import load_config
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.files import shipped_file
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.native.loader import load_kernel

if TYPE_CHECKING:
    from bstm_daemon.model.thermal.program import Program
    from bstm_daemon.native.loader import Kernel

STEP_S = 0.05
MEMBERS = (1, 4, 8, 64, 1024)


def run(*, full: bool) -> Outcome:
    """Measure the cost per step and member of the front left corner."""
    config = load_config(shipped_file("config/example_vehicle.toml"))
    program = compile_corner(config, config.disc_corners()[0])
    compiled = load_kernel("compiled")
    _check_equal(program, compiled)

    pairs = 40_960 if full else 16_384
    plain_steps = 1000 if full else 300
    plain = Batch([program], config.vehicle.ambient_c + 273.15, kernel=None)
    works = {
        "reference": Work(
            partial(_march, plain, stop_and_go(plain_steps)), plain_steps
        )
    }
    for members in MEMBERS:
        batch = Batch(
            [program] * members, 283.15, [0] * members, compiled, sets=1
        )
        steps = pairs // members
        works[f"{members}"] = Work(
            partial(_march, batch, stop_and_go(steps)), pairs
        )
    timings = take_turns(works, 9 if full else 5)

    net = program.network
    outcome = Outcome(
        "Kernel",
        f"Front corner of the example car: {len(net.nodes)} nodes, "
        f"{len(net.links)} links, {len(net.sources)} sources; ROS2, step "
        f"{STEP_S} s, stop-and-go. Both forms give the same bits, checked in "
        "the run.",
    )
    outcome.goals = [
        Goal(
            "one member, compiled against pure Python",
            timings.ratio("reference", "1"),
            at_least=50.0,
            tolerance=0.35,
        ),
        Goal(
            "four members (a car) side by side against one member",
            timings.ratio("1", "4"),
            at_least=1.8,
            tolerance=0.35,
        ),
        Goal(
            "64 members side by side against one member",
            timings.ratio("1", "64"),
            at_least=2.0,
            tolerance=0.35,
        ),
    ]
    rows = [("pure Python", "1", "reference")]
    rows += [("compiled", name, name) for name in map(str, MEMBERS)]
    outcome.tables = [
        Table(
            "CPU time per step and member",
            ("form", "members", "us"),
            tuple(
                (
                    form,
                    members,
                    three_digits(timings.median(key) * 1e6),
                )
                for form, members, key in rows
            ),
        )
    ]
    return outcome


def stop_and_go(steps: int) -> array[float]:
    """Return inputs [steps, 1, channels]: braking in two thirds of 10 s."""
    rows = array("d")
    measured = float("nan")
    for step in range(steps):
        braking = step % 200 < 130
        speed_ms = 20.0 + 20.0 * cos(0.031 * step)
        values = {
            "speed_ms": speed_ms,
            "pressure_pa": 2e6 if braking else 0.0,
            "brake_on": float(braking),
            "wetness": 0.0,
            "ambient_k": 283.15,
            "brake_power_w": 500.0 * speed_ms if braking else 0.0,
            "brake_energy_ff_j": 0.0,
            "brake_energy_fb_j": 0.0,
        }
        rows.extend(values.get(channel, measured) for channel in CHANNELS)
    return rows


def _march(batch: Batch, inputs: array[float]) -> None:
    steps = len(inputs) // len(CHANNELS)
    batch.march(inputs, steps, STEP_S, output_every=steps)


def _check_equal(program: Program, compiled: Kernel | None) -> None:
    inputs = stop_and_go(400)
    ends = []
    # 13 = 8 + 4 + 1, every width of the compiled march
    for kernel, members in ((None, 1), (compiled, 1), (compiled, 13)):
        batch = Batch(
            [program] * members, 283.15, [0] * members, kernel, sets=1
        )
        _march(batch, inputs)
        ends += [
            batch.state[first : first + batch.width].tobytes()
            for first in range(0, len(batch.state), batch.width)
        ]
    if len(set(ends)) != 1:
        msg = "compiled and reference step differ"
        raise AssertionError(msg)
