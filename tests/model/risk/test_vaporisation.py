"""The boiling point as a distribution."""

import sys
from array import array
from itertools import pairwise
from math import isnan
from typing import Any

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
from bstm_daemon.native.loader import load_kernel
from bstm_daemon.units import KELVIN_OFFSET, to_celsius

KERNEL = load_kernel()
needs_kernel = pytest.mark.skipif(KERNEL is None, reason="not installed")


@pytest.mark.parametrize(
    ("percent", "celsius"), [(0.0, 250.0), (1.0, 180.0), (3.0, 145.0)]
)
def test_keens_vapour_lock_points(percent: float, celsius: float) -> None:
    """TRRL LR 903: 250, 180 and 145 degC at 0, 1 and 3 % of water."""
    dry_k, wet_k = 250.0 + KELVIN_OFFSET, 142.3 + KELVIN_OFFSET

    found = boiling_point_k(dry_k, wet_k, percent, slowness=0.995)

    assert to_celsius(found) == pytest.approx(celsius, abs=1.0)


@pytest.mark.parametrize(
    ("percent", "celsius"), [(0.0, 255.0), (2.0, 180.0), (3.0, 160.0)]
)
def test_a_maker_of_refractometers_on_dot_3(
    percent: float, celsius: float
) -> None:
    """MISCO: 180 and 160 degC at 2 and 3 % of water, 75 K less than dry."""
    dry_k, wet_k = 255.0 + KELVIN_OFFSET, 149.0 + KELVIN_OFFSET

    found = boiling_point_k(dry_k, wet_k, percent, slowness=2.5)

    assert to_celsius(found) == pytest.approx(celsius, abs=1.5)


@pytest.mark.parametrize("grade", BOILING_POINTS)
@pytest.mark.parametrize("slowness", [1.0, 2.0, 3.0])
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
    assert widths[2] < 12.0


def test_a_distribution_is_drawn_once() -> None:
    """The fluid of all corners is the same and changes once a day."""
    fluid, water = Fluid("DOT4"), water_of_age(2.0, "humid")

    assert boiling(fluid, water) is boiling(Fluid("DOT4"), Water(*water))


def test_no_number_is_no_probability() -> None:
    """An estimate that is none is not a safe one, and no crash."""
    found = boiling(Fluid("DOT3"), water_of_age(1.0, "dry"))

    assert isnan(found.probability(float("nan")))
    assert found.probability(float("inf")) == 1.0


SHARES = (0.05, 0.5, 0.95)
CAN = Fluid("DOT4", 265.0 + KELVIN_OFFSET, 165.0 + KELVIN_OFFSET)
KEENS = Fluid("DOT3", 250.0 + KELVIN_OFFSET, 142.3 + KELVIN_OFFSET)


@pytest.mark.parametrize(
    ("fluid", "percent", "celsius"),
    [
        # 265 +- 10 degC of a DOT 4 of today, vapour lock 0 to 6 K below
        (Fluid("DOT4"), 0.0, (245.9, 262.0, 278.8)),
        (CAN, 0.0, (258.9, 262.0, 265.2)),
        # at 3.7 % the wet minimum, at most some kelvin above it
        (Fluid("DOT4"), 3.7, (151.2, 156.3, 164.3)),
        (CAN, 3.7, (158.7, 162.0, 165.3)),
        # Keen's 180 and 145 degC with w_0 = 1.0, up to 27 and 9 K more with
        # the 3.0 of a slower fluid
        (KEENS, 1.0, (180.7, 196.7, 204.3)),
        (KEENS, 3.0, (141.7, 147.5, 152.4)),
        # the form falls by 4 to 27 K from 4 to 8 %, the fluid by 0 to 24 K
        # more
        (CAN, 4.0, (155.9, 159.6, 163.2)),
        (CAN, 8.0, (114.3, 132.9, 152.6)),
    ],
)
def test_quantiles_at_exactly_so_much_water(
    fluid: Fluid, percent: float, celsius: tuple[float, ...]
) -> None:
    """FMVSS 116 minima, a DOT 4 of today, Keen's vapour lock points."""
    found = boiling(fluid, Water(percent, 0.0))

    assert [to_celsius(found.quantile(share)) for share in SHARES] == (
        pytest.approx(celsius, abs=0.1)
    )


@pytest.mark.parametrize(
    ("grade", "celsius"),
    [
        ("DOT3", (112.7, 148.2, 185.7)),
        ("DOT4", (125.8, 163.8, 205.7)),
        ("DOT5.1", (149.7, 189.2, 232.9)),
        ("CLASS6", (133.6, 174.5, 220.1)),
    ],
)
def test_quantiles_of_a_fluid_of_unknown_age(
    grade: str, celsius: tuple[float, ...]
) -> None:
    """Water of 3 % with a spread of 0.55, as the surveys have it."""
    found = boiling(Fluid(grade), water_of_age(None, "temperate"))

    assert [to_celsius(found.quantile(share)) for share in SHARES] == (
        pytest.approx(celsius, abs=0.1)
    )


