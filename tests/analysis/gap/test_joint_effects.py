"""Further effects, and twins that only make up for the other's form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bstm_daemon.analysis.gap.changes import are_twins
from bstm_daemon.analysis.gap.evidence import weigh
from bstm_daemon.analysis.gap.joint_effects import _Search
from bstm_daemon.analysis.gap.signatures import Linearised, Signature
from bstm_daemon.analysis.statistics.evidence import Projector


def test_a_change_of_an_effect_has_the_twins_of_the_effect() -> None:
    change = "change.effect.bracket_conduction.strength"

    assert are_twins(change, "caliper_bypass")
    assert are_twins("caliper_bypass", change)
    assert are_twins("backplate_loss", change)
    assert not are_twins(change, "hub_heat")
    # no strength of an effect
    assert not are_twins("change.disc_mass", "disc_wear")


@pytest.mark.parametrize("strength", [0.5, 2.0])
def test_a_twin_that_makes_up_for_a_strength_is_no_second_effect(
    strength: float,
) -> None:
    """What one does at its strength is not that times what it does at 1."""
    one, other = "thermocouple_lag", "clock_offset"
    assert are_twins(one, other)
    linear = np.zeros(900)
    linear[:10] = 9.0
    curved = np.zeros(900)
    curved[10:20] = 4.0
    signatures = (
        Signature(one, linear, curved, linear + curved, either_sign=False),
        Signature(*(other, curved, np.zeros(900), curved), either_sign=True),
    )
    project = Projector(np.zeros((900, 1)), np.ones(1))

    def is_form(residual: np.ndarray) -> bool:
        linearised = Linearised(
            *(residual, np.zeros((900, 1)), signatures, (), ())
        )
        found = [weigh(project, residual, each) for each in signatures]
        return _Search(project, linearised, found).is_form(one, other)

    own = signatures[0].at(strength)
    assert is_form(-own)
    # far more of it than the form of the one
    assert not is_form(-own + 6.0 * curved)
    if strength == 0.5:
        # plain, with 26 and 45 % of what the one explains
        assert is_form(-own - 0.8 * curved)
        assert not is_form(-own - 1.2 * curved)


@pytest.mark.parametrize(
    ("z", "log_evidence", "first_gain", "is_plain"),
    [
        (5.1, 5.1, 100.0, True),
        (4.9, 5.1, 100.0, False),
        (5.1, 4.9, 100.0, False),
        (5.1, 5.1, 0.5 * 5.1**2 / 0.11, True),
        (5.1, 5.1, 0.5 * 5.1**2 / 0.09, False),
    ],
)
def test_what_a_further_effect_needs(
    z: float, log_evidence: float, first_gain: float, *, is_plain: bool
) -> None:
    """Five deviations, a log Bayes factor of 5, a tenth of the first gain."""
    own = np.ones(4)
    one = Signature("wet_disc", own, 0.0 * own, own, either_sign=False)
    project = Projector(np.zeros((4, 1)), np.ones(1))
    linearised = Linearised(own, np.zeros((4, 1)), (one,), (), ())
    found = weigh(project, own, one)
    first = replace(found, gain=first_gain)
    search = _Search(project, linearised, [first])
    second = replace(found, gain=0.5 * z**2, log_evidence=log_evidence)

    assert second.z == pytest.approx(z)
    assert search.plain(second) is is_plain
