"""Heat partition (Eq 2.3, 2.4) and the flux into a pad (Eq 4.13)."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.model.thermal.partition import (
    disc_share,
    effusivity,
    flux_ratio_at_radius,
    pad_flux_w_m2,
    pad_share,
)

DISC = effusivity(50.0, 7200.0, 460.0)
PAD = effusivity(1.2, 2300.0, 1000.0)


@pytest.mark.parametrize(
    ("area_ratio", "percent"), [(1.0, 88.6), (6.0, 97.9), (10.0, 98.7)]
)
def test_share_of_the_disc(area_ratio: float, percent: float) -> None:
    """Cast iron on a lining: hand figures for three area ratios."""
    share = disc_share(DISC, area_ratio * 0.013, PAD, 0.013)
    assert 100.0 * share == pytest.approx(percent, abs=0.05)


@given(st.floats(0.5, 0.999), st.floats(0.0, 1.0))
def test_disc_takes_what_the_pads_leave(sigma: float, part: float) -> None:
    """The factor scales 1 - sigma, never beyond all of the heat."""
    factor = part / (1.0 - sigma)
    share = pad_share(sigma, factor)
    assert share == pytest.approx(part)


def test_more_heat_than_there_is_is_refused() -> None:
    """The message tells the largest factor."""
    with pytest.raises(ValueError, match=r"at most 10\.0"):
        pad_share(0.9, 11.0)


@given(
    st.floats(1e5, 1e7),
    st.floats(0.1, 100.0),
    st.integers(1, 4),
    st.floats(0.1, 0.6),
    st.floats(0.01, 0.2),
)
def test_two_pads_take_their_share_of_the_brake_power(
    pressure_pa: float, omega: float, n: int, mu: float, share: float
) -> None:
    """Flux times both areas is the pads' share of T * omega."""
    radius, piston, area, efficiency = 0.13, 2.8e-3, 6.5e-3, 0.96
    torque = 2.0 * pressure_pa * piston * n * efficiency * mu * radius
    flux = pad_flux_w_m2(
        pressure_pa, omega * radius, piston, n, mu, area, share, efficiency
    )
    assert 2.0 * area * flux == pytest.approx(share * torque * omega)


def test_flux_over_the_radius() -> None:
    """Uniform wear is flat; uniform pressure has the area mean 1."""
    inner, outer, rings = 0.09, 0.165, 2000
    assert flux_ratio_at_radius(0.1, inner, outer, "uniform-wear") == 1.0
    total = area = 0.0
    for i in range(rings):
        radius = inner + (i + 0.5) * (outer - inner) / rings
        ratio = flux_ratio_at_radius(radius, inner, outer, "uniform-pressure")
        total += ratio * radius
        area += radius
    assert total / area == pytest.approx(1.0, abs=1e-6)
    edge = flux_ratio_at_radius(outer, inner, outer, "uniform-pressure")
    bore = flux_ratio_at_radius(inner, inner, outer, "uniform-pressure")
    assert edge / bore == pytest.approx(outer / inner)
