"""How near the shipped structures come to the reality's two presets.

Nothing is matched on these drives: the example car's parameters, matched on
the preset without effects, and every effect of the structure ``extended`` at
strength 1 with typical parameters.
"""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING, Any

import numpy as np
from physics import NODES, nodes_of, stop_s
from side_by_side import Outcome, Table

from bstm_daemon.channels import CHANNELS
from bstm_daemon.config.reading import load_config
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.estimator.estimator import Estimator
from bstm_daemon.files import shipped_file
from bstm_daemon.model.effects.catalogue import STRUCTURES
from bstm_daemon.model.thermal.kernel import Batch
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.simulation import load_drive, simulate
from bstm_daemon.simulation.profile import SAMPLE_S

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation import SimulatedDrive

    Series = np.typing.NDArray[np.floating[Any]]
    Nodes = dict[str, Series]

DRIVES = ("simalp", "rich", "long-run")
PRESETS = ("plain", "road")
EVERY = 5
ROLES = (
    *("vehicle_speed", "primary_pressure", "secondary_pressure"),
    "ambient_temperature",
)


def run(*, full: bool) -> Outcome:
    """Drive each preset and compare both structures with it."""
    rows = [
        row
        for name in (DRIVES if full else DRIVES[:1])
        for preset in PRESETS
        for row in _drive(name, preset)
    ]
    header = (
        *("drive", "preset", "heat", "structure"),
        *(f"{node}, K" for node in NODES),
        *("fluid peak, K", "its time, min"),
    )
    return Outcome(
        "Structures",
        "Front left brake of the simulated car without sensor errors. RMS and "
        "largest error at each node over the whole drive, estimate less "
        "truth of the fluid's peak. Heat known (the reality's own), or "
        "Feed-Forward from the pressure with the nominal friction.",
        tables=[Table("Errors by structure", header, tuple(rows))],
    )


def _drive(name: str, preset: str) -> list[tuple[str, ...]]:
    driven = simulate(load_drive(name), preset=preset)
    truth = nodes_of(driven)
    rows = []
    for heat, estimates in (("known", known_heat), ("ff", _fed_forward)):
        for structure in STRUCTURES:
            found = estimates(example_car(structure, heat), driven)
            rows.append(
                (name, preset, heat, structure, *_errors(found, truth, driven))
            )
    return rows


def example_car(structure: str, heat: str = "known") -> Config:
    """Return the example car of *structure*; *heat*: known or ff."""
    config = load_config(shipped_file("config/example_vehicle.toml"))
    mode = "fb" if heat == "known" else "ff"
    return config.model_copy(
        update={
            "thermal": config.thermal.model_copy(
                update={"structure": structure}
            ),
            "heat": config.heat.model_copy(update={"mode": mode}),
        }
    )


def known_heat(config: Config, driven: SimulatedDrive) -> Nodes:
    """Return :data:`NODES` [K] at 1 Hz on the reality's own brake power."""
    count = len(driven.time_s) // EVERY
    series = {
        "speed_ms": driven.course.speed_ms,
        "pressure_pa": driven.roles["primary_pressure"],
        "brake_power_w": driven.brake_power_w[:, 0],
        "ambient_k": driven.roles["ambient_temperature"],
        "wetness": driven.course.level(
            [segment.rain for segment in driven.course.segments]
        ),
    }
    rows = np.full((count, len(CHANNELS)), np.nan)
    for name, values in series.items():
        cut = values[: count * EVERY].reshape(count, EVERY)
        rows[:, CHANNELS.index(name)] = cut.mean(axis=1)
    pressure = rows[:, CHANNELS.index("pressure_pa")]
    on_pa = config.heat.brake_on_pressure_pa
    rows[:, CHANNELS.index("brake_on")] = pressure > on_pa
    program = compile_corner(config, config.corner[0])
    start_k = float(driven.truth["FL.disc"][0])
    batch = Batch([program], start_k, kernel=load_kernel("compiled"))
    step_s = EVERY * SAMPLE_S
    each = round(1.0 / step_s)
    out = batch.march(array("d", rows.ravel()), count, step_s, each, each)
    table = np.array(out).reshape(-1, batch.width + batch.sources)
    names = program.state_names
    return {node: table[:, names.index(node)] for node in NODES}


def _fed_forward(config: Config, driven: SimulatedDrive) -> Nodes:
    """Give the estimator what the vehicle's signals would say."""
    present = {ROLE_INDEX[role]: 500_000 for role in ROLES}
    start_k = float(driven.truth["FL.disc"][0])
    estimator = Estimator(
        config, present, history_known=True, initial_k=start_k
    )
    count = len(driven.time_s)
    times = np.arange(count, dtype=np.int64) * round(SAMPLE_S * 1e6)
    columns = [driven.roles[role] for role in ROLES]
    blocks = estimator.advance(
        np.repeat(times, len(ROLES)),
        np.tile(
            np.array([ROLE_INDEX[role] for role in ROLES], dtype=np.int32),
            count,
        ),
        np.column_stack(columns).ravel(),
    )
    for number, group in enumerate(estimator.groups):
        if "FL" in group.corners:
            member = group.corners.index("FL")
            parts = [
                np.array(block.outputs[number]).reshape(
                    -1, len(group.corners), group.size
                )[:, member]
                for block in blocks
            ]
            # publications at 10 Hz from 0.1 s on; the truth is at 1 Hz
            table = np.concatenate(parts)[9::10]
            names = group.state_names
            return {node: table[:, names.index(node)] for node in NODES}
    msg = "no group holds the front left brake"
    raise LookupError(msg)


def _errors(
    found: Nodes, truth: Nodes, driven: SimulatedDrive
) -> tuple[str, ...]:
    cells = []
    for node in NODES:
        both = min(len(found[node]), len(truth[node]))
        apart = found[node][:both] - truth[node][:both]
        rms = float(np.sqrt((apart**2).mean()))
        cells.append(f"{rms:.1f} / {np.abs(apart).max():.1f}")
    mine, real = found["fluid"], truth["fluid"]
    after = int(stop_s(driven))
    at = [after + int(one[after:].argmax()) for one in (mine, real)]
    cells.append(f"{mine[at[0]] - real[at[1]]:+.1f}")
    cells.append(f"{(at[0] - at[1]) / 60:+.1f}")
    return tuple(cells)
