"""The cars of another simulator that a release is reported on."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(BENCHMARKS)
    return import_module("second_world")


def test_no_release_has_a_car_of_an_earlier_one(
    world: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In any order of asking; those of the last release are used up too."""
    log = tmp_path / "CHANGELOG.md"
    monkeypatch.setattr(world, "CHANGELOG", log)
    log.write_text(
        "".join(
            f"## [{version}] - 2026-01-01\n"
            for version in ("Unreleased", "0.3.0", "0.2.0", "0.1.0")
        )
    )

    drawn = {}
    for version in ("0.2.0", "0.3.0", "0.1.0"):
        monkeypatch.setattr(world.bstm_daemon, "__version__", version)
        drawn[version] = world.release_seeds(world.CARS)

    every = [seed for seeds in drawn.values() for seed in seeds]
    assert len(set(every)) == len(every) == 3 * world.CARS
    assert set(every) <= set(world.RELEASE_SEEDS)
    assert world.release_seeds(3) == drawn["0.1.0"][:3]
    monkeypatch.setattr(world.bstm_daemon, "__version__", "0.4.0")
    with pytest.raises(SystemExit, match=r"no version 0\.4\.0"):
        world.release_seeds(3)


def test_the_cars_of_a_report_are_those_of_its_release(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(world.bstm_daemon, "__version__", "0.4.9")

    assert world.release_seeds(10) == [
        *(554, 758, 524, 598, 872, 593, 556, 888, 986, 736)
    ]
