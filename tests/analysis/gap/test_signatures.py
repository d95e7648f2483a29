"""Steps of the sensitivities, and what signatures are without a choice."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bstm_daemon.analysis.gap.signatures import (
    CHANGE_STRENGTHS,
    STEP,
    Sensed,
    _of_values_k,
    _sensitivities_k,
)


def test_sensitivities_are_taken_inside_the_bounds() -> None:
    """One step up, and where that would leave them, one down."""
    slopes = np.array([[2.0, 0.0, 1.0], [0.0, -3.0, 4.0]])
    seen = []

    def residuals_k(points: Any, effects: Any) -> Any:
        assert effects == ["what is adopted"]
        seen.append(points)
        return 5.0 + slopes @ points.T

    upper = np.array([0.1, STEP, 0.5 * STEP])
    comparison: Any = SimpleNamespace(upper=upper, residuals_k=residuals_k)
    x = np.array([-0.2, 0.0, 0.0])

    base_k, jacobian_k = _sensitivities_k(comparison, x, ["what is adopted"])

    (points,) = seen
    assert (points <= upper).all()
    assert points[0].tolist() == x.tolist()
    moved = points[1:] - x
    assert np.diag(moved) == pytest.approx([STEP, STEP, -STEP])
    assert np.count_nonzero(moved) == 3
    assert base_k == pytest.approx([4.6, 5.0])
    assert jacobian_k == pytest.approx(slopes)


def test_a_changed_value_is_marched_from_where_it_settles() -> None:
    """At every strength; what has effects of its own is not among them."""
    asked = []

    def residuals_k(points: Any, *, each_settles: bool) -> Any:
        asked.append(each_settles)
        return np.array([[1.0], [2.0]]) + points[:, 0]

    hat = "change.effect.disc_hat.strength"
    comparison: Any = SimpleNamespace(
        start=np.zeros(1),
        upper=np.array([0.9]),
        trials={
            "change.a": SimpleNamespace(effects=()),
            "change.b": SimpleNamespace(effects=("one",)),
            hat: SimpleNamespace(effects=(), direction=np.array([0.6])),
        },
        placed=lambda start, of: (start + sum(of.values()), []),
        residuals_k=residuals_k,
    )

    found = _of_values_k(comparison, np.array([1.0, 2.0]))

    assert asked == [True]
    assert found.keys() == {"change.a", hat}
    for name, expected in ("change.a", CHANGE_STRENGTHS), (hat, (-0.5, 1.5)):
        strengths, changes = found[name]
        assert strengths == pytest.approx(expected)
        assert changes.tolist() == [
            [pytest.approx(strength)] * 2 for strength in expected
        ]


def test_an_effect_of_one_form_costs_no_choice() -> None:
    terms = np.array([[1.0, 2.0], [0.5, 0.0]])
    sensed = Sensed(
        *(np.ones(2), np.ones((2, 1))),
        {"hub_heat": terms, "disc_hat": terms},
        *((), ()),
        form_costs={"disc_hat": 0.4},
    )
    layout: Any = SimpleNamespace(
        whiten=lambda k: 2.0 * k, series=(), edges=np.zeros(1, int)
    )

    found = sensed.whitened(layout)

    hub, hat = found.signatures
    assert (hub.form_cost, hat.form_cost) == (0.0, 0.4)
    assert hub.linear.tolist() == [2.0, 4.0]
    assert hub.at(2.0).tolist() == [8.0, 8.0]
    assert found.residual.tolist() == [2.0, 2.0]
