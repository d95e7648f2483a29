"""Friction that differs with something, by hand and in a search."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap.force_balance import ForceComparison
from bstm_daemon.analysis.gap.heat_only import find_force_gap
from bstm_daemon.analysis.gap.unnamed_friction import (
    SHARE,
    _braked_s,
    unnamed_friction,
)
from bstm_daemon.analysis.matching.march import march
from bstm_daemon.estimator.corner_model import compile_corner

from .test_heat_only import (
    car,
    driven,
    matched_to,
)

if TYPE_CHECKING:
    from bstm_daemon.analysis.statistics.series import Column


def test_a_straight_line_in_what_it_goes_with() -> None:
    """Weighted by the force: no part of friction as a whole, and 5 %."""
    config, _ = car()
    drives = [
        driven("idiada-step", {}, sensors="none", seed=seed) for seed in (3, 4)
    ]
    comparison = ForceComparison(config, drives)
    identity: Any = SimpleNamespace(whiten=lambda column: column)
    comparison.layout = identity
    whole_n = comparison.column("whole_n")

    found = {one.regime: one.change for one in unnamed_friction(comparison)}

    def disc_k(number: int) -> Column:
        corners = config.disc_corners()
        drive, first = drives[number].drive, comparison.parts[number].first
        series = [
            march([compile_corner(config, one)], drive, one.name)["disc"]
            for one in corners
        ]
        return sum(one[first, 0] for one in series) / len(corners)

    work_j = [np.cumsum(p.whole_n * p.metres) for p in comparison.parts]
    held_s = np.concatenate(
        [
            _braked_s(one)[own]
            for one, own in zip(comparison.parts, comparison.kept, strict=True)
        ]
    )
    assert held_s.max() > 12.0
    drivers = {
        "with speed": comparison.column("speed_ms"),
        "with pressure": whole_n,
        "with the work so far": np.concatenate(
            [j[own] for j, own in zip(work_j, comparison.kept, strict=True)]
        ),
        # no more than in the first ten seconds
        "with the length of the braking": np.log1p(np.minimum(held_s, 10.0)),
        "with the discs' temperature": np.concatenate(
            [disc_k(i)[own] for i, own in enumerate(comparison.kept)]
        ),
    }
    assert found.keys() == drivers.keys()
    for name, change_n in found.items():
        assert abs(change_n @ whole_n) < 1e-6 * (whole_n @ whole_n)
        assert change_n @ change_n == pytest.approx(
            SHARE**2 * (whole_n @ whole_n)
        )
        braked = whole_n > 1.0
        share = change_n[braked] / whole_n[braked]
        line = np.polyfit(drivers[name][braked], share, 1)
        assert line[0] > 0.0
        assert share == pytest.approx(
            np.polyval(line, drivers[name][braked]), abs=1e-9
        )


def test_a_braking_lasts_since_it_began() -> None:
    part: Any = SimpleNamespace(
        time_s=2.0 * np.arange(6),
        braked=np.array([0.0, 0.3, 1.0, 0.0, 0.0, 1.0]),
    )

    assert _braked_s(part).tolist() == [0.0, 2.0, 4.0, 0.0, 0.0, 2.0]


def test_friction_that_never_differs_is_none() -> None:
    """A drive without a braking, of a car without a disc."""
    empty: Any = SimpleNamespace(
        column=lambda _: np.zeros(3),
        kept=[np.ones(3, bool)],
        parts=[
            SimpleNamespace(
                time_s=np.arange(3.0),
                speed_ms=np.ones(3),
                whole_n=np.zeros(3),
                metres=np.ones(3),
                braked=np.zeros(3),
                first=np.arange(3),
            )
        ],
        recordings=[SimpleNamespace(drive=None)],
        config=SimpleNamespace(disc_corners=list),
    )

    assert unnamed_friction(empty) == ()


@pytest.mark.slow
def test_a_law_beyond_the_catalogue_is_not_taken_for_nothing() -> None:
    config = matched_to(car()[0], {})
    hot = driven("rich", {"friction_fade": 2.0})

    found = find_force_gap(config, [hot], without={"friction_fade"}).naming

    assert (found.answer, found.names) == ("unknown", ())
    assert found.unknown_place == "friction, with the discs' temperature"
