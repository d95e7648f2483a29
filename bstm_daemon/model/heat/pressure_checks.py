"""Checks of the pressures: stuck, without switch, zero, left against right.

The pure-Python form of ``native/heat/pressure_checks.c``; both do the same
operations in the same order.
"""

from math import exp, isnan

from bstm_daemon.model.heat.check_rules import (
    FROZEN_PRESSURE_MS,
    FROZEN_PRESSURE_PA,
    FROZEN_PRESSURE_S,
    MOVES_S,
    STUCK,
    SWITCH,
    SWITCH_MS,
    SWITCH_PRESSURE_PA,
    TWIN,
    TWIN_LIMIT,
    TWIN_MOST,
    TWIN_MOST_PA,
    TWIN_PA,
    TWIN_S,
    TWIN_SETTLED_S,
    TWIN_ZERO_PA,
    ZERO,
    ZERO_PA,
)
from bstm_daemon.model.heat.memory import CheckMemory
from bstm_daemon.model.heat.readings import Readings


def hold_pressures(m: CheckMemory, now: Readings, *, unsure: bool) -> None:
    """Time values that stay; *unsure*: a change of speed is no driving."""
    for i, pressure in enumerate(now.pressures):
        if isnan(pressure) or pressure != m.pressure_held[i]:
            m.pressure_held[i] = 0.0 if isnan(pressure) else pressure
            m.pressure_held_s[i] = 0.0
            m.pressure_mark[i] = now.speed
        else:
            m.pressure_held_s[i] += now.dt_s
        if unsure:
            m.pressure_mark[i] = now.speed
        failed = None
        if not isnan(pressure) and now.speed_known:
            held_s = m.pressure_held_s[i]
            driven_ms = abs(now.speed - m.pressure_mark[i])
            if pressure <= FROZEN_PRESSURE_PA or held_s < MOVES_S:
                failed = False
            elif (
                held_s >= FROZEN_PRESSURE_S and driven_ms > FROZEN_PRESSURE_MS
            ):
                failed = True
        m.pressure_stuck_s[i] = STUCK.advance(
            m.pressure_stuck_s[i], now.dt_s, failed=failed
        )


def compare_switch(m: CheckMemory, now: Readings) -> None:
    """Compare the primary pressure with the brake switch."""
    # only the pedal's own pressure: assistance fills the other circuits
    failed = None
    primary = now.pressures[0]
    if (
        not isnan(primary)
        and now.speed > SWITCH_MS
        and not isnan(now.brake_switch)
        and now.esc_active == 0.0
    ):
        failed = primary > SWITCH_PRESSURE_PA and now.brake_switch == 0.0
    m.switch_fault_s = SWITCH.advance(
        m.switch_fault_s, now.dt_s, failed=failed
    )


def compare_zero(m: CheckMemory, now: Readings) -> None:
    """Compare all with the pressure of the air."""
    for i, pressure in enumerate(now.pressures):
        failed = None if isnan(pressure) else pressure < ZERO_PA
        m.zero_fault_s[i] = ZERO.advance(
            m.zero_fault_s[i], now.dt_s, failed=failed
        )


def compare_twins(m: CheckMemory, now: Readings) -> None:
    """Compare the two brakes of each axle, and the two circuits."""
    share = 1.0 - exp(-now.dt_s / TWIN_S)
    for i, low in enumerate(now.twin_low):
        mean = 0.5 * (low + now.twin_high[i])
        failed = None
        if mean > TWIN_PA and not now.intervenes:
            m.twin_pressed_s[i] += now.dt_s
        else:
            m.twin_pressed_s[i] = 0.0
        if m.twin_pressed_s[i] > TWIN_SETTLED_S:
            apart = max(now.twin_high[i] - low - TWIN_ZERO_PA, 0.0) / mean
            weight = min(mean, TWIN_MOST_PA)
            apart = min(apart, TWIN_MOST) * weight
            m.twin_difference[i] += share * (apart - m.twin_difference[i])
            m.twin_pressure[i] += share * (weight - m.twin_pressure[i])
            failed = m.twin_difference[i] > TWIN_LIMIT * m.twin_pressure[i]
        m.twin_fault_s[i] = TWIN.advance(
            m.twin_fault_s[i], now.dt_s, failed=failed
        )
