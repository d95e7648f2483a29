"""From evidence to an answer: a name, a class, none of them, or nothing.

Never a forced guess: a name is given where one effect alone is probable, a
class where the data can not tell its members apart, and 'none of the known
effects' where something is plainly missing that no effect explains.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any, Final, Literal

import numpy as np

from bstm_daemon.analysis.gap.changes import (
    are_twins,
    is_change,
    of_sensor,
)
from bstm_daemon.analysis.gap.evidence import (
    Candidate,
    best_placebo,
    cross_validated,
    explained_share,
    held_back,
    likeliest,
    may_stand_in,
    missing_evidence,
    missing_probability,
    probabilities,
    unnamed_beside,
    weigh,
)
from bstm_daemon.analysis.gap.joint_effects import (
    JointEffects,
    NormalEquations,
    normal_equations,
    search_joint_effects,
)
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.signatures import Linearised, Signature
from bstm_daemon.analysis.statistics.evidence import Projector, mean_evidence
from bstm_daemon.model.effects.catalogue import effect_class

Answer = Literal[
    "nothing", "name", "class", "composed", "unknown", "undecided"
]

SURE: Final = 0.95
"""Probability from which a name, or a class, is given."""

GATE_Z: Final = 4.1
"""Standard deviations of the best candidate from which there is a gap. With
39 candidates chance reaches it once in 1000 searches; the form of the model
takes effect-free cars up to 3.8, right names begin at 5.2
(`docs/evidence-gap.md`)."""

GATE_NOTHING: Final = 0.05
"""And nothing missing must be less probable than this."""

ALIKE: Final = 0.95
"""Cosine of two signatures, tunables projected out, from which data can not
tell them apart."""

CLEARLY: Final = 1.0
"""Log evidence by which heat that no effect has must be better before it is
said that no single one explains what is missing."""

SOMETHING: Final = 0.88
"""Probability from which something is missing though nothing can be named:
one effect, or heat without a name, as likely each before data. Effect-free
cars reach 0.84 (`docs/evidence-gap.md`)."""

EXPLAINED: Final = 0.6
EXPLAINED_TOGETHER: Final = 0.91
UNEXPLAINED: Final = 15.0
"""Below this share of what all effects together explain, and with so much of
the log-likelihood left besides chance, no name is given if heat without a
name is likely beside it: what else is left is noise of another form. The
second share is of several: two or three can imitate much of one that the
catalogue lacks. Where forms alone differ, as they do of every real effect,
right ones reach 0.92 with as much left (`docs/evidence-gap.md`)."""

AGAINST: Final = 3.0
"""Log Bayes factor by which a drive, predicted by the others, may speak
against an effect."""

SMALL: Final = 0.2
"""Strength up to which a sensor may err on one day alone: 3 s of response,
1.2 s of a clock."""


@dataclass(frozen=True, slots=True)
class Naming:
    """The answer.

    ``unknown_evidence`` is the log Bayes factor of what has no name, heat or
    a reading, and ``unknown_place`` which of it alone explains most.
    ``names`` are the effects found, best first: one, up to three, or the
    members of a class; ``strengths`` are theirs. ``probability`` is that of
    the answer, ``odds`` of every candidate and of ``""``, nothing. ``sizes``
    are those of composed terms at strength 1; ``equations`` those of all
    candidates, without any None.
    """

    answer: Answer
    names: tuple[str, ...]
    probability: float
    candidates: tuple[Candidate, ...]
    odds: dict[str, float]
    reason: str
    explained: float = np.nan
    best_placebo_z: float = np.nan
    cross_validated: dict[str, float] = field(default_factory=dict)
    leftover: Candidate | None = None
    unknown_evidence: float = 0.0
    unknown_place: str = ""
    sizes: dict[str, float] = field(default_factory=dict)
    equations: NormalEquations | None = None

    @property
    def found(self) -> bool:
        """Whether something is missing."""
        return self.answer != "nothing"

    def answered(
        self,
        answer: Answer,
        names: Sequence[str],
        probability: float,
        reason: str,
    ) -> Naming:
        """Return it with another answer."""
        return replace(
            self,
            answer=answer,
            names=tuple(names),
            probability=probability,
            reason=reason,
        )

    def provenance(self, name: str) -> dict[str, Any]:
        """Return how sure *name* is, and what else it may be.

        Of a class each member has its own probability.
        """
        if self.answer != "class":
            return {"probability": round(self.probability, 4)}
        return {
            "probability": round(self.odds[name], 4),
            "or": [one for one in self.names if one != name],
        }

    @property
    def adoptable(self) -> tuple[str, ...]:
        """What can be fitted and adopted: all named, the best of a class."""
        if self.answer in {"name", "composed"}:
            return self.names
        return self.names[:1] if self.answer == "class" else ()

    @property
    def gate_z(self) -> float:
        """Standard deviations of the best candidate."""
        return max((one.z for one in self.candidates), default=0.0)


def name_effect(
    layout: Layout, linearised: Linearised, *, alone: bool = False
) -> Naming:
    """Return what *linearised* says is missing.

    With *alone* it is one effect at most, or a class.
    """
    project = Projector(linearised.jacobian, layout.prior)
    found = sorted(
        (
            held_back(weigh(project, linearised.residual, one), one.most)
            for one in linearised.signatures
        ),
        key=lambda one: -one.log_evidence,
    )
    odds = probabilities(found)
    nothing = Naming(
        "nothing",
        (),
        odds[""],
        tuple(found),
        odds,
        "no effect of the catalogue changes the temperatures of these drives "
        "by more than they are uncertain, the tunables re-fitted",
        equations=normal_equations(project, linearised, found)
        if found
        else None,
    )
    if linearised.unknown:
        ways = [
            missing_evidence(project, linearised.residual, unnamed)
            for unnamed in (linearised.unknown, linearised.readings)
            if unnamed
        ]
        everything = (*linearised.unknown, *linearised.readings)
        nothing = replace(
            nothing,
            unknown_evidence=mean_evidence(ways),
            unknown_place=likeliest(
                project, linearised.residual, everything
            ).said,
        )
    best = found[0] if found else None
    if best and odds[""] <= GATE_NOTHING and best.z >= GATE_Z:
        return _named(layout, project, linearised, nothing, alone=alone)
    return _unnamed(layout, project, linearised, nothing)


def _unnamed(
    layout: Layout, project: Projector, linearised: Linearised, nothing: Naming
) -> Naming:
    """Return whether anything is missing though no effect passes the gate."""
    found = nothing.candidates
    of_one = mean_evidence([one.log_evidence for one in found])
    ways = [of_one]
    if linearised.unknown:
        ways.append(nothing.unknown_evidence)
    missing = missing_probability(ways)
    if missing < SOMETHING:
        return nothing
    if of_one < max(ways) - CLEARLY:
        reason = "no effect of the catalogue alone explains it"
        return nothing.answered("unknown", (), missing, reason)
    members, _ = _likeliest(nothing, SURE * (1.0 - nothing.odds[""]))
    best = next(s for s in linearised.signatures if s.name == found[0].name)
    weighed = replace(
        nothing,
        explained=explained_share(project, linearised, found[:1])[0],
        best_placebo_z=best_placebo(
            layout, project, linearised.residual, best
        ),
    )
    reason = "no effect is plain enough to be named"
    return weighed.answered("undecided", members, missing, reason)


def _named(
    layout: Layout,
    project: Projector,
    linearised: Linearised,
    nothing: Naming,
    *,
    alone: bool,
) -> Naming:
    """Return what it is that is missing, the gate passed."""
    found, odds = nothing.candidates, nothing.odds
    best = found[0]
    own = next(s for s in linearised.signatures if s.name == best.name)
    placebo = best_placebo(layout, project, linearised.residual, own)
    validated = cross_validated(layout, linearised, own)
    several = JointEffects((best,), None, 1.0, (best.name,))
    if not alone:
        several = search_joint_effects(project, linearised, found)
    explained, left = explained_share(project, linearised, several.chosen)
    common = replace(
        nothing,
        best_placebo_z=placebo,
        cross_validated=validated,
        explained=explained,
        leftover=several.leftover,
    )
    alone = len(several.chosen) == 1

    def unknown(reason: str) -> Naming:
        return common.answered("unknown", (), 1.0 - odds[""], reason)

    if (
        explained < (EXPLAINED if alone else EXPLAINED_TOGETHER)
        and left > UNEXPLAINED
        and unnamed_beside(project, linearised, several.chosen) > 0.0
    ):
        what = ", ".join(one.name for one in several.chosen)
        how = (
            f"the best, {what}, explains"
            if alone
            else f"the best together, {what}, explain"
        )
        return unknown(
            f"{how} {100 * explained:.0f} % of what all together could"
        )
    most = {one.name: one.most for one in linearised.signatures}
    first, *further = several.chosen
    if may_stand_in(first, most[first.name]):
        return unknown(
            f"{first.name} would be {abs(first.strength):.1f} times its "
            "typical size: rather something similar"
        )
    unsure = {
        one.name
        for one in further
        if may_stand_in(one, most[one.name])
        or _of_some_days(layout, linearised, one, several.chosen)
    }
    several = replace(
        several,
        sure=tuple(name for name in several.sure if name not in unsure),
    )
    if placebo > best.z:
        reason = f"{best.name} at other times than its own explains as much"
        return common.answered(
            "undecided", (best.name,), odds[best.name], reason
        )
    worst = min(validated, key=lambda name: validated[name], default="")
    if alone and worst and validated[worst] < -AGAINST:
        return unknown(
            f"the best, {best.name}, as the other drives have it makes "
            f"{worst} less likely"
        )
    answer = (
        _single(common, project, linearised, best)
        if alone
        else _together(common, several)
    )
    if answer.answer == "undecided" and explained < EXPLAINED:
        # one of these, if only they did explain it
        return unknown(
            f"several explain a part; the best, {best.name}, "
            f"{100 * explained:.0f} % of what all together could"
        )
    return answer


def is_contradicted(one: Candidate, validated: Mapping[str, float]) -> bool:
    """Return whether a drive, predicted by the others, speaks against *one*.

    Of a small error of a sensor, whether one is no likelier with it.
    """
    small = of_sensor(one.name) and abs(one.strength) < SMALL
    least = 0.0 if small else -AGAINST
    return min(validated.values(), default=0.0) < least


def _of_some_days(
    layout: Layout,
    linearised: Linearised,
    one: Candidate,
    chosen: Sequence[Candidate],
) -> bool:
    """Return whether a drive contradicts *one* of *chosen*, the others in."""
    by_name = {each.name: each for each in linearised.signatures}
    others = [by_name[each.name].column for each in chosen if each is not one]
    return is_contradicted(
        one, cross_validated(layout, linearised, by_name[one.name], others)
    )


def _likeliest(naming: Naming, least: float) -> tuple[list[str], float]:
    """Return as few candidates as are *least* probable, and how much."""
    members: list[str] = []
    total = 0.0
    for one in naming.candidates:
        members.append(one.name)
        total += naming.odds[one.name]
        if total >= least:
            break
    return members, total


def _together(common: Naming, several: JointEffects) -> Naming:
    names = tuple(one.name for one in several.chosen)
    sure = tuple(name for name in names if name in several.sure)
    if sure == names:
        reason = f"together they explain {100 * common.explained:.0f} %"
        return common.answered("name", names, several.share, reason)
    rest = ", ".join(name for name in names if name not in sure)
    if sure:
        reason = f"and another one, perhaps {rest}"
        return common.answered("name", sure, SURE, reason)
    reason = "several effects at once, in more than one way"
    return common.answered("undecided", names, several.share, reason)


def _single(
    common: Naming, project: Projector, linearised: Linearised, best: Candidate
) -> Naming:
    odds = common.odds
    if odds[best.name] >= SURE:
        reason = (
            "a value that the match had otherwise explains it"
            if is_change(best.name)
            else effect_class(best.name).signature
        )
        return common.answered("name", (best.name,), odds[best.name], reason)
    members, total = _likeliest(common, SURE)
    by_name = {one.name: one for one in linearised.signatures}
    why = []
    for name in members[1:]:
        alike = cosine(project, by_name[best.name], by_name[name])
        if are_twins(name, best.name) or abs(alike) >= ALIKE:
            why.append(f"{name} (signatures alike, cosine {alike:.2f})")
    if len(why) == len(members) - 1:
        reason = (
            f"these drives do not separate {best.name} from {', '.join(why)}"
        )
        return common.answered("class", members, total, reason)
    reason = (
        "several effects of different kinds explain it; another drive must "
        "decide"
    )
    return common.answered("undecided", members, total, reason)


def cosine(project: Projector, a: Signature, b: Signature) -> float:
    """Return how alike *a* and *b* are, the tunables projected out."""
    one, two = a.column, b.column
    pa, pb = project(one), project(two)
    size = float(one @ pa) * float(two @ pb)
    return float(one @ pb) / sqrt(max(size, 1e-30))
