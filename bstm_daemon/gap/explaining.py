"""What effects explain, and what they leave beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.gap.projector import FREE
from bstm_daemon.gap.unknown import missing_evidence

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.gap.evidence import Candidate
    from bstm_daemon.gap.projector import Projector
    from bstm_daemon.gap.signatures import Linearised
    from bstm_daemon.matching.drives import Column


def explained_share(
    project: Projector, linearised: Linearised, chosen: Sequence[Candidate]
) -> tuple[float, float]:
    """Return the gain of *chosen* as a share of that of all together.

    And what is left of it. Half a unit for each effect is chance.
    """
    names = {one.name for one in chosen}
    own = np.column_stack(
        [s.at(1.0) for s in linearised.signatures if s.name in names]
    )
    everything = _everything(linearised)
    few = _joint_gain(project, linearised.residual, own)
    chance = 0.5 * (everything.shape[1] - own.shape[1])
    many = _joint_gain(project, linearised.residual, everything) - chance
    return min(few / max(many, few, 1e-9), 1.0), max(many - few, 0.0)


def unknown_beside(
    project: Projector, linearised: Linearised, chosen: Sequence[Candidate]
) -> float:
    """Return the log Bayes factor of heat without a name beside *chosen*.

    By forces alone there is none to ask for: then nothing speaks against it.
    """
    if not linearised.unknown:
        return np.inf
    names = {one.name for one in chosen}
    own = [s.at(1.0) for s in linearised.signatures if s.name in names]
    return missing_evidence(
        project.beside(own), linearised.residual, linearised.unknown
    )


def _everything(linearised: Linearised) -> Column:
    """Return all effects and heats without a name as columns, (n, k)."""
    return np.column_stack(
        [
            *(s.at(1.0) for s in linearised.signatures),
            *(one.change for one in linearised.unknown),
        ]
    )


def _joint_gain(
    project: Projector, residual: Column, columns: Column
) -> float:
    projected = project(columns)
    gram = columns.T @ projected + np.eye(columns.shape[1]) / FREE**2
    score = projected.T @ residual
    return 0.5 * float(score @ np.linalg.solve(gram, score))
