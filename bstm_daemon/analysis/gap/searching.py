"""From what was simulated to an answer, by the noise that suits it.

What a match knows is taken in here: the form of the model is taken off, what
differs from day to day is integrated out, and large changes are simulated
again where they are.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import forms_of, is_change
from bstm_daemon.analysis.gap.comparison import Comparison
from bstm_daemon.analysis.gap.composing import with_composed
from bstm_daemon.analysis.gap.evidence import weigh
from bstm_daemon.analysis.gap.fitting import fit, prior_along
from bstm_daemon.analysis.gap.form import daily, form_k
from bstm_daemon.analysis.gap.joint_effects import NEXT_EVIDENCE, NEXT_SHARE
from bstm_daemon.analysis.gap.naming import Naming, name_effect
from bstm_daemon.analysis.gap.noise import Layout, calibrated
from bstm_daemon.analysis.gap.signatures import (
    NO_FORM,
    Linearised,
    Sensed,
    of_large_change,
    whitened_signature,
)
from bstm_daemon.analysis.statistics.evidence import Projector, mean_evidence
from bstm_daemon.analysis.statistics.series import Column

LEADING: Final = 4
LARGE: Final = 0.7
"""Changes at the head of the list that are larger are simulated again."""

MOVED: Final = 0.1
ROUNDS: Final = 6
"""And again, where they then are by so much of it larger or smaller; so often
at most."""


def search(
    comparison: Comparison, simulated: Sensed, basis: Column
) -> tuple[Linearised, Naming]:
    """Return what is known, whitened, and what it says is missing.

    Args:
        comparison: gets its noise, and the error of its form.
        simulated: residuals and sensitivities at its start.
        basis: directions (p, q) in which the tunables may move.
    """
    comparison.form_k = form_k(comparison, simulated)
    jacobian_k = simulated.jacobian_k @ basis
    prior = prior_along(comparison, basis)
    if comparison.matched:
        columns_k, deviations = daily(comparison, simulated)
        jacobian_k = np.column_stack((jacobian_k, columns_k))
        prior = np.concatenate((prior, deviations))
    turned = replace(
        simulated,
        base_k=simulated.base_k + comparison.form_k,
        jacobian_k=jacobian_k,
    )
    layout = Layout(
        comparison.series, comparison.noise, prior, comparison.drive_names
    )
    if comparison.matched:
        noise = calibrated(layout, turned.base_k, turned.columns_k())
    else:
        # free of each other: what a flat table ties together is no noise
        noise = calibrated(comparison, simulated.base_k, simulated.columns_k())
    layout.set_noise(noise)
    comparison.set_noise(noise)
    turned = _in_best_forms(
        comparison,
        layout,
        turned,
        {
            name: list(
                zip(
                    (NO_FORM, *forms_of(name)),
                    (turned.terms_k[name], *others),
                    strict=True,
                )
            )
            for name, others in turned.forms_k.items()
        },
    )
    known = turned.whitened(layout)
    naming = name_effect(layout, known)
    done: dict[str, float] = {}
    for _ in range(ROUNDS):
        far = _far(naming, done)
        if not far:
            break
        turned = _simulated_there(comparison, layout, turned, far)
        known = turned.whitened(layout)
        naming = name_effect(layout, known)
        done |= far
    if len(naming.adoptable) > 1 and done:
        first = naming.candidates[0]
        alone, together = (
            fit(comparison, start, basis, known_k=simulated.jacobian_k).cost
            for start in ({first.name: first.strength}, starts(naming))
        )
        least = max(NEXT_EVIDENCE, NEXT_SHARE * first.gain)
        if alone - together < least:
            naming = name_effect(layout, known, alone=True)
    return with_composed(comparison, layout, known, naming)


def _simulated_there(
    comparison: Comparison,
    layout: Layout,
    simulated: Sensed,
    far: Mapping[str, float],
) -> Sensed:
    """Return *simulated* with changes as large as *far*, simulated there.

    What is at its bound has no more of it and stays as it is.
    """
    every = {
        name: options
        for name, a in far.items()
        if (options := of_large_change(comparison, simulated.base_k, name, a))
    }
    near = {**simulated.near, **{name: far[name] for name in every}}
    return _in_best_forms(
        comparison, layout, replace(simulated, near=near), every
    )


def _in_best_forms(
    comparison: Comparison,
    layout: Layout,
    simulated: Sensed,
    every: Mapping[str, Sequence[tuple[Mapping[str, float], Column]]],
) -> Sensed:
    """Return *simulated* with each candidate in the form that fits best.

    *every* has forms and their terms [K], (2, n), by name. *comparison* has
    the values of the best from then on. The evidence of a candidate is the
    mean over its forms, so the choice costs the difference.
    """
    project = Projector(layout.whiten(simulated.jacobian_k), layout.prior)
    residual = layout.whiten(simulated.base_k)
    chosen, costs = {}, {}
    for name, options in every.items():
        logs = [
            weigh(project, residual, signature).log_evidence
            for _, terms in options
            for signature in [
                whitened_signature(
                    layout, name, terms, simulated.near.get(name, 1.0)
                )
            ]
        ]
        best = int(np.argmax(logs))
        comparison.forms[name], chosen[name] = options[best]
        costs[name] = logs[best] - mean_evidence(logs)
    return replace(
        simulated,
        terms_k={**simulated.terms_k, **chosen},
        form_costs={**simulated.form_costs, **costs},
    )


def starts(naming: Naming) -> dict[str, float]:
    """Return what can be adopted, and the strengths that a fit begins at."""
    return {
        one.name: one.strength
        for one in naming.candidates
        if one.name in naming.adoptable
    }


def _far(naming: Naming, done: Mapping[str, float]) -> dict[str, float]:
    """Return changes that are large and not simulated there, by name."""
    leading = {one.name for one in naming.candidates[:LEADING]}
    return {
        one.name: one.strength
        for one in naming.candidates
        if is_change(one.name)
        and one.name in leading.union(naming.names)
        and abs(one.strength) > LARGE
        and abs(one.strength - done.get(one.name, 0.0))
        > MOVED * abs(one.strength)
    }
