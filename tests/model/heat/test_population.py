"""The population of heat inputs: how it is drawn, and that columns are fair.

Its figures are in ``docs/heat.md``; here is what they rest on.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bstm_daemon.cli.vehicle import load_vehicle
from bstm_daemon.files import shipped_file
from bstm_daemon.simulation.recorder import Encoder, write_candump
from tests.replayed import replay_log

BENCHMARKS = str(Path(__file__).parents[2] / "benchmarks")


@pytest.fixture
def cases(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the module of the population's cases."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    import heat_case  # noqa: PLC0415

    yield heat_case
    for name in ("heat_case", "heat_roads"):
        sys.modules.pop(name, None)


@pytest.fixture
def population(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the module that writes the table."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    before = set(sys.modules)
    import heat_population  # noqa: PLC0415

    yield heat_population
    for name in set(sys.modules) - before:
        if not name.startswith("bstm_daemon"):
            del sys.modules[name]


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


@pytest.mark.usefixtures("compiled_chosen")
@pytest.mark.parametrize(
    "number", [0, pytest.param(3, marks=pytest.mark.slow)]
)
def test_columns_give_what_frames_give(
    cases: Any, tmp_path: Path, number: int
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
        cases.configured("fused"), signal_map, path, forecast=False
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


@pytest.mark.slow
@pytest.mark.usefixtures("compiled_chosen")
def test_learning_makes_the_heat_right(cases: Any) -> None:
    """One car of the population: where FF and FB alone are far off."""
    found = cases.examine(cases.hypercube(8, 1)[1])

    for kind in ("descent", "hard stops", "city"):
        heat = found["heat"][kind]
        assert abs(heat["fused"]) < 0.08, kind
        assert max(abs(heat["ff"]), abs(heat["fb"])) > 0.1, kind


def invented(number: int, heat: float, mass: float) -> dict[str, Any]:
    """Return a case with one error of all heat, said to be 2 %."""
    figures = {
        **dict.fromkeys(("fused", "relative", "front", "ff", "fb"), heat),
        "sd": 0.02,
        "grade_rms": 0.001,
        "grade_mean": 0.0,
        "grade_sd": 0.002,
        "flags": 0,
    }
    kinds = ("learning 1", "learning 2", "learning 3", "descent")
    kinds += ("hard stops", "city", "first descent")
    learned = dict.fromkeys(
        ("bias", "mass_true", "friction", "friction_alone", "drag"), 0.001
    )
    learned |= {"mass": mass, "friction_true": 0.001}
    learned |= {f"{name}_sd": 0.01 for name in ("bias", "mass", "friction")}
    return {
        "case": {
            "number": number,
            "satellites": number % 2 == 0,
            "sensors": ("n1", "n2", "n3")[number % 3],
            "preset": ("plain", "road")[number % 2],
        },
        "heat": dict.fromkeys(kinds, figures),
        "learned": [learned] * 3,
    }


def test_goals_are_missed_and_reached(population: Any) -> None:
    """Medians, the 95th percentile, and both ends of the coverage."""
    heats = [0.01] * 18 + [0.1, -0.1]
    found = [invented(i, heat, 0.01) for i, heat in enumerate(heats)]
    reached = {
        goal.name: goal.reached
        for goal in population.outcome_of(found, 1, full=True).goals
    }

    assert reached["heat of descent, median"]
    assert not reached["heat of descent, 95th percentile"]
    assert reached["mass over torque scale after 15 min, 95th percentile"]
    assert reached["descent to city, median"]
    assert reached["heat within 90 % intervals"]
    for heat in (0.001, 0.1):
        sure = [invented(i, heat, 0.01) for i in range(20)]
        goals = population.outcome_of(sure, 1, full=True).goals
        assert not goals[-1].reached


def test_the_table_goes_between_its_marks(
    population: Any, tmp_path: Path
) -> None:
    page = tmp_path / "heat.md"
    found = [invented(i, 0.01, 0.01) for i in range(6)]
    outcome = population.outcome_of(found, 1, full=True).as_data()
    outcome["conditions"] = {"date": "2026-01-02", "commit": "abc"}
    page.write_text(
        f"head\n{population.BEGIN}\nold\n{population.END}\ntail\n", "utf-8"
    )

    population.write(page, outcome)
    once = page.read_text("utf-8")
    population.write(page, outcome)

    assert page.read_text("utf-8") == once
    assert once.startswith("head\n")
    assert once.endswith("tail\n")
    assert "old" not in once
    assert "| heat of city | 1.0 / 1.0 % | 4 / 8 % |" in once
    page.write_text("no marks\n", "utf-8")
    with pytest.raises(ValueError, match="no <!-- population -->"):
        population.write(page, outcome)
