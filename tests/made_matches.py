"""Matches of known values, without a fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.analysis.matching.matcher import Match
from bstm_daemon.analysis.matching.refine import (
    Accuracy,
    NodeAccuracy,
    Refinement,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bstm_daemon.analysis.matching.tunables import Target


def match_of(
    before: Target,
    values: Mapping[str, float],
    *,
    after: Target | None = None,
    left_out: str = "the last drive",
    nodes: Mapping[str, NodeAccuracy] | None = None,
    rms_k: Mapping[str, float] | None = None,
    verdict: tuple[str, ...] = (),
) -> Match:
    """Return a match that found *values*, each known to 10 % or less."""
    after = after or before.changed(dict(values))
    deviations = 0.1 / np.arange(1.0, len(values) + 1.0)
    joint = Refinement(
        tuple(values),
        dict.fromkeys(values, 1.0),
        dict(values),
        np.ones(len(values)),
        np.diag(deviations**2),
        np.eye(len(values)),
        (),
        *({}, {}, 100, 10),
    )
    accuracy = Accuracy(nodes or {}, 0, left_out, {}, rms_k or {})
    return Match(
        *(before.corners, before, before, after, [], (), joint, None),
        *(accuracy, (), verdict),
    )
