"""How far a matched model lies off on drives that it was not matched to.

Each drive in turn is left out, the others are fitted, and what is left on it
is the discrepancy: sensor, heat and form of the model together. A fit's own
covariance knows of the last only through drives it has not seen.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.matching.problem import Problem, whole_drives
from bstm_daemon.matching.refine import refine

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bstm_daemon.matching.drives import Column, Drive
    from bstm_daemon.matching.refine import Refinement
    from bstm_daemon.matching.tunables import Target

LEAST_K: Final = 0.5
"""No estimate is surer."""


@dataclass(frozen=True, slots=True)
class NodeAccuracy:
    """Standard deviation of an estimate.

    ``floor_k`` and ``share`` of the rise above the air, in quadrature.
    """

    floor_k: float
    share: float

    def deviation_k(self, rise_k: Column) -> Column:
        """Return the standard deviation at *rise_k* above the air, (n,)."""
        return np.asarray(np.hypot(self.floor_k, self.share * rise_k))


@dataclass(frozen=True, slots=True)
class Accuracy:
    """By node; ``drives`` held-out drives have shown it, 0: none could."""

    nodes: Mapping[str, NodeAccuracy]
    drives: int
    rms_k: Mapping[str, float]


def held_out(
    target: Target,
    drives: Sequence[Drive],
    joint: Refinement,
    progress: Callable[[float], None] | None = None,
) -> Accuracy:
    """Return what *joint*, fitted without it, leaves on each of *drives*.

    With a single drive that is what it leaves on this one.
    """
    errors: dict[str, list[tuple[Column, Column, float]]] = {}
    for number, drive in enumerate(drives):
        values = joint.values
        others = [one for one in drives if one is not drive]
        if others:
            values = refine(
                target, others, joint.keys, start=joint.values,
                noise=joint.noise, rounds=1,
            ).values  # fmt: skip
        for node, parts in _left_over(target, drive, values, joint).items():
            errors.setdefault(node, []).extend(parts)
        if progress is not None:
            progress((number + 1) / len(drives))
    return Accuracy(
        {node: fitted(parts) for node, parts in errors.items()},
        len(drives) if len(drives) > 1 else 0,
        {
            node: float(
                np.sqrt(np.mean(np.concatenate([e for e, *_ in parts]) ** 2))
            )
            for node, parts in errors.items()
        },
    )


def _left_over(
    target: Target,
    drive: Drive,
    values: dict[str, float],
    joint: Refinement,
) -> dict[str, list[tuple[Column, Column, float]]]:
    """Return error, rise and white noise of each thermocouple by node."""
    runs, terms = whole_drives(target, [drive])
    problem = Problem(target, [drive], joint.keys, runs, terms, joint.noise)
    x = np.log([[values[key] for key in joint.keys]])
    found: dict[str, list[tuple[Column, Column, float]]] = {}
    for term, apart in zip(terms, problem.apart_k(x), strict=True):
        air = drive.channel(term.corner, "ambient_k")[term.steps]
        found.setdefault(term.node, []).append(
            (
                apart[:, 0],
                term.measured_k - air,
                problem.noise[term.node].white_k,
            )
        )
    return found


def fitted(parts: Sequence[tuple[Column, Column, float]]) -> NodeAccuracy:
    """Fit floor and share to errors, rises and white noise, one a series.

    Errors squared are a straight line over the rise squared, neither part
    below 0; white noise of the thermocouple is not the estimate's.
    """
    error_2 = np.concatenate([e**2 - w**2 for e, _, w in parts])
    rise_2 = np.concatenate([rise**2 for _, rise, _ in parts])
    spread = float(np.mean((rise_2 - rise_2.mean()) ** 2))
    slope = 0.0
    if spread > 0.0:
        covariance = np.mean((rise_2 - rise_2.mean()) * error_2)
        slope = max(float(covariance) / spread, 0.0)
    floor = float(np.mean(error_2)) - slope * float(np.mean(rise_2))
    if floor < LEAST_K**2:
        floor = LEAST_K**2
        slope = max(float(np.mean(error_2)) - floor, 0.0) / max(
            float(np.mean(rise_2)), 1.0
        )
    return NodeAccuracy(floor**0.5, slope**0.5)
