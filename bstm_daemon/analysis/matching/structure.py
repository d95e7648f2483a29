"""What a match adds to the model where the model as configured is not enough.

The thesis splits the heat between disc and pads by a constant (Eq 2.3). Real
faces exchange heat as well while they are pressed together, so that in a long
drag the pad comes near to the disc; without it the lining's properties take
values that no lining has. Whether a car's drives ask for it is decided by
what was left out of the fit, not by its name in a file.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, log
from typing import TYPE_CHECKING, Final

from bstm_daemon.analysis.matching.tunables import CONTACT
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.effects.catalogue import effects_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.matcher import Match
    from bstm_daemon.analysis.matching.tunables import Target

FIRST_W_M2K: Final = 500.0
"""Conductance that the fit begins from, at 1 MPa."""

LINING: Final = ("pad.conductivity_w_mk", "pad.heat_capacity_j_kgk")
"""Refined beside it: together they say how deep the heat goes."""

KEPT: Final = 0.9
"""An addition stays where it leaves so much less of the error."""


def with_additions(
    plain: Match, match_again: Callable[[Target], Match]
) -> Match:
    """Return the better of *plain* and a match with what it may lack."""
    trial = _with_contact(plain.before, plain.drives)
    if trial is None:
        return plain
    more = match_again(trial)
    left = _share_left(plain.accuracy.rms_k, more.accuracy.rms_k)
    what = (
        f"heat through the contact of disc and pads ({CONTACT}), with k and "
        f"cp of the lining, leaves {left:.2f} times the error on what was "
        "left out"
    )
    if left > KEPT:
        note = f"{what}: not added"
        return replace(plain, remarks=(*plain.remarks, note))
    return replace(
        more,
        before=plain.before,
        table_4_1=plain.table_4_1,
        accuracy=replace(more.accuracy, before_k=plain.accuracy.before_k),
        remarks=(*more.remarks, f"{what}: added"),
    )


def _with_contact(target: Target, drives: Sequence[Drive]) -> Target | None:
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
    return replace(target, config=config, free=LINING)


def _share_left(
    before_k: Mapping[str, float], after_k: Mapping[str, float]
) -> float:
    """Return the geometric mean over nodes of what is left of an error."""
    shares = [
        log(after_k[node] / before_k[node])
        for node in before_k
        if node in after_k and before_k[node] > 0.0 < after_k[node]
    ]
    return exp(sum(shares) / len(shares)) if shares else 1.0
