"""Alternatives and nothing: what their Bayes factors make of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.matching.drives import Column

NOTHING: Final = 0.5
"""Probability that nothing is missing, before data."""


def mean_evidence(logs: Column | Sequence[float]) -> float:
    """Return the log Bayes factor of alternatives (k,) as likely each."""
    logs = np.asarray(logs, float)
    top = float(np.max(logs, initial=-np.inf))
    if not np.isfinite(top):
        return -np.inf
    return top + float(np.log(np.mean(np.exp(logs - top))))


def missing_probability(evidence: Sequence[float]) -> float:
    """Return how probable it is that anything is missing.

    *evidence* are the log Bayes factors of the ways in which it can be.
    """
    log_odds = mean_evidence(evidence)
    log_odds += float(np.log((1.0 - NOTHING) / NOTHING))
    return float(1.0 / (1.0 + np.exp(-min(log_odds, 700.0))))
