"""The risk benchmark's truth: published figures, and no hot descent lost.

Its figures are in ``docs/risk.md``; here is what they rest on.
"""

from __future__ import annotations

import ast
import sys
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.units import KELVIN_OFFSET

if TYPE_CHECKING:
    from collections.abc import Iterator

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def imported(monkeypatch: pytest.MonkeyPatch, name: str) -> Iterator[Any]:
    """Give benchmark *name* and forget what it imported beside it."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    before = set(sys.modules)
    yield __import__(name)
    for other in set(sys.modules) - before:
        if (BENCHMARKS / f"{other}.py").exists():
            del sys.modules[other]


@pytest.fixture
def published(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    yield from imported(monkeypatch, "risk_published")


@pytest.fixture
def cases(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    yield from imported(monkeypatch, "risk_cases")


def test_the_truth_takes_nothing_from_the_daemon() -> None:
    """Of the product it imports the zero of the Celsius scale only."""
    tree = ast.parse((BENCHMARKS / "risk_published.py").read_text("utf-8"))
    found = {
        node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
    } | {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import)
        for alias in node.names
    }
    product = {name for name in found if "bstm_daemon" in str(name)}

    assert product == {"bstm_daemon.units"}
    assert {
        str(name).split(".", maxsplit=1)[0] for name in found - product
    } == {
        *("__future__", "dataclasses", "functools", "typing"),
        *("collections", "numpy", "scipy", "side_by_side"),
    }


def test_every_row_names_its_source(published: Any) -> None:
    rows = (*published.CANS, *published.CURVES, *published.SURVEYS)

    assert len(rows) >= 20
    assert all(len(row.source) > 10 for row in rows)
    assert {can.grade for can in published.CANS} == set(published.GRADES)
    assert sum(published.GRADES.values()) == pytest.approx(1.0)


def test_a_fluid_passes_its_can_s_points_and_falls(published: Any) -> None:
    """By every curve of its grade, from dry to 8 % of water."""
    for can in published.CANS:
        for curve in published.CURVES:
            if can.grade not in curve.of:
                continue
            fluid = published.Published(can, curve, 3.0)
            falling = [
                fluid.at(percent) for percent in np.arange(0.0, 8.5, 0.5)
            ]

            assert fluid.at(can.dry_percent) - KELVIN_OFFSET == (
                pytest.approx(can.dry_c)
            )
            assert fluid.at(can.wet_percent) - KELVIN_OFFSET == (
                pytest.approx(can.wet_c)
            )
            assert all(a >= b for a, b in pairwise(falling))
            assert falling[2] > falling[8] > falling[-1] >= 373.15
            other = fluid.of_form(published.CURVES[0])
            assert other.at(0.0) == pytest.approx(fluid.at(0.0))
            assert other.at(3.7) == pytest.approx(fluid.at(3.7))


def test_water_is_as_surveyed(published: Any) -> None:
    """Half at 3 % and a fifth above 5 %; a mean of 2.6 %, a quarter above 4.

    One survey in two each: a fluid of known age has 1 to 2 % a year at most.
    """
    rng = np.random.default_rng(1)
    drawn = [published.drawn(rng, "DOT4", None) for _ in range(2000)]
    percents = np.array([fluid.water_percent for fluid in drawn])
    young = [
        published.drawn(rng, "DOT4", 1.0).water_percent for _ in range(200)
    ]

    assert (percents > 5.0).mean() == pytest.approx(0.19, abs=0.03)
    assert (percents > 3.0).mean() == pytest.approx(0.425, abs=0.03)
    (dry, none), *rest = published.SURVEYS[1].points
    assert none == 0.0
    mean, before, below = 0.0, dry, 0.0
    for percent, share in rest:
        mean += (share - below) * (before + percent) / 2.0
        before, below = percent, share
    assert mean == pytest.approx(2.6, abs=0.05)
    assert max(young) <= 2.2
    assert np.median(young) == pytest.approx(1.5, abs=0.2)


@pytest.mark.slow
def test_no_descent_is_left_out_for_being_hot(
    cases: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drivers hold the disc with the engine; the lowest gear is the last."""
    import risk_fleet  # noqa: PLC0415

    rng = np.random.default_rng(3)
    car, ring = risk_fleet._drawn_car(rng)
    cars = [
        risk_fleet.FleetCar(car, name, risk_fleet._unmatched(ring, structure))
        for name, structure in risk_fleet.STRUCTURES.items()
    ]
    drawn = [cases.draw_case(rng, cars, another_day=False) for _ in range(30)]
    found = cases.driven(drawn)
    monkeypatch.setattr(cases, "ENGINE_N", ())
    held = [case.drive.drag_n.max() for case, _ in found]
    alone = [truth.disc_k for _, truth in cases.driven(drawn)]

    assert len(found) == len(drawn)
    assert sum(disc_k > cases.HOTTEST_DISC_K for disc_k in alone) >= 3
    for (_, truth), engine_n, disc_k in zip(found, held, alone, strict=True):
        was_hot = disc_k > cases.HOTTEST_DISC_K
        assert (engine_n >= 500.0) == was_hot
        assert truth.disc_k <= disc_k
        assert truth.disc_k <= cases.HOTTEST_DISC_K or engine_n == 1300.0
    assert {case.one.preset for case, _ in found} == {"plain", "road"}
