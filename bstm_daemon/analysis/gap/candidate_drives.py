"""Drives that could be driven next, as the model sees them.

The driver and the car of each menu drive are the simulated ones: speed,
pressure and torque of every sample. What thermocouples would then show is
the model's own prediction, never the simulated brake's: advice is given
before the drive.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.gap.recording import Recording, inputs_of, thinned
from bstm_daemon.analysis.matching.drives import GRID_S, Drive, Thermocouple
from bstm_daemon.analysis.matching.march import march, model_of
from bstm_daemon.bus.signals.columns import Events
from bstm_daemon.estimator.corner_model import compiled_model
from bstm_daemon.model.heat.sample_pass import TICK
from bstm_daemon.roles import ROLE_INDEX
from bstm_daemon.simulation import load_drive, simulate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bstm_daemon.config.sections import Config
    from bstm_daemon.simulation.simulate import SimulatedDrive

MENU: Final = tuple(f"m{number:02d}" for number in range(1, 16))

EVERY: Final = 10
"""Of the simulation's samples at 100 Hz one in so many is kept."""

READ_S: Final = 2.0
"""Between two readings of a predicted thermocouple."""


def candidate_drive(
    name: str,
    config: Config,
    present: Mapping[int, int],
    couples: Mapping[str, Sequence[str]],
) -> tuple[Recording, str]:
    """Return the menu drive *name* as *config* predicts it, and what it is.

    Args:
        name: of a drive of the simulated car.
        config: the model.
        present: role number to timeout [us] of what this car's bus has.
        couples: thermocouples by corner.

    Raises:
        UsageError: no such drive.
    """
    simulated = simulate(load_drive(name), sensors="none", seed=0)
    events = samples_of(simulated, present)
    inputs, corners = inputs_of(config, present, events)
    start_s = float(events.time_us[0]) * 1e-6
    empty = Drive(name, start_s, corners, inputs, {})
    drive = replace(
        empty,
        measured={
            corner: _predicted(config, empty, corner, nodes)
            for corner, nodes in couples.items()
        },
    )
    thin = thinned(events)
    description = simulated.drive.drive.description.partition(": ")[2]
    return Recording(drive, events, present, thin, inputs), description


def samples_of(
    drive: SimulatedDrive,
    present: Mapping[int, int],
    *,
    temperatures: bool = False,
) -> Events:
    """Return what a simulated car's sensors say, in order of time.

    Roles of *present* only; thermocouples where *temperatures* are wanted.
    """
    bus = np.asarray(drive.bus_on)[::EVERY]
    time_s = drive.time_s[::EVERY][bus]
    parts = [
        (time_s, ROLE_INDEX[name], np.asarray(values)[::EVERY][bus])
        for name, values in drive.roles.items()
        if ROLE_INDEX[name] in present
    ]
    # a bus may sleep where the drive goes on
    parts.append((drive.slow_time_s, TICK, np.zeros(len(drive.slow_time_s))))
    if temperatures:
        on = np.interp(drive.slow_time_s, drive.time_s, drive.logger_on) > 0.5
        parts += [
            (drive.slow_time_s[on], ROLE_INDEX[name], values[on])
            for name, values in drive.temperatures.items()
            if ROLE_INDEX[name] in present
        ]
    stamps = np.concatenate(
        [np.rint(time * 1e6).astype(np.int64) for time, _, _ in parts]
    )
    order = np.argsort(stamps, kind="stable")
    roles = np.concatenate(
        [np.full(len(time), role, np.int32) for time, role, _ in parts]
    )
    values = np.concatenate([value for _, _, value in parts])
    return Events(stamps[order], roles[order], values[order], Counter())


def _predicted(
    config: Config, drive: Drive, corner: str, nodes: Sequence[str]
) -> dict[str, Thermocouple]:
    model = model_of(config, corner)
    result = march([compiled_model(model)], drive, corner)
    own = {node.name for node in model.network.nodes}
    every = round(READ_S / GRID_S)
    return {
        node: Thermocouple(
            drive.time_s[::every], result[model.shown(node)][::every, 0]
        )
        for node in nodes
        if node in own
    }
