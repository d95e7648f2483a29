"""How probable each effect is, the tunables re-fitted with every one of them.

Residuals are whitened, the tunables x (p,) have their priors, the strength a
a prior of its own. All of x is integrated out in closed form (generalised
least squares), a on a grid, so an effect that the tunables can imitate gains
nothing by it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import LARGEST, can_vanish
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
)
from bstm_daemon.analysis.gap.unnamed import Unnamed
from bstm_daemon.analysis.statistics.evidence import (
    FREE,
    Projector,
    fit_terms,
    mean_evidence,
)
from bstm_daemon.analysis.statistics.series import Column

NOTHING: Final = 0.5
"""Probability that nothing is missing, before data."""

PLACEBOS: Final = 20
"""Candidates that can not be: the best one's signature at other times."""

STRENGTHS: Final = 0.05 * np.geomspace(1.0, LARGEST / 0.05, 60)[1] ** (
    np.arange(75)
)
"""As many as physics has room for, the first 60 to :data:`LARGEST`."""

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


STAND_IN: Final = 0.15
NEARLY: Final = 0.1
"""A candidate that needs more than :data:`LARGEST`, or all but a tenth of it,
may stand in for a similar one: that share of its gain is lost."""

AHEAD: Final = 3.0
"""Log evidence by which an error of a reading must be ahead of heat to be told
instead: beside heat at a fluid one was 1.4 ahead, a misread disc's 39."""

DETECTED: Final = 3.5
"""Standard deviations that count as detected."""


def weigh(
    project: Projector, residual: Column, signature: Signature
) -> Candidate:
    """Return what *signature* does to *residual* (n,)."""
    columns = np.column_stack((residual, signature.linear, signature.curved))
    gram = columns.T @ project(columns)
    grid, weights = strength_prior(
        signature.most, either_sign=signature.either_sign, even=signature.even
    )
    if signature.near != 1.0:
        # simulated on one side, it says nothing of the other
        here = grid * signature.near > 0.0
        grid, weights = grid[here], weights[here]
    gains = _gains(gram, grid)
    top = int(np.argmax(gains))
    best = _refined(gram, grid, top)
    gain = float(_gains(gram, np.array([best]))[0])
    slopes = np.array([0.0, 1.0, 2.0 * best])
    curvature = float(slopes @ gram @ slopes)
    peak = float(gains.max())
    log_evidence = peak + float(np.log(np.sum(weights * np.exp(gains - peak))))
    log_evidence -= signature.form_cost
    slope = max(gram[1, 1], 1e-12)
    return Candidate(
        signature.name,
        best,
        float(1.0 / np.sqrt(max(curvature, 1e-12))),
        gain,
        log_evidence,
        DETECTED / float(np.sqrt(slope)),
    )


def may_stand_in(candidate: Candidate, most: float) -> bool:
    """Whether *candidate* is so strong that it may be something similar.

    One whose largest strength *most* is another ends where physics does, and
    so does what can fall to nothing.
    """
    size = abs(candidate.strength)
    near = min(candidate.deviation, NEARLY * size)
    if most != LARGEST or size + near < LARGEST:
        return False
    return candidate.strength > 0.0 or not can_vanish(candidate.name)


def held_back(candidate: Candidate, most: float) -> Candidate:
    """Return *candidate* with less evidence if it may be a stand-in."""
    if not may_stand_in(candidate, most):
        return candidate
    evidence = candidate.log_evidence - STAND_IN * candidate.gain
    return replace(candidate, log_evidence=evidence)


def strength_prior(
    most: float = LARGEST, *, either_sign: bool, even: bool = False
) -> tuple[Column, Column]:
    """Return strengths to *most* and their weights, log-normal, summing to 1.

    Both signs are as likely where that is *even*.
    """
    grid = STRENGTHS[most * (1.0 + 1e-9) >= STRENGTHS]
    if either_sign:
        grid = np.concatenate((-grid[::-1], grid))
    logs = (np.log(np.abs(grid)) - LOG_CENTRE) / LOG_WIDTH
    weights = np.exp(-0.5 * logs**2)
    if either_sign and not even:
        # the typical sign is the likelier one
        weights = np.where(grid > 0, 0.75, 0.25) * weights
    return grid, np.asarray(weights / weights.sum())


def _gains(gram: Column, a: Column) -> Column:
    change = np.column_stack((np.zeros(len(a)), a, a * a))
    quadratic = np.sum((change @ gram) * change, axis=1)
    return np.asarray(-(change @ gram[0]) - 0.5 * quadratic)


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


