"""What a match hands on: values, their covariance, what the form leaves.

A fit's own covariance trusts the form of the model. How far the values move
when a drive is left out says how far to trust that: both add up, never beyond
the prior.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from bstm_daemon.analysis.matching.tunables import (
    FADE,
    NODES_MS,
    SAME,
    TUNABLES,
    Target,
    refined_keys,
    usable,
)
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.config.estimates import MatchedConfig

DAY_TO_DAY: Final = 0.03
"""Standard deviation of a value's logarithm from drive to drive, at least:
weather, and how pads lie."""


def settings_of(
    before: Target, after: Target, values: Mapping[str, float]
) -> dict[str, Any]:
    """Return the keys of the configuration and their values in *after*.

    *values* are the tunables that *after* differs from *before* by.
    """
    old = before.config.cooling_of(before.corner)
    new = after.config.cooling_of(after.corner)
    found: dict[str, Any] = {
        key: value for key, value in values.items() if key not in NODES_MS
    }
    if NODES_MS.keys() & values.keys():
        if new.speed_ms != old.speed_ms:
            found["cooling.speed_ms"] = tuple(new.speed_ms)
        found["cooling.s_per_s"] = tuple(new.s_per_s)
    return found


def entry(
    target: Target,
    keys: Sequence[str],
    covariance: Column,
    like: MatchedConfig,
) -> MatchedConfig:
    """Return *like* with the values of *target* and their *covariance*."""
    factor = np.linalg.cholesky(covariance)
    return like.model_copy(
        update={
            "names": list(keys),
            "values": [short(target.setting(key)) for key in keys],
            "factor": [
                [short(one) for one in row[: i + 1].tolist()]
                for i, row in enumerate(factor)
            ],
        }
    )


def short(value: float) -> float:
    """Return *value* in the digits that are written."""
    return float(f"{value:.5g}")


def known_keys(target: Target) -> list[str]:
    """Return what is free in *target*: what its match fitted, if it has one.

    A key that this version does not know is left out, and what acts on the
    heat.
    """
    one = target.config.matched_of(target.corners[0])
    wanted = refined_keys(target)
    if one is not None:
        wanted = tuple(
            key for key in one.names if key in TUNABLES and key != FADE
        )
    return usable(target, wanted)[0]


def known_covariance(target: Target, keys: Sequence[str]) -> Column:
    """Return the covariance of the logarithms of *keys*, (p, p).

    Without a match, and for values that were edited since, that of the
    priors.
    """
    prior = np.array([target.tunable(key).prior for key in keys])
    found = np.diag(prior**2)
    one = target.config.matched_of(target.corners[0])
    if one is None:
        return found
    lower = np.zeros((len(one.names), len(one.names)))
    for i, row in enumerate(one.factor):
        lower[i, : i + 1] = row
    whole = lower @ lower.T + DAY_TO_DAY**2 * np.eye(len(lower))
    of = {name: i for i, name in enumerate(one.names)}
    kept = [
        i
        for i, key in enumerate(keys)
        if key in of
        and abs(target.setting(key) / one.values[of[key]] - 1.0) < SAME
    ]
    there = [of[keys[i]] for i in kept]
    found[np.ix_(kept, kept)] = whole[np.ix_(there, there)]
    return np.asarray(found)
