"""Where a drive's energy came from and where it went.

Every term is integrated from its own physics along the course, none is the
difference of others, so their sum is a test.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.simulation.profile import SAMPLE_S
from bstm_daemon.units import AIR_DENSITY_KG_M3, GRAVITY_MS2

if TYPE_CHECKING:
    from bstm_daemon.simulation.materials import Array
    from bstm_daemon.simulation.simulate import SimulatedDrive


@dataclass(frozen=True, slots=True)
class EnergyLedger:
    """Energies of a whole drive [J].

    In: ``potential`` (height lost), ``kinetic`` (speed lost), ``push`` and
    ``engine``. Out: ``brakes``, ``resistance``, ``engine_drag``,
    ``regeneration`` and ``tyres`` (slip of braked wheels).
    """

    potential: float
    kinetic: float
    push: float
    engine: float
    brakes: float
    resistance: float
    engine_drag: float
    regeneration: float
    tyres: float

    @property
    def residual(self) -> float:
        """In less out over the larger of the turnover's terms."""
        into = self.potential + self.kinetic + self.push + self.engine
        out = (
            self.brakes
            + self.resistance
            + self.engine_drag
            + self.regeneration
            + self.tyres
        )
        largest = max(abs(getattr(self, f.name)) for f in fields(self))
        return (into - out) / max(float(largest), 1.0)


def energy_ledger(driven: SimulatedDrive) -> EnergyLedger:
    """Return the energies of *driven*."""
    course, motion, car = driven.course, driven.motion, driven.car
    v, slope = course.speed_ms, course.slope_rad
    weight_n = car.mass_kg * GRAVITY_MS2

    def total(power_w: Array) -> float:
        return SAMPLE_S * float(power_w.sum())

    air = 0.5 * AIR_DENSITY_KG_M3 * car.drag_area_m2 * v**3
    air += car.wind(v, course.headwind_ms) * v
    rolling = weight_n * car.rolling_resistance * np.cos(slope) * v
    wheel_w = motion.powertrain_torque_nm / car.wheel_radius_m * v
    force_w = motion.corner_force_n * v[:, None]
    return EnergyLedger(
        potential=-total(weight_n * np.sin(slope) * v),
        kinetic=0.5 * car.effective_mass_kg * float(v[0] ** 2 - v[-1] ** 2),
        push=total(motion.external_force_n * v),
        # a spinning wheel's brake is heated by the engine
        engine=total(np.maximum(wheel_w, 0.0))
        + total((force_w * np.maximum(-motion.slip, 0.0)).sum(axis=1)),
        brakes=total(driven.brake_power_w.sum(axis=1)),
        resistance=total(air + rolling + car.friction_ns_m * v**2),
        engine_drag=-total(np.minimum(wheel_w, 0.0)),
        regeneration=-total(motion.motor_torque_nm / car.wheel_radius_m * v),
        tyres=total((force_w * np.maximum(motion.slip, 0.0)).sum(axis=1)),
    )