def missing_probability(evidence: Sequence[float]) -> float:
    """Return how probable it is that anything is missing.

    *evidence* are the log Bayes factors of the ways in which it can be.
    """
    log_odds = mean_evidence(evidence)
    log_odds += float(np.log((1.0 - NOTHING) / NOTHING))
    return float(1.0 / (1.0 + np.exp(-min(log_odds, 700.0))))


def best_placebo(
    layout: Layout, project: Projector, residual: Column, signature: Signature
) -> float:
    """Return the largest score of the signature at other times."""
    rng = np.random.default_rng(7)
    drives = range(len(layout.drive_names))
    scores = []
    for _ in range(PLACEBOS):
        moved = signature.kelvin.copy()
        for drive in drives:
            share = rng.uniform(0.2, 0.8)
            for part in layout.slices(drive):
                count = part.stop - part.start
                moved[part] = np.roll(moved[part], int(share * count))
        white = layout.whiten(moved)
        projected = project(white)
        slope = max(float(white @ projected), 1e-12)
        score = -float(projected @ residual) / sqrt(slope)
        scores.append(abs(score) if signature.either_sign else score)
    return max(scores)


def cross_validated(
    layout: Layout,
    linearised: Linearised,
    signature: Signature,
    beside: Sequence[Column] = (),
) -> dict[str, float]:
    """Return the log Bayes factor of each drive, predicted by the others.

    How much likelier the effect makes the drive once the others are known:
    what the others leave open, of tunables, strength and the changes (n,)
    that are *beside* it, is integrated out.
    """
    found: dict[str, float] = {}
    count = len(layout.drive_names)
    if count < 2:
        return found
    project = Projector(linearised.jacobian, layout.prior).beside(beside)
    whole = weigh(project, linearised.residual, signature).log_evidence
    for drive, name in enumerate(layout.drive_names):
        others = np.ones(len(linearised.residual), bool)
        for part in layout.slices(drive):
            others[part] = False
        there = replace(
            signature,
            linear=signature.linear[others],
            curved=signature.curved[others],
        )
        project = Projector(linearised.jacobian[others], layout.prior).beside(
            [one[others] for one in beside]
        )
        without = weigh(project, linearised.residual[others], there)
        found[name] = whole - without.log_evidence
    return found


def explained_share(
    project: Projector, linearised: Linearised, chosen: Sequence[Candidate]
) -> tuple[float, float]:
    """Return the gain of *chosen* as a share of that of all together.

    And what is left of it. Half a unit for each effect is chance.
    """
    names = {one.name for one in chosen}
    own = np.column_stack(
        [s.column for s in linearised.signatures if s.name in names]
    )
    everything = np.column_stack(
        [
            *(s.column for s in linearised.signatures),
            *(one.change for one in linearised.unknown),
        ]
    )
    few = fit_terms(project, linearised.residual, own, FREE).gain
    chance = 0.5 * (everything.shape[1] - own.shape[1])
    many = fit_terms(project, linearised.residual, everything, FREE).gain
    many -= chance
    return min(few / max(many, few, 1e-9), 1.0), max(many - few, 0.0)


def is_clearly_better(gain: float, named: float, least: float) -> bool:
    """Return whether *gain* is enough for names with the gain *named* to go.

    Both of the log-likelihood; *least* more, and half as much again.
    """
    return gain - named >= max(least, 0.5 * named)


def unnamed_beside(
    project: Projector, linearised: Linearised, chosen: Sequence[Candidate]
) -> float:
    """Return the log Bayes factor of heat without a name beside *chosen*.

    By forces alone there is none to ask for: then nothing speaks against it.
    """
    if not linearised.unknown:
        return np.inf
    names = {one.name for one in chosen}
    own = [s.column for s in linearised.signatures if s.name in names]
    return missing_evidence(
        project.beside(own), linearised.residual, linearised.unknown
    )


def missing_evidence(
    project: Projector, residual: Column, unnamed: Sequence[Unnamed]
) -> float:
    """Return the log Bayes factor of what has no name, wherever it is.

    As likely before data: one alone, all those of one place, all of them;
    each place as likely as the other. All at once alone would pay for
    a dozen strengths where one is missing.
    """
    by_place: dict[str, list[Column]] = {}
    for one in unnamed:
        by_place.setdefault(one.place, []).append(one.change)
    every = [one.change for one in unnamed]
    kinds = ([[one] for one in every], list(by_place.values()), [every])

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
    project: Projector, residual: Column, unnamed: Sequence[Unnamed]
) -> Unnamed:
    """Return the one that alone explains most, no heat by :data:`AHEAD`."""

    def evidence(one: Unnamed) -> float:
        found = _log_evidence(project, residual, [one.change])
        return found + AHEAD * one.is_heat

    return max(unnamed, key=evidence)
