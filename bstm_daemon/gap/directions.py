"""In which directions the tunables may move while effects are on trial.

All by themselves, as a rule. A cooling table that is flat over speed is a
baseline with one constant coefficient: its factors at three speeds then move
together, or they would be the speed dependence that is asked about.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.gap.layout import Layout
from bstm_daemon.matching.tunables import S_SPEEDS_MS, TUNABLES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.gap.comparison import Comparison
    from bstm_daemon.gap.signatures import Linearised
    from bstm_daemon.matching.drives import Column
    from bstm_daemon.matching.tunables import Target

FLAT: Final = 1e-3
"""Relative difference of a table's values that are one constant."""


def is_flat(target: Target) -> bool:
    """Whether cooling by wind is one constant at all speeds."""
    s = np.array(target.config.cooling_of(target.corner).s_per_s)
    return len(s) < 2 or float(np.ptp(s)) <= FLAT * float(np.max(s))


def askable(target: Target, names: Sequence[str]) -> list[str]:
    """Return which of *names* mean something on *target*.

    Nothing can be steeper with speed than what does not depend on it: on a
    flat table that is ``speed_dependent_convection``.
    """
    return [
        name
        for name in names
        if not (name == "convection_exponent" and is_flat(target))
    ]


def directions(comparison: Comparison) -> Column:
    """Return the directions of the tunables, (p, q)."""
    keys = comparison.keys
    whole = np.eye(len(keys))
    target = comparison.target
    if not is_flat(target):
        return whole
    tied = [i for i, key in enumerate(keys) if key in S_SPEEDS_MS]
    others = [i for i in range(len(keys)) if i not in tied]
    if not tied:
        return whole
    return np.column_stack((whole[:, tied].sum(axis=1), whole[:, others]))


def prior_along(comparison: Comparison, basis: Column) -> Column:
    """Return the prior's standard deviation along each of *basis*, (q,)."""
    if basis.shape[0] == basis.shape[1]:
        return comparison.prior
    own = [
        TUNABLES[key].prior if key in TUNABLES else sd
        for key, sd in zip(comparison.keys, comparison.prior, strict=True)
    ]
    first = np.argmax(basis, axis=0)
    return np.array([own[i] for i in first])


def along(
    comparison: Comparison, known: Linearised, basis: Column
) -> tuple[Layout, Linearised]:
    """Return *known* and its layout with the tunables along *basis*."""
    layout = Layout(
        comparison.series,
        comparison.noise,
        prior_along(comparison, basis),
        comparison.drive_names,
    )
    return layout, replace(known, jacobian=known.jacobian @ basis)
