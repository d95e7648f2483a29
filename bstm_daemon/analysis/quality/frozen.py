"""Detection of channels that are frozen while the measured quantity moves."""

from collections.abc import Callable
from typing import Final

import numpy as np

from bstm_daemon.analysis.quality import limits
from bstm_daemon.analysis.quality.channels import (
    Channels,
    difference_quotient,
    median_of,
)
from bstm_daemon.analysis.quality.comparison import spread
from bstm_daemon.analysis.quality.finding import Checks
from bstm_daemon.analysis.quality.recording import Run, constant_runs
from bstm_daemon.analysis.quality.speeds import SPEEDS
from bstm_daemon.analysis.statistics.series import Column
from bstm_daemon.roles import LONGITUDINAL, PRESSURES, WHEELS

_END_S: Final = 1.0
_AXLES: Final = {"front": WHEELS[:2], "rear": WHEELS[2:]}


def find_frozen_speeds(channels: Checks) -> None:
    """Name speeds that are dead or hold a value, and leave them out."""
    roles = channels.alive(SPEEDS)
    for role in _without_standing_axle(channels, roles):
        _name_runs(channels, role, _speed_contradiction(channels, role))


def find_frozen(channels: Checks, role: str, reference: Column) -> None:
    """Name *role* if it is there and still while *reference* (n,) moves.

    *reference* is in the channel's own unit.
    """
    least = limits.FROZEN_ACCELERATION_MS2
    if role in PRESSURES:
        least = limits.PRESSURE_SPAN_PA

    def moved(run: Run) -> str:
        inside = _inside(channels, run, reference)
        still = not len(inside) or np.ptp(inside) < least
        return "" if still else "while its reference moves"

    if channels.alive([role]):
        _name_runs(channels, role, moved)


def _without_standing_axle(channels: Checks, roles: list[str]) -> list[str]:
    """Leave out an axle at rest because the car is on a test stand."""
    for name, wheels in _AXLES.items():
        others = [role for role in roles if role not in wheels]
        if not (set(wheels) <= set(roles) and others):
            continue
        turning = median_of({role: channels.raw(role) for role in others})
        known = turning[np.isfinite(turning)]
        still = all(np.ptp(channels.series[w].value) == 0.0 for w in wheels)
        if (
            not still
            or not len(known)
            or np.ptp(known) < limits.FROZEN_SPEED_MS
        ):
            continue
        if _car_stood(channels, turning):
            listed = ", ".join(wheels)
            channels.fault(
                "axles-disagree",
                wheels,
                f"axles disagree: stand or roller? The {name} wheels "
                f"({listed}) stand, the others turn at up to "
                f"{3.6 * known.max():.0f} km/h and the accelerometer "
                "shows no motion",
                wrong=False,
            )
            channels.dead.update(wheels)
            channels.on_stand = True
            return others
    return roles


def _car_stood(channels: Channels, turning: Column) -> bool:
    """Whether the accelerometer shows no motion while wheels turn."""
    if not channels.alive([LONGITUDINAL]):
        return False
    return feels_nothing(difference_quotient(turning), channels.acceleration())


def feels_nothing(rate_ms2: Column, accel_ms2: Column) -> bool:
    """Whether an accelerometer shows none of the changes of speed.

    Args:
        rate_ms2: dv/dt of wheels that turn, (n,).
        accel_ms2: what is measured along the car then, (n,).
    """
    both = np.isfinite(rate_ms2) & np.isfinite(accel_ms2)
    rate, accel = rate_ms2[both], accel_ms2[both]
    if len(rate) < 2 or rate.std() < 0.5:
        return False
    rate, accel = rate - rate.mean(), accel - accel.mean()
    response = abs(float(rate @ accel) / float(rate @ rate))
    return response < limits.STAND_RESPONSE


def _speed_contradiction(
    channels: Channels, role: str
) -> Callable[[Run], str]:
    """Return the evidence from the other speeds that *role* is frozen."""
    others = [r for r in SPEEDS if r in channels.series and r != role]
    living = {r: channels.raw(r) for r in channels.alive(others)}
    around = median_of(living) if living else np.empty(0)
    axle = next((a for a in _AXLES.values() if role in a), ())
    axle_still = bool(axle) and all(
        r in channels.series and np.ptp(channels.series[r].value) == 0.0
        for r in axle
    )
    values = channels.series[role].value
    fine = len(np.unique(values)) >= limits.FROZEN_STEPS

    def contradiction(run: Run) -> str:
        inside = _inside(channels, run, around) if living else around
        if len(inside) and np.ptp(inside) >= limits.FROZEN_SPEED_MS:
            words = "while the other speeds move"
            return words + " (or the car is on a stand)" * axle_still
        if not fine or run.value == 0.0:
            return ""
        independent = [r for r in others if r not in axle]
        seen = [_inside(channels, run, channels.raw(r)) for r in independent]
        away = [np.abs(s - run.value).min() for s in seen if len(s)]
        if away and min(away) >= limits.FROZEN_SPEED_MS:
            return "to the last digit, and no other speed bears it out"
        return ""

    return contradiction


def _inside(channels: Channels, run: Run, value: Column) -> Column:
    """Return *value* in *run* except at its ends, where a late one differs."""
    first_s, last_s = run.start_s + _END_S, run.end_s - _END_S
    here = (channels.time_s >= first_s) & (channels.time_s <= last_s)
    inside = value[here]
    return inside[np.isfinite(inside)]


def _name_runs(
    channels: Checks, role: str, contradiction: Callable[[Run], str]
) -> None:
    series = channels.series[role]
    unit, factor = channels.unit(role)
    named = len(channels.findings)
    for run in constant_runs(series, limits.FROZEN_S):
        why = contradiction(run)
        if not why:
            continue
        value = f"{run.value / factor:.6g} {unit}"
        if run.length_s >= series.time_s[-1] - series.time_s[0]:
            text = f"dead: reads {value} throughout, {why}"
            channels.rule_out("dead", role, text)
            continue
        channels.spans.setdefault(role, []).append((run.start_s, run.end_s))
        to_end = run.end_s >= series.time_s[-1]
        until = "to the end" if to_end else f"to {run.end_s:.1f} s"
        text = f"frozen at {value} from {run.start_s:.1f} s {until}, {why}"
        channels.fault("frozen", role, text)
    if len(channels.findings) > named:
        _show(channels, role, channels.findings[-1].text)


def _show(channels: Checks, role: str, verdict: str) -> None:
    """Write a comparison with the first channel of its kind that moves."""
    kind = PRESSURES if role in PRESSURES else SPEEDS
    others = [other for other in channels.alive(kind) if other != role]
    if role == LONGITUDINAL or not others:
        reference, name = channels.speed_rate(), "dv/dt"
    else:
        name = max(others, key=lambda other: spread(channels.raw(other)))
        reference = channels.raw(name)
    unit = "bar" if role in PRESSURES else "km/h"
    if role == LONGITUDINAL:
        unit = "m/s2"
    channels.compare(
        f"{role} against {name}",
        (name, role),
        (reference, channels.raw(role)),
        (verdict, False, None),
        unit,
    )
