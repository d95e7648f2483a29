"""A pushed descent, simulated once, and inputs for single corners."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bstm_daemon.simulation import (
    LaneInputs,
    SimulatedDrive,
    load_drive,
    parse_drive,
    simulate,
)
from bstm_daemon.simulation.recorder import Encoder

DATABASE = Path(__file__).parents[2] / "dbc" / "example_vehicle.dbc"

SHORT = """
[drive]
name = "short"
description = "a stop and a pause"
ambient_c = 10.0
thermocouple_logger = true
[[segment]]
speed_kmh = 72.0
rate_ms2 = 2.0
gear = 3
duration_s = 15.0
[[segment]]
speed_kmh = 0.0
rate_ms2 = 4.0
[[segment]]
parked = true
duration_s = 5.0
[[segment]]
parked = true
ignition = false
duration_s = 8.0
"""


@pytest.fixture(scope="session")
def simalp() -> SimulatedDrive:
    """Return the drive simalp on the nominal car."""
    return simulate(load_drive("simalp"))


@pytest.fixture(scope="session")
def short() -> SimulatedDrive:
    """Return half a minute: away, a stop, parked, ignition off."""
    return simulate(parse_drive(SHORT, "short.toml"))


@pytest.fixture(scope="session")
def encoder() -> Encoder:
    """Return the encoder of the example car."""
    return Encoder(DATABASE)


@pytest.fixture
def lane_inputs() -> Callable[..., LaneInputs]:
    """Return a maker of steps with constant inputs but those given."""

    def make(steps: int, step_s: float, **given: Any) -> LaneInputs:
        rows = {
            "speed_ms": 0.0,
            "power_w": 0.0,
            "pressure_pa": 0.0,
            "contact": 0.0,
            "ambient_k": 283.15,
            "wetness": 0.0,
            "pumping_pa_s": 0.0,
        }
        per_car = given.pop("corners_per_car", 0)
        rows.update(given)
        columns = {
            name: np.asarray(value)
            if np.ndim(value) == 2
            else np.broadcast_to(value, (steps,))[:, None]
            for name, value in rows.items()
        }
        return LaneInputs(
            step_s=np.full(steps, step_s),
            keep=np.ones(steps, dtype=np.bool_),
            corners_per_car=per_car,
            **columns,
        )

    return make
