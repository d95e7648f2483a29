"""Checks of brake pressures against each other and the car's motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.channels import PRESSURES, Channels
from bstm_daemon.analysis.quality.comparison import Fit, fit_channels
from bstm_daemon.analysis.quality.naming import (
    Naming,
    Tolerance,
    components,
    name_faults,
    write_faults,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from bstm_daemon.analysis.quality.finding import Notes
    from bstm_daemon.analysis.statistics.series import Column

_REAR: Final = ("secondary_pressure", "wheel_pressure_rl", "wheel_pressure_rr")


def compare_pressures(
    channels: Channels, notes: Notes, motion_says: dict[str, bool]
) -> None:
    """Compare every pressure, name the wrong ones and leave them out.

    *motion_says* is, for each pressure, whether the car's braking fits it,
    where that could be judged: it decides between two that disagree.
    """
    roles = channels.alive(PRESSURES)
    if len(roles) < 2:
        if roles:
            notes.skip(f"{roles[0]}: the only pressure, see deceleration")
        return
    names: dict[tuple[str, str], tuple[Naming, Fit | None]] = {}

    def naming(one: str, other: str) -> Naming:
        if (one, other) not in names:
            names[one, other] = _name(channels, one, other)
        return names[one, other][0]

    groups = components(roles, lambda a, b: naming(a, b).agrees)
    for other in roles[1:]:
        found = naming(roles[0], other)
        notes.compare(
            f"{other} against {roles[0]}",
            (roles[0], other),
            (channels.time_s, channels.value(roles[0]), channels.value(other)),
            (found.verdict, found.agrees, names[roles[0], other][1]),
            "bar",
            unit_si=1e5,
        )
        if found.agrees is None:
            notes.skip(f"{other} against {roles[0]}: {found.why_not_judged}")
    _attribute(channels, notes, groups, naming, motion_says)


def _attribute(
    channels: Channels,
    notes: Notes,
    groups: list[tuple[str, ...]],
    naming: Callable[[str, str], Naming],
    motion_says: dict[str, bool],
) -> None:
    first = groups[0]
    for group in groups[1:]:
        for role in group:
            against = [naming(other, role) for other in first]
            judged = [n for n in against if n.agrees is False]
            if not judged:
                continue
            believed = _believed(first, group, motion_says)
            if believed is first:
                write_faults(notes, role, judged[0], first[0])
                channels.dead.add(role)
            elif believed is group:
                for other in first:
                    turned = naming(role, other)
                    write_faults(notes, other, turned, role)
                    channels.dead.add(other)
            else:
                notes.fault(
                    "ambiguous",
                    (first[0], role),
                    f"{first[0]} and {role} disagree "
                    f"({judged[0].verdict}): one is wrong and this log "
                    "does not show which",
                )
    for role in first:
        late = [
            (fault, text)
            for other in first
            if other != role
            for fault, text in naming(other, role).faults
            if fault == "lag" and text.endswith("late")
        ]
        if late:
            notes.fault("lag", role, f"{late[0][1]}", wrong=False)


def _believed(
    one: tuple[str, ...], other: tuple[str, ...], motion_says: dict[str, bool]
) -> tuple[str, ...] | None:
    fits_one = [motion_says[r] for r in one if r in motion_says]
    fits_other = [motion_says[r] for r in other if r in motion_says]
    if any(fits_one) != any(fits_other):
        return one if any(fits_one) else other
    if len(one) != len(other):
        return one if len(one) > len(other) else other
    return None


def _name(
    channels: Channels, one: str, other: str
) -> tuple[Naming, Fit | None]:
    x, y = channels.value(one), channels.value(other)
    fit = fit_channels(x, y, limits.PRESSURE_FLOOR_PA)
    both = np.isfinite(x) & np.isfinite(y)
    span = max(np.ptp(x[both]), np.ptp(y[both])) if both.any() else 0.0
    why = ""
    if span < limits.PRESSURE_SPAN_PA:
        why = f"the pressures range over {span / 1e5:.1f} bar only"
    rear = one in _REAR or other in _REAR
    tolerance = Tolerance(
        limits.REAR_PRESSURE_SCALE if rear else limits.PRESSURE_SCALE,
        limits.PRESSURE_OFFSET_PA,
    )
    return name_faults(channels, other, fit, tolerance, why), fit


def released_reading(
    pressure: Column, speed_ms: Column, rate_ms2: Column
) -> tuple[float, float]:
    """Return what a *pressure* reads with the brake certainly released.

    The car gains speed, or rolls at the lowest pressures of the log.

    Args:
        pressure: of one circuit [Pa], (n,) on the grid, NaN where absent.
        speed_ms: of the car, (n,).
        rate_ms2: its change, (n,).

    Returns:
        The reading, and how far above it the brake is still released [Pa];
        the reading is 0 where there is none or one that can not be that of a
        released brake.
    """
    above_pa = limits.RELEASED_PA
    rolling = (speed_ms > limits.MOVING_MS) & np.isfinite(pressure)
    gaining = rolling & (rate_ms2 > limits.DRIVING_MS2)
    chosen = pressure[gaining if gaining.any() else rolling]
    if not len(chosen):
        return 0.0, above_pa
    rest = float(np.median(chosen) if gaining.any() else np.min(chosen))
    if abs(rest) > limits.RESIDUAL_PA:
        return 0.0, above_pa
    if gaining.any():
        spread = float(np.percentile(chosen, 95)) - rest
        above_pa = max(0.5 * above_pa, limits.RELEASED_SPREADS * spread)
    return rest, above_pa


def check_resting(channels: Channels, notes: Notes) -> None:
    """Name pressures that are negative, or not zero with no braking."""
    for role in channels.alive(PRESSURES):
        value = channels.value(role)
        value = value[np.isfinite(value)]
        if not len(value):
            continue
        low, high = value.min(), value.max()
        if low < -limits.PRESSURE_SPAN_PA and high < -0.5 * low:
            notes.fault(
                "sign",
                role,
                f"wrong sign: falls to {low / 1e5:.0f} bar, a brake pressure "
                "is not negative",
            )
            channels.dead.add(role)
    _resting(channels, notes)


def _resting(channels: Channels, notes: Notes) -> None:
    """Name what a pressure reads while the car gains speed."""
    if not channels.speed_roles or channels.on_stand:
        return
    driving = channels.speed_rate() > limits.DRIVING_MS2
    driving &= channels.speed > limits.MOVING_MS
    limit = channels.config.heat.brake_on_pressure_pa
    for role in channels.alive(PRESSURES):
        value = channels.value(role)
        resting = value[driving & np.isfinite(value)]
        if len(resting) * limits.GRID_S < limits.ENOUGH_S:
            continue
        low, middle = np.percentile(resting, (10, 50))
        if abs(middle) > limit and abs(low) > limit:
            unit, factor = channels.unit(role)
            notes.fault(
                "offset",
                role,
                f"offset {middle / factor:+.3g} {unit}: read while the car "
                f"gains speed, more than brake_on_pressure_pa",
            )
