"""Feed-Back: brake force from the vehicle's own motion (Eq 4.2 to 4.11)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from bstm_daemon.units import AIR_DENSITY_KG_M3, GRAVITY_MS2

if TYPE_CHECKING:  # the build of C needs the standard library alone
    from bstm_daemon.config.sections import VehicleConfig


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Masses and resistances of the car for Feed-Back.

    ``quadratic``, ``linear`` and ``constant`` are the terms of Eq 4.2,
    ``F_drag = 1/2 Cd A rho v^2 + C_fric v + m g f_r`` [N s2/m2, N s/m, N].
    """

    mass_kg: float
    wheel_inertia_kg_m2: float
    wheel_radius_m: float
    quadratic: float
    linear: float
    constant: float

    @classmethod
    def of_config(cls, vehicle: VehicleConfig) -> Vehicle:
        """Take the values of ``[vehicle]``."""
        return cls(
            mass_kg=vehicle.mass_kg,
            wheel_inertia_kg_m2=vehicle.wheel_inertia_kg_m2,
            wheel_radius_m=vehicle.wheel_radius_m,
            quadratic=0.5 * AIR_DENSITY_KG_M3 * vehicle.drag_area_m2,
            linear=vehicle.friction_ns_m,
            constant=(
                vehicle.mass_kg * GRAVITY_MS2 * vehicle.rolling_resistance
            ),
        )

    @property
    def rotating_mass_kg(self) -> float:
        """Wheel inertia as a mass at the wheel's rim, J / R^2."""
        return self.wheel_inertia_kg_m2 / self.wheel_radius_m**2

    @property
    def effective_mass_kg(self) -> float:
        """M + J / R^2, the inertia against a change of speed."""
        return self.mass_kg + self.rotating_mass_kg

    def resistance_n(self, speed_ms: float) -> float:
        """Eq 4.2 at *speed_ms* >= 0; at rest nothing rolls and it is 0."""
        if speed_ms <= 0.0:
            return 0.0
        return (
            self.quadratic * speed_ms + self.linear
        ) * speed_ms + self.constant

    def kinetic_energy_j(self, speed_ms: float) -> float:
        """Eq 4.6 in the right form, 1/2 m v^2 + 1/2 J w^2.

        The thesis prints and used ``1/2 m v^2 + J w``.
        """
        return 0.5 * self.effective_mass_kg * speed_ms**2

    def brake_force_n(
        self,
        speed_ms: float,
        speed_rate_ms2: float,
        slope_force_n: float,
        powertrain_torque_nm: float,
        external_force_n: float = 0.0,
    ) -> float:
        """Eq 4.11 with the external force of Eq 4.7, in the right form.

        ``F_b = T_pt / R + F_ext - F_drag - m g sin(theta) - m_eff dv/dt``;
        *slope_force_n* is m g sin(theta), positive uphill. An accelerometer
        reads dv/dt + g sin(theta), so it gives both terms of m at once and
        no grade is needed.
        """
        return (
            powertrain_torque_nm / self.wheel_radius_m
            + external_force_n
            - self.resistance_n(speed_ms)
            - slope_force_n
            - self.effective_mass_kg * speed_rate_ms2
        )
