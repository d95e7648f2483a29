"""What the drives determine: each value, and which combinations.

With temperatures only, a node gives ratios of conductance to capacity, never
both; the scale comes from the brake power. So a value by itself may be
unknown although a ratio with another is well known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final

import numpy as np

from bstm_daemon.analysis.matching.refine import Refinement
from bstm_daemon.analysis.matching.tunables import TUNABLES

KNOWN: Final = 0.5
"""The drives settle a value where they halve its prior's deviation."""

SILENT: Final = 0.5
"""Below this the drives alone would say less than the prior does, even if
every other value were known."""

TWINS: Final = 0.7
"""Correlation from which two values are worth naming together."""

RATIO_GAIN: Final = 0.6
"""A ratio is named where it is so much surer than either value."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """How well one value is known.

    ``share`` is the deviation over the prior's; ``reason`` says why it is
    not settled, empty where it is.
    """

    key: str
    value: float
    deviation: float
    share: float
    reason: str

    @property
    def settled(self) -> bool:
        """Whether the drives settle it."""
        return not self.reason


@dataclass(frozen=True, slots=True)
class Ratio:
    """Two values whose ratio or product the drives know better than either.

    ``sign`` is ``x`` or ``/``, ``deviation`` is relative.
    """

    first: str
    sign: str
    second: str
    deviation: float

    def __str__(self) -> str:
        """Return it in words."""
        return f"{self.first} {self.sign} {self.second}"


def verdicts(fit: Refinement) -> list[Verdict]:
    """Return how well each value of *fit* is known, in its order."""
    deviations = np.sqrt(np.diag(fit.covariance))
    correlation = correlations(fit)
    alone = np.sqrt(np.diag(fit.information)) * fit.prior
    found = []
    for i, key in enumerate(fit.keys):
        share = float(deviations[i] / fit.prior[i])
        reason = ""
        # what the drives say nothing of may lie at a bound by chance
        if key in fit.at_bound and share < KNOWN:
            tunable = TUNABLES[key]
            at_upper = fit.values[key] > (tunable.lower * tunable.upper) ** 0.5
            bound = tunable.upper if at_upper else tunable.lower
            reason = f"at its physical bound {bound:g}: the form is wrong"
        elif alone[i] < SILENT:
            reason = "these drives hardly depend on it: the prior decides"
        elif share > KNOWN:
            row = np.abs(correlation[i])
            row[i] = 0.0
            twin = int(np.argmax(row))
            reason = "known no better than half the prior"
            if row[twin] > TWINS:
                reason = (
                    f"only together with {fit.keys[twin]} (correlation "
                    f"{correlation[i, twin]:+.2f})"
                )
        found.append(
            Verdict(
                key,
                fit.values[key],
                fit.standard_deviation(key),
                share,
                reason,
            )
        )
    return found


def correlations(fit: Refinement) -> np.ndarray:
    """Return the correlations of the values' logarithms, (p, p)."""
    deviations = np.sqrt(np.diag(fit.covariance))
    found: np.ndarray = fit.covariance / np.outer(deviations, deviations)
    return found


def ratios(fit: Refinement) -> list[Ratio]:
    """Return ratios and products that are known best beside their parts."""
    found = []
    cov = fit.covariance
    for i, j in combinations(range(len(fit.keys)), 2):
        if {fit.keys[i], fit.keys[j]} & set(fit.at_bound):
            continue
        sign = "x" if cov[i, j] < 0.0 else "/"
        together = cov[i, i] + cov[j, j] - 2.0 * abs(cov[i, j])
        deviation = float(np.sqrt(max(together, 0.0)))
        least = float(np.sqrt(min(cov[i, i], cov[j, j])))
        if deviation < RATIO_GAIN * least:
            found.append(Ratio(fit.keys[i], sign, fit.keys[j], deviation))
    return sorted(found, key=lambda one: one.deviation)


def strong_pairs(fit: Refinement) -> Sequence[tuple[str, str, float]]:
    """Return pairs of values with a correlation from :data:`TWINS` on."""
    found = correlations(fit)
    return sorted(
        (
            (fit.keys[i], fit.keys[j], float(found[i, j]))
            for i, j in combinations(range(len(fit.keys)), 2)
            if abs(found[i, j]) >= TWINS
        ),
        key=lambda pair: -abs(pair[2]),
    )
