"""Logs of the simulated car, and their motion as identification sees it."""

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import pytest

from bstm_daemon.analysis.identify.driving import Driving, driving_of
from bstm_daemon.analysis.quality.recording import (
    Recording,
    Series,
    read_recording,
)
from bstm_daemon.bus.signals.signal_map import SignalMap, compile_signal_map
from bstm_daemon.config.reading import load_config
from bstm_daemon.config.sections import Config
from bstm_daemon.simulation import (
    SimulatedDrive,
    load_drive,
    parse_drive,
    preset_effects,
    simulate,
)
from bstm_daemon.simulation.recorder import Encoder, write_candump

ROOT = Path(__file__).parents[3]
EXAMPLE = ROOT / "config" / "example_vehicle.toml"
DBC = ROOT / "dbc" / "example_vehicle.dbc"

Logged = Callable[..., Path]


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
def logged(tmp_path_factory: pytest.TempPathFactory) -> Logged:
    """Return a function that writes the CAN log of a drive, once each.

    *drive* is a packaged one's name or a drive's text; *car* changes the
    nominal car, *effects* are strengths besides the preset's.
    """
    folder = tmp_path_factory.mktemp("drives")
    known: dict[str, Path] = {}

    def log(drive: str, sensors: str = "n1", **options: Any) -> Path:
        key = repr((drive, sensors, sorted(options.items())))
        if key not in known:
            path = folder / f"{len(known)}.log"
            write_candump(path, driven(drive, sensors, **options), ENCODER)
            known[key] = path
        return known[key]

    return log


ENCODER = Encoder(DBC)


@lru_cache(maxsize=2)
def driven(
    drive: str,
    sensors: str = "n1",
    *,
    preset: str = "plain",
    car: Any = None,
    seed: int = 3,
    **effects: float,
) -> SimulatedDrive:
    """Return the simulated *drive*."""
    strengths = preset_effects(preset)
    for name, strength in effects.items():
        strengths = strengths.with_strength(name, strength)
    return simulate(
        parse_drive(drive, "own.toml")
        if "[drive]" in drive
        else load_drive(drive),
        car,
        preset=strengths,
        sensors=sensors,
        seed=seed,
    )


@pytest.fixture(scope="session")
def driving(
    example: tuple[Config, SignalMap],
) -> Callable[[Path], Driving]:
    """Return a function that reads a log's motion for the example car."""
    config, plan = example

    def of_log(path: Path) -> Driving:
        return driving_of(
            path.name, read_recording([path], plan), config, plan
        )

    return of_log


@pytest.fixture(scope="session")
def simulated() -> Callable[..., SimulatedDrive]:
    """Return the function that drives the simulated car."""
    return driven


@pytest.fixture(scope="session")
def sampled() -> Callable[..., Recording]:
    """Return the function that records roles past the DBC."""
    return recorded


def recorded(drive: SimulatedDrive, *roles: str) -> Recording:
    """Return *roles* of *drive* as samples, past its DBC.

    Vehicle roles at 50 Hz, thermocouples at the logger's rate.
    """
    start_s = drive.time_s[0]
    time_s, slow_s = drive.time_s[::2] - start_s, drive.slow_time_s - start_s
    series = {
        role: Series(slow_s, drive.temperatures[role])
        if role.startswith("temp_")
        else Series(time_s, drive.roles[role][::2])
        for role in roles
    }
    return Recording(series, float(time_s[-1]), {}, {})
