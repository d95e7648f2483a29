"""Why a match is not to be trusted."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest

from bstm_daemon.analysis.matching.doubts import doubts
from bstm_daemon.analysis.matching.refine import Accuracy
from bstm_daemon.analysis.matching.tunables import strength_key

if TYPE_CHECKING:
    from bstm_daemon.analysis.matching.refine import Refinement


@pytest.mark.parametrize(
    ("node", "before_k", "left_k", "said"),
    [
        ("fluid", 1.5, 7.3, ["fluid 7.3 K on what was left out, 1.5 K as"]),
        ("fluid", 1.5, 5.0, []),
        ("fluid", 20.0, 7.3, []),
        ("disc", 14.0, 16.0, []),
    ],
)
def test_a_match_that_is_worse_than_configured_is_doubted(
    node: str, before_k: float, left_k: float, said: list[str]
) -> None:
    """By three usual drifts of the node, on what was left out of the fit."""
    joint = SimpleNamespace(
        keys=(), prior=np.zeros(0), covariance=np.zeros((0, 0)), at_bound=()
    )
    accuracy = Accuracy(
        {}, 2, "a and b", {node: before_k}, {node: left_k}, 60.0
    )
    rise_k, error_k = np.full(9, 100.0), np.full(9, 1.2)

    found = list(
        doubts(
            cast("Refinement", joint),
            accuracy,
            {node: [(error_k if node == "fluid" else 10.0 * error_k, rise_k)]},
        )
    )

    assert [
        one[: len(text)] for one, text in zip(found, said, strict=True)
    ] == said


@pytest.mark.parametrize(
    ("effect", "strength", "said"),
    [
        # log 9 over 0.3 is 7.3: as far as 4.3 of a normal prior
        ("disc_caliper_radiation", 9.0, "from 1 to 9, 4.3 times what such"),
        ("disc_caliper_radiation", 3.0, None),
        # log 3 over 0.3 is 3.7
        ("disc_hat", 3.0, "from 1 to 3, 3.7 times what such"),
    ],
)
def test_a_value_far_from_its_prior_is_doubted(
    effect: str, strength: float, said: str | None
) -> None:
    """By what a normal prior would hold as strongly."""
    key = strength_key(effect)
    joint = SimpleNamespace(
        keys=(key,),
        start={key: 1.0},
        values={key: strength},
        prior=np.array([0.3]),
        covariance=np.array([[0.01]]),
        at_bound=(),
    )
    accuracy = Accuracy({}, 2, "a and b", {}, {}, 60.0)

    found = [*doubts(cast("Refinement", joint), accuracy, {})]

    assert [said in one for one in found] == [True] if said else not found
