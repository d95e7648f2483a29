"""What the observer of the car remembers, in which order.

Accelerations and forces over the configured mass are in m/s2, so that the
states have the size of 1. ``_observer.h`` has the same order.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isclose, isfinite, sqrt
from typing import TYPE_CHECKING, Final

from bstm_daemon.heat.check_layout import UNKNOWN
from bstm_daemon.heat.observer_rules import (
    HIGH,
    LOW,
    ROLLING_SD,
    SD,
    STOOD_S,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

MOTION: Final = ("mass_ratio", "bias", "drag_ratio", "gain")
"""Configured mass over the mass; bias of the accelerometer less g f_r
[m/s2]; drag over that of the configuration, times ``mass_ratio``; what is
felt of a change of speed beyond it (body pitch, scale)."""

FRICTION: Final = ("level", "speed", "pressure", "drift")
"""ln of friction over Feed-Forward's: at 10 m/s and 10 bar; exponents of
speed and of pressure; what passes within minutes (temperature, bedding)."""

STATES: Final = len(MOTION) + len(FRICTION)

LEARNED_NAMES: Final = (
    *(MOTION + FRICTION),
    *(f"{a}_{b}" for a in MOTION + FRICTION for b in MOTION + FRICTION),
    "rolling",
    "rolling_variance",
)
"""States and covariances; ``rolling`` is the error of the configured g f_r
[m/s2], which only the height of the road tells."""

STEP_SUMS: Final = ("sum_time", "sum_felt", "sum_push", "sum_drag")
"""Of the open step."""

OBSERVER_NUMBERS: Final = (
    *(f"learned_{name}" for name in LEARNED_NAMES),
    *(f"recent_{name}" for name in LEARNED_NAMES),
    *(f"earlier_{name}" for name in LEARNED_NAMES),
    *(f"first_{name}" for name in LEARNED_NAMES),
    *("copy_age", "started", "resets"),
    *("last_rolled", "rate", "felt", "slow_rate", "slow_felt", "gain_time"),
    "rough",
    *("calm_s", "released_s", "pressed_s", "last_gear", "last_clutch"),
    *("external_s", "external_held_s", "alike", "changed", "radius_ratio"),
    *("unpressed_s", "stood_s"),
    *("window_kind", "window_time", "window_felt", "window_push"),
    *("window_drag", "window_brake", "window_pressure", "window_speed"),
    "window_first_speed",
    *("sine", "height_last", "height_work", "height_path"),
    *("tare_primary", "tare_secondary"),
    *("slow_braking", "slow_brake", "silent_s", "silent_energy"),
    *STEP_SUMS,
)
"""The numbers of the state after those of the checks; then per corner
``brake_sum`` [N s], the force by pressure of the open step."""


@dataclass(slots=True)
class Step:
    """What a step was: means over it, nan where not known.

    ``felt`` the acceleration, ``push`` what drives the car and ``drag`` what
    the air and the bearings take, both over the configured mass [m/s2];
    ``brake_n`` Feed-Forward's force. ``steady``: no intervention, no slip,
    nothing suspect.
    """

    dt_s: float
    speed: float
    end_speed: float
    felt: float
    push: float
    drag: float
    brake_n: float
    pressure_pa: float
    brake_switch: float
    lateral: float
    gear: float
    clutch: float
    height: float
    gnss_speed: float
    steady: bool
    forward: bool
    pressed: bool
    pressure_known: bool
    wheel_pressures: bool
    torque_known: bool
    on_stand: bool


def observer_number_names(corners: Sequence[str]) -> list[str]:
    """Return the name of each of the numbers of a car with *corners*."""
    return [*OBSERVER_NUMBERS, *(f"brake_sum.{c}" for c in corners)]


def new_observer(
    corners: int, learned: Sequence[float] | None = None
) -> list[float]:
    """Return the numbers before the first sample.

    *learned* is what was learned before the car was parked, as
    :data:`LEARNED_NAMES` has it.
    """
    numbers = [0.0] * (len(OBSERVER_NUMBERS) + corners)
    if learned is not None:
        numbers[: 4 * len(learned)] = 4 * list(learned)
        for name, value in (
            ("started", 1.0),
            ("last_rolled", UNKNOWN),
            ("radius_ratio", 1.0),
            # somebody may have got in
            ("stood_s", 2.0 * STOOD_S),
        ):
            numbers[OBSERVER_NUMBERS.index(name)] = value
    return numbers


def learned_fault(learned: Sequence[float]) -> str | None:
    """Return why *learned* can not have been learned, or None.

    *learned* as :data:`LEARNED_NAMES` has it: in bounds, the covariance
    symmetric, positive definite and no wider than at the first start.
    """
    if len(learned) != len(LEARNED_NAMES):
        return f"{len(learned)} numbers instead of {len(LEARNED_NAMES)}"
    if not all(map(isfinite, learned)):
        return "not finite"
    for i, name in enumerate(MOTION + FRICTION):
        if not LOW[i] <= learned[i] <= HIGH[i]:
            return f"{name} = {learned[i]:g} is out of bounds"
    cov = [
        list(learned[STATES * (i + 1) : STATES * (i + 2)])
        for i in range(STATES)
    ]
    for i, name in enumerate(MOTION + FRICTION):
        if not 0.0 < cov[i][i] <= 1.1 * SD[i] * SD[i]:
            return f"the variance of {name} is out of bounds"
    if not 0.0 < learned[-1] <= 1.1 * ROLLING_SD * ROLLING_SD:
        return "the variance of rolling is out of bounds"
    return None if _positive(cov) else "no positive definite covariance"


def _positive(matrix: Sequence[Sequence[float]]) -> bool:
    """Whether *matrix* is symmetric and has a Cholesky factor."""
    factor: list[list[float]] = []
    for i, row in enumerate(matrix):
        own: list[float] = []
        for j in range(i + 1):
            if not isclose(row[j], matrix[j][i], rel_tol=1e-6, abs_tol=1e-15):
                return False
            above = own if j == i else factor[j]
            left = row[j] - sum(
                a * b for a, b in zip(own, above, strict=False)
            )
            if j < i:
                own.append(left / factor[j][j])
            elif left > 0.0:
                own.append(sqrt(left))
            else:
                return False
        factor.append(own)
    return True
