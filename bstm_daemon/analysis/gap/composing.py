"""Beyond the catalogue: a heat path composed of the grammar's words.

Every term of :mod:`~bstm_daemon.model.effects.composed` is a heat at measured
temperatures. The few that explain most are simulated with the whole model and
weighed like the effects of the catalogue: all tunables free, each term paying
for the choice among all of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import islice
from math import log
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.comparison import Comparison
from bstm_daemon.analysis.gap.evidence import (
    Candidate,
    cross_validated,
    explained_share,
    is_clearly_better,
    missing_evidence,
    probabilities,
    weigh,
)
from bstm_daemon.analysis.gap.heat_response import BLOCK, Response
from bstm_daemon.analysis.gap.joint_effects import NEXT_EVIDENCE, NEXT_SHARE
from bstm_daemon.analysis.gap.naming import AGAINST, Naming
from bstm_daemon.analysis.gap.noise import Layout
from bstm_daemon.analysis.gap.signatures import (
    Linearised,
    Signature,
    signature_of,
)
from bstm_daemon.analysis.matching.march import model_of
from bstm_daemon.analysis.statistics.evidence import FREE, Projector, fit_terms
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.errors import ConfigError
from bstm_daemon.estimator.corner_model import compiled_model
from bstm_daemon.model.effects.composed import (
    FORMS,
    PATHS,
    PREFIX,
    Term,
    read,
)

WIDENED: Final = 16
"""Terms of one clause that get a second one."""

SIMULATED: Final = 6
"""Terms that are simulated with the whole model, each round; and the best of
another path."""

AS_LIKELY: Final = 3.0
"""Up to so much less log evidence a term of another path is told too."""

AT_ONCE: Final = 128
"""Terms that are marched at a time: more take memory, not less time."""

MOST_TERMS: Final = 3
WORDS: Final = sum(len(form.grid) for form in FORMS.values())


class Search:
    """Terms against what a comparison leaves, with all that is *known*."""

    def __init__(
        self, comparison: Comparison, layout: Layout, known: Linearised
    ) -> None:
        """Find the response to heat of every corner over every drive."""
        self.comparison = comparison
        self.layout = layout
        self.known = known
        self.project = Projector(known.jacobian, layout.prior)
        config = comparison.config(comparison.start)
        self.model = model_of(config, comparison.target.corners[0])
        self.single = [
            one
            for path in PATHS.values()
            for plain in [Term(path, (), path.size)]
            for one in (plain, *_widened(plain))
            if self.fits(one)
        ]
        self.responses = {
            (number, corner): Response(
                model_of(config, corner),
                comparison.recordings[number].drive,
                self.single,
            )
            for number, corner in comparison.pairs
        }
        self.columns_of_single = self.columns(self.single)
        self.base_k = comparison.residuals_k(comparison.start[None])[:, 0]

    def fits(self, term: Term) -> bool:
        """Whether *term*, with either sign, is possible in this structure."""
        signs = [term, replace(term, size=-term.size)]
        if all(one.problems() for one in signs):
            return False
        try:
            compiled_model(term.edit(self.model))
        except (ValueError, ConfigError):
            return False
        return True

    def columns(self, terms: Sequence[Term]) -> Column:
        """Return the whitened change of the residuals by *terms*, (n, k)."""
        return np.column_stack(
            [
                self._columns(terms[first : first + AT_ONCE])
                for first in range(0, len(terms), AT_ONCE)
            ]
        )

    def _columns(self, terms: Sequence[Term]) -> Column:
        nodes = list(dict.fromkeys(s.node for s in self.comparison.series))
        shown = {
            pair: one.of(terms, nodes) for pair, one in self.responses.items()
        }
        parts = []
        for s in self.comparison.series:
            at = s.steps // BLOCK
            corners = sorted({corner for corner, _ in s.couples})
            own = [shown[s.drive, corner][s.node] for corner in corners]
            last = len(own[0]) - 1
            parts.append(np.mean([k[np.minimum(at, last)] for k in own], 0))
        return self.layout.whiten(np.concatenate(parts))

    def ranked(
        self, terms: Sequence[Term], columns: Column, project: Projector
    ) -> list[tuple[float, Term]]:
        """Return log evidence and term at its best size, best first."""
        projected = project(columns)
        precision = np.sum(columns * projected, axis=0) + FREE**-2
        strength = -(projected.T @ self.known.residual) / precision
        evidence = 0.5 * strength**2 * precision
        evidence -= 0.5 * np.log(precision * FREE**2)
        sized = [
            replace(term, size=float(a) * term.size)
            for a, term in zip(strength, terms, strict=True)
        ]
        found = [
            (float(one) - cost(term), term)
            for one, term in zip(evidence, sized, strict=True)
            if not term.problems()
        ]
        return sorted(found, key=lambda one: -one[0])

    def best(
        self, chosen: Sequence[Signature]
    ) -> list[tuple[Candidate, Signature]]:
        """Return terms that explain most beside *chosen*, best first."""
        project = self.project.beside([one.column for one in chosen])
        ranked = self.ranked(self.single, self.columns_of_single, project)
        wider = [
            two
            for _, one in ranked[:WIDENED]
            for two in _widened(one)
            if one.clauses and self.fits(two)
        ]
        if wider:
            ranked += self.ranked(wider, self.columns(wider), project)
            ranked.sort(key=lambda one: -one[0])
        leading = ranked[:SIMULATED]
        paths = {term.path for _, term in leading}
        others = (one for one in ranked if one[1].path not in paths)
        found = []
        for _, term in (*leading, *islice(others, 1)):
            name = PREFIX + str(term)
            self.comparison.sizes[name] = term.size
            signature = signature_of(
                self.comparison, name, self.base_k, (0.5, 1.0)
            )
            if signature and name not in {one.name for one in chosen}:
                one = weigh(project, self.known.residual, signature)
                paid = one.log_evidence - cost(term)
                found.append((replace(one, log_evidence=paid), signature))
        return sorted(found, key=lambda one: -one[0].log_evidence)


def cost(term: Term) -> float:
    """Return what the choice of *term*'s words costs, as log probability."""
    return log(len(PATHS)) + len(term.clauses) * log(WORDS)


