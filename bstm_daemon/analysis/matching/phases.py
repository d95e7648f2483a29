"""Phases of a drive, found by themselves: soak, drive, cooling, braking.

Each is a list of stretches of steps, first to last, both included.
"""

from typing import Final

import numpy as np

from bstm_daemon.analysis.matching.drives import GRID_S, Drive
from bstm_daemon.analysis.statistics.series import Column, Mask, runs

STANDING_MS: Final = 0.5
SOAK_S: Final = 300.0
"""A shorter stop is traffic."""

DRIVE_S: Final = 60.0
COOLING_S: Final = 30.0
"""Stretches off the brake must last so long."""

BRAKING_W: Final = 200.0
HARD_MS2: Final = 4.0
HARD_S: Final = 1.0
"""A hard stop decelerates so much for so long."""

WARM_K: Final = 20.0
"""Above the air, anywhere in the corner, for a soak to show something."""


def soak(drive: Drive, corner: str) -> Mask:
    """Return where the car stands for long with *corner* warm, (steps,)."""
    standing = drive.channel(corner, "speed_ms") < STANDING_MS
    warm = np.zeros(len(drive), bool)
    for node in drive.measured.get(corner, {}):
        rise = excess_k(drive, corner, node)
        warm |= np.nan_to_num(rise, nan=0.0) > WARM_K
    found = _lasting(standing, SOAK_S)
    for first, last in runs(found):
        found[first : last + 1] = warm[first : last + 1].any()
    return found


def moving(drive: Drive, corner: str) -> Mask:
    """Return where the car drives for a while, (steps,)."""
    return _lasting(drive.channel(corner, "speed_ms") >= STANDING_MS, DRIVE_S)


def cooling(drive: Drive, corner: str) -> Mask:
    """Return where the car drives a while off the brake, (steps,)."""
    driving = drive.channel(corner, "speed_ms") >= STANDING_MS
    return _lasting(driving & ~braking(drive, corner), COOLING_S)


def _lasting(mask: Mask, least_s: float) -> Mask:
    """Return *mask* without the stretches shorter than *least_s*."""
    found = np.zeros(len(mask), bool)
    for first, last in runs(mask):
        found[first : last + 1] = (last - first + 1) * GRID_S >= least_s
    return found


def braking(drive: Drive, corner: str) -> Mask:
    """Return where the brake takes power, (steps,)."""
    braked: Mask = drive.channel(corner, "brake_power_w") > BRAKING_W
    return braked


def hard_stops(drive: Drive, corner: str) -> int:
    """Return how many hard stops *corner* brakes in."""
    speed_ms = drive.channel(corner, "speed_ms")
    if len(speed_ms) < 2:
        return 0
    hard = braking(drive, corner) & (
        np.gradient(speed_ms, GRID_S) <= -HARD_MS2
    )
    return len(runs(_lasting(hard, HARD_S)))


def excess_k(drive: Drive, corner: str, node: str) -> Column:
    """Return how far a measured node lies above the air, (steps,)."""
    measured = drive.measured[corner][node].at(drive.time_s)
    return np.asarray(measured - drive.channel(corner, "ambient_k"))
