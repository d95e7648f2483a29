"""Strengths with what noise and form leave open, and the quick fit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap import fitting
from bstm_daemon.analysis.gap.changes import HEAT_SCALE, LARGEST, largest
from bstm_daemon.analysis.gap.fitting import (
    FORM_ERROR,
    NINETY,
    Fit,
    _strength_bounds,
    directions,
    fit,
    prior_along,
    scale_basis,
)
from bstm_daemon.analysis.gap.signatures import sensed
from bstm_daemon.analysis.gap.workflow import compare
from bstm_daemon.analysis.matching.tunables import S_SPEEDS_MS
from bstm_daemon.model.effects.catalogue import effect_class, effect_names

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.gap.recording import Recording
    from bstm_daemon.analysis.matching.tunables import Target


def fitted(strength: float, noise: float) -> Fit:
    return Fit(np.zeros(1), {"a": strength}, {"a": noise}, 0.0)


def test_a_form_that_differs_is_in_the_deviation() -> None:
    exact = fitted(1.5, 0.0)
    noisy = fitted(1.5, 0.4)

    assert exact.deviations["a"] == pytest.approx(1.5 * FORM_ERROR)
    assert noisy.deviations["a"] == pytest.approx(
        np.hypot(0.4, 1.5 * FORM_ERROR)
    )


@pytest.mark.parametrize("strength", [2.0, -2.0])
def test_the_interval_holds_ninety_percent(strength: float) -> None:
    one = fitted(strength, 0.3)

    low, high = one.interval("a")

    assert high - low == pytest.approx(2.0 * NINETY * one.deviations["a"])
    assert 0.5 * (low + high) == pytest.approx(strength)


@pytest.mark.parametrize("strength", [0.3, -0.3])
def test_the_interval_ends_where_the_effect_would_turn(
    strength: float,
) -> None:
    low, high = fitted(strength, 1.0).interval("a")

    assert (low, high)[int(strength < 0.0)] == 0.0
    assert low < strength < high


@pytest.mark.slow
def test_known_sensitivities_lead_to_the_same_fit(
    target: Target, made: Callable[..., Recording]
) -> None:
    comparison = compare(target, [made({"gap_conduction": 1.3})])
    known = sensed(comparison, [])

    slow = fit(comparison, {"gap_conduction": 0.7})
    quick = fit(comparison, {"gap_conduction": 0.7}, known_k=known.jacobian_k)

    assert quick.strengths["gap_conduction"] == pytest.approx(
        slow.strengths["gap_conduction"], rel=0.02
    )
    assert quick.cost == pytest.approx(slow.cost, rel=0.02)


@pytest.mark.parametrize("flat", [True, False])
def test_a_flat_table_is_moved_as_a_whole(
    monkeypatch: pytest.MonkeyPatch, *, flat: bool
) -> None:
    """Its factors at three speeds are one coefficient; else each is free."""
    monkeypatch.setattr(fitting, "is_flat", lambda _: flat)
    keys = ["pad.conductivity_w_mk", *S_SPEEDS_MS, "unknown"]
    prior = np.array([0.15, 0.2, 0.2, 0.2, 0.7])
    made: Any = SimpleNamespace(
        keys=keys, target=None, prior=prior, matched=False
    )

    basis = directions(made)
    along = prior_along(made, basis)

    if flat:
        tied = [0.0, 1.0, 1.0, 1.0, 0.0]
        assert basis.T.tolist() == [tied, *np.eye(5)[[0, 4]].tolist()]
        assert along.tolist() == [0.2, 0.15, 0.7]
    else:
        assert basis.tolist() == np.eye(5).tolist()
        assert along.tolist() == prior.tolist()


def test_a_flat_table_that_is_not_fitted_ties_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(fitting, "is_flat", lambda _: True)
    made: Any = SimpleNamespace(keys=["a", "b"], target=None, matched=False)

    assert directions(made).tolist() == np.eye(2).tolist()


@pytest.mark.parametrize(
    ("keys", "columns"),
    [
        (
            ["other", HEAT_SCALE, *S_SPEEDS_MS],
            [[0.0, 1.0, *(0.0 for _ in S_SPEEDS_MS)],
             [0.0, 0.0, *(1.0 for _ in S_SPEEDS_MS)]],
        ),
        (["other", HEAT_SCALE], [[0.0, 1.0]]),
        ([next(iter(S_SPEEDS_MS)), "other"], [[1.0, 0.0]]),
        (["other"], []),
    ],
)  # fmt: skip
def test_heat_and_cooling_are_moved_as_wholes(
    keys: list[str], columns: list[list[float]]
) -> None:
    made: Any = SimpleNamespace(keys=keys)

    assert scale_basis(made).T.tolist() == columns


def test_a_strength_stays_on_the_side_of_0_where_it_began() -> None:
    """Within its own bounds, not those of another parameter."""
    names = ["friction_history", "change.disc_air", "change.disc_air"]
    names += ["accelerometer_bias"]
    least = effect_class("accelerometer_bias").parameters()[0].lower
    assert least < -1.0

    lower, upper = _strength_bounds(names, np.array([1.0, 0.5, -0.5, -1.0]))

    assert lower.tolist() == pytest.approx(
        [0.0, 0.0, -LARGEST, least], abs=0.02
    )
    assert upper.tolist() == pytest.approx(
        [largest("friction_history"), LARGEST, 0.0, 0.0], abs=0.02
    )


@pytest.mark.parametrize(
    "name",
    [
        name
        for name in effect_names()
        if effect_class(name).most_strength < LARGEST
    ],
)
def test_a_strength_is_fitted_up_to_where_physics_ends(
    name: str, made: Callable[..., Recording], target: Target
) -> None:
    """A drive with all of it that there can be: no trial goes beyond."""
    most = effect_class(name).most_strength
    comparison = compare(target, [made({name: most})])

    found = fit(comparison, {name: most}).strengths[name]

    assert 0.3 * most < found <= most
