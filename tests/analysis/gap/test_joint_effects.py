"""Two effects at once, also where their mixture looks like a third one."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.analysis.gap.evidence import weigh
from bstm_daemon.analysis.gap.joint_effects import (
    JointEffects,
    search_joint_effects,
)
from bstm_daemon.analysis.gap.signatures import Linearised, Signature
from bstm_daemon.analysis.statistics.evidence import Projector

POINTS = 400
PRIOR = np.ones(2)


def signature(name: str, change: np.ndarray) -> Signature:
    return Signature(name, change, 0.0 * change, change, either_sign=False)


@pytest.fixture
def columns() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(11)
    found = {
        name: rng.normal(0.0, 1.0, POINTS) for name in ("a", "b", "other")
    }
    # neither is missing, but alone it explains more than each that is
    own = rng.normal(0.0, 0.3, POINTS)
    found["mixture"] = 0.7 * (found["a"] + found["b"]) + own
    return found


def searched(
    columns: dict[str, np.ndarray], strengths: dict[str, float]
) -> JointEffects:
    rng = np.random.default_rng(12)
    residual = rng.normal(0.0, 1.0, POINTS)
    for name, strength in strengths.items():
        residual = residual - strength * columns[name]
    signatures = tuple(signature(*one) for one in columns.items())
    linearised = Linearised(
        residual, rng.normal(0.0, 1.0, (POINTS, 2)), signatures, (), ()
    )
    project = Projector(linearised.jacobian, PRIOR)
    found = sorted(
        (weigh(project, residual, one) for one in signatures),
        key=lambda one: -one.log_evidence,
    )
    return search_joint_effects(project, linearised, found)


def test_a_wrong_first_pick_is_undone(columns: dict[str, np.ndarray]) -> None:
    found = searched(columns, {"a": 1.2, "b": 0.8})

    assert {one.name for one in found.chosen} == {"a", "b"}
    assert set(found.sure) == {"a", "b"}
    assert found.share > 0.9


def test_one_effect_stays_alone(columns: dict[str, np.ndarray]) -> None:
    found = searched(columns, {"a": 1.0})

    assert [one.name for one in found.chosen] == ["a"]
    assert found.sure == ("a",)
    assert found.leftover is not None


def test_what_is_small_beside_the_first_is_not_added(
    columns: dict[str, np.ndarray],
) -> None:
    found = searched(columns, {"a": 3.0, "other": 0.4})

    assert [one.name for one in found.chosen] == ["a"]
    assert found.leftover is not None
    assert found.leftover.name == "other"
    assert found.leftover.z > 4.2
