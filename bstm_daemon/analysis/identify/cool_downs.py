"""Stretches in which a hot disc cools at one speed, without braking.

All series have steps of a second: discs are slow, and a thermocouple measures
about the mean over a second.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from bstm_daemon.analysis.identify.driving import Driving
from bstm_daemon.analysis.quality.limits import GRID_S, MOVING_MS
from bstm_daemon.analysis.statistics.series import (
    Column,
    Mask,
    block_means,
    runs,
)
from bstm_daemon.roles import CORNERS

STEP_S: Final = 1.0
BIN: Final = 5
"""Steps averaged to one reading of the regression."""

SETTLING_S: Final = 10.0
"""Settling time after braking, until the disc's inside and the thermocouple
have followed its face."""

SHORTEST_S: Final = 60.0
STANDING_MS: Final = 0.3
SPAN_MS: Final = 1.2
SPAN_SHARE: Final = 0.08
"""Widest range of speed within a cool-down: the larger of the two."""

HOT_K: Final = 40.0
"""Least temperature above ambient at the start of a cool-down."""

WARM_K: Final = 15.0
"""Temperature above ambient at which it ends: ambient's error dominates."""

FALL_K: Final = 10.0
"""Least fall of temperature in a cool-down."""

AXLES: Final = {"F": "front", "R": "rear"}
COUPLES: Final = ("disc", "disc_2")


@dataclass(frozen=True, slots=True)
class Slow:
    """One log by the second: (n,) each, SI, NaN if unknown.

    ``free`` means that no brake has been on for :data:`SETTLING_S`, or that
    the car stands. ``discs`` and ``pads`` are measured temperatures by role.
    """

    driving: Driving
    time_s: Column
    speed_ms: Column
    ambient_k: Column
    free: Mask
    discs: dict[str, Column]
    pads: dict[str, Column]


@dataclass(frozen=True, slots=True)
class CoolDown:
    """One thermocouple while its disc cools at one speed, (n,) each.

    ``time_s`` since ``start_s`` of the log. ``pad_k`` is the measured pad
    front, NaN where there is none.
    """

    log: str
    role: str
    corner: str
    start_s: float
    time_s: Column
    disc_k: Column
    ambient_k: Column
    speed_ms: Column
    pad_k: Column

    @property
    def mean_speed_ms(self) -> float:
        """Its speed, 0 where the car stands."""
        return float(self.speed_ms.mean())

    def bins(self, value: Column) -> Column:
        """Return means of *value*, (n,), over :data:`BIN` steps."""
        return block_means(value, BIN)

    @property
    def standing(self) -> bool:
        """Whether the car stands."""
        return bool(self.speed_ms.max() < STANDING_MS)


def slow_of(driving: Driving) -> Slow:
    """Return *driving* by the second with its measured discs."""
    channels = driving.channels
    speed = _with_parked(driving.speed_ms)

    def by_second(*nodes: str) -> dict[str, Column]:
        roles = [f"temp_{c.lower()}_{node}" for c in CORNERS for node in nodes]
        return {
            role: _by_second(driving.value(role))
            for role in channels.alive(roles)
        }

    ambient = np.full(len(driving.time_s), np.nan)
    if channels.alive(["ambient_temperature"]):
        ambient = _held(driving.value("ambient_temperature"))
    configured = channels.config.vehicle.ambient_k
    ambient = np.where(np.isfinite(ambient), ambient, configured)
    return Slow(
        driving,
        _by_second(driving.time_s),
        _by_second(speed),
        _by_second(ambient),
        _by_second(_free(driving, speed).astype(float)) > 0.99,
        by_second(*COUPLES),
        by_second("pad_front"),
    )


