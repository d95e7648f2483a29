"""Water in the fluid, by age, climate or measurement."""

from itertools import pairwise
from statistics import NormalDist

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.model.risk.water import (
    CLIMATES,
    water_measured,
    water_of_age,
)


@pytest.mark.parametrize(
    ("years", "percent"), [(1.0, 1.5), (2.0, 2.5), (4.0, 3.5)]
)
def test_usual_uptake(years: float, percent: float) -> None:
    """1.5, 2.5 and 3.5 % after one, two and four years."""
    assert water_of_age(years, "temperate").median_percent == percent


def test_unknown_age_fits_both_surveys() -> None:
    """Half of Keen's cars above 3 %; a fifth of 1720 at 5 % or more."""
    water = water_of_age(None, "temperate")
    normal = NormalDist()

    assert water.at(normal.inv_cdf(0.5)) == pytest.approx(3.0)
    assert 4.3 < water.at(normal.inv_cdf(0.8)) < 5.3


@given(st.floats(0.0, 40.0), st.sampled_from(sorted(CLIMATES)))
def test_water_grows_with_age_and_humidity(years: float, climate: str) -> None:
    now = water_of_age(years, climate).median_percent
    later = water_of_age(years + 0.5, climate).median_percent

    assert now < later < 12.0
    by_climate = [
        water_of_age(years, name).median_percent
        for name in ("dry", "temperate", "humid")
    ]
    assert all(a < b for a, b in pairwise(by_climate))


def test_a_measurement_ages() -> None:
    """Exact today, higher and less certain after two years."""
    today = water_measured(1.5, 0.05, "temperate")
    later = water_measured(1.5, 0.05, "temperate", since_years=1.0)

    assert today == pytest.approx((1.5, 0.05))
    assert later.median_percent == pytest.approx(2.5)
    assert later.spread > 0.15


@pytest.mark.parametrize(
    ("climate", "by_age", "unknown"),
    [("dry", 1.75, 2.1), ("temperate", 2.5, 3.0), ("humid", 3.5, 4.2)],
)
def test_the_air_s_humidity_scales_the_uptake(
    climate: str, by_age: float, unknown: float
) -> None:
    """0.7 and 1.4 times the 2.5 % after two years; no age, the median."""
    assert water_of_age(2.0, climate) == pytest.approx((by_age, 0.45))
    assert water_of_age(None, climate) == pytest.approx((unknown, 0.55))


@pytest.mark.parametrize(
    ("years", "percent"),
    [(-1.0, 0.2), (0.0, 0.2), (3.0, 3.0), (12.0, 5.0), (32.0, 6.5)],
)
def test_uptake_between_the_points_and_beyond(
    years: float, percent: float
) -> None:
    """Linear between them; beyond 16 years one percent each doubling."""
    assert water_of_age(years, "temperate").median_percent == (
        pytest.approx(percent)
    )


@pytest.mark.parametrize(
    ("climate", "since_years", "percent", "spread"),
    [
        # 3.5 % is 4 years old; 1 % more after four, and 0.5 % in dry air
        ("temperate", 4.0, 4.5, 0.1073),
        # 3.5 % in humid air is 2 years old: 1.4 % more after two
        ("humid", 2.0, 4.9, 0.1334),
        # 3.5 % in dry air is as much as 5 % elsewhere, 12 years old
        ("dry", 4.0, 3.85, 0.0612),
    ],
)
def test_a_measurement_ages_by_climate(
    climate: str, since_years: float, percent: float, spread: float
) -> None:
    """5 % off what was measured and 45 % off what came since."""
    found = water_measured(3.5, 0.05, climate, since_years)

    assert found.median_percent == pytest.approx(percent)
    assert found.spread == pytest.approx(spread, abs=1e-4)


def test_a_measurement_beyond_the_table() -> None:
    """Above 5.5 % as at 16 years; what is measured dry holds a little."""
    wet = water_measured(7.0, 0.05, "temperate", 16.0)

    assert wet.median_percent == pytest.approx(8.0)
    assert water_measured(0.0, 0.05, "dry").median_percent == 0.05
    assert water_measured(0.1, 0.0, "temperate", 1.0) == (
        pytest.approx((1.4, 0.45 * 1.3 / 1.4))
    )


@pytest.mark.parametrize(
    ("years", "percent"), [(0.1, 0.33), (0.5, 0.85), (1.5, 2.0), (6.0, 4.0)]
)
def test_uptake_within_the_first_years(years: float, percent: float) -> None:
    """Linear from the 0.2 % of a fresh fluid on."""
    assert water_of_age(years, "temperate").median_percent == (
        pytest.approx(percent)
    )
