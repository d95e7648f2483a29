"""The population of heat inputs: how it is drawn, and that columns are fair.

Its figures are in ``docs/heat.md``; here is what they rest on.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.replay import replay_log
from bstm_daemon.shipped import shipped_file
from bstm_daemon.simulation.frames import Encoder
from bstm_daemon.simulation.recorder import write_candump

if TYPE_CHECKING:
    from bstm_daemon.native import Kernel

BENCHMARKS = str(Path(__file__).parents[1] / "benchmarks")


@pytest.fixture
def cases(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the module of the population's cases."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    import heat_case  # noqa: PLC0415

    yield heat_case
    for name in ("heat_case", "heat_roads"):
        sys.modules.pop(name, None)


def test_each_dimension_is_once_in_each_of_its_strata(cases: Any) -> None:
    count = 20
    drawn = cases.hypercube(count, 1)

    for name, (low, high) in cases.DIMENSIONS.items():
        if name == "sensors":
            continue
        values = np.array([getattr(case, name) for case in drawn])
        strata = np.floor((values - low) / (high - low) * count)
        assert sorted(strata) == list(range(count)), name
    assert {case.sensors for case in drawn} == {"n1", "n2", "n3"}
    assert {(case.preset, case.satellites) for case in drawn} == {
        (preset, given)
        for preset in ("plain", "road")
        for given in (True, False)
    }


def test_another_seed_draws_other_cars(cases: Any) -> None:
    assert cases.hypercube(4, 1) == cases.hypercube(4, 1)
    assert cases.hypercube(4, 1)[0].mass_kg != cases.hypercube(4, 2)[0].mass_kg


@pytest.mark.parametrize("number", [0, 3])
def test_columns_give_what_frames_give(
    compiled: Kernel, cases: Any, tmp_path: Path, number: int
) -> None:
    """The bus's resolution and its staggered frames change little."""
    case = cases.hypercube(8, 1)[number]
    road = cases.Road(np.random.default_rng(1), 3.0, 6.0)
    cases.learning(road, 0)
    driven = cases.simulated(case, road.drive("learning 1"))
    by_columns = cases.estimate(cases.configured("fused"), driven, 0)

    path = tmp_path / "drive.log"
    write_candump(
        path, driven, Encoder(shipped_file("dbc/example_vehicle.dbc"))
    )
    _, signal_map = load_vehicle(shipped_file("config/example_vehicle.toml"))
    columns = replay_log(
        cases.configured("fused"), signal_map, path
    ).results.columns

    energy_j = 0.1 * sum(
        float(columns[f"{corner}.brake_power_w"].sum())
        for corner in ("FL", "FR", "RL", "RR")
    )
    assert energy_j == pytest.approx(by_columns.heat.energy_j, rel=0.01)
    for name, off in (("mass_kg", 0.01), ("friction_scale", 0.01)):
        assert columns[name][-1] == pytest.approx(
            by_columns.last(name), rel=off
        )


def test_learning_makes_the_heat_right(compiled: Kernel, cases: Any) -> None:
    """One car of the population: where FF and FB alone are far off."""
    found = cases.examine(cases.hypercube(8, 1)[1])

    for kind in ("descent", "hard stops", "city"):
        heat = found["heat"][kind]
        assert abs(heat["fused"]) < 0.08, kind
        assert max(abs(heat["ff"]), abs(heat["fb"])) > 0.1, kind
