"""Drives made by the model itself, so that the right values are known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.corner_model import compile_corner
from bstm_daemon.heat.sample_plan import CHANNELS
from bstm_daemon.matching.drives import GRID_S, Drive, Thermocouple
from bstm_daemon.matching.march import march
from bstm_daemon.matching.tunables import Target
from bstm_daemon.native import load_kernel

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from bstm_daemon.config import Config

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "config" / "example_vehicle.toml"
NODES = ("disc", "pad_front", "pad_back", "fluid")
AIR_K = 285.0

# speed [m/s], brake power [W], duration [s]
PROFILE = (
    (10.0, 0.0, 20.0),
    (10.0, 6000.0, 700.0),
    (10.0, 0.0, 120.0),
    (20.0, 0.0, 120.0),
    (36.0, 0.0, 120.0),
    (25.0, 20000.0, 30.0),
    (14.0, 5000.0, 400.0),
    (0.0, 0.0, 2700.0),
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """An hour of data, dozens of times over, takes pure Python minutes."""
    if load_kernel() is None:
        for item in items:
            if "matching" in item.path.parts:
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
def made(target: Target) -> Callable[..., Drive]:
    """Return what makes a drive with the model's own temperatures."""

    def make(
        values: Mapping[str, float] | None = None,
        name: str = "made",
        *,
        profile: Any = PROFILE,
        nodes: tuple[str, ...] = NODES,
        noise_k: float = 0.0,
        seed: int = 1,
        scale: float = 1.0,
        target: Target = target,
    ) -> Drive:
        steps = [round(duration / GRID_S) for *_, duration in profile]
        rows = np.zeros((sum(steps), 1, len(CHANNELS)))
        rows[:, 0, CHANNELS.index("ambient_k")] = AIR_K
        for i, channel in enumerate(("speed_ms", "brake_power_w")):
            column = np.repeat([part[i] for part in profile], steps)
            rows[:, 0, CHANNELS.index(channel)] = column * (
                scale if i else 1.0
            )
        power = rows[:, 0, CHANNELS.index("brake_power_w")]
        rows[:, 0, CHANNELS.index("brake_on")] = power > 0.0
        empty = Drive(name, 0.0, ("FL",), rows, {"FL": {}})
        right = target.changed(dict(values or {}))
        program = compile_corner(right.config, right.corner)
        start = {node.name: AIR_K for node in program.network.nodes}
        result = march([program], empty, "FL", start)
        rng = np.random.default_rng(seed)
        every = round(1.0 / GRID_S)
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

    return make
