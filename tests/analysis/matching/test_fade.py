"""Fade as a value that temperatures show: an axle's share follows it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from bstm_daemon.analysis.matching.changes import (
    changes_of,
    learned,
    value_changes,
)
from bstm_daemon.analysis.matching.coarse import (
    Reading,
    driven_keys,
    read_with_fade,
)
from bstm_daemon.analysis.matching.curves import curves_of
from bstm_daemon.analysis.matching.effect_values import effect_value
from bstm_daemon.analysis.matching.learned import known_keys
from bstm_daemon.analysis.matching.matcher import match_drives
from bstm_daemon.analysis.matching.power_by import PowerBy
from bstm_daemon.analysis.matching.targets import targets_of
from bstm_daemon.analysis.matching.tunables import FADE, MASS, refined_keys
from bstm_daemon.analysis.statistics.series import rms
from bstm_daemon.channels import CHANNELS
from bstm_daemon.config.sections import EffectConfig

from .conftest import PROFILE

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.matching.drives import Drive
    from bstm_daemon.config.sections import Config

    from ...made_drives import Profile  # noqa: TID252

NAME = "friction_fade.strength"
RIGHT = 0.4
LOST = 0.25
"""Share of the power in the last braking at a strength of 1."""


@pytest.fixture
def fading(config: Config) -> Config:
    effects = [*config.effect, EffectConfig(name="friction_fade")]
    return config.model_copy(update={"effect": effects})


def profile(strength: float) -> Profile:
    """Return the brakings as linings of that fade heat the brake.

    The last is hot, and the other axle takes what this one loses.
    """
    return tuple(
        (speed, power * (1.0 - LOST * strength * (speed == 14.0)), seconds)
        for speed, power, seconds in PROFILE
    )


def test_drives_are_read_without_the_fade_of_each_lining(
    fading: Config, made: Callable[..., Drive]
) -> None:
    """The power of a corner is that of its own lining's strengths."""
    drive = made(nodes=("disc",))
    corners = ("FL", "FR", "RL", "RR")
    inputs = drive.inputs.repeat(len(corners), 1)
    wide = replace(drive, corners=corners, inputs=inputs)
    place = CHANNELS.index("brake_power_w")
    asked = []

    def read(of: Config) -> list[Drive]:
        strengths = [effect_value(of, one, NAME) for one in corners]
        asked.append(strengths)
        inputs = wide.inputs.copy()
        inputs[:, :, place] = [100.0 - 30.0 * one for one in strengths]
        return [replace(wide, inputs=inputs)]

    linings = [("FL", "FR"), ("RL", "RR")]
    found = read_with_fade(
        Reading(None, read(fading)), fading, linings, read
    ).drives[0]

    off, on = [0.0] * 2, [1.0] * 2
    assert asked == [on + on, off + on, on + off]
    assert found.power_by.keys() == set(corners)
    for by in found.power_by.values():
        assert by.key == FADE
        assert by.at([0.0, 1.0, 2.0])[0].tolist() == [100.0, 70.0, 40.0]

    plain = fading.model_copy(update={"effect": []})
    asked.clear()
    same = Reading(None, [wide])
    assert read_with_fade(same, plain, linings, read).drives == [wide]
    assert asked == []


@pytest.mark.slow
def test_temperatures_show_how_much_linings_fade(
    fading: Config, made: Callable[..., Drive]
) -> None:
    """A match that can not say so puts it into other values."""
    (target,) = targets_of(fading, ["FL"])

    def read(of: Config) -> list[Drive]:
        powers = made(profile=profile(effect_value(of, "FL", NAME)), nodes=())
        return [replace(right, inputs=powers.inputs)]

    right = made(
        {MASS: 1.05}, profile=profile(RIGHT), target=target, noise_k=0.3
    )
    plain = Reading(None, read(fading))
    reading = read_with_fade(plain, fading, [target.corners], read)

    (match,) = match_drives(fading, [reading], beside=False)
    (without,) = match_drives(fading, [plain], beside=False)

    found = match.joint.values
    assert found[FADE] == pytest.approx(RIGHT, abs=0.03)
    assert match.joint.standard_deviation(FADE) < 0.1
    assert found[MASS] == pytest.approx(1.05, rel=0.01)
    assert match.settings()[FADE] == found[FADE]
    assert match.joint.rms_k["disc"] < 1.0 < without.joint.rms_k["disc"]
    assert FADE not in without.joint.values
    written = changes_of([match], fading, "matched")
    assert [
        one.corner for one in written if one.effect == "friction_fade"
    ] == ["all"]
    known = match.after.config.model_copy(update={"matched": [learned(match)]})
    assert FADE in known.matched[0].names
    assert FADE not in known_keys(replace(match.after, config=known))
    (curve, *_) = curves_of(match, reading.drives[0], "FL")
    assert rms(curve.after_c - curve.measured_c) < 1.0
    assert rms(curve.before_c - curve.measured_c) > 3.0


def test_discs_alone_do_not_show_the_fade(
    fading: Config, made: Callable[..., Drive]
) -> None:
    """What cools them does the same to the hot ones."""
    (target,) = targets_of(fading, ["FL"])
    by = PowerBy(FADE, np.array([0.0, 1.0]), np.ones((2, 1)))
    drive = replace(made(), power_by={"FL": by})
    disc = {"FL": {"disc": drive.measured["FL"]["disc"]}}

    keys, _ = driven_keys(target, [drive], refined_keys(target))
    assert keys[-1] == FADE
    assert FADE not in refined_keys(target)
    alone = replace(drive, measured=disc)
    assert FADE not in driven_keys(target, [alone], refined_keys(target))[0]


def test_a_fade_is_that_of_all_linings_that_share_it(fading: Config) -> None:
    """All other values are those of the measured corners."""
    (target,) = targets_of(fading, ["FL"])
    target = replace(target, linings=("FL", "FR"))

    changed = target.changed({FADE: 0.4, MASS: 1.1}).config

    fades = [effect_value(changed, one.name, NAME) for one in changed.corner]
    assert fades == [0.4, 0.4, 1.0, 1.0]
    key = MASS.removeprefix("thermal.")
    masses = [one.thermal.get(key) for one in changed.corner]
    assert masses[0] == 1.1
    assert masses[1:] == [one.thermal.get(key) for one in fading.corner][1:]
    alone = replace(target, linings=()).changed({FADE: 0.4}).config
    fades = [effect_value(alone, one.name, NAME) for one in alone.corner]
    assert fades == [0.4, 1.0, 1.0, 1.0]


def test_the_fade_is_written_for_all_linings_that_share_it(
    config: Config,
) -> None:
    def where(*linings: str) -> list[str]:
        changes = value_changes(
            {FADE: 0.4}, {FADE: "matched"}, config, ["FL"], linings
        )
        assert {(one.effect, one.key, one.value) for one in changes} == {
            ("friction_fade", "strength", 0.4)
        }
        return [one.corner for one in changes]

    assert where("FL", "FR") == ["FL", "FR"]
    assert where("FL", "FR", "RL", "RR") == ["all"]
    assert where() == ["FL"]
    other = value_changes(
        {MASS: 1.1}, {MASS: ""}, config, ["FL"], ["FL", "FR"]
    )
    assert [one.corner for one in other] == ["FL"]
