"""Fixtures shared by all tests: both forms of the kernel, a car."""

import functools
import gc
import os
from collections.abc import Callable, Iterator
from typing import Any, cast

# before anything imports numpy: a worker of pytest has one core, and BLAS
# threads that wait for each other would take the other worker's
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import Phase, settings

from bstm_daemon.bus.signals import dbc
from bstm_daemon.config.sections import Config, CornerConfig, VehicleConfig
from bstm_daemon.estimate import NO_INPUT
from bstm_daemon.estimator import validity
from bstm_daemon.model.thermal.brake_corner import CornerSpec, corner_spec
from bstm_daemon.native.loader import VARIABLE, Kernel, load_module

# CI runs the same examples every time, a developer looks for new ones; a busy
# machine is no defect, so that no example has a deadline. .ci/full searches
# with --hypothesis-profile thorough; of a mutant the first failure is enough
settings.register_profile(
    "ci", derandomize=True, deadline=None, max_examples=25
)
settings.register_profile("local", deadline=None, max_examples=25)
settings.register_profile("thorough", deadline=None, max_examples=1000)
settings.register_profile(
    "mutants",
    settings.get_profile("ci"),
    phases=(Phase.explicit, Phase.generate),
)
settings.load_profile("ci" if os.environ.get("CI") else "local")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Give each worker files in a row: what they share is made once.

    The rig's box has no xdist.
    """
    from xdist.scheduler import WorkStealingScheduling  # noqa: PLC0415

    if config.getoption("dist") != "load":
        return None
    return WorkStealingScheduling(config, log)


def pytest_collection_finish() -> None:
    """Keep what was collected, which stays, out of garbage collection."""
    gc.collect()
    gc.freeze()


def pytest_collection_modifyitems(
    config: pytest.Config, items: list[pytest.Item]
) -> None:
    """With pure Python chosen, leave out what names the compiled kernel.

    Those tests run the pure-Python form beside it in every run.
    """
    if os.environ.get(VARIABLE) != "reference":
        return
    both = {"compiled", "compiled_chosen", "kernel"}
    left_out = {
        item
        for item in items
        if not both.isdisjoint(getattr(item, "fixturenames", ()))
    }
    config.hook.pytest_deselected(items=list(left_out))
    items[:] = [item for item in items if item not in left_out]


@pytest.fixture(scope="session", autouse=True)
def parsed_once() -> Iterator[None]:
    """Let cantools, which is slow, parse each text of a DBC once.

    Nothing changes a database that is loaded.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dbc, "_parse", functools.cache(dbc._parse))
        yield


@pytest.fixture(scope="session")
def compiled() -> Kernel:
    """Return the compiled kernel; skip where it is not installed.

    One that was built from other sources is an error, not a skip.
    """
    kernel = load_module("native._kernel")
    if kernel is None:
        if os.environ.get(VARIABLE) == "compiled":
            pytest.fail("BSTM_KERNEL=compiled, but it is not installed")
        pytest.skip("the compiled kernel is not installed")
    return cast("Kernel", kernel)


@pytest.fixture(scope="session", params=["reference", "compiled"])
def kernel(request: pytest.FixtureRequest) -> Kernel | None:
    """Return None for the pure-Python form, then the compiled kernel."""
    if request.param == "reference":
        return None
    found: Kernel = request.getfixturevalue("compiled")
    return found


def corner_config(name: str = "FL", **changes: Any) -> CornerConfig:
    """Return a front corner of a 2.2 t car with *changes*."""
    table: dict[str, Any] = {
        "name": name,
        "piston_area_m2": 2.83e-3,
        "effective_radius_m": 0.13,
        "disc": {
            "mass_kg": 7.5,
            "swept_area_m2": 0.085,
            "total_area_m2": 0.2,
        },
        "pad": {"area_m2": 6.5e-3, "thickness_m": 0.011},
        **changes,
    }
    return CornerConfig(**table)


def car_config(*corners: CornerConfig, **sections: Any) -> Config:
    """Return a car with *corners*; *sections* are sections as tables."""
    vehicle = {
        "id": "test",
        "mass_kg": 2194.0,
        "wheel_radius_m": 0.3418,
        "wheel_inertia_kg_m2": 3.0809,
        **sections.pop("vehicle", {}),
    }
    heat = sections.pop("heat", {})
    if isinstance(heat, dict):
        heat = {"mode": "ff", **heat}
    return Config(
        vehicle=VehicleConfig(**vehicle),
        bus=[],
        signals={},
        corner=list(corners or (corner_config(),)),
        heat=heat,
        **sections,
    )


@pytest.fixture
def all_verified(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take every input as verified: the other reasons alone count."""
    monkeypatch.setattr(
        validity,
        "unverified_inputs",
        lambda config, _: {corner.name: NO_INPUT for corner in config.corner},
    )


@pytest.fixture(scope="session")
def make_corner() -> Callable[..., CornerConfig]:
    """Return the maker of corners."""
    return corner_config


@pytest.fixture(scope="session")
def make_car() -> Callable[..., Config]:
    """Return the maker of cars."""
    return car_config


@pytest.fixture(scope="session")
def make_spec() -> Callable[..., CornerSpec]:
    """Return what makes the spec of a corner with [thermal], [cooling]."""

    def make(
        corner: dict[str, Any] | None = None, **sections: Any
    ) -> CornerSpec:
        car = car_config(corner_config(**(corner or {})), **sections)
        return corner_spec(car, car.corner[0])

    return make