def cool_downs(slow: Slow) -> tuple[list[CoolDown], str]:
    """Return the cool-downs of a log, and what was searched in words."""
    name = slow.driving.name
    if not slow.discs:
        return [], f"{name}: no measured disc temperature in this log"
    free = slow.free & np.isfinite(slow.speed_ms)
    even = [
        part
        for first, last in runs(free)
        for part in _even(slow.speed_ms, first, last)
    ]
    found = []
    for role, disc in slow.discs.items():
        corner = role.split("_")[1].upper()
        pad = slow.pads.get(
            f"temp_{corner.lower()}_pad_front", np.full(len(disc), np.nan)
        )
        above = disc - slow.ambient_k
        for first, last in even:
            warm = above[first:last] > WARM_K
            for begin, end in runs(warm):
                part = slice(first + begin, first + end + 1)
                excess = above[part]
                if (
                    (end - begin) * STEP_S < SHORTEST_S
                    or excess[0] < HOT_K
                    or excess[:5].mean() - excess[-5:].mean() < FALL_K
                ):
                    continue
                time_s = slow.time_s[part]
                columns = (disc, slow.ambient_k, slow.speed_ms, pad)
                found.append(
                    CoolDown(
                        *(name, role, corner, float(time_s[0])),
                        time_s - time_s[0],
                        *(column[part] for column in columns),
                    )
                )
    seconds = sum(last - first for first, last in even) * STEP_S
    words = (
        f"{name}: {np.count_nonzero(free) * STEP_S:.0f} s standing or "
        f"{SETTLING_S:g} s after the last braking, {seconds:.0f} s of it at "
        f"one speed for {SHORTEST_S:g} s or more, {len(found)} times a disc "
        f"{HOT_K:g} K above ambient that falls by {FALL_K:g} K"
    )
    if not (slow.driving.brake_known or found):
        words += "; no signal shows that the brake is released while driving"
    return found, words


def _free(driving: Driving, speed_ms: Column) -> Mask:
    """Return where nothing has heated the discs for :data:`SETTLING_S`."""
    cold = driving.released() | (speed_ms < STANDING_MS)
    settling = round(SETTLING_S / GRID_S)
    last_hot = np.maximum.accumulate(
        np.where(cold, -settling - 1, np.arange(len(cold)))
    )
    return np.asarray(np.arange(len(cold)) - last_hot > settling)


def _even(speed_ms: Column, first: int, last: int) -> list[tuple[int, int]]:
    """Return the parts of *first* to *last* at one speed, end excluded."""
    least = round(SHORTEST_S / STEP_S)
    speeds = speed_ms[first : last + 1].tolist()
    found = []
    at = 0
    while at + least <= len(speeds):
        low = high = speeds[at]
        end = at
        while end < len(speeds) and _one_speed(
            min(low, speeds[end]), max(high, speeds[end])
        ):
            low, high = min(low, speeds[end]), max(high, speeds[end])
            end += 1
        if end - at >= least and (high < STANDING_MS or low > MOVING_MS):
            found.append((first + at, first + end))
            at = end
        else:
            at += 1
    return found


def _one_speed(low: float, high: float) -> bool:
    if low < STANDING_MS:
        return high < STANDING_MS
    return high - low <= max(SPAN_MS, SPAN_SHARE * high)


def _with_parked(speed_ms: Column) -> Column:
    """Return *speed_ms* with 0 where a standing car's bus is silent."""
    before, after = _held(speed_ms), _held(speed_ms[::-1])[::-1]
    known = np.isfinite(speed_ms)
    parked = ~known & np.logical_or.accumulate(known)
    parked &= (before < STANDING_MS) & (after < STANDING_MS)
    return np.where(parked, 0.0, speed_ms)


def _held(value: Column) -> Column:
    """Return *value* with its last one held over gaps, the first before."""
    known = np.flatnonzero(np.isfinite(value))
    if not len(known):
        return value
    place = np.searchsorted(known, np.arange(len(value)), "right") - 1
    return np.asarray(value[known[np.maximum(place, 0)]])


def _by_second(value: Column) -> Column:
    """Return means over :data:`STEP_S`, NaN where a value is missing."""
    return block_means(value, round(STEP_S / GRID_S))
