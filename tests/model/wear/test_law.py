"""Eq 4.20 and 4.21 in the right form, as lines over the dose."""

from __future__ import annotations

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.estimate import WearSource
from bstm_daemon.model.wear.law import (
    WearLaw,
    between_indicators_rate_m_j,
    first_millimetre_rate_m_j,
)

NEW_M = 0.011


def line(**changes: float) -> WearLaw:
    """Return new pads that lose 1 mm in 60 MJ, give or take a half."""
    numbers = {
        "thickness_m": NEW_M,
        "dose_j": 0.0,
        "rate_m_j": 1e-3 / 60e6,
        "thickness_std_m": 1e-4,
        "rate_spread": 0.5,
    } | changes
    return WearLaw(WearSource.NEW_PADS, **numbers)


def test_eq_4_20_has_its_millimetre() -> None:
    """The quotient times 1 mm: at twice the energy 2 mm are gone."""
    rate = first_millimetre_rate_m_j(1e-3, 10e6, 70e6)
    law = line(rate_m_j=rate, dose_j=10e6)

    assert law.thickness_at_m(70e6) == pytest.approx(NEW_M - 1e-3)
    assert law.thickness_at_m(130e6) == pytest.approx(NEW_M - 2e-3)


def test_eq_4_21_is_the_slope_between_the_indicators() -> None:
    """Eight of eleven millimetres between 1 mm worn and 2 mm left."""
    rate = between_indicators_rate_m_j(NEW_M, 1e-3, 2e-3, 60e6, 540e6)
    law = line(rate_m_j=rate, thickness_m=2e-3, dose_j=540e6)

    assert rate == pytest.approx(8e-3 / 480e6)
    assert law.thickness_at_m(600e6) == pytest.approx(1e-3)


@pytest.mark.parametrize("dose_j", [0.0, -1.0])
def test_no_dose_is_no_rate(dose_j: float) -> None:
    with pytest.raises(ValueError, match="no rate"):
        first_millimetre_rate_m_j(1e-3, 5.0, 5.0 + dose_j)


def test_a_disc_loses_nothing_unless_it_is_given() -> None:
    assert line().disc_loss_at_m(1e9) == 0.0


def test_the_interval_grows_with_what_is_worn() -> None:
    law = line()

    assert law.std_at_m(0.0) == pytest.approx(1e-4)
    assert law.std_at_m(240e6) == pytest.approx(2e-3, rel=0.01)


@given(
    doses=st.lists(st.floats(0, 1e9), min_size=2, max_size=2),
    lowest=st.floats(0, 0.005),
    highest=st.floats(0.006, 0.02),
)
def test_thickness_never_grows_and_keeps_its_limits(
    doses: list[float], lowest: float, highest: float
) -> None:
    law = line(lowest_m=lowest, highest_m=highest)
    early, late = (law.thickness_at_m(dose) for dose in sorted(doses))

    assert lowest <= late <= early <= min(highest, NEW_M)


@given(moved=st.floats(0, 5e8), dose=st.floats(0, 5e8))
def test_another_reference_is_the_same_line(moved: float, dose: float) -> None:
    law = line(lowest_m=0.0, highest_m=inf, disc_rate_m_j=1e-12)
    same = law.moved_to(moved)

    after = moved + dose
    assert same.thickness_at_m(after) == pytest.approx(
        law.thickness_at_m(after), abs=1e-12
    )
    assert same.disc_loss_at_m(after) == pytest.approx(
        law.disc_loss_at_m(after), abs=1e-12
    )
