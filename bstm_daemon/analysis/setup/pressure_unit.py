"""The unit of a brake pressure without one in the DBC, by deceleration.

A pressure is zero except during single applications, has many levels, and the
car slows down under it. Passenger cars need some 10 bar for 1 m/s2 (tyres and
brakes scale with the mass), so units that differ by a factor of ten or more
can be distinguished. The travel of a pedal in % would look alike.
"""

from math import log10
from typing import Final

import numpy as np

from bstm_daemon.analysis.setup.behaviour import Motion
from bstm_daemon.analysis.setup.recording import Samples
from bstm_daemon.units import UNITS

_UNITS: Final = ("bar", "MPa", "kPa", "Pa")
_USUAL_PA: Final = 10e5
"""Usual pressure for 1 m/s2."""

_DECADES: Final = 0.5
_HIGHEST_PA: Final = 300e5
_HARDEST_MS2: Final = 12.0
"""Hardest braking; more is a wheel that locks or stands on rollers."""

_RARE: Final = 0.1
"""Share of harder braking that may be the noise of the speed."""

_LEVELS: Final = 8
_REST: Final = 0.02
_APPLIED: Final = 0.05
_MOST: Final = 0.5
_SLOWING: Final = 0.8
_ENOUGH_S: Final = 0.5
_ROLLING_MS: Final = 0.5
_BRAKING_MS2: Final = -0.3


def assumed_unit(motion: Motion, pressure: Samples) -> tuple[str, str] | None:
    """Return the likely unit of *pressure*, None if unlike a pressure.

    Args:
        motion: the car's.
        pressure: in an unknown unit.

    Returns:
        The unit, and the figures that speak for it.
    """
    value = pressure.value
    top = float(value.max(initial=0.0))
    if (
        not motion.known
        or len(np.unique(value)) < _LEVELS
        or float(np.median(value)) > _REST * top
        or float(value.min()) < -_REST * top
    ):
        return None
    column = motion.on_grid(pressure)
    applied = column > _APPLIED * top
    rolling = motion.seen & (motion.speed_ms > _ROLLING_MS)
    braking = applied & rolling
    braking_s = float(np.count_nonzero(braking)) * motion.step_s
    if braking_s < _ENOUGH_S or float(np.mean(applied[rolling])) > _MOST:
        return None
    change_ms2 = motion.change_ms2[braking]
    slowing = change_ms2 < _BRAKING_MS2
    hardest_ms2 = -float(np.quantile(change_ms2, _RARE))
    if float(np.mean(slowing)) < _SLOWING or hardest_ms2 > _HARDEST_MS2:
        return None
    for_1_ms2 = float(
        np.median(-column[braking][slowing] / change_ms2[slowing])
    )
    unit = min(_UNITS, key=lambda one: _distance(for_1_ms2, one))
    is_usual = _distance(for_1_ms2, unit) <= _DECADES
    if not is_usual or top * UNITS[unit].factor > _HIGHEST_PA:
        return None
    reason = (
        f"unit assumed from its highest value of {top:g} and {for_1_ms2:.2g} "
        f"for 1 m/s2 of {braking_s:.1f} s of braking: check, the travel of a "
        "pedal would look alike"
    )
    return unit, reason


def _distance(for_1_ms2: float, unit: str) -> float:
    """Return the decades between a pressure in *unit* and the usual one."""
    return abs(log10(for_1_ms2 * UNITS[unit].factor / _USUAL_PA))
