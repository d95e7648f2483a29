"""Drives of one corner made by the model itself: its values are known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.matching.drives import GRID_S, Drive, Thermocouple
from bstm_daemon.analysis.matching.march import march
from bstm_daemon.channels import CHANNELS
from bstm_daemon.estimator.corner_model import compile_corner

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.config.sections import Config

EXAMPLE: Final = Path(__file__).parents[1] / "config" / "example_vehicle.toml"
NODES: Final = ("disc", "pad_front", "pad_back", "fluid")
AIR_K: Final = 285.0

Profile = tuple[tuple[float, float, float], ...]
"""Stretches of speed [m/s], brake power [W], duration [s]."""


def driven(
    config: Config,
    name: str,
    profile: Profile,
    *,
    every: int,
    nodes: Sequence[str] = NODES,
    noise_k: float = 0.0,
    seed: int = 1,
    scale: float = 1.0,
) -> Drive:
    """Return the front left corner of *config* driven by *profile*.

    Thermocouples at *nodes* are read each *every* steps of the grid, with
    white noise; the brake power of the profile is taken *scale* times.
    """
    steps = [round(duration / GRID_S) for *_, duration in profile]
    rows = np.zeros((sum(steps), 1, len(CHANNELS)))
    rows[:, 0, CHANNELS.index("ambient_k")] = AIR_K
    for i, (channel, factor) in enumerate(
        (("speed_ms", 1.0), ("brake_power_w", scale))
    ):
        column = np.repeat([part[i] for part in profile], steps)
        rows[:, 0, CHANNELS.index(channel)] = column * factor
    power = rows[:, 0, CHANNELS.index("brake_power_w")]
    rows[:, 0, CHANNELS.index("brake_on")] = power > 0.0
    empty = Drive(name, 0.0, ("FL",), rows, {"FL": {}})
    program = compile_corner(config, config.corner[0])
    start = {node.name: AIR_K for node in program.network.nodes}
    result = march([program], empty, "FL", start)
    rng = np.random.default_rng(seed)
    at = slice(every - 1, None, every)
    couples = {
        node: Thermocouple(
            empty.time_s[at],
            result[node][at, 0]
            + rng.normal(0.0, noise_k, len(empty.time_s[at])),
        )
        for node in nodes
    }
    return Drive(name, 0.0, ("FL",), rows, {"FL": couples})
