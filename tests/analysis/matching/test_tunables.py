"""Tunables as keys of a configuration."""

from __future__ import annotations

import numpy as np
import pytest

from bstm_daemon.analysis.matching.tunables import (
    DRAG,
    FADE,
    FAST,
    LEVEL,
    MASS,
    NODES_MS,
    REFINED,
    SIDES,
    SLOW,
    TABLE_4_1,
    TUNABLES,
    Target,
    strength_key,
    usable,
)
from bstm_daemon.analysis.statistics.student import as_normal
from bstm_daemon.config.estimates import PriorsConfig
from bstm_daemon.config.sections import EffectConfig
from bstm_daemon.estimator.corner_model import compile_corner
from bstm_daemon.model.effects.catalogue import effect_class, effect_names
from bstm_daemon.model.thermal.program import same_structure


def test_the_thesis_has_nine_and_the_refinement_twelve() -> None:
    assert len(TABLE_4_1) == 9
    assert 8 <= len(REFINED) <= 12


def having(target: Target, key: str) -> Target:
    """Return *target* with the effect that *key* is of."""
    if not key.startswith("effect."):
        return target
    entry = EffectConfig(name=key.split(".")[1])
    config = target.config.model_copy(update={"effect": [entry]})
    return Target(config, target.corners)


@pytest.mark.parametrize("key", sorted(TUNABLES.keys() - SIDES.keys()))
def test_a_value_is_read_where_it_is_written(key: str, target: Target) -> None:
    target = having(target, key)
    tunable = TUNABLES[key]
    middle = (tunable.lower * tunable.upper) ** 0.5

    changed = target.changed({key: middle})

    if key not in {*NODES_MS, LEVEL}:
        assert changed.value(tunable) == pytest.approx(middle)
    assert changed.config.corner[1] == target.config.corner[1]


# drag and fade act before the model
@pytest.mark.parametrize("key", sorted(TUNABLES.keys() - {DRAG, FADE, *SIDES}))
def test_variants_are_lanes_of_one_march(key: str, target: Target) -> None:
    target = having(target, key)
    tunable = TUNABLES[key]
    programs = [
        compile_corner(one.config, one.corner)
        for value in (tunable.lower, tunable.upper)
        for one in (target.changed({key: value}),)
    ]

    assert same_structure(programs)
    assert programs[0].floats != programs[1].floats


RADIATION = strength_key("disc_caliper_radiation")


def test_a_caliper_alike_is_held_closely_and_another_hardly() -> None:
    """As a normal prior of 0.3 beside 1, and less than one of 0.6 far off."""
    one = TUNABLES[RADIATION]

    def cost(strength: float) -> float:
        deviations = np.array([np.log(strength) / one.prior])
        return 0.5 * float(as_normal(deviations, one.freedom)[0]) ** 2

    assert cost(1.15) == pytest.approx(
        0.5 * (np.log(1.15) / 0.3) ** 2, rel=0.02
    )
    assert cost(8.0) - cost(7.0) < 0.5 * (
        (np.log(8.0) / 0.6) ** 2 - (np.log(7.0) / 0.6) ** 2
    )
    assert one.lower < 0.1
    assert one.upper == 10.0


def test_the_s_table_bends_between_its_speeds(target: Target) -> None:
    before = target.config.cooling_of(target.corner)

    changed = target.changed({SLOW: 2.0, FAST: 0.5})
    after = changed.config.cooling_of(changed.corner)

    factors = [
        new / old
        for new, old in zip(after.s_per_s, before.s_per_s, strict=True)
    ]
    assert factors[:3] == pytest.approx([2.0, 2.0, 2.0])
    assert factors[4] == pytest.approx(1.0)
    assert factors[-1] == pytest.approx(0.5)


def test_what_is_zero_stays_and_is_said(target: Target) -> None:
    keys, remarks = usable(
        target, ("thermal.pad_static_loss_w_k", "thermal.disc_emissivity")
    )

    assert keys == ["thermal.disc_emissivity"]
    assert "pad_static_loss_w_k is 0" in remarks[0]


def test_priors_of_the_type_count_while_the_value_is_the_types(
    target: Target,
) -> None:
    """Of these corners, by name; an edited value has its usual prior."""
    mass, still = MASS, "cooling.standstill_convection_fraction"
    usual = TUNABLES[mass].prior

    def prior(corners: list[str], value: float) -> float:
        known = PriorsConfig(
            corners=corners,
            names=[still, mass],
            values=[0.3, value],
            deviations=[0.5, 0.011],
            cars=3,
        )
        config = target.config.model_copy(update={"priors": [known]})
        return Target(config, target.corners).tunable(mass).prior

    now = target.setting(mass)
    assert prior(["FL", "FR"], 1.0005 * now) == 0.011
    assert prior(["FL"], 1.002 * now) == usual
    assert prior(["RL"], now) == usual


def test_another_form_of_cooling_is_one_of_the_same_corners(
    target: Target,
) -> None:
    changed = target.with_cooling_form("conductance")

    forms = [
        changed.config.cooling_of(corner).form
        for corner in changed.config.disc_corners()
    ]
    assert forms == ["conductance", "rate", "rate", "rate"]


def test_no_strength_is_tried_that_its_effect_refuses() -> None:
    tried = {
        name: TUNABLES[strength_key(name)].upper
        for name in effect_names()
        if strength_key(name) in TUNABLES
    }

    assert tried["cooling_band"] == 2.5
    for name, strength in tried.items():
        effect_class(name)({"strength": strength})
