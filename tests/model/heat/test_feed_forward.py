"""Feed-Forward: pressure to torque (Eq 4.1)."""

from collections.abc import Callable
from math import pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.config.sections import CornerConfig
from bstm_daemon.model.heat.feed_forward import (
    PressureTorque,
    effective_radius_m,
)

MakeCorner = Callable[..., CornerConfig]


@given(st.floats(0.0, 2e7))
def test_floating_and_fixed_caliper_of_equal_clamp(
    make_corner: MakeCorner, pressure_pa: float
) -> None:
    """One 60 mm piston that floats, or two a side of half its area."""
    floating = make_corner(piston_area_m2=2.83e-3, piston_count=1)
    fixed = make_corner(
        caliper="fixed", piston_area_m2=1.415e-3, piston_count=2
    )
    one = PressureTorque.of_corner(floating).torque_nm(pressure_pa)
    two = PressureTorque.of_corner(fixed).torque_nm(pressure_pa)
    assert one == pytest.approx(two)
    assert one == pytest.approx(2.0 * pressure_pa * 2.83e-3 * 0.38 * 0.13)


def test_pushout_and_efficiency(make_corner: MakeCorner) -> None:
    """Nothing up to p0, then eta of the rest; never negative."""
    corner = make_corner(pushout_pressure_pa=1e5, efficiency=0.96)
    torque = PressureTorque.of_corner(corner)
    assert torque.torque_nm(0.0) == torque.torque_nm(1e5) == 0.0
    expected = 2.0 * 0.9e6 * 2.83e-3 * 0.96 * 0.38 * 0.13
    assert torque.torque_nm(1e6) == pytest.approx(expected)


def test_drum(make_corner: MakeCorner) -> None:
    """Clamp force times radius times C*, whatever the friction is."""
    drum = make_corner(
        "RL",
        type="drum",
        disc=None,
        pad=None,
        piston_area_m2=3e-4,
        effective_radius_m=0.115,
        drum_brake_factor=2.3,
        friction_coefficient=0.9,
    )
    torque = PressureTorque.of_corner(drum).torque_nm(5e6)
    assert torque == pytest.approx(5e6 * 3e-4 * 2.3 * 0.115)


def test_pressure_per_brake_force(make_corner: MakeCorner) -> None:
    """60 mm front and 42 mm rear, R 0.342 m: about 410 Pa per N."""
    per_pa = sum(
        PressureTorque.of_corner(
            make_corner(name, piston_area_m2=pi / 4.0 * diameter**2)
        ).torque_per_pressure_nm_pa
        for name, diameter in (
            *(("FL", 0.060), ("FR", 0.060)),
            *(("RL", 0.042), ("RR", 0.042)),
        )
    )
    assert 0.342 / per_pa == pytest.approx(410.0, rel=0.03)


def test_effective_radius(make_corner: MakeCorner) -> None:
    """Given, uniform wear, and uniform pressure from rings summed up."""
    assert effective_radius_m(make_corner()) == 0.13
    swept = {
        "effective_radius_m": None,
        "swept_inner_radius_m": 0.09,
        "swept_outer_radius_m": 0.165,
    }
    wear = make_corner(**swept)
    assert effective_radius_m(wear) == pytest.approx(0.1275)
    pressed = make_corner(**swept, pressure_distribution="uniform-pressure")
    rings = [0.09 + (i + 0.5) * 0.075 / 3000 for i in range(3000)]
    mean = sum(r * r for r in rings) / sum(rings)
    assert effective_radius_m(pressed) == pytest.approx(mean, rel=1e-6)
    assert effective_radius_m(pressed) > effective_radius_m(wear)
