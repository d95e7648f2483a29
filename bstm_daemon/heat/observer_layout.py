"""What the observer of the car remembers, in which order.

Accelerations and forces over the configured mass are in m/s2, so that the
states have the size of 1. ``_observer.h`` has the same order.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Sequence

MOTION: Final = ("mass_ratio", "bias", "drag_ratio", "gain")
"""Configured mass over the mass; bias of the accelerometer less g f_r
[m/s2]; drag over that of the configuration, times ``mass_ratio``; what is
felt of a change of speed beyond it (body pitch, scale)."""

FRICTION: Final = ("level", "speed", "pressure", "drift")
"""ln of friction over Feed-Forward's: at 10 m/s and 10 bar; exponents of
speed and of pressure; what passes within minutes (temperature, bedding)."""

LEARNED_NAMES: Final = (
    *(MOTION + FRICTION),
    *(f"{a}_{b}" for a in MOTION + FRICTION for b in MOTION + FRICTION),
    "rolling",
    "rolling_variance",
)
"""States and covariances; ``rolling`` is the error of the configured g f_r
[m/s2], which only the height of the road tells."""

OBSERVER_NUMBERS: Final = (
    *(f"learned_{name}" for name in LEARNED_NAMES),
    *(f"recent_{name}" for name in LEARNED_NAMES),
    *(f"earlier_{name}" for name in LEARNED_NAMES),
    *("copy_age", "started", "resets"),
    *("last_rolled", "rate", "felt", "slow_rate", "slow_felt", "gain_time"),
    *("calm_s", "released_s", "pressed_s", "last_gear", "last_clutch"),
    *("external_s", "external_held_s", "alike", "changed", "radius_ratio"),
    *("unpressed_s", "stood_s"),
    *("window_kind", "window_time", "window_felt", "window_push"),
    *("window_drag", "window_brake", "window_pressure", "window_speed"),
    "window_first_speed",
    *("sine", "height_last", "height_work", "height_path"),
    *("slow_braking", "slow_brake", "silent_s", "silent_energy"),
    *("sum_time", "sum_felt", "sum_push", "sum_drag"),
)
"""The numbers of the state after those of the checks; then per corner
``brake_sum`` [N s], the force by pressure of the open step."""


def observer_number_names(corners: Sequence[str]) -> list[str]:
    """Return the name of each of the numbers of a car with *corners*."""
    return [*OBSERVER_NUMBERS, *(f"brake_sum.{c}" for c in corners)]


def new_observer(corners: int) -> list[float]:
    """Return the numbers before the first sample."""
    return [0.0] * (len(OBSERVER_NUMBERS) + corners)
