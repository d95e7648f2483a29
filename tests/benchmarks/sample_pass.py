"""The pass over samples, compiled against pure Python."""

from __future__ import annotations

import tempfile
from array import array
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from log_decode import with_events
from side_by_side import Goal, Outcome, Table, Work, take_turns, three_digits
from traffic import write_traffic

from bstm_daemon.channels import CHANNELS, VEHICLE_CHANNELS
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.estimator.estimator import ROWS, STEP_US
from bstm_daemon.files import shipped_file
from bstm_daemon.model.heat import sample_pass as reference
from bstm_daemon.model.heat.memory import SampleState
from bstm_daemon.model.heat.sample_plan import SamplePlan, plan_samples
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.replay.columns import present_roles

if TYPE_CHECKING:
    from log_decode import Samples

    from bstm_daemon.native.loader import Kernel

REFERENCE_SAMPLES = 20_000


class Room(NamedTuple):
    """Where the pass puts its steps."""

    rows: array[float]
    vehicle: array[float]
    times: array[int]

    @classmethod
    def of(cls, plan: SamplePlan) -> Room:
        """Return room for as many steps as the estimator has."""
        per_step = 8 * len(plan.corners) * len(CHANNELS)
        return cls(
            array("d", bytes(ROWS * per_step)),
            array("d", bytes(ROWS * 8 * len(VEHICLE_CHANNELS))),
            array("q", bytes(ROWS * 8)),
        )


def run(*, full: bool) -> Outcome:
    """Measure the samples of a mixed log, four corners."""
    vehicle = load_vehicle(shipped_file("config/example_vehicle.toml"))
    config, signal_map = vehicle
    kernel = load_kernel("compiled")
    assert kernel is not None
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "mixed.log"
        write_traffic(path, 300 if full else 60, config)
        samples = with_events(path, signal_map, "any")
    plan = plan_samples(config, present_roles(signal_map), STEP_US)
    few = samples.first(REFERENCE_SAMPLES)
    if with_python(plan, few) != with_kernel(kernel, plan, few):
        msg = "compiled and reference pass differ"
        raise AssertionError(msg)
    timings = take_turns(
        {
            "reference": Work(lambda: with_python(plan, few), len(few.value)),
            "compiled": Work(
                lambda: with_kernel(kernel, plan, samples), len(samples.value)
            ),
        },
        9 if full else 5,
    )
    ratio = timings.ratio("reference", "compiled")
    outcome = Outcome(
        "Pass over samples",
        f"{len(samples.value)} samples of the log decode's traffic, "
        f"{len(plan.corners)} corners: held values, friction energy, motion, "
        "time. Both forms give the same bits, checked in the run.",
    )
    outcome.goals = [
        Goal("compiled against pure Python", ratio, 50.0, tolerance=0.5)
    ]
    outcome.tables = [
        Table(
            "CPU time per sample",
            ("form", "ns"),
            tuple(
                (text, three_digits(timings.median(name) * 1e9))
                for name, text in (
                    ("reference", "pure Python"),
                    ("compiled", "compiled"),
                )
            ),
        )
    ]
    return outcome


def with_python(plan: SamplePlan, samples: Samples) -> tuple[bytes, int]:
    """Pass over *samples*; returns rows with numbers, and steps."""
    state, room = SampleState.new(), Room.of(plan)
    columns = [column.tolist() for column in samples]
    index = total = 0
    while index < len(columns[0]):
        index, steps, _ = reference.sample_pass(
            plan, state, columns[0], columns[1], columns[2], index, *room
        )
        total += steps
    return room.rows.tobytes() + state.numbers.tobytes(), total


def with_kernel(
    kernel: Kernel, plan: SamplePlan, samples: Samples
) -> tuple[bytes, int]:
    """Do the same compiled."""
    state, room = SampleState.new(), Room.of(plan)
    index = total = 0
    while index < len(samples.value):
        index, steps, _ = kernel.sample_pass(
            plan.ints, plan.floats, state.times, state.numbers, state.flags,
            *samples, *room, index,
        )  # fmt: skip
        total += steps
    return room.rows.tobytes() + state.numbers.tobytes(), total
