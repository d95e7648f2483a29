"""Boiling points of the fluid grades."""

from typing import get_args

import pytest

from bstm_daemon.config.estimates import FluidConfig
from bstm_daemon.errors import ConfigError
from bstm_daemon.model.risk.boiling import BOILING_POINTS, wet_boiling_point_k
from bstm_daemon.units import to_celsius


@pytest.mark.parametrize(
    ("grade", "wet_c"),
    [("DOT3", 140), ("DOT4", 155), ("DOT5.1", 180), ("CLASS6", 165)],
)
def test_wet_boiling_point_is_the_minimum_of_the_standard(
    grade: str, wet_c: float
) -> None:
    """FMVSS 116 S5.1.2 and ISO 4925."""
    assert to_celsius(wet_boiling_point_k(grade)) == pytest.approx(wet_c)


@pytest.mark.parametrize(
    ("grade", "dry_c", "dry_f"),
    [("DOT3", 205, 401), ("DOT4", 230, 446), ("DOT5.1", 260, 500)],
)
def test_dry_boiling_point_is_the_minimum_of_the_standard(
    grade: str, dry_c: float, dry_f: float
) -> None:
    """FMVSS 116 gives both scales, which catches a slip of a digit."""
    dry_k = BOILING_POINTS[grade].dry_k

    assert to_celsius(dry_k) == pytest.approx(dry_c)
    assert to_celsius(dry_k) * 9 / 5 + 32 == pytest.approx(dry_f)


def test_every_grade_of_the_configuration_has_boiling_points() -> None:
    """A grade that passes the configuration never fails later."""
    grades = get_args(FluidConfig.model_fields["grade"].annotation)

    assert set(grades) == set(BOILING_POINTS)


def test_water_lowers_the_boiling_point_of_every_grade() -> None:
    """Each entry also names its source."""
    for points in BOILING_POINTS.values():
        assert points.wet_k < points.dry_k
        assert points.source


def test_an_unknown_grade_is_a_configuration_error() -> None:
    """The message names key, value and the known grades."""
    known = r"DOT3, DOT4, DOT5\.1, CLASS6$"
    with pytest.raises(ConfigError, match=f'grade = "DOT6".* {known}'):
        wet_boiling_point_k("DOT6")
