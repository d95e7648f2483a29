"""How probable each effect is, the tunables re-fitted with every one of them.

Residuals are whitened, the tunables x (p,) have their priors, the strength a
a prior of its own. All of x is integrated out in closed form (generalised
least squares), a on a grid, so an effect that the tunables can imitate gains
nothing by it.

Of more than one effect at once, forward search alone fails where the mixture
of two looks like a third one, so all pairs are weighed together; each of a
pair must be plain beside the other. A first effect whose form is not exact
leaves residuals that another can take up: a further one must explain a share
of what the first does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
    UnnamedHeat,
)
from bstm_daemon.analysis.statistics.evidence import (
    FREE,
    Projector,
    fit_terms,
    mean_evidence,
)
from bstm_daemon.analysis.statistics.series import (
    Column,
    Indices,
    Matrix,
)

NOTHING: Final = 0.5
"""Probability that nothing is missing, before data."""

PLACEBOS: Final = 20
"""Candidates that can not be: the best one's signature at other times."""

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
    grid, weights = strength_prior(
        signature.most, either_sign=signature.either_sign, even=signature.even
    )
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


def strength_prior(
    most: float = np.inf, *, either_sign: bool, even: bool = False
) -> tuple[Column, Column]:
    """Return strengths to *most* and their weights, log-normal, summing to 1.

    Both signs are as likely where that is *even*.
    """
    grid = STRENGTHS[most >= STRENGTHS]
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
    layout: Layout, linearised: Linearised, signature: Signature
) -> dict[str, float]:
    """Return the log Bayes factor of each drive, predicted by the others.

    How much likelier the effect makes the drive once the others are known:
    what the others leave open, of tunables and strength, is integrated out.
    """
    found: dict[str, float] = {}
    count = len(layout.drive_names)
    if count < 2:
        return found
    project = Projector(linearised.jacobian, layout.prior)
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
        project = Projector(linearised.jacobian[others], layout.prior)
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
        heats, key=lambda one: _log_evidence(project, residual, [one.change])
    )


NEXT_EVIDENCE: Final = 5.0
NEXT_Z: Final = 4.2
NEXT_SHARE: Final = 0.1
"""A further effect needs this log Bayes factor, these standard deviations
beside the others, and this share of the first one's gain."""

MOST_EFFECTS: Final = 3
THIRD_Z: Final = 6.0
"""A third one must be plainer still."""


@dataclass(frozen=True, slots=True)
class JointEffects:
    """Effects that are plain beside each other, the best first.

    ``leftover`` is the best one that is not. ``share`` is the probability of
    a pair among all pairs, ``sure`` those of its members that nearly all
    probable pairs have; of a single effect 1 and itself.
    """

    chosen: tuple[Candidate, ...]
    leftover: Candidate | None
    share: float
    sure: tuple[str, ...]


def search_joint_effects(
    project: Projector, linearised: Linearised, found: Sequence[Candidate]
) -> JointEffects:
    """Return which of *found*, best first, act together."""
    search = _Search(project, linearised, found[0].gain)
    chosen = [found[0]]
    share = 1.0
    sure: tuple[str, ...] = (found[0].name,)
    pair, share_of_pair, in_most = _best_pair(project, linearised, found)
    if pair:
        both = [
            search.beside([one for one in pair if one != name], [name])[0]
            for name in pair
        ]
        if all(map(search.plain, both)):
            chosen = sorted(both, key=lambda one: -one.gain)
            share, sure = share_of_pair, in_most
    leftover = None
    while True:
        rest = search.beside([one.name for one in chosen])
        if not rest:
            break
        leftover = rest[0]
        least_z = THIRD_Z if len(chosen) > 1 else NEXT_Z
        if (
            len(chosen) == MOST_EFFECTS
            or leftover.z < least_z
            or not search.plain(leftover)
        ):
            break
        chosen.append(leftover)
        sure = (*sure, leftover.name)
    return JointEffects(tuple(chosen), leftover, share, sure)


