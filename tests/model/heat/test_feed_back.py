"""Feed-Back: brake force from the motion of the thesis's car."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bstm_daemon.config.sections import VehicleConfig
from bstm_daemon.model.heat.feed_back import Vehicle

FULL_SPEED_MS = 100.0 / 3.6
OMEGA_RAD_S = 250.4 / 3.0809  # J w as printed with Eq 4.6

CAR = Vehicle.of_config(
    VehicleConfig(
        id="thesis",
        mass_kg=2194.0,
        wheel_radius_m=FULL_SPEED_MS / OMEGA_RAD_S,
        wheel_inertia_kg_m2=3.0809,
        rolling_resistance=0.014,
        friction_ns_m=4.0,
        drag_area_m2=0.75,
    )
)


def coast_down(dt_s: float) -> tuple[float, float]:
    """Return the work of the drag [J] and the distance [m] to rest."""

    def slowing(speed: float) -> float:
        return CAR.resistance_n(speed) / CAR.effective_mass_kg

    speed, work, distance = FULL_SPEED_MS, 0.0, 0.0
    while speed > 0.0:
        half = max(speed - 0.5 * dt_s * slowing(speed), 0.0)
        after = max(speed - dt_s * slowing(half), 0.0)
        work += CAR.resistance_n(half) * half * dt_s
        distance += half * dt_s
        speed = after
    return work, distance


def test_coast_down_ends_all_kinetic_energy_in_drag() -> None:
    """Eq 4.6 in the right form; the printed one misses by 1.16 %."""
    work, distance = coast_down(0.005)
    right = 0.5 * 2194.0 * FULL_SPEED_MS**2 + 0.5 * 3.0809 * OMEGA_RAD_S**2
    printed = 0.5 * 2194.0 * FULL_SPEED_MS**2 + 3.0809 * OMEGA_RAD_S
    assert right == pytest.approx(856_625.0, abs=2.0)
    assert printed == pytest.approx(846_701.0, abs=2.0)
    assert work == pytest.approx(right, rel=1e-4)
    assert CAR.kinetic_energy_j(FULL_SPEED_MS) == pytest.approx(right)
    assert 1.0 - printed / work == pytest.approx(0.0116, abs=1e-4)
    assert 500.0 < distance < 3000.0


def test_resistance_terms() -> None:
    """Eq 4.2 term by term at 36 km/h, and nothing at rest."""
    expected = (
        0.5 * 0.75 * 1.2041 * 100.0 + 4.0 * 10.0 + 2194.0 * 9.80665 * 0.014
    )
    assert CAR.resistance_n(10.0) == pytest.approx(expected)
    assert CAR.resistance_n(0.0) == 0.0


@given(
    speed=st.floats(0.5, 50.0),
    rate=st.floats(-8.0, 3.0),
    slope=st.floats(-3000.0, 3000.0),
    torque=st.floats(0.0, 3000.0),
    brake=st.floats(0.0, 15e3),
)
def test_brake_force_closes_newton_s_law(
    speed: float, rate: float, slope: float, torque: float, brake: float
) -> None:
    """The external force that makes the motion possible gives it back."""
    external = (
        CAR.effective_mass_kg * rate
        + brake
        + CAR.resistance_n(speed)
        + slope
        - torque / CAR.wheel_radius_m
    )
    found = CAR.brake_force_n(speed, rate, slope, torque, external)
    assert found == pytest.approx(brake, abs=1e-6)


def test_pushed_at_constant_speed() -> None:
    """Eq 4.7, flat and at a = 0: push force less resistance."""
    force = CAR.brake_force_n(10.0, 0.0, 0.0, 0.0, 2000.0)
    assert force == pytest.approx(2000.0 - CAR.resistance_n(10.0))


def test_held_on_a_descent() -> None:
    """8 % downhill at 36 km/h: 1.34 kN with 387 N of resistance."""
    slope = -2194.0 * 9.80665 * 0.08
    force = CAR.brake_force_n(10.0, 0.0, slope, 0.0)
    assert force == pytest.approx(1340.0, rel=0.02)


def test_rotating_mass() -> None:
    """J / R^2 is the 26 kg of physics: 1.2 % of the car."""
    assert CAR.rotating_mass_kg == pytest.approx(26.4, abs=0.1)
    assert CAR.effective_mass_kg == CAR.mass_kg + CAR.rotating_mass_kg
