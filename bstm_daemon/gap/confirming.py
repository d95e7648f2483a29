"""Is it this effect? At other times, and on the drives it was not found on."""

from __future__ import annotations

from dataclasses import replace
from math import sqrt
from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.gap.evidence import weigh
from bstm_daemon.gap.projector import Projector

if TYPE_CHECKING:
    from bstm_daemon.gap.layout import Layout
    from bstm_daemon.gap.signatures import Linearised, Signature
    from bstm_daemon.matching.drives import Column

PLACEBOS: Final = 20
"""Candidates that can not be: the best one's signature at other times."""


def best_placebo(
    layout: Layout,
    project: Projector,
    residual: Column,
    signature: Signature,
) -> float:
    """Return the largest score of the signature at other times."""
    rng = np.random.default_rng(7)
    drives = range(len(layout.drive_names))
    scores = []
    for _ in range(PLACEBOS):
        moved = signature.kelvin.copy()
        for drive in drives:
            share = rng.uniform(0.2, 0.8)
            for part in layout.slices(drive):
                count = part.stop - part.start
                moved[part] = np.roll(moved[part], int(share * count))
        white = layout.whiten(moved)
        projected = project(white)
        slope = max(float(white @ projected), 1e-12)
        score = -float(projected @ residual) / sqrt(slope)
        scores.append(abs(score) if signature.either_sign else score)
    return max(scores)


def cross_validated(
    layout: Layout, linearised: Linearised, signature: Signature
) -> dict[str, float]:
    """Return the log Bayes factor of each drive, predicted by the others.

    How much likelier the effect makes the drive once the others are known:
    what the others leave open, of tunables and strength, is integrated out.
    """
    found: dict[str, float] = {}
    count = len(layout.drive_names)
    if count < 2:
        return found
    project = Projector(linearised.jacobian, layout.prior)
    whole = weigh(project, linearised.residual, signature).log_evidence
    for drive, name in enumerate(layout.drive_names):
        others = np.ones(len(linearised.residual), bool)
        for part in layout.slices(drive):
            others[part] = False
        there = replace(
            signature,
            linear=signature.linear[others],
            curved=signature.curved[others],
        )
        project = Projector(linearised.jacobian[others], layout.prior)
        without = weigh(project, linearised.residual[others], there)
        found[name] = whole - without.log_evidence
    return found
