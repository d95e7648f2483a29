"""From the temperatures of an ensemble to the probability of vapour."""

from __future__ import annotations

from math import nan
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bstm_daemon.risk.vaporisation import Boiling


def likelihood(boiling: Boiling, temperatures_k: Sequence[float]) -> float:
    """Return the mean probability of vapour; NaN without a temperature."""
    if not temperatures_k:
        return nan
    found = sum(boiling.probability(kelvin) for kelvin in temperatures_k)
    return found / len(temperatures_k)


def hottest(series: Sequence[Sequence[float]]) -> list[float]:
    """Return the hottest corner of each member; *series* one a corner."""
    return [max(values) for values in zip(*series, strict=True)]