def test_no_fluid_boils_below_water() -> None:
    """Vapour lock begins at most 6 K below 100 degC, however wet it is."""
    found = boiling(Fluid("DOT3"), Water(20.0, 0.5))

    assert 94.0 <= to_celsius(found.quantile(0.0)) < 94.1
    assert to_celsius(found.quantile(0.5)) == pytest.approx(98.4, abs=0.1)


def test_a_new_fluid_never_boils_below_its_grade_s_minimum() -> None:
    """Vapour lock begins at most 6 K below the 230 degC of a DOT 4."""
    found = boiling(Fluid("DOT4"), Water(0.0, 0.0))

    assert to_celsius(found.quantile(0.0)) >= 224.0


def test_mean_probability_is_that_of_every_temperature() -> None:
    found = Boiling([400.0, 410.0, 420.0, 430.0])

    assert found.probability(400.0) == 0.0
    assert found.probability(405.0) == 0.25
    assert found.probability(425.0) == 0.75
    assert found.probability(430.5) == 1.0
    assert found.mean_probability([440.0, 405.0, 425.0]) == (
        pytest.approx(2.0 / 3.0)
    )
    assert found.lowest_k == 400.0
    assert found.mean_probability([300.0, 400.0]) == 0.0
    assert found.mean_probability([400.0, 405.0]) == 0.125
    assert found.mean_probability([431.0]) == found.probability(431.0) == 1.0
    assert found.mean_probability([float("inf"), 300.0]) == 0.5
    assert isnan(found.mean_probability([]))
    assert isnan(found.mean_probability([405.0, float("nan")]))
    assert found.quantile(0.5) == 415.0
    assert found.quantile(1.0) == 430.0
    narrow = Boiling([400.0, 400.5])
    assert narrow.probability(400.2) == pytest.approx(0.6)
    assert narrow.mean_probability([400.2]) == narrow.probability(400.2)
    assert narrow.probability(401.0) == 1.0


@needs_kernel
@given(
    st.lists(st.floats(300.0, 600.0), min_size=2, max_size=20),
    st.lists(st.floats() | st.floats(290.0, 610.0), max_size=20),
)
def test_both_forms_have_the_same_mean_to_the_last_bit(
    points_k: list[float], temperatures_k: list[float]
) -> None:
    compiled = Boiling(points_k)
    reference = Boiling(points_k)
    reference._compiled = None
    temperatures_k += [max(points_k) + k for k in (-0.5, 0.5, 1.5, 2.5)]

    for series in (temperatures_k, tuple(temperatures_k)):
        found = compiled.mean_probability(series)
        expected = reference.mean_probability(series)
        assert found == expected or (isnan(found) and isnan(expected))


@needs_kernel
@pytest.mark.parametrize(
    ("lines", "temperatures_k", "error"),
    [
        (array("f", [0.0, 1.0]), [300.0], ValueError),
        ([0.0, 1.0], [300.0], TypeError),
        (array("d", [0.0, 1.0]), ["hot"], TypeError),
        (array("d", [0.0, 1.0]), 300.0, TypeError),
    ],
)
def test_the_compiled_mean_refuses_what_is_no_number(
    lines: Any, temperatures_k: Any, error: type[Exception]
) -> None:
    assert KERNEL is not None
    with pytest.raises(error):
        KERNEL.mean_probability(lines, 300.0, temperatures_k)
    lines.append(0.0)  # which would fail, were it held


@needs_kernel
def test_the_compiled_mean_reads_no_line_that_is_not_there() -> None:
    assert KERNEL is not None
    odd = array("d", [0.25, 0.0, 0.5])

    found = KERNEL.mean_probability(odd, 300.0, [300.5, 301.5])

    assert found == (0.25 + 1.0) / 2.0
    odd.append(0.0)


def test_points_far_apart_and_close_together() -> None:
    """The last interval is wider, the first one within a table's step."""
    found = Boiling([400.0, 400.25, 410.0, 450.0])

    assert found.quantile(1.0) == 450.0
    assert found.quantile(0.9) == pytest.approx(438.0)
    assert found.quantile(0.5) == pytest.approx(405.125)
    assert found.probability(400.0) == 0.0
    assert found.probability(400.5) == pytest.approx(0.375)
    assert found.probability(449.0) == 0.75
    assert found.probability(449.5) == pytest.approx(0.875)


@needs_kernel
def test_the_compiled_mean_keeps_no_temperature() -> None:
    assert KERNEL is not None
    kelvin = 431.5
    held = sys.getrefcount(kelvin)

    KERNEL.mean_probability(array("d", [0.0, 1.0]), 300.0, [kelvin] * 9)

    assert sys.getrefcount(kelvin) == held
