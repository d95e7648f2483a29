"""Heat that no effect of the catalogue brings: the open set.

For each node and regime a heat flow into the node that follows its excess
over the air, or the brake power at the disc while braking. Together they
stand for whatever is missing there, without a name. They decide whether
anything is missing that no named effect explains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.gap.residual_heat import REGIMES
from bstm_daemon.analysis.matching.march import (
    initial_temperatures,
    march,
    model_of,
)
from bstm_daemon.analysis.matching.phases import BRAKING_W, STANDING_MS
from bstm_daemon.analysis.statistics.evidence import fit_terms, mean_evidence
from bstm_daemon.estimator.corner_model import compiled_model
from bstm_daemon.model.thermal.program import compile_network

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.analysis.gap.comparison import Comparison
    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.problem import Series
    from bstm_daemon.analysis.statistics.evidence import Projector
    from bstm_daemon.analysis.statistics.series import Column

TYPICAL_W_K: Final = {
    "disc": 2.0,
    "pad_front": 1.0,
    "pad_back": 0.4,
    "fluid": 0.4,
}
"""Heat per kelvin above the air that counts as strength 1."""

OF_BRAKING: Final = 0.05
"""Share of the brake power at the disc, likewise."""

OTHER_W_K: Final = 0.4


@dataclass(frozen=True, slots=True, eq=False)
class UnnamedHeat:
    """A heat flow at a node in a regime; ``change`` (n,) of the residuals."""

    node: str
    regime: str
    change: Column


def unnamed_heats(
    comparison: Comparison, base_k: Column
) -> tuple[UnnamedHeat, ...]:
    """Return what each would change in the residuals *base_k* (n,) [K]."""
    nodes = list(dict.fromkeys(one.node for one in comparison.series))
    found = []
    for node in nodes:
        for regime in REGIMES:
            apart = _apart(comparison, node, regime)
            change = apart - base_k
            if float(np.abs(change).max()) > 1e-3:
                found.append(UnnamedHeat(node, regime, change))
    return tuple(found)


def _apart(comparison: Comparison, node: str, regime: str) -> Column:
    """Return the residuals [K] with that heat, (n,)."""
    shown = {}
    config = comparison.config(comparison.start)
    own = {s.drive: s for s in comparison.series if s.node == node}
    for number, name in comparison.pairs:
        drive = comparison.recordings[number].drive
        model = model_of(config, name)
        program = compile_network(model.network.with_extra_heat(node))
        heat = np.zeros(drive.inputs.shape[:2])
        if number in own:
            heat[:] = _heat_w(drive, name, own[number], regime)[:, None]
        initial = initial_temperatures(compiled_model(model), drive, name)
        result = march([program], drive.with_extra_heat(heat), name, initial)
        shown[number, name] = {
            s.node: result[model.shown(s.node)] for s in comparison.series
        }
    return comparison.less_measured(config, shown)[:, 0]


def _heat_w(drive: Drive, corner: str, series: Series, regime: str) -> Column:
    power = drive.channel(corner, "brake_power_w")
    braking = power > BRAKING_W
    moving = drive.channel(corner, "speed_ms") > STANDING_MS
    if regime == "braking" and series.node == "disc":
        return np.asarray(OF_BRAKING * power * braking)
    mask = {
        "braking": braking,
        "driving": moving & ~braking,
        "parked": ~moving & ~braking,
    }[regime]
    rise = np.interp(drive.time_s, series.time_s, series.rise_k)
    typical = TYPICAL_W_K.get(series.node, OTHER_W_K)
    return np.asarray(typical * rise * mask)


def missing_evidence(
    project: Projector, residual: Column, heats: Sequence[UnnamedHeat]
) -> float:
    """Return the log Bayes factor of heat without a name, wherever it is.

    As likely before data: one heat alone, all those of one node, all of
    them; each place as likely as the other. All at once alone would pay for
    a dozen strengths where one is missing.
    """
    by_node: dict[str, list[Column]] = {}
    for one in heats:
        by_node.setdefault(one.node, []).append(one.change)
    every = [one.change for one in heats]
    kinds = ([[one] for one in every], list(by_node.values()), [every])

    def of(kind: Sequence[Sequence[Column]]) -> float:
        return mean_evidence(
            [_log_evidence(project, residual, changes) for changes in kind]
        )

    return mean_evidence([of(kind) for kind in kinds])


def _log_evidence(
    project: Projector, residual: Column, changes: Sequence[Column]
) -> float:
    """Return the log Bayes factor of *changes* together, strength 1 each."""
    columns = np.column_stack(changes)
    return fit_terms(project, residual, columns, 1.0).log_evidence


def likeliest(
    project: Projector, residual: Column, heats: Sequence[UnnamedHeat]
) -> UnnamedHeat:
    """Return the one that alone explains most."""
    return max(
        heats,
        key=lambda one: _log_evidence(project, residual, [one.change]),
    )
