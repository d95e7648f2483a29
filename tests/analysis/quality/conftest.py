"""A simulated drive as a recording, clean and with faults put in."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bstm_daemon.analysis.quality.finding import Quality
from bstm_daemon.analysis.quality.judge import judge
from bstm_daemon.analysis.quality.recording import Recording, Series
from bstm_daemon.bus.signals.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import Config
from bstm_daemon.simulation import SimulatedDrive, parse_drive, simulate

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "config" / "example_vehicle.toml"

TRACK_M = 1.6
WHEELBASE_M = 2.8
NOISE = {
    "wheel_speed": 0.01,
    "vehicle_speed": 0.01,
    "gnss_speed": 0.05,
    "acceleration": 0.03,
}

DRIVE = """
[drive]
name = "mixed"
description = "stops of all kinds, bends and a hill"
ambient_c = 10.0
[[segment]]
parked = true
duration_s = 4.0
[[segment]]
repeat = 3
[[segment.segment]]
speed_kmh = 90.0
rate_ms2 = 2.5
gear = 3
duration_s = 16.0
[[segment.segment]]
speed_kmh = 40.0
rate_ms2 = 5.0
[[segment.segment]]
speed_kmh = 40.0
gear = 2
bend_radius_m = 40.0
duration_s = 5.0
[[segment.segment]]
speed_kmh = 40.0
gear = 2
bend_radius_m = -30.0
duration_s = 4.0
[[segment.segment]]
speed_kmh = 60.0
rate_ms2 = 1.5
gear = 2
grade_percent = -6.0
duration_s = 14.0
[[segment.segment]]
speed_kmh = 0.0
rate_ms2 = 3.0
[[segment.segment]]
parked = true
duration_s = 4.0
"""


@pytest.fixture(scope="session")
def mixed() -> SimulatedDrive:
    """Return three minutes with everything the checks need."""
    return simulate(parse_drive(DRIVE, "mixed.toml"))


@pytest.fixture(scope="session")
def example() -> tuple[Config, SignalMap]:
    """Return the example car and its extraction plan."""
    config = load_config(EXAMPLE)
    plan = compile_signal_map(
        config.bus,
        config.signals,
        EXAMPLE.parent,
        config.vehicle.wheel_radius_m,
    )
    return config, plan


@pytest.fixture(scope="session")
def role_names(example: tuple[Config, SignalMap]) -> list[str]:
    """Return the roles that the example car has, sorted."""
    return sorted(example[0].signals)


@pytest.fixture(scope="session")
def clean(
    mixed: SimulatedDrive, example: tuple[Config, SignalMap]
) -> Recording:
    """Return the drive as 50 Hz samples with noise and real bends.

    The simulated car's wheels all run at its own speed; here they follow
    their circles.
    """
    wanted = example[0].signals
    rng = np.random.default_rng(7)
    time_s = mixed.time_s[::2] - mixed.time_s[0]
    series = {}
    yaw = mixed.roles["yaw_rate"][::2]
    for role, samples in mixed.roles.items():
        if role not in wanted:
            continue
        value = samples[::2].astype(float)
        for start, sd in NOISE.items():
            if role.startswith(start):
                value = value + rng.normal(0.0, sd, len(value))
        if role.startswith("wheel_speed"):
            corner = role[-2:]
            side = -1.0 if corner[1] == "l" else 1.0
            ahead = WHEELBASE_M * yaw if corner[0] == "f" else 0.0
            value = np.hypot(value + side * 0.5 * TRACK_M * yaw, ahead)
        series[role] = Series(time_s, value)
    for role, samples in mixed.temperatures.items():
        series[role] = Series(mixed.slow_time_s, samples)
    return Recording(series, float(time_s[-1]), {}, {})


@pytest.fixture(scope="session")
def judged(
    example: tuple[Config, SignalMap],
) -> Callable[[Recording], Quality]:
    """Return a function that judges a recording for the example car."""
    config, plan = example

    def of_example(recording: Recording) -> Quality:
        return judge(recording, config, plan)

    return of_example
