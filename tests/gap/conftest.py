"""Drives made by the model with effects, so that what is missing is known."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.bus.columns import Events
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.corner_model import compile_corner
from bstm_daemon.gap.comparison import with_effects
from bstm_daemon.gap.fitting import effect_entries
from bstm_daemon.gap.recording import Recording
from bstm_daemon.heat.sample_plan import CHANNELS
from bstm_daemon.matching.drives import GRID_S, Drive, Thermocouple
from bstm_daemon.matching.march import march
from bstm_daemon.matching.tunables import Target
from bstm_daemon.native import load_kernel

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bstm_daemon.config import Config

EXAMPLE = Path(__file__).parents[2] / "config" / "example_vehicle.toml"
NODES = ("disc", "pad_front", "pad_back", "fluid")
AIR_K = 285.0

# speed [m/s], brake power [W], duration [s]
PROFILE = (
    (10.0, 6000.0, 700.0),
    (10.0, 0.0, 120.0),
    (36.0, 0.0, 200.0),
    (25.0, 20000.0, 30.0),
    (14.0, 5000.0, 400.0),
    (0.0, 0.0, 1800.0),
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """An hour of data, dozens of times over, takes pure Python minutes."""
    if load_kernel() is None:
        for item in items:
            if "gap" in item.path.parts:
                item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def config() -> Config:
    """Return the example car."""
    return load_vehicle(EXAMPLE)[0]


@pytest.fixture(scope="session")
def target(config: Config) -> Target:
    """Return its front left corner."""
    return Target(config, ("FL",))


@pytest.fixture(scope="session")
def made(config: Config) -> Callable[..., Recording]:
    """Return what makes a recording of a car with effects, by strength."""

    def make(
        effects: Mapping[str, float] | None = None,
        name: str = "made",
        *,
        noise_k: float = 0.5,
        seed: int = 1,
    ) -> Recording:
        steps = [round(duration / GRID_S) for *_, duration in PROFILE]
        rows = np.zeros((sum(steps), 1, len(CHANNELS)))
        rows[:, 0, CHANNELS.index("ambient_k")] = AIR_K
        for i, channel in enumerate(("speed_ms", "brake_power_w")):
            column = np.repeat([part[i] for part in PROFILE], steps)
            rows[:, 0, CHANNELS.index(channel)] = column
        power = rows[:, 0, CHANNELS.index("brake_power_w")]
        rows[:, 0, CHANNELS.index("brake_on")] = power > 0.0
        empty = Drive(name, 0.0, ("FL",), rows, {"FL": {}})
        real = with_effects(config, effect_entries(dict(effects or {})))
        program = compile_corner(real, real.corner[0])
        start = {node.name: AIR_K for node in program.network.nodes}
        result = march([program], empty, "FL", start)
        rng = np.random.default_rng(seed)
        couples = {
            node: Thermocouple(
                empty.time_s[1::2],
                result[node][1::2, 0]
                + rng.normal(0.0, noise_k, len(empty) // 2),
            )
            for node in NODES
        }
        drive = Drive(name, 0.0, ("FL",), rows, {"FL": couples})
        none = Events(
            np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros(0),
            Counter(),
        )  # fmt: skip
        return Recording(drive, none, {}, none, rows)

    return make
