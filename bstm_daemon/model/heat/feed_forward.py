"""Feed-Forward: brake torque from pressure (Eq 4.1, 2.2b, 2.2c)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the build of C needs the standard library alone
    from bstm_daemon.config.sections import CornerConfig


@dataclass(frozen=True, slots=True)
class PressureTorque:
    """Brake torque of one corner as a straight line over pressure.

    Eq 4.1 in the right form: ``T = 2 (p - p0) A n eta mu r_eff``. ``n``
    counts the pistons of one side and the 2 the two friction faces, so a
    floating and a fixed caliper of equal clamp force give equal torque; the
    push-out pressure p0 and the efficiency eta are what the printed equation
    leaves out (p0 = 0 and eta = 1 give it back).
    """

    torque_per_pressure_nm_pa: float
    pushout_pressure_pa: float

    def torque_nm(self, pressure_pa: float) -> float:
        """Brake torque [Nm] at *pressure_pa*; never negative."""
        pushing = max(pressure_pa - self.pushout_pressure_pa, 0.0)
        return self.torque_per_pressure_nm_pa * pushing

    @classmethod
    def of_corner(cls, corner: CornerConfig) -> PressureTorque:
        """Build it from the geometry of *corner*.

        A drum brake has no Eq 4.1: its torque is clamp force times radius
        times the brake factor C* = F_u / F_s (Limpert), both shoes in one.
        """
        clamp_per_pa = (
            corner.piston_area_m2 * corner.piston_count * corner.efficiency
        )
        radius = effective_radius_m(corner)
        if corner.type == "drum":
            per_pa = clamp_per_pa * corner.drum_brake_factor * radius
        else:
            per_pa = 2.0 * clamp_per_pa * corner.friction_coefficient * radius
        return cls(per_pa, corner.pushout_pressure_pa)


def effective_radius_m(corner: CornerConfig) -> float:
    """Radius at which the friction force acts [m].

    The configured value, or from the swept radii: uniform wear (p r
    constant) gives the mean radius, uniform pressure
    ``2/3 (ro^3 - ri^3) / (ro^2 - ri^2)``.
    """
    if corner.effective_radius_m is not None:
        return corner.effective_radius_m
    inner, outer = corner.swept_inner_radius_m, corner.swept_outer_radius_m
    if inner is None or outer is None:  # the configuration guarantees both
        msg = f"corner {corner.name}: no effective and no swept radius"
        raise ValueError(msg)
    if corner.pressure_distribution == "uniform-wear":
        return 0.5 * (inner + outer)
    return 2.0 / 3.0 * (outer**3 - inner**3) / (outer**2 - inner**2)
