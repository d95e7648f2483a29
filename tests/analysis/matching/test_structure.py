"""What a match adds: heat through the contact of disc and pads."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import pytest

from bstm_daemon.analysis.matching.changes import changes_of
from bstm_daemon.analysis.matching.coarse import Reading
from bstm_daemon.analysis.matching.matcher import match_drives
from bstm_daemon.analysis.matching.tunables import (
    CONDUCTANCE,
    CONTACT,
    PARTITION,
)
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.model.thermal.brake_corner import corner_spec

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.analysis.matching.tunables import Target

RIGHT_W_M2K: Final = 1400.0


def with_contact(target: Target, w_m2k: float) -> Target:
    """Return *target* with that conductance between disc and pads."""
    effect = EffectConfig(
        name=CONTACT, parameters={"conductance_w_m2k": w_m2k}
    )
    config = target.config.model_copy(update={"effect": [effect]})
    return replace(target, config=config)


@pytest.mark.slow
def test_contact_that_the_drives_have_is_added(
    made: Callable[..., Drive], target: Target
) -> None:
    """Its conductance is found, and stands in the file that is written."""
    car = with_contact(target, RIGHT_W_M2K)
    drives = [
        made(name=name, target=car, noise_k=0.5, seed=seed, scale=scale)
        for name, seed, scale in (("one", 1, 1.0), ("two", 2, 0.7))
    ]

    (match,) = match_drives(target.config, [Reading(None, drives)])

    assert match.joint.values[CONDUCTANCE] == pytest.approx(
        RIGHT_W_M2K, rel=0.15
    )
    assert any(remark.endswith(": added") for remark in match.remarks)
    assert match.before.config.effect == target.config.effect
    changes = changes_of([match], target.config, "matched")
    found = match.joint.values[CONDUCTANCE]
    # the right one is alike
    assert [
        (one.corner, one.key, one.value)
        for one in changes
        if one.effect == CONTACT
    ] == [(corner, "conductance_w_m2k", found) for corner in ("FL", "FR")]


@pytest.mark.slow
def test_nothing_is_added_where_the_model_is_enough(
    made: Callable[..., Drive], target: Target
) -> None:
    drives = [
        made(name=n, noise_k=0.5, seed=s) for n, s in (("a", 1), ("b", 2))
    ]

    (match,) = match_drives(target.config, [Reading(None, drives)])

    assert CONDUCTANCE not in match.joint.values
    assert not match.verdict


def test_where_the_contact_conducts_the_share_of_the_pads_is_open(
    target: Target,
) -> None:
    """Eq 2.3 is of faces of one temperature; a half is the most there is."""
    tunable = with_contact(target, RIGHT_W_M2K).tunable(PARTITION)

    alike = 1.0 - corner_spec(target.config, target.corner).disc_share
    assert tunable.upper == pytest.approx(0.5 / alike)
    assert tunable.prior > 5.0 * target.tunable(PARTITION).prior
    assert target.tunable(PARTITION).upper == 3.0
