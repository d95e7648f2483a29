"""The example car and its front left corner, for drives made by the model."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from bstm_daemon.analysis.matching.tunables import Target
from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.native.loader import load_kernel

from ..made_drives import EXAMPLE  # noqa: TID252  (tests are no package)

if TYPE_CHECKING:
    from bstm_daemon.config.sections import Config


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """An hour of data, dozens of times over, takes pure Python minutes."""
    if load_kernel() is None:
        for item in items:
            if {"gap", "matching"} & set(item.path.parts):
                item.add_marker(pytest.mark.slow)


@pytest.fixture(scope="session")
def config() -> Config:
    """Return the example car."""
    return load_vehicle(EXAMPLE)[0]


@pytest.fixture(scope="session")
def target(config: Config) -> Target:
    """Return its front left corner."""
    return Target(config, ("FL",))
