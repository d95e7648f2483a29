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
        _name_runs(channels, role, _SpeedContradiction(channels, role))


def find_frozen(
    channels: Checks, roles: tuple[str, ...], reference: Column
) -> None:
    """Name *roles* that hold a value while *reference* (n,) moves.

    *reference* is in the channels' own unit.
    """
    for role in channels.alive(roles):
        least = (
            limits.PRESSURE_SPAN_PA
            if "pressure" in role
            else limits.FROZEN_ACCELERATION_MS2
        )

        def moved(run: Run, least: float = least) -> str:
            inside = _inside(channels, run, reference)
            if len(inside) and np.ptp(inside) >= least:
                return "while its reference moves"
            return ""

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


class _SpeedContradiction:
    """Evidence from the other speeds that a constant one is frozen."""

    def __init__(self, channels: Channels, role: str) -> None:
        self._channels = channels
        others = [r for r in SPEEDS if r in channels.series and r != role]
        living = [r for r in others if r not in channels.dead]
        self._around = (
            median_of({r: channels.raw(r) for r in living}) if living else None
        )
        axle = next((a for a in _AXLES.values() if role in a), ())
        self._independent = [r for r in others if r not in axle]
        partner = [r for r in axle if r != role]
        self._axle_still = bool(axle) and all(
            r in channels.series and np.ptp(channels.series[r].value) == 0.0
            for r in (role, *partner)
        )
        values = channels.series[role].value
        self._fine = len(np.unique(values)) >= limits.FROZEN_STEPS

    def __call__(self, run: Run) -> str:
        """Return the contradiction of *run*, or nothing."""
        if self._around is not None:
            inside = _inside(self._channels, run, self._around)
            if len(inside) and np.ptp(inside) >= limits.FROZEN_SPEED_MS:
                words = "while the other speeds move"
                if self._axle_still:
                    words += " (or the car is on a stand)"
                return words
        if not self._fine or run.value == 0.0:
            return ""
        seen = [
            inside
            for role in self._independent
            for inside in (self._inside(run, role),)
            if len(inside)
        ]
        if seen and all(
            np.abs(inside - run.value).min() >= limits.FROZEN_SPEED_MS
            for inside in seen
        ):
            return "to the last digit, and no other speed bears it out"
        return ""

    def _inside(self, run: Run, role: str) -> Column:
        return _inside(self._channels, run, self._channels.raw(role))


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
