"""Brake power between and beyond the values that drives were read with."""

from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.analysis.matching.power_by import PowerBy
from bstm_daemon.analysis.matching.problem import power_w
from bstm_daemon.analysis.matching.tunables import FADE, Target
from bstm_daemon.config.sections import EffectConfig

from ...made_drives import driven  # noqa: TID252  (tests are no package)

BY = PowerBy(
    FADE,
    np.array([0.0, 1.0, 3.0]),
    np.array([[800.0, 0.0], [600.0, 0.0], [100.0, 40.0]]),
)


def test_power_is_straight_between_two_values() -> None:
    found = BY.at([0.0, 0.25, 1.0, 2.0, 3.0])

    assert found[0] == pytest.approx([800.0, 750.0, 600.0, 350.0, 100.0])
    assert found[1] == pytest.approx([0.0, 0.0, 0.0, 20.0, 40.0])


def test_it_goes_on_beyond_the_last_and_no_brake_cools() -> None:
    found = BY.at([-1.0, 3.2, 4.0])

    assert found[0] == pytest.approx([1000.0, 50.0, 0.0])


def test_a_part_has_its_own_steps() -> None:
    assert BY.part(slice(1, 2)).at([2.0]) == pytest.approx(np.array([[20.0]]))


def test_each_target_brakes_by_its_own_value(target: Target) -> None:
    """And as the drive was read, where its power follows nothing."""
    config = target.config.model_copy(
        update={"effect": [EffectConfig(name="friction_fade")]}
    )
    drive = driven(config, "one", ((10.0, 0.0, 1.0),), every=1)
    fading = Target(config, target.corners)
    targets = [fading, fading.changed({FADE: 0.25})]

    found = power_w(replace(drive, power_by={"FL": BY}), "FL", targets)

    assert found is not None
    assert found.tolist() == BY.at([1.0, 0.25]).tolist()
    assert power_w(drive, "FL", targets) is None
