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
    """In any order of asking; twelve by chance would share some."""
    log = tmp_path / "CHANGELOG.md"
    monkeypatch.setattr(world, "CHANGELOG", log)
    versions = [f"0.3.{number}" for number in range(12)]
    log.write_text(
        "".join(
            f"## [{version}] - 2026-01-01\n"
            for version in ("Unreleased", *reversed(versions))
        )
    )

    every: list[int] = []
    for version in (*versions[6:], *versions[:6]):
        monkeypatch.setattr(world.bstm_daemon, "__version__", version)
        every += world.release_seeds(world.CARS)

    assert len(set(every)) == len(every) == 12 * world.CARS
    assert set(every) <= set(world.RELEASE_SEEDS)
    assert world.release_seeds(3) == every[-world.CARS :][:3]
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