class _Search:
    """Weighs effects beside others."""

    def __init__(
        self, project: Projector, linearised: Linearised, first_gain: float
    ) -> None:
        self._project = project
        self._linearised = linearised
        self._first_gain = first_gain
        self._by_name = {one.name: one for one in linearised.signatures}

    def beside(
        self, others: Sequence[str], names: Sequence[str] | None = None
    ) -> list[Candidate]:
        """Return *names* (all) weighed with *others* free, best first."""
        project = self._project.beside(
            [self._by_name[name].column for name in others]
        )
        found = [
            weigh(project, self._linearised.residual, self._by_name[name])
            for name in (names or self._by_name)
            if name not in others
        ]
        return sorted(found, key=lambda one: -one.log_evidence)

    def plain(self, one: Candidate) -> bool:
        """Whether *one* is more than what the others' forms leave."""
        return (
            one.log_evidence >= NEXT_EVIDENCE
            and one.z >= NEXT_Z
            and one.gain >= NEXT_SHARE * self._first_gain
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """All pairs (i, j), (k,) each: what both explain and how probable it is.

    ``logs`` are log Bayes factors, minus infinity where physics forbids a
    strength.
    """

    i: Indices
    j: Indices
    gains: Column
    logs: Column


def pair_evidence(
    project: Projector, linearised: Linearised, found: Sequence[Candidate]
) -> float:
    """Return the log Bayes factor of two effects, whichever, against none.

    All pairs are as likely before data.
    """
    if len(linearised.signatures) < 2:
        return -np.inf
    return mean_evidence(_pairs(project, linearised, found).logs)


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """What data say of strengths a (k,) of effects acting together.

    The log-likelihood is ``score @ a - a @ information @ a / 2``, the tunables
    integrated out; ``form_cost`` (k,) is what the choice of a form costs.
    """

    names: tuple[str, ...]
    score: Column
    information: Matrix
    form_cost: Column


def normal_equations(
    project: Projector, linearised: Linearised, found: Sequence[Candidate]
) -> NormalEquations:
    """Return those of all signatures, whose best strengths *found* has."""
    strengths = {one.name: one.strength for one in found}
    signatures = linearised.signatures
    slopes = np.column_stack(
        [s.linear + strengths.get(s.name, 1.0) * s.curved for s in signatures]
    )
    projected = project(slopes)
    return NormalEquations(
        tuple(one.name for one in signatures),
        -(projected.T @ linearised.residual),
        slopes.T @ projected,
        np.array([one.form_cost for one in signatures]),
    )


def _pairs(
    project: Projector, linearised: Linearised, found: Sequence[Candidate]
) -> _Pairs:
    signatures = linearised.signatures
    equations = normal_equations(project, linearised, found)
    gram, score = equations.information, equations.score
    i, j = np.triu_indices(len(signatures), 1)
    own_i = gram[i, i] + FREE**-2
    own_j = gram[j, j] + FREE**-2
    determinant = own_i * own_j - gram[i, j] ** 2
    a_i = (own_j * score[i] - gram[i, j] * score[j]) / determinant
    a_j = (own_i * score[j] - gram[i, j] * score[i]) / determinant
    either = np.array([one.either_sign for one in signatures])
    allowed = ((a_i > 0.0) | either[i]) & ((a_j > 0.0) | either[j])
    # no brake has an effect of many times its typical strength
    allowed &= np.maximum(abs(a_i), abs(a_j)) <= STRENGTHS[-1]
    gains = 0.5 * (a_i * score[i] + a_j * score[j])
    # what a strength that is well known costs
    logs = gains - 0.5 * np.log(determinant * FREE**4)
    return _Pairs(i, j, gains, np.where(allowed, logs, -np.inf))


def _best_pair(
    project: Projector, linearised: Linearised, found: Sequence[Candidate]
) -> tuple[tuple[str, ...], float, tuple[str, ...]]:
    """Return the pair that explains most, its share, its sure members."""
    signatures = linearised.signatures
    if len(signatures) < 2:
        return (), 0.0, ()
    pairs = _pairs(project, linearised, found)
    i, j = pairs.i, pairs.j
    # two that stand in for the best one must explain more than it does
    best = [k for k, one in enumerate(signatures) if one.name == found[0].name]
    more = (
        np.isin(i, best)
        | np.isin(j, best)
        | (pairs.gains >= (1.0 + NEXT_SHARE) * found[0].gain)
    )
    logs = np.where(more, pairs.logs, -np.inf)
    top = int(np.argmax(logs))
    if not np.isfinite(logs[top]):
        return (), 0.0, ()
    weights = np.exp(logs - logs[top])
    weights /= weights.sum()
    names = (signatures[i[top]].name, signatures[j[top]].name)
    sure = tuple(
        signatures[k].name
        for k in (i[top], j[top])
        if weights[(i == k) | (j == k)].sum() >= SURE_MEMBER
    )
    return names, float(weights[top]), sure


SURE_MEMBER: Final = 0.95
