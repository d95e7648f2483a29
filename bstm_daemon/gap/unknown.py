"""Heat that no effect of the catalogue brings: the open set.

For each node and regime a heat flow into the node that follows its excess
over the air, or the brake power at the disc while braking. Together they
stand for whatever is missing there, without a name. They decide whether
anything is missing that no named effect explains.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.corner_model import compiled_model, corner_model
from bstm_daemon.gap.odds import mean_evidence
from bstm_daemon.gap.residual_heat import REGIMES
from bstm_daemon.matching.march import initial_temperatures, march
from bstm_daemon.matching.phases import BRAKING_W, STANDING_MS
from bstm_daemon.thermal.program import compile_network

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.gap.comparison import Comparison
    from bstm_daemon.gap.layout import Series
    from bstm_daemon.gap.projector import Projector
    from bstm_daemon.matching.drives import Column, Drive

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
class UnknownHeat:
    """A heat flow at a node in a regime; ``change`` (n,) of the residuals."""

    node: str
    regime: str
    change: Column


def unknown_heats(
    comparison: Comparison, base_k: Column
) -> tuple[UnknownHeat, ...]:
    """Return what each would change in the residuals *base_k* (n,) [K]."""
    nodes = list(dict.fromkeys(one.node for one in comparison.series))
    found = []
    for node in nodes:
        for regime in REGIMES:
            apart = _apart(comparison, node, regime)
            change = apart - base_k
            if float(np.abs(change).max()) > 1e-3:
                found.append(UnknownHeat(node, regime, change))
    return tuple(found)


def _apart(comparison: Comparison, node: str, regime: str) -> Column:
    shown = {}
    config = comparison.config(comparison.start)
    pairs = {(s.drive, c) for s in comparison.series for c, _ in s.couples}
    for number, name in sorted(pairs):
        drive = comparison.recordings[number].drive
        corner = next(one for one in config.corner if one.name == name)
        model = corner_model(config, corner)
        program = compile_network(model.network.with_extra_heat(node))
        heat = np.zeros((*drive.inputs.shape[:2], 1))
        own = _series_of(comparison, number, node)
        if own is not None:
            heat[:, :, 0] = _heat_w(drive, name, own, regime)[:, None]
        heated = replace(
            drive, inputs=np.concatenate((drive.inputs, heat), axis=2)
        )
        plain = compiled_model(model)
        initial = initial_temperatures(plain, drive, name)
        result = march([program], heated, name, initial)
        shown[number, name] = {
            s.node: result[model.shown(s.node)][:, 0]
            for s in comparison.series
        }
    return np.concatenate(
        [
            np.mean(
                [
                    shown[one.drive, corner][one.node][one.steps]
                    for corner in {c for c, _ in one.couples}
                ],
                axis=0,
            )
            - one.measured_k
            for one in comparison.series
        ]
    )


def _series_of(comparison: Comparison, drive: int, node: str) -> Series | None:
    for one in comparison.series:
        if one.drive == drive and one.node == node:
            return one
    return None


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


def log_evidence(
    project: Projector, residual: Column, changes: Column
) -> float:
    """Return the log Bayes factor of *changes* (n, k), strengths N(0, 1).

    Against nothing missing, the tunables integrated out in both.
    """
    projected = project(changes)
    gram = changes.T @ projected + np.eye(changes.shape[1])
    score = projected.T @ residual
    gain = 0.5 * float(score @ np.linalg.solve(gram, score))
    return gain - 0.5 * float(np.linalg.slogdet(gram)[1])


def missing_evidence(
    project: Projector, residual: Column, heats: Sequence[UnknownHeat]
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
            [
                log_evidence(project, residual, np.column_stack(changes))
                for changes in kind
            ]
        )

    return mean_evidence([of(kind) for kind in kinds])


def likeliest(
    project: Projector, residual: Column, heats: Sequence[UnknownHeat]
) -> UnknownHeat:
    """Return the one that alone explains most."""
    return max(
        heats,
        key=lambda one: log_evidence(project, residual, one.change[:, None]),
    )
