"""Exported models, compiled once, and open instances of them."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.exchange.fmu import write_fmu

from ..fmu_slave import PLATFORM, Slave, model_of  # noqa: TID252

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.bus.signals.signal_map import SignalMap
    from bstm_daemon.config.sections import Config

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def vehicle() -> tuple[Config, SignalMap]:
    return load_vehicle(ROOT / "config" / "example_vehicle.toml", quiet=True)


@pytest.fixture(scope="session")
def config(vehicle: tuple[Config, SignalMap]) -> Config:
    return vehicle[0]


@pytest.fixture(scope="session")
def fmu_file(
    vehicle: tuple[Config, SignalMap],
    tmp_path_factory: pytest.TempPathFactory,
) -> Callable[[str, int], Path]:
    """Return the FMU of a corner or "car", each compiled once."""
    pytest.importorskip("fmpy", reason="FMPy is not installed (extra fmu)")
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    config, signal_map = vehicle
    folder = tmp_path_factory.mktemp("fmu")

    def made(name: str, fmi: int) -> Path:
        path = folder / f"{name}{fmi}.fmu"
        if not path.exists():
            write_fmu(
                model_of(config, signal_map, name), path, fmi, [PLATFORM]
            )
        return path

    return made


@pytest.fixture
def opened(
    fmu_file: Callable[[str, int], Path],
) -> Any:
    """Open instances of an FMU; they are closed at the end."""
    there: list[Slave] = []

    def slave(name: str, fmi: int = 2, start_s: float = 0.0) -> Slave:
        there.append(Slave(fmu_file(name, fmi), fmi, start_s))
        return there[-1]

    yield slave
    for one in there:
        one.close()