def _widened(term: Term) -> list[Term]:
    """Return *term* with each further clause."""
    return [
        replace(term, clauses=(*term.clauses, (form, number)))
        for form in FORMS.values()
        for number in form.grid
    ]


CLEAR: Final = 10.0
"""By so much of the log-likelihood at least a composition must explain more
for a name to be withheld. On ten cars of another simulator right names were
beaten by at most 5, or a third; of six later ones one by 1.51 times."""


def with_composed(
    comparison: Comparison, layout: Layout, known: Linearised, naming: Naming
) -> tuple[Linearised, Naming]:
    """Return *known* and *naming* with a composed effect, if one is better.

    Where nothing is missing none is looked for. Each term pays for its words,
    and no drive, predicted by the others, may contradict the first one: the
    likeliest of those nearly as likely as any that none contradicts. It
    must be clearly better than what is named or most likely, and likelier than
    an error of a reading.
    """
    if not naming.found:
        return known, naming
    search = Search(comparison, layout, known)
    terms: list[Candidate] = []
    chosen: list[Signature] = []
    validated: dict[str, float] = {}
    others: list[str] = []
    while len(terms) < MOST_TERMS:
        found = search.best(chosen)
        if not found:
            break
        if not terms:
            found, validated = _not_contradicted(layout, known, found)
            others = _as_likely([each for each, _ in found])
        one, signature = found[0]
        if one.log_evidence < NEXT_EVIDENCE or (
            terms and one.gain < NEXT_SHARE * terms[0].gain
        ):
            break
        if min(validated.values(), default=0.0) < -AGAINST:
            break
        terms.append(one)
        chosen.append(signature)
    rivals = naming.adoptable or naming.names[:1]
    listed = _listed_gain(search.project, known, naming)
    gain = _gain(search.project, known, dict.fromkeys(chosen, 1.0))
    evidence = sum(one.log_evidence for one in terms)
    if (
        not terms
        or (rivals and not is_clearly_better(gain, listed, CLEAR))
        or (not rivals and evidence <= _misread(search.project, known))
    ):
        return known, naming
    whole = replace(terms[0], log_evidence=evidence)
    odds = probabilities([whole, *naming.candidates])
    names = tuple(one.name for one in terms)
    known = replace(known, signatures=(*known.signatures, *chosen))
    reason = naming.reason
    if rivals:
        reason = (
            f"the best of the catalogue, {', '.join(rivals)}, explains "
            f"{100.0 * listed / gain:.0f} % of what it does"
        )
    if others:
        reason += f"; nearly as likely: {' or '.join(others)}"
    return known, replace(
        naming,
        answer="composed",
        names=names,
        probability=odds[names[0]],
        candidates=(*terms, *naming.candidates),
        odds={**dict.fromkeys(names, odds[names[0]]), **odds},
        reason=reason,
        cross_validated=validated,
        explained=explained_share(search.project, known, terms)[0],
        sizes={name: comparison.sizes[name] for name in names},
    )


def _not_contradicted(
    layout: Layout,
    known: Linearised,
    found: list[tuple[Candidate, Signature]],
) -> tuple[list[tuple[Candidate, Signature]], dict[str, float]]:
    """Return *found* from the first on that no drive contradicts.

    Of those nearly as likely as the best, and what each drive says of it; all
    of *found* where each is contradicted.
    """
    least = found[0][0].log_evidence - AS_LIKELY
    by_first: dict[str, float] = {}
    for i, (one, signature) in enumerate(found):
        if one.log_evidence < least:
            break
        validated = cross_validated(layout, known, signature)
        if min(validated.values(), default=0.0) >= -AGAINST:
            return found[i:], validated
        by_first = by_first or validated
    return found, by_first


def _misread(project: Projector, known: Linearised) -> float:
    """Return the log Bayes factor of an error of a reading, -inf for none."""
    if not known.readings:
        return -np.inf
    return missing_evidence(project, known.residual, known.readings)


def _as_likely(found: Sequence[Candidate]) -> list[str]:
    """Return the terms nearly as likely as the first, each of another path."""
    best, *rest = found
    by_path = {read(best.name.removeprefix(PREFIX)).path: ""}
    for one in rest:
        words = one.name.removeprefix(PREFIX)
        if one.log_evidence >= best.log_evidence - AS_LIKELY:
            by_path.setdefault(read(words).path, words)
    return [words for words in by_path.values() if words]


def _listed_gain(
    project: Projector, known: Linearised, naming: Naming
) -> float:
    """Return what is named explains, or the most likely of the catalogue.

    The latter within what its strength can be.
    """
    if not naming.adoptable:
        first = naming.names[:1]
        own = (one.gain for one in naming.candidates if one.name in first)
        return next(own, 0.0)
    by_name = {one.name: one for one in known.signatures}
    return _gain(
        project,
        known,
        {
            by_name[one.name]: one.strength
            for one in naming.candidates
            if one.name in naming.adoptable
        },
    )


def _gain(
    project: Projector, known: Linearised, strengths: Mapping[Signature, float]
) -> float:
    """Return what signatures together, near their strengths, explain.

    What they take off half the sum of squares.
    """
    if not strengths:
        return 0.0
    columns = np.column_stack([one.at(a) / a for one, a in strengths.items()])
    return fit_terms(project, known.residual, columns, FREE).gain
