"""Fault detection on the inputs of the vehicle observer.

The pure-Python form of ``native/heat/observer_faults.c``. The faults are
reported and stop the learning: a wrong scale of the accelerometer, a wheel
radius that contradicts the speed over ground, an external force.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isnan, sqrt
from typing import TYPE_CHECKING, Annotated

from bstm_daemon.model.heat import observer_rules as rules
from bstm_daemon.model.heat.learned import MASS, STATES
from bstm_daemon.model.heat.memory import PER_GROUND_SPEED

if TYPE_CHECKING:
    from bstm_daemon.model.heat.memory import ObserverMemory


@dataclass(slots=True)
class Step:
    """Mean inputs of one step; nan if unknown.

    ``accel`` is the accelerometer; ``drive`` the driving force and ``drag``
    that of air and bearings, both over the configured mass [m/s2];
    ``brake_n`` Feed-Forward's force, ``light_n`` that of a foot that rests on
    the pedal. ``steady``: no intervention, no slip, no suspect input.
    ``wrong_scale``: the checks found speed and accelerometer to differ by a
    factor.
    """

    dt_s: float
    speed: float
    end_speed: float
    accel: float
    drive: float
    drag: float
    brake_n: float
    light_n: float
    pressure_pa: float
    brake_switch: float
    lateral: float
    gear: float
    clutch: float
    height: float
    ground_speeds: Annotated[list[float], PER_GROUND_SPEED]
    steady: bool
    forward: bool
    pressed: bool
    pressure_known: bool
    wheel_pressures: bool
    torque_known: bool
    on_stand: bool
    wrong_scale: bool


def findings(m: ObserverMemory, s: Step) -> int:
    """Return the bits of the faults found."""
    found = 0
    if m.external_held_s > 0.0:
        found |= rules.EXTERNAL_SUSPECTED
    if implausible_gain(m) or s.wrong_scale:
        found |= rules.GAIN_SUSPECT
    if implausible_radius(m):
        found |= rules.RADIUS_SUSPECT
    if m.unpressed_s > rules.DEAD_S:
        found |= rules.PRESSURE_DEAD
    longest_s = max(m.outlier_s, m.held_back_s)
    if unbalanced(m) or implausible_mass(m) or longest_s > rules.OUTLIER_S:
        found |= rules.FORCES_CONTRADICT
    if m.proof_s > 0.0:
        found |= rules.FORCES_UNPROVEN
    return found


def implausible_gain(m: ObserverMemory) -> bool:
    """Whether the accelerometer scales changes of speed wrongly."""
    square, product = m.gain_square, m.gain_product
    return square > rules.GAIN_SQUARE_LEAST and (
        product < rules.GAIN_LOW * square or product > rules.GAIN_HIGH * square
    )


def motion_unmeasured(m: ObserverMemory) -> bool:
    """Whether it does not measure them at all: wheels on a test stand."""
    square = m.gain_square
    return (
        square > rules.GAIN_SQUARE_LEAST
        and m.gain_product < rules.UNMEASURED * square
    )


def implausible_radius(m: ObserverMemory) -> bool:
    """Whether the wheels disagree with a speed over ground."""
    return any(
        abs(ratio - 1.0) > rules.RADIUS_LIMIT for ratio in m.radius_ratio
    )


def compare_forces(m: ObserverMemory, x: float, y: float, std: float) -> None:
    """Add the braking of a window by pressure *x* and by motion *y* [m/s2].

    *std* is what the learned states leave open of *y*.
    """
    keep = 1.0 - 1.0 / rules.BALANCE_WINDOWS
    m.balance_count = keep * m.balance_count + 1.0
    m.balance_x = keep * m.balance_x + x
    m.balance_y = keep * m.balance_y + y
    m.balance_xx = keep * m.balance_xx + x * x
    m.balance_xy = keep * m.balance_xy + x * y
    m.balance_yy = keep * m.balance_yy + y * y
    m.balance_std = keep * m.balance_std + std


def is_outlier(m: ObserverMemory, innovation: float, std: float) -> bool:
    """Whether ln friction is not to be learned; count what contradicts."""
    if abs(innovation) <= rules.OUTLIER * std:
        m.outlier_s = max(m.outlier_s - rules.WINDOW_S, 0.0)
        return False
    if innovation > rules.OUTLIER_MORE or innovation < -rules.OUTLIER_LESS:
        longer_s = m.outlier_s + rules.WINDOW_S
        m.outlier_s = min(longer_s, rules.OUTLIER_MOST_S)
    return True


def count_drive(
    m: ObserverMemory, innovation: float, std: float, drive: float
) -> None:
    """Count windows in which *drive* [m/s2] moves the car too little."""
    if drive < rules.IDLE_DRIVE_MS2:
        return
    if abs(innovation) <= rules.OUTLIER * std:
        m.held_back_s = max(m.held_back_s - rules.WINDOW_S, 0.0)
    elif innovation < -rules.HELD_BACK * drive:
        longer_s = m.held_back_s + rules.WINDOW_S
        m.held_back_s = min(longer_s, rules.OUTLIER_MOST_S)


def unbalanced(m: ObserverMemory) -> bool:
    """Whether braking by motion and by pressure differ by a constant."""
    n = m.balance_count
    if n < rules.BALANCE_LEAST:
        return False
    mean_x, mean_y = m.balance_x / n, m.balance_y / n
    var_x = m.balance_xx / n - mean_x * mean_x
    if var_x < rules.BALANCE_SPREAD_MS2 * rules.BALANCE_SPREAD_MS2:
        return False
    cov = m.balance_xy / n - mean_x * mean_y
    slope = cov / var_x
    at_0 = mean_y - slope * mean_x
    rest = m.balance_yy / n - mean_y * mean_y - slope * cov
    var_0 = max(rest, 0.0) * (1.0 + mean_x * mean_x / var_x) / n
    # the windows scatter, and share the error of the learned states
    std = m.balance_std / n
    var_0 = rules.CORRELATED_WINDOWS * var_0 + std * std
    margin = rules.BALANCE_STDS * sqrt(var_0)
    less = max(rules.BALANCE_MS2, rules.BALANCE_SHARE * mean_x)
    more = max(rules.BALANCE_MORE_MS2, rules.BALANCE_MORE_SHARE * mean_x)
    if slope < rules.BALANCE_STEEP and at_0 + margin < -less:
        return True
    return slope > rules.BALANCE_MORE_FLAT and at_0 - margin > more


def implausible_mass(m: ObserverMemory) -> bool:
    """Whether less mass was learned than the car has."""
    ratio, cov = m.known.x[MASS], m.known.cov[MASS * STATES + MASS]
    return m.started != 0.0 and (
        ratio - rules.MASS_STDS * sqrt(cov) > 1.0 / rules.LEAST_MASS
    )


def compare_radius(m: ObserverMemory, s: Step) -> None:
    """Filter the ratio of wheel speed to each speed over ground."""
    if not s.steady or abs(m.rate) > rules.RADIUS_RATE_MS2:
        return
    share = 1.0 - exp(-s.dt_s / rules.RADIUS_S)
    for i, ground_ms in enumerate(s.ground_speeds):
        if not isnan(ground_ms) and ground_ms >= rules.REFERENCE_SPEED_MS:
            ratio = m.radius_ratio[i]
            m.radius_ratio[i] += share * (s.speed / ground_ms - ratio)
