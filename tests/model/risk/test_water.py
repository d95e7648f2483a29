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
