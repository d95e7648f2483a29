"""What the form of a matched model lacks, known from the drives of the match.

No lumped model has the linings, the friction and the air of a real car. What
that leaves over is alike in all drives of the car, so it is learned once, in
the terms of the catalogue and of heat without a name, and taken off the
residuals of later drives. What is new since the match is left.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from bstm_daemon.analysis.gap.changes import is_change
from bstm_daemon.analysis.gap.comparison import HEAT_SCALE_PRIOR, Comparison
from bstm_daemon.analysis.gap.noise import FREEDOM, Layout, calibrated
from bstm_daemon.analysis.gap.signatures import Sensed
from bstm_daemon.analysis.matching.learned import short
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.config.estimates import MatchedConfig

DAILY: Final = {
    "accelerometer_bias": 1.2,
    "mass_error": 0.5,
    "powertrain_torque_error": 0.5,
    "clock_offset": 0.1,
}
"""Strengths by which drives of one car differ, standard deviations: the zero
of an accelerometer by 0.1 m/s2, the load by 3 %, the torque by 4 %, clocks by
0.6 s. Less than that is neither missing nor a change since the match."""


def with_form(
    known: MatchedConfig, comparison: Comparison, simulated: Sensed
) -> MatchedConfig:
    """Return *known* with what the form lacks on *comparison*.

    Args:
        known: what the match learned.
        comparison: the matched target on the drives that it was matched to.
        simulated: the same as simulated; changes in it do not count.
    """
    target = comparison.target
    effects = {
        name: terms
        for name, terms in simulated.terms_k.items()
        if not is_change(name)
    }
    simulated = replace(simulated, terms_k=effects)
    # by its priors: the match's own covariance comes of the same drives
    prior = [target.tunable(key).prior for key in comparison.keys[:-1]]
    layout = Layout(
        comparison.series,
        comparison.noise,
        np.array([*prior, HEAT_SCALE_PRIOR]),
        comparison.drive_names,
    )
    columns_k = simulated.columns_k()
    layout.set_noise(calibrated(layout, simulated.base_k, columns_k))
    free = columns_k.shape[1] - len(layout.prior)
    scale = np.concatenate((layout.prior, np.full(free, FREEDOM)))
    white = layout.whiten(columns_k * scale)
    normal = white.T @ white + np.eye(len(scale))
    score = white.T @ layout.whiten(simulated.base_k)
    found = -scale * np.linalg.solve(normal, score)
    keys = [*comparison.keys, *_terms_k(simulated)]
    return known.model_copy(
        update={
            "form": {
                key: short(value)
                for key, value in zip(keys, found.tolist(), strict=True)
            }
        }
    )


def form_k(comparison: Comparison, simulated: Sensed) -> Column:
    """Return what the form leaves on *comparison* [K], less than nothing.

    (n,), to be added to residuals; 0 where the match does not know.
    """
    target = comparison.target
    known = target.config.matched_of(target.corners[0])
    form = {} if known is None else known.form
    parts = dict(zip(comparison.keys, simulated.jacobian_k.T, strict=True))
    parts |= _terms_k(simulated)
    return np.asarray(
        sum(
            (form.get(name, 0.0) * part for name, part in parts.items()),
            np.zeros(len(simulated.base_k)),
        )
    )


def daily(comparison: Comparison, simulated: Sensed) -> tuple[Column, Column]:
    """Return what differs from day to day in :data:`DAILY`, (n, k), and how.

    Each drive by its own, in each form. The second are standard deviations
    (k,).
    """
    count = np.diff(comparison.edges)
    drive = np.repeat([one.drive for one in comparison.series], count)
    columns, deviations = [np.zeros((len(drive), 0))], []
    for name, deviation in DAILY.items():
        terms = simulated.terms_k.get(name)
        if terms is None:
            continue
        for linear, curved in (terms, *simulated.forms_k.get(name, ())):
            # as it is when small: six seconds late is no tenth of that
            small = linear + deviation * curved
            for one in np.unique(drive):
                own = np.where(drive == one, small, 0.0)
                columns.append(own[:, None])
                deviations.append(deviation)
    return np.hstack(columns), np.array(deviations)


def _terms_k(simulated: Sensed) -> dict[str, Column]:
    """Return the change of each effect and heat at strength 1 by name."""
    terms = {
        name: terms.sum(axis=0) for name, terms in simulated.terms_k.items()
    }
    return terms | {one.said: one.change for one in simulated.unknown_k}
