"""Forces that differ with something, by hand and in a search."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap import heat_only
from bstm_daemon.analysis.gap.force_balance import ForceComparison
from bstm_daemon.analysis.gap.heat_only import find_force_gap
from bstm_daemon.analysis.gap.naming import Answer, Naming
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
)
from bstm_daemon.analysis.gap.unnamed import Unnamed
from bstm_daemon.analysis.gap.unnamed_forces import (
    MOTION,
    SHARE,
    _braked_s,
    unnamed_forces,
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


@pytest.mark.slow
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

    found = {one.when: one.change for one in unnamed_forces(comparison)}

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
    by_mass_n = found.pop("with acceleration and slope")
    inertia_n = comparison.column("inertia_n")
    assert by_mass_n == pytest.approx(SHARE * (inertia_n - comparison.noise_n))
    assert np.abs(inertia_n).max() > 0.3 * comparison.vehicle.mass_kg * 9.81
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
    """A drive without a braking, of a car without a disc: motion alone."""
    empty: Any = SimpleNamespace(
        column=lambda _: np.zeros(3),
        noise_n=np.zeros(3),
        layout=SimpleNamespace(whiten=lambda column: column),
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

    assert [one.place for one in unnamed_forces(empty)] == [MOTION]


@pytest.mark.parametrize(
    ("named", "evidence", "answer"),
    [
        ((), 0.9, "nothing"),
        ((), 1.1, "unknown"),
        # the name explains 50 of the log-likelihood: half as much again
        (("friction_fade",), 74.0, "name"),
        (("friction_fade",), 76.0, "unknown"),
    ],
)
def test_friction_without_a_name_is_told_where_it_explains_more(
    monkeypatch: pytest.MonkeyPatch,
    named: tuple[str, ...],
    evidence: float,
    answer: Answer,
) -> None:
    own = np.array([0.0, 1e3, 0.0])
    known = Linearised(
        *(np.array([3.0, 10.0, 1.0]), np.zeros((3, 1))),
        (Signature("friction_fade", own, 0.0 * own, own, either_sign=False),),
        *((), ()),
    )
    odds = {"friction_fade": 0.9, "": 0.1}
    plain = Naming(
        *("name" if named else "nothing", named, 0.9, (), odds, "plain")
    )
    told = replace(
        plain.answered("unknown", (), 0.9, "told"),
        unknown_evidence=evidence,
        unknown_place="friction that differs with speed",
    )
    monkeypatch.setattr(
        heat_only,
        "name_effect",
        lambda _, found: told if found.unknown else plain,
    )
    heat = Unnamed("friction", "with speed", own, is_heat=False)
    monkeypatch.setattr(heat_only, "unnamed_forces", lambda _: (heat,))
    comparison: Any = SimpleNamespace(layout=None, prior=np.ones(1))

    found = heat_only._with_unnamed(comparison, known)

    assert found.answer == answer
    if named and answer == "unknown":
        assert found.reason == (
            "friction that differs with speed explains more than friction_fade"
        )
        assert found.probability == pytest.approx(0.9)


@pytest.mark.slow
def test_a_law_beyond_the_catalogue_is_not_taken_for_nothing() -> None:
    config = matched_to(car()[0], {})
    hot = driven("rich", {"friction_fade": 2.0})

    found = find_force_gap(config, [hot], without={"friction_fade"}).naming

    assert (found.answer, found.names) == ("unknown", ())
    assert found.unknown_place == (
        "friction that differs with the discs' temperature"
    )


@pytest.mark.slow
def test_a_mass_beyond_the_catalogue_is_not_taken_for_nothing() -> None:
    config = matched_to(car()[0], {})
    heavy = driven("rich", {"mass_error": 3.0})
    twins = {"mass_error", "powertrain_torque_error"}

    found = find_force_gap(config, [heavy], without=twins).naming

    assert (found.answer, found.names) == ("unknown", ())
    assert found.unknown_place == (
        "force of the motion that differs with acceleration and slope"
    )
