"""What counts against the observer's inputs, as its memory shows it.

The pure-Python form of ``native/heat/observer_faults.c``. Each is reported
and nothing is learned from it: an accelerometer of a wrong scale, a wheel
radius that no speed over ground confirms, a force from outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isnan
from typing import TYPE_CHECKING, Annotated

from bstm_daemon.model.heat import observer_rules as rules
from bstm_daemon.model.heat.memory import PER_GROUND_SPEED

if TYPE_CHECKING:
    from bstm_daemon.model.heat.memory import ObserverMemory


@dataclass(slots=True)
class Step:
    """What a step was: means over it, nan where not known.

    ``accel`` is what the accelerometer measures, ``drive`` what drives the
    car and ``drag`` what the air and the bearings take, both over the
    configured mass [m/s2]; ``brake_n`` Feed-Forward's force. ``steady``: no
    intervention, no slip, nothing suspect.
    """

    dt_s: float
    speed: float
    end_speed: float
    accel: float
    drive: float
    drag: float
    brake_n: float
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


def findings(m: ObserverMemory) -> int:
    """Return the bits of what counts against the inputs."""
    found = 0
    if m.external_held_s > 0.0:
        found |= rules.EXTERNAL_SUSPECTED
    if implausible_gain(m):
        found |= rules.GAIN_SUSPECT
    if implausible_radius(m):
        found |= rules.RADIUS_SUSPECT
    if m.unpressed_s > rules.DEAD_S:
        found |= rules.PRESSURE_DEAD
    return found


def implausible_gain(m: ObserverMemory) -> bool:
    """Whether the accelerometer shows changes of speed wrongly scaled."""
    square, product = m.gain_square, m.gain_product
    return square > rules.GAIN_SQUARE_LEAST and (
        product < rules.GAIN_LOW * square or product > rules.GAIN_HIGH * square
    )


def motion_unmeasured(m: ObserverMemory) -> bool:
    """Whether it does not show them at all: wheels on a stand."""
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


def compare_radius(m: ObserverMemory, s: Step) -> None:
    """Follow the wheels' speed over each of those over ground."""
    if not s.steady:
        return
    share = 1.0 - exp(-s.dt_s / rules.RADIUS_S)
    for i, ground_ms in enumerate(s.ground_speeds):
        if not isnan(ground_ms) and ground_ms >= rules.REFERENCE_SPEED_MS:
            ratio = m.radius_ratio[i]
            m.radius_ratio[i] += share * (s.speed / ground_ms - ratio)
