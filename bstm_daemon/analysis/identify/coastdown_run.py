"""One coast-down against theory: v(t) of Fig 4.4, energies of Eq 4.5."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from bstm_daemon.analysis.quality.limits import GRID_S
from bstm_daemon.units import GRAVITY_MS2

if TYPE_CHECKING:
    from bstm_daemon.analysis.identify.coasting import Stretch
    from bstm_daemon.analysis.statistics.series import Column
    from bstm_daemon.model.heat.feed_back import Vehicle


@dataclass(frozen=True, slots=True)
class Run:
    """One coast-down: measured and in theory.

    ``time_s`` since its start, ``speed_ms``, ``theory_ms`` with the values
    found, ``configured_ms`` with those of the configuration, (n,).
    ``grade`` is its mean, uphill positive. Energies [J] of Eq 4.5: what the
    car lost of its kinetic energy, the work of the resistances, of the climb
    and of the drive line; ``miss`` is what is left over as a share of the
    first.
    """

    stretch: Stretch
    direction: int
    grade: float
    time_s: Column
    speed_ms: Column
    theory_ms: Column
    configured_ms: Column
    kinetic_j: float
    resistance_j: float
    climb_j: float
    drive_j: float

    @property
    def miss(self) -> float:
        """What Eq 4.5 leaves over, as a share of the kinetic energy."""
        left_j = self.kinetic_j - self.resistance_j - self.climb_j
        return (left_j + self.drive_j) / self.kinetic_j

    @property
    def residual_rms_ms(self) -> float:
        """Root mean square of theory less measurement."""
        return float(np.sqrt(np.mean((self.theory_ms - self.speed_ms) ** 2)))


def run_of(
    stretch: Stretch,
    direction: int,
    grade: float,
    car: Vehicle,
    *,
    bias_ms2: float | None,
) -> Run:
    """Return the run of *car*, which has the values found, on *stretch*.

    *grade* is its mean; *bias_ms2* the accelerometer's, None where the grade
    is even and no accelerometer is used.
    """
    driving, part = stretch.driving, stretch.points
    time_s = driving.time_s[part] - stretch.start_s
    speed = driving.speed_ms[part]
    traction = driving.traction_n[part]
    slope_ms2 = np.full(len(time_s), GRAVITY_MS2 * grade)
    if bias_ms2 is not None:
        apart = driving.slope_ms2[part] - bias_ms2
        # three numbers a run: more would hand the measurement to the theory
        x = time_s / max(float(time_s[-1]), GRID_S)
        slope_ms2 = np.polynomial.Polynomial.fit(x, apart, 2)(x)
    resistance = (car.quadratic * speed + car.linear) * speed + car.constant
    return Run(
        stretch,
        direction,
        grade,
        time_s,
        speed,
        theory(car, speed, traction, slope_ms2),
        theory(driving.vehicle, speed, traction, slope_ms2),
        car.kinetic_energy_j(float(speed[0]))
        - car.kinetic_energy_j(float(speed[-1])),
        work_j(resistance, speed),
        work_j(car.mass_kg * slope_ms2, speed),
        work_j(traction, speed),
    )


def theory(
    car: Vehicle, speed_ms: Column, traction_n: Column, slope_ms2: Column
) -> Column:
    """Return v(t) of *car* coasting from the first of *speed_ms*, (n,).

    *traction_n* drives it, *slope_ms2* is g sin(grade), both (n,) on the grid.
    """
    result = np.empty(len(speed_ms))
    v = float(speed_ms[0])
    tractions, slopes = traction_n.tolist(), slope_ms2.tolist()
    for i in range(len(result)):
        result[i] = v
        outer = tractions[i] - car.mass_kg * slopes[i]

        def rate(at: float, outer_n: float = outer) -> float:
            return (outer_n - car.resistance_n(at)) / car.effective_mass_kg

        middle = v + 0.5 * GRID_S * rate(v)
        v = max(v + GRID_S * rate(middle), 0.0)
    return result


def work_j(force_n: Column, speed_ms: Column) -> float:
    """Return the integral of force times speed over the grid (Eq 4.3)."""
    power = np.nan_to_num(force_n * speed_ms)
    return float((power[1:] + power[:-1]).sum()) * 0.5 * GRID_S
