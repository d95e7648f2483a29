"""Coast-downs: stretches in which nothing drives or brakes the car.

Each is compared with theory: v(t) of Fig 4.4, energies of Eq 4.5.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.identify.driving import (
    CONTROL,
    Balance,
    Driving,
    Span,
    balance_of,
    flagged,
)
from bstm_daemon.analysis.quality.limits import GRID_S
from bstm_daemon.analysis.statistics.series import Column, Mask, runs
from bstm_daemon.model.heat.feed_back import Vehicle
from bstm_daemon.units import GRAVITY_MS2

LOWEST_MS: Final = 2.5
"""Lowest speed: below it wheel sensors with few teeth are not reliable."""

SHORTEST_S: Final = 15.0
LEAST_FALL_MS: Final = 4.0
"""Least time and loss of speed of a stretch, to exceed the noise."""

SETTLING_S: Final = 1.5
"""Time left out at both ends, while drive line, body and filters settle."""

DRIVEN_MS2: Final = 0.05
"""Torque at the wheels over the mass up to which the car counts as coasting if
no gear or clutch signal shows it; it is known and taken into account."""

CORNERING_MS2: Final = 0.5
"""Largest lateral acceleration, as cornering tyres brake the car."""


@dataclass(frozen=True, slots=True)
class Stretch(Span):
    """Grid points of a coast-down."""

    driving: Driving

    @property
    def start_s(self) -> float:
        """Time of the first point since the start of the log."""
        return float(self.driving.time_s[self.first])

    @property
    def duration_s(self) -> float:
        """Time from the first to the last point."""
        return float(self.driving.time_s[self.last]) - self.start_s


def coasting(driving: Driving) -> tuple[list[Stretch], str]:
    """Return the coast-downs of *driving*, and what was searched in words.

    The text says how much of the log each condition leaves, so that a log
    without a coast-down says why.
    """
    steps = _conditions(driving)
    left = np.ones(len(driving.time_s), bool)
    words = []
    for name, mask in steps:
        left = left & mask
        words.append(f"{name} {np.count_nonzero(left) * GRID_S:.0f} s")
    found = []
    trim = round(SETTLING_S / GRID_S)
    for first, last in runs(left):
        begin, end = first + trim, last - trim
        if (end - begin) * GRID_S < SHORTEST_S:
            continue
        speed = driving.speed_ms[begin : end + 1]
        if float(speed[0] - speed[-1]) < LEAST_FALL_MS:
            continue
        found.append(Stretch(begin, end, driving))
    words.append(
        f"in {len(found)} pieces of {SHORTEST_S:g} s or more that lose "
        f"{LEAST_FALL_MS * 3.6:.0f} km/h or more"
    )
    return found, ", ".join(words)


def _conditions(driving: Driving) -> list[tuple[str, Mask]]:
    """Return what a coast-down has to fulfil, in words and where it does."""
    channels, speed = driving.channels, driving.speed_ms
    moving = (speed > LOWEST_MS) & np.isfinite(driving.rate_ms2)
    released = driving.released()
    released &= ~flagged(channels, (*CONTROL, "park_brake"))
    name = "brakes released"
    if not driving.brake_known:
        name = "brakes known to be released (no pressure, no brake_switch)"
    steps = [
        (f"above {LOWEST_MS * 3.6:.0f} km/h", moving),
        (name, released),
        ("drive line open or without torque", _undriven(driving)),
    ]
    if channels.alive(["yaw_rate"]):
        bend = np.abs(driving.value("yaw_rate") * speed) > CORNERING_MS2
        steps.append(("no bend", ~bend))
    if driving.has_accelerometer:
        known = np.isfinite(driving.accel_measured_ms2)
        steps.append(("accelerometer there", known))
    return steps


def _undriven(driving: Driving) -> Mask:
    mass_kg = driving.vehicle.mass_kg
    radius_m = driving.vehicle.wheel_radius_m
    limit_nm = DRIVEN_MS2 * mass_kg * radius_m
    undriven = np.abs(driving.torque_nm) < limit_nm
    if driving.channels.alive(["motor_torque"]):
        undriven &= ~(np.abs(driving.value("motor_torque")) > limit_nm)
    undriven &= np.abs(driving.external_n) < DRIVEN_MS2 * mass_kg
    return np.asarray(undriven)


@dataclass(frozen=True, slots=True)
class Run:
    """One coast-down: measured and in theory.

    ``time_s`` since its start, ``speed_ms``, ``theory_ms`` with the values
    found, ``configured_ms`` with those of the configuration, (n,).
    ``grade`` is its mean, uphill positive.
    """

    stretch: Stretch
    direction: int
    grade: float
    time_s: Column
    speed_ms: Column
    theory_ms: Column
    configured_ms: Column
    balance: Balance

    @property
    def miss(self) -> float:
        """What Eq 4.5 leaves over, as a share of the kinetic energy."""
        return self.balance.brake_j / self.balance.kinetic_j

    @property
    def residual_rms_ms(self) -> float:
        """Root mean square of theory minus measurement."""
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
        grade_ms2 = driving.slope_ms2[part] - bias_ms2
        # three numbers a run: more would hand the measurement to the theory
        x = time_s / max(float(time_s[-1]), GRID_S)
        slope_ms2 = np.polynomial.Polynomial.fit(x, grade_ms2, 2)(x)
    return Run(
        stretch,
        direction,
        grade,
        time_s,
        speed,
        theory(car, speed, traction, slope_ms2),
        theory(driving.vehicle, speed, traction, slope_ms2),
        balance_of(car, speed, slope_ms2, traction),
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
