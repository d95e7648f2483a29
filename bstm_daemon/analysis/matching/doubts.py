"""Why a match is not to be trusted: a part of the model may be missing."""

from __future__ import annotations

from math import log
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.matching.baseline import bearable_k
from bstm_daemon.analysis.matching.identifiability import KNOWN
from bstm_daemon.analysis.matching.problem import FIRST, OTHER
from bstm_daemon.analysis.matching.refine import rms_of
from bstm_daemon.analysis.matching.tunables import TUNABLES
from bstm_daemon.analysis.statistics.series import rms
from bstm_daemon.analysis.statistics.student import as_normal

if TYPE_CHECKING:
    from collections.abc import Iterator

    from bstm_daemon.analysis.matching.refine import (
        Accuracy,
        Errors,
        Refinement,
    )

FAR: Final = 3.0
"""Deviations of its prior that a value moves only for what is missing."""

FAR_ABOVE: Final = 2.0
ABOVE_K: Final = 6.0
ABOVE_SHARE: Final = 0.03
"""An error beside the fit's, times, and plus the larger of kelvins and a share
of the rise, that is another drive's own."""

RISE_SHARE: Final = 0.05
"""Of its rise above the air, an error in the fit that a lump may have."""


def doubts(
    joint: Refinement, accuracy: Accuracy, errors: Errors
) -> Iterator[str]:
    """Say why a part of the model may be missing, nothing where it is not."""
    known = np.sqrt(np.diag(joint.covariance)) < KNOWN * joint.prior
    for i, key in enumerate(joint.keys):
        moved = log(joint.values[key] / joint.start[key]) / joint.prior[i]
        moved = float(as_normal(np.array(moved), TUNABLES[key].freedom))
        # what the drives say nothing of may lie at a bound by chance
        if key in joint.at_bound and known[i]:
            yield f"{key} at its bound {joint.values[key]:.3g}"
        elif abs(moved) > FAR:
            yield (
                f"{key} from {joint.start[key]:.3g} to "
                f"{joint.values[key]:.3g}, {abs(moved):.1f} times what such "
                "brakes differ by"
            )
    fit_k = rms_of(errors)
    for node, parts in errors.items():
        rise_k = rms(np.concatenate([rise for _, rise in parts]))
        usual_k = FAR * FIRST.get(node, OTHER).drift_k
        most_k = max(usual_k, RISE_SHARE * rise_k)
        if fit_k[node] > most_k:
            yield (
                f"{node} {fit_k[node]:.1f} K in the fit, where sensor and "
                f"lump explain {most_k:.1f} K"
            )
        left_k = accuracy.rms_k.get(node, 0.0)
        before_k = accuracy.before_k.get(node, left_k)
        if left_k > before_k + usual_k:
            yield (
                f"{node} {left_k:.1f} K on what was left out, {before_k:.1f} "
                "K as configured"
            )
        if left_k > FAR_ABOVE * fit_k[node] + max(
            ABOVE_K, ABOVE_SHARE * rise_k
        ):
            yield (
                f"{node} {left_k:.1f} K on what was left out, "
                f"{fit_k[node]:.1f} K in the fit"
            )
    disc_k = accuracy.rms_k.get("disc", 0.0)
    if disc_k > bearable_k(accuracy.baseline_k):
        yield (
            f"disc {disc_k:.1f} K on what was left out, a disc of one node "
            f"{accuracy.baseline_k:.1f} K"
        )
