"""What was found as it is written into a configuration, all of it together.

The values that were fitted with an effect or a change belong to it: a file
with the one and without the others is a model that nobody has tried.
"""

import time
from typing import Any

import numpy as np

from bstm_daemon.analysis.gap.changes import (
    PREFIX,
    factor_of,
    is_change,
    path_of,
    said,
)
from bstm_daemon.analysis.gap.comparison import Comparison
from bstm_daemon.analysis.gap.fitting import HEAT_CHANGE, Fit
from bstm_daemon.analysis.gap.naming import Naming
from bstm_daemon.analysis.identify.writing import Change, Entries
from bstm_daemon.analysis.matching.changes import value_changes
from bstm_daemon.analysis.matching.learned import entry, settings_of
from bstm_daemon.config.estimates import ChangeConfig
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.effects.composed import NAME as COMPOSED
from bstm_daemon.model.effects.composed import is_composed


def written(
    comparison: Comparison, fit: Fit, naming: Naming
) -> tuple[list[Change], Entries]:
    """Return what is written of *fit*: values, and what was found.

    Each has its provenance.
    """
    target = comparison.target
    logs = ", ".join(comparison.drive_names)
    today = time.strftime("%Y-%m-%d")
    found = np.exp(fit.written_x[:-1])
    values = dict(zip(comparison.keys[:-1], found.tolist(), strict=True))
    after = target.changed(values)
    note = f"fitted with {', '.join(fit.strengths)}, {logs}, {today}"
    settings = settings_of(target, after, values)
    changes = value_changes(
        settings, dict.fromkeys(settings, note), target.config, target.corners
    )
    if HEAT_CHANGE in fit.strengths:
        factor = factor_of(HEAT_CHANGE, fit.strengths[HEAT_CHANGE])
        changes += [
            Change(
                *("corner", "friction_coefficient"),
                factor * corner.friction_coefficient,
                corner.name,
                note,
            )
            for corner in target.config.corner
            if corner.name in target.corners
        ]
    effects, moved = [], []
    there: set[str] = set()
    for name, strength in fit.strengths.items():
        said_of = _provenance(comparison, fit, naming, name)
        if is_composed(name):
            # one entry has all its terms, and the first one's provenance
            effects += [
                one.model_copy(update={"provenance": said_of})
                for one in fit.entries
                if one.name == COMPOSED and one.name not in there
            ]
            there = {COMPOSED}
            continue
        if not is_change(name):
            own = {"strength": strength, **comparison.forms.get(name, {})}
            effects.append(
                EffectConfig(name=name, parameters=own, provenance=said_of)
            )
            continue
        effects += comparison.trials[name].effects_at(strength)
        changes += [
            Change("effect", key, value, corner, note, path_of(name))
            for key, value in comparison.forms.get(name, {}).items()
            for corner in target.corners
        ]
        said_of["meaning"] = said(name, strength)
        every = {corner.name for corner in target.config.disc_corners()}
        corners = target.corners
        moved += [
            ChangeConfig.model_validate(
                {
                    "name": name.removeprefix(PREFIX),
                    "corner": corner,
                    "factor": factor_of(name, strength),
                    "provenance": said_of,
                }
            )
            for corner in (("all",) if set(corners) == every else corners)
        ]
    known = target.config.matched_of(target.corners[0])
    matched = []
    if known is not None:
        covariance = fit.covariance[:-1, :-1]
        matched = [entry(after, comparison.keys[:-1], covariance, known)]
    return changes, Entries(effects, moved, matched)


def _provenance(
    comparison: Comparison, fit: Fit, naming: Naming, name: str
) -> dict[str, Any]:
    """Return where *name* and its strength come from, and how sure it is."""
    evidence = next(
        one.log_evidence for one in naming.candidates if one.name == name
    )
    size = comparison.sizes.get(name, 1.0)
    of = (lambda a: factor_of(name, a)) if is_change(name) else size.__mul__
    return {
        "source": "bstm gap",
        "data": list(comparison.drive_names),
        "date": time.strftime("%Y-%m-%d"),
        "strength_sd": round(abs(size) * fit.deviations[name], 3),
        "strength_90": [round(of(end), 3) for end in fit.interval(name)],
        **naming.provenance(name),
        "log_bayes_factor": round(evidence, 1),
    }
