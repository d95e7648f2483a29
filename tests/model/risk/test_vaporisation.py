"""The boiling point as a distribution."""

from itertools import pairwise
from math import isnan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.model.risk.boiling import BOILING_POINTS
from bstm_daemon.model.risk.vaporisation import (
    Boiling,
    Fluid,
    boiling,
    boiling_point_k,
)
from bstm_daemon.model.risk.water import Water, water_measured, water_of_age
from bstm_daemon.units import KELVIN_OFFSET, to_celsius


@pytest.mark.parametrize(
    ("percent", "celsius"), [(0.0, 250.0), (1.0, 180.0), (3.0, 145.0)]
)
def test_keens_vapour_lock_points(percent: float, celsius: float) -> None:
    """TRRL LR 903: 250, 180 and 145 degC at 0, 1 and 3 % of water."""
    dry_k, wet_k = 250.0 + KELVIN_OFFSET, 142.3 + KELVIN_OFFSET

    found = boiling_point_k(dry_k, wet_k, percent, slowness=0.995)

    assert to_celsius(found) == pytest.approx(celsius, abs=1.0)


@pytest.mark.parametrize("grade", BOILING_POINTS)
@pytest.mark.parametrize("slowness", [1.0, 1.25, 1.5])
def test_the_curve_passes_dry_and_wet_minimum(
    grade: str, slowness: float
) -> None:
    """The wet point is that at 3.7 % of water."""
    dry_k, wet_k, _ = BOILING_POINTS[grade]

    assert boiling_point_k(dry_k, wet_k, 0.0, slowness) == pytest.approx(dry_k)
    assert boiling_point_k(dry_k, wet_k, 3.7, slowness) == pytest.approx(wet_k)


@given(st.floats(0.1, 8.0))
def test_water_only_lowers_the_boiling_point(percent: float) -> None:
    """At every share, for a fluid of any knowledge."""
    fluid = Fluid("DOT4")
    here = boiling(fluid, Water(percent, 0.3))
    wetter = boiling(fluid, Water(percent + 0.5, 0.3))

    for share in (0.01, 0.5, 0.99):
        assert wetter.quantile(share) < here.quantile(share)


def test_probability_is_the_share_of_fluids_that_boil_below() -> None:
    """Rises from 0 to 1; the quantiles are its inverse."""
    found = boiling(Fluid("DOT4"), water_of_age(None, "temperate"))
    steps = [found.probability(300.0 + k) for k in range(400)]

    assert steps[0] == 0.0
    assert steps[-1] == 1.0
    assert all(a <= b for a, b in pairwise(steps))
    for share in (0.01, 0.1, 0.5, 0.9):
        at_k = found.quantile(share)
        assert found.probability(at_k) == pytest.approx(share, abs=0.02)


def test_what_is_known_narrows_the_distribution() -> None:
    """By age, by a measurement, by the can's own boiling points."""

    def width(found: Boiling) -> float:
        return found.quantile(0.95) - found.quantile(0.05)

    can = Fluid("DOT4", 265.0 + KELVIN_OFFSET, 165.0 + KELVIN_OFFSET)
    measured = water_measured(3.0, 0.05, "temperate")
    widths = [
        width(boiling(Fluid("DOT4"), water_of_age(None, "temperate"))),
        width(boiling(Fluid("DOT4"), measured)),
        width(boiling(can, measured)),
    ]

    assert widths == sorted(widths, reverse=True)
    assert widths[0] > 40.0
    assert widths[2] < 10.0


def test_no_number_is_no_probability() -> None:
    """An estimate that is none is not a safe one, and no crash."""
    found = boiling(Fluid("DOT3"), water_of_age(1.0, "dry"))

    assert isnan(found.probability(float("nan")))
    assert found.probability(float("inf")) == 1.0
