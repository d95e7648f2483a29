"""Wheel speeds, vehicle speed and speeds over ground compared."""

from collections.abc import Callable
from functools import cache
from typing import Final

import numpy as np

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.accelerations import fit_acceleration
from bstm_daemon.analysis.quality.channels import Channels
from bstm_daemon.analysis.quality.comparison import fit_channels, spread
from bstm_daemon.analysis.quality.finding import Checks
from bstm_daemon.analysis.quality.naming import (
    Naming,
    Tolerance,
    components,
    name_faults,
    write_faults,
)
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.roles import GROUND_LAG_S, WHEELS

SPEEDS: Final = ("vehicle_speed", *WHEELS, *GROUND_LAG_S)
_PAIRS: Final = (
    ("wheel_speed_fl", "wheel_speed_fr"),
    ("wheel_speed_rl", "wheel_speed_rr"),
    ("wheel_speed_fl", "wheel_speed_rl"),
    ("wheel_speed_fr", "wheel_speed_rr"),
)
_Pairs = Callable[[str, str], Naming]
"""The verdict on a speed, the second one, against another one."""


def compare_speeds(channels: Checks) -> None:
    """Compare every speed, report wrong ones, set the car's speed."""
    roles = channels.alive(SPEEDS)
    if not roles:
        return
    pairs = cache(lambda x, y: _naming(channels, channels.value(x), y))
    groups = components(roles, lambda one, other: pairs(one, other).agrees)
    trusted = _trusted(channels, pairs, groups)
    _write_comparisons(channels, pairs, roles)
    if trusted is None:
        listed = " against ".join(", ".join(group) for group in groups)
        channels.fault(
            "ambiguous",
            tuple(role for group in groups for role in group),
            f"speeds disagree, {listed}: one side is wrong and this log does "
            "not show which",
        )
        channels.set_speed(roles)
        return
    channels.set_speed(trusted)
    for role in roles:
        if role in trusted:
            _late_only(channels, pairs, role, trusted)
            continue
        naming = _naming(channels, channels.speed, role)
        if naming.agrees is False:
            write_faults(channels, role, naming, _named(trusted))


def family(role: str) -> str:
    """Return the roles that share a source with *role*: all wheels do."""
    return "wheels" if role in WHEELS else role


def _named(roles: tuple[str, ...]) -> str:
    return roles[0] if len(roles) == 1 else f"{len(roles)} other speeds"


def _naming(channels: Channels, speed: Column, role: str) -> Naming:
    """Judge *role* against *speed*, (n,)."""
    value = channels.value(role)
    both = np.isfinite(speed) & np.isfinite(value)
    span = max(spread(speed[both]), spread(value[both]))
    why = ""
    if span < limits.SPEED_SPAN_MS:
        why = f"the speed varies by {span:.1f} m/s only"
    fit = fit_channels(speed, value, limits.SPEED_FLOOR_MS)
    lag_s = GROUND_LAG_S.get(role, limits.LAG_S)
    tolerance = Tolerance(limits.SPEED_SCALE, limits.SPEED_OFFSET_MS, lag_s)
    return name_faults(channels, role, fit, tolerance, why)


def _trusted(
    channels: Channels, pairs: _Pairs, groups: list[tuple[str, ...]]
) -> tuple[str, ...] | None:
    """Return the group to trust, None if undecided.

    Each source has one vote (the wheels, the vehicle, each over ground); the
    accelerometer decides before them where it follows one group and no other.
    """
    if len(groups) == 1:
        return groups[0]
    judged = [
        group
        for group in groups
        if any(
            pairs(one, other).agrees is not None
            for one in group
            for other in set().union(*groups) - set(group)
        )
    ]
    if not judged:
        return tuple(role for group in groups for role in group)
    borne_out = [
        group for group in judged if _accelerometer_follows(channels, group)
    ]
    if len(borne_out) == 1:
        return borne_out[0]
    votes = [len({family(role) for role in group}) for group in judged]
    if votes.count(max(votes)) == 1:
        return judged[votes.index(max(votes))]
    families = {family(r) for group in judged for r in group}
    if len(families) == 1:
        sizes = [len(group) for group in judged]
        if sizes.count(max(sizes)) == 1:
            return judged[sizes.index(max(sizes))]
    return None


def _accelerometer_follows(channels: Channels, group: tuple[str, ...]) -> bool:
    channels.set_speed(group)
    fit = fit_acceleration(channels)
    return (
        fit is not None
        and fit.correlation > limits.UNRELATED
        and not fit.beyond(limits.ACCELERATION_SCALE)
    )


def _late_only(
    channels: Checks, pairs: _Pairs, role: str, trusted: tuple[str, ...]
) -> None:
    """Name *role* late where it is against most of the others."""
    others = [other for other in trusted if other != role]
    late = [
        text
        for other in others
        for fault, text in pairs(other, role).faults
        if fault == "lag"
    ]
    # of two, the one behind is called late
    if len(others) == 1:
        late = [text for text in late if text.endswith("late")]
    if len(late) * 2 > len(others):
        channels.fault(
            "lag", role, f"{late[0]}, against {_named(trusted)}", wrong=False
        )


def _write_comparisons(
    channels: Checks, pairs: _Pairs, roles: list[str]
) -> None:
    first = "vehicle_speed" if "vehicle_speed" in roles else roles[0]
    for one, other in (
        *(("vehicle_speed", wheel) for wheel in WHEELS),
        *_PAIRS,
        *((first, ground) for ground in GROUND_LAG_S),
    ):
        if one in roles and other in roles and one != other:
            channels.compare(
                f"{other} against {one}",
                (one, other),
                (channels.value(one), channels.value(other)),
                pairs(one, other).named,
                "km/h",
            )


def note_unjudged(channels: Checks) -> None:
    """Note the speeds without another one to compare with."""
    roles = channels.alive(SPEEDS)
    if len(roles) == 1:
        channels.skip(
            f"{roles[0]}: the only speed, nothing to compare it with"
        )
    elif roles and spread(channels.speed) < limits.SPEED_SPAN_MS:
        channels.skip(
            f"speeds: they vary by less than {limits.SPEED_SPAN_MS:g} m/s in "
            "this log"
        )
