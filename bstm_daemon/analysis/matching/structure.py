"""What a match adds to the model where the model as configured is not enough.

The thesis splits the heat between disc and pads by a constant (Eq 2.3). Real
faces exchange heat as well while they are pressed together, so that in a long
drag the pad comes near to the disc; without it the lining's properties take
values that no lining has. Whether a car's drives ask for it is decided by
what was left out of the fit, not by its name in a file.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import exp, log
from typing import Final

from bstm_daemon.analysis.matching.drives import Drive
from bstm_daemon.analysis.matching.tunables import CONTACT, Target
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.effects.catalogue import effects_of

FIRST_W_M2K: Final = 500.0
"""Conductance that the fit begins from, at 1 MPa."""

KEPT: Final = 0.9
"""An addition stays where it leaves so much less of the error."""

GROWN: Final = 1.25
GROWN_K: Final = 2.0
"""Nor may what a node is off by on a drive that was left out grow by more than
both: a mean over nodes hides one that pays for the others."""


def with_contact(target: Target, drives: Sequence[Drive]) -> Target | None:
    """Return *target* with heat between disc and pads through their contact.

    None where it has that already, or where no drive has thermocouples on
    both sides.
    """
    there = any(
        {"disc", "pad_front"} <= drive.measured.get(corner, {}).keys()
        for drive in drives
        for corner in target.corners
    )
    names = {effect.name for effect in effects_of(target.config)}
    if CONTACT in names or not there:
        return None
    effect = EffectConfig(
        name=CONTACT, parameters={"conductance_w_m2k": FIRST_W_M2K}
    )
    config = target.config.model_copy(
        update={"effect": [*target.config.effect, effect]}
    )
    return replace(target, config=config)


def has_grown(before_k: float, after_k: float, noise_k: float = 0.0) -> bool:
    """Whether an error has grown, by more than *noise_k* too."""
    least_k = before_k + max(GROWN_K, noise_k)
    return after_k > max(GROWN * before_k, least_k)


def share_left(
    before_k: Mapping[str, float], after_k: Mapping[str, float]
) -> float:
    """Return the geometric mean over nodes of what is left of an error."""
    shares = [
        log(after_k[node] / before_k[node])
        for node in before_k
        if node in after_k and before_k[node] > 0.0 < after_k[node]
    ]
    return exp(sum(shares) / len(shares)) if shares else 1.0
