"""How probable each effect is, the tunables re-fitted with every one of them.

Residuals are whitened, the tunables x (p,) have their priors, the strength a
a prior of its own. All of x is integrated out in closed form (generalised
least squares), a on a grid, so an effect that the tunables can imitate gains
nothing by it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.gap.odds import NOTHING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.gap.projector import Projector
    from bstm_daemon.gap.signatures import Signature
    from bstm_daemon.matching.drives import Column

STRENGTHS: Final = np.geomspace(0.05, 4.0, 60)
LOG_CENTRE: Final = -0.2
LOG_WIDTH: Final = 0.8
"""Prior of a strength: log-normal about the typical one."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One effect against nothing missing.

    ``gain`` is the fall of half the sum of squares at the best ``strength``,
    ``log_evidence`` the logarithm of the Bayes factor, ``reach`` the strength
    that these drives would show with 3.5 standard deviations.
    """

    name: str
    strength: float
    deviation: float
    gain: float
    log_evidence: float
    reach: float

    @property
    def z(self) -> float:
        """Signed-root score in standard deviations."""
        return float(np.sqrt(max(2.0 * self.gain, 0.0)))


DETECTED: Final = 3.5
"""Standard deviations that count as detected."""


def weigh(
    project: Projector, residual: Column, signature: Signature
) -> Candidate:
    """Return what *signature* does to *residual* (n,)."""
    columns = np.column_stack((residual, signature.linear, signature.curved))
    gram = columns.T @ project(columns)
    grid = STRENGTHS
    if signature.either_sign:
        grid = np.concatenate((-STRENGTHS[::-1], STRENGTHS))
    weights = strength_prior(grid, either_sign=signature.either_sign)
    gains = _gains(gram, grid)
    top = int(np.argmax(gains))
    best = _refined(gram, grid, top)
    gain = float(_gains(gram, np.array([best]))[0])
    curvature = _curvature(gram, best)
    peak = float(gains.max())
    log_evidence = peak + float(np.log(np.sum(weights * np.exp(gains - peak))))
    slope = max(gram[1, 1], 1e-12)
    return Candidate(
        signature.name,
        best,
        float(1.0 / np.sqrt(max(curvature, 1e-12))),
        gain,
        log_evidence,
        DETECTED / float(np.sqrt(slope)),
    )


def strength_prior(grid: Column, *, either_sign: bool) -> Column:
    """Return the weights of *grid*, log-normal, summing to 1."""
    logs = (np.log(np.abs(grid)) - LOG_CENTRE) / LOG_WIDTH
    weights = np.exp(-0.5 * logs**2)
    if either_sign:
        # the typical sign is the likelier one
        weights = np.where(grid > 0, 0.75, 0.25) * weights
    return np.asarray(weights / weights.sum())


def _gains(gram: Column, a: Column) -> Column:
    change = np.column_stack((np.zeros(len(a)), a, a * a))
    quadratic = np.sum((change @ gram) * change, axis=1)
    return np.asarray(-(change @ gram[0]) - 0.5 * quadratic)


def _curvature(gram: Column, a: float) -> float:
    slope = np.array([0.0, 1.0, 2.0 * a])
    return float(slope @ gram @ slope)


def _refined(gram: Column, grid: Column, top: int) -> float:
    low, high = grid[max(top - 1, 0)], grid[min(top + 1, len(grid) - 1)]
    fine = np.linspace(low, high, 41)
    return float(fine[np.argmax(_gains(gram, fine))])


def probabilities(found: Sequence[Candidate]) -> dict[str, float]:
    """Return the probability of each candidate and of ``""``, nothing."""
    logs = np.array([0.0, *(one.log_evidence for one in found)])
    share = (1.0 - NOTHING) / max(len(found), 1)
    logs += np.log([NOTHING, *([share] * len(found))])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    names = ["", *(one.name for one in found)]
    return dict(zip(names, weights.tolist(), strict=True))
