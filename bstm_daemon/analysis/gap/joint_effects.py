"""Which effects act at once, each plain beside the others.

Forward search alone fails where the mixture of two looks like a third one, so
all pairs are weighed together; each of a pair must be plain beside the other.
A first effect whose form is not exact leaves residuals that another can take
up: a further one must explain a share of what the first does, and a twin more
of it, beside the first as it is at its strength.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import are_twins, of_sensor
from bstm_daemon.analysis.gap.evidence import STRENGTHS, Candidate, weigh
from bstm_daemon.analysis.gap.signatures import Linearised
from bstm_daemon.analysis.statistics.evidence import (
    FREE,
    Projector,
)
from bstm_daemon.analysis.statistics.series import Column, Indices, Matrix

NEXT_EVIDENCE: Final = 5.0
NEXT_Z: Final = 5.0
NEXT_SHARE: Final = 0.1
"""A further effect needs this log Bayes factor, these standard deviations
beside the others, and this share of the first one's gain."""

FORM_SHARE: Final = 0.3
"""A twin, and an error of a sensor beside an effect on the brake, need more: a
large effect of another form leaves what its twin does, and its own rate of
change, as late sensors do."""

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
    search = _Search(project, linearised, found)
    chosen = [found[0]]
    share = 1.0
    sure: tuple[str, ...] = (found[0].name,)
    pair, share_of_pair, in_most = _best_pair(project, linearised, found)
    if pair:
        both = [
            search.beside([one for one in pair if one != name], [name])[0]
            for name in pair
        ]
        if all(map(search.plain, both)) and not search.is_form(*pair):
            chosen = sorted(both, key=lambda one: -one.gain)
            share, sure = share_of_pair, in_most
    leftover = None
    while True:
        names = [one.name for one in chosen]
        rest = [
            one
            for one in search.beside(names)
            if not any(search.is_form(one.name, name) for name in names)
        ]
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
        self,
        project: Projector,
        linearised: Linearised,
        found: Sequence[Candidate],
    ) -> None:
        self._project = project
        self._linearised = linearised
        self._alone = {one.name: one for one in found}
        self._first_gain = found[0].gain
        self._of_sensor = of_sensor(found[0].name)
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

    def is_form(self, a: str, b: str) -> bool:
        """Whether one of twins only makes up for the other's strength.

        A thermocouple that is twice as late has another course, not twice
        that at strength 1: the difference looks like a late clock.
        """
        if not are_twins(a, b):
            return False
        better, other = sorted((a, b), key=lambda n: -self._alone[n].gain)
        strength = self._alone[better].strength
        own = self._by_name[better].at(strength) / strength
        signature = self._by_name[other]
        project = self._project.beside([own])
        return not self.plain(
            weigh(project, self._linearised.residual, signature), FORM_SHARE
        )

    def plain(self, one: Candidate, share: float = NEXT_SHARE) -> bool:
        """Whether *one* is more than what the others' forms leave."""
        if of_sensor(one.name) and not self._of_sensor:
            share = FORM_SHARE
        return (
            one.log_evidence >= NEXT_EVIDENCE
            and one.z >= NEXT_Z
            and one.gain >= share * self._first_gain
        )


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
) -> tuple[Indices, Indices, Column, Column]:
    """Return all pairs (i, j): what both explain and how probable it is.

    Places i and j, gains and log Bayes factors, (k,) each; the last are minus
    infinity where physics forbids a strength.
    """
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
    return i, j, gains, np.where(allowed, logs, -np.inf)


def _best_pair(
    project: Projector, linearised: Linearised, found: Sequence[Candidate]
) -> tuple[tuple[str, ...], float, tuple[str, ...]]:
    """Return the pair that explains most, its share, its sure members."""
    signatures = linearised.signatures
    if len(signatures) < 2:
        return (), 0.0, ()
    i, j, gains, logs = _pairs(project, linearised, found)
    # two that stand in for the best one must explain more than it does
    best = [k for k, one in enumerate(signatures) if one.name == found[0].name]
    more = (
        np.isin(i, best)
        | np.isin(j, best)
        | (gains >= (1.0 + NEXT_SHARE) * found[0].gain)
    )
    logs = np.where(more, logs, -np.inf)
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
