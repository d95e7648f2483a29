"""Why a match is not to be trusted."""

from __future__ import annotations

from types import SimpleNamespace
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest

from bstm_daemon.analysis.matching.doubts import doubts
from bstm_daemon.analysis.matching.refine import Accuracy

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
