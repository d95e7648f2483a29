"""What matched cars of a type say of a further one, as a configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.identify.writing import Entries, write_changed
from bstm_daemon.analysis.matching.changes import value_changes
from bstm_daemon.analysis.matching.learned import (
    entry_of,
    settings_of,
    short,
)
from bstm_daemon.analysis.matching.tunables import (
    NODES_MS,
    TUNABLES,
    Target,
    targets_of,
)
from bstm_daemon.config.estimates import PriorsConfig
from bstm_daemon.config.reading import load_config
from bstm_daemon.fleet.learning import type_prior

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from bstm_daemon.analysis.identify.writing import Change
    from bstm_daemon.config.estimates import MatchedConfig

LEARNED: Final = 0.7
"""A value that a match knows no better than this share of its usual prior is
what the file had before: it says nothing of the type."""

LEAST_CARS: Final = 2


def write_prior(kind: str, configs: Sequence[Path], out: Path) -> int:
    """Write what the matched *configs* of the type *kind* share as *out*.

    The rest is as in the first of them, whose own match is left out.

    Returns:
        The number of matched cars; with fewer than two nothing is written.

    Raises:
        ConfigError: of a configuration.
        FileAccessError: one is unreadable or *out* unwritable.
    """
    cars = [(path, load_config(path)) for path in configs]
    cars = [(path, config) for path, config in cars if config.matched]
    if len(cars) < LEAST_CARS:
        return 0
    source, first = cars[0]
    origin = f"type {kind}, {len(cars)} cars"
    changes: list[Change] = []
    priors = []
    corners = [name for one in first.matched for name in one.corners]
    for target in targets_of(first, corners):
        entries = [entry_of(each, target.corners[0]) for _, each in cars]
        found = _values(target, [one for one in entries if one is not None])
        if not found:
            continue
        # of the table as factors
        values = {
            key: value / (target.setting(key) if key in NODES_MS else 1.0)
            for key, (value, _) in found.items()
        }
        after = target.changed(values)
        settings = settings_of(target, after, values)
        changes += value_changes(
            settings, dict.fromkeys(settings, origin), first, target.corners
        )
        priors.append(
            PriorsConfig(
                corners=list(target.corners),
                names=list(found),
                values=[short(after.setting(key)) for key in found],
                deviations=[short(sd) for _, sd in found.values()],
                cars=len(cars),
            )
        )
    if priors:
        entries_of_type = Entries(priors=priors)
        write_changed(source, out, changes, origin, entries=entries_of_type)
    return len(cars) if priors else 0


def _values(
    target: Target, entries: Sequence[MatchedConfig]
) -> dict[str, tuple[float, float]]:
    """Return value and deviation of its logarithm by key, for a next car."""
    known: dict[str, list[tuple[float, float]]] = {}
    for one in entries:
        for i, key in enumerate(one.names):
            deviation = float(np.linalg.norm(one.factor[i]))
            if key in TUNABLES and deviation < LEARNED * TUNABLES[key].prior:
                log = float(np.log(one.values[i]))
                known.setdefault(key, []).append((log, deviation))
    found = {}
    for key, pairs in known.items():
        if len(pairs) >= LEAST_CARS and target.setting(key) > 0.0:
            logs, deviations = np.array(pairs).T
            prior = TUNABLES[key].prior
            mean, sd = type_prior(logs, deviations, prior)
            found[key] = float(np.exp(mean)), min(sd, prior)
    return found
