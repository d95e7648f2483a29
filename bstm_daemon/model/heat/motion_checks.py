"""Checks of the accelerometer and of all speeds against each other.

The pure-Python form of ``native/heat/motion_checks.c``; both do the same
operations in the same order. Speeds that freeze together, or have one wrong
scale, agree with each other. The accelerometer measures the slope as well, but
a slope changes slowly: in a band of frequencies both measure the same.
"""

from math import exp, isnan

from bstm_daemon.model.heat.check_rules import (
    BAND_LEAST_MS2,
    BAND_QUICK_S,
    BAND_RATE_MS2,
    BAND_RESTART_S,
    BAND_SLOW_S,
    BAND_SPEED_MS,
    FROZEN_SPEED_S,
    INERTIA,
    INERTIA_FILTER_S,
    INERTIA_MS2,
    LEAP_MS,
    LEAP_S,
    MOVES_S,
    PROOF_J,
    PROOF_MS2,
    REVERSED,
    REVERSED_MEMORY_S,
    REVERSED_MOTION,
    REVERSED_MS2,
    REVERSED_SHARE,
    SHARE_BEYOND,
    SHARE_CORRELATION,
    SHARE_LEAST,
    SHARE_LIMIT,
    SHARE_MOST,
    STAND_MOTION,
    STAND_SHARE,
    STANDING_MS,
    STUCK,
    TILT_MS2,
    TILT_S,
    TURN_CORRELATION,
    TURN_LEAST,
    TURN_LEAST_MS2,
    TURN_LIMIT,
    TURN_MOST,
    TURN_SPEED_MS,
    UNMOVED_S,
    UNMOVED_SQUARE,
)
from bstm_daemon.model.heat.memory import UNKNOWN, CheckMemory
from bstm_daemon.model.heat.readings import Readings


def compare_motion(m: CheckMemory, now: Readings, *, noise: bool) -> None:
    """Follow speed and accelerometer through a step; *noise*: not to use."""
    if now.acceleration != m.accel_held:
        m.accel_held, m.accel_held_s = now.acceleration, 0.0
    m.accel_held_s += now.dt_s
    if isnan(now.acceleration) or not now.speed_known or noise:
        m.slow_speed = m.band_speed = UNKNOWN
        m.unmoved_square, m.tilted_s = 0.0, UNKNOWN
        return
    rate = (now.speed - m.band_speed) / now.dt_s
    if m.band_speed < 0.0 or abs(rate) > BAND_RATE_MS2:
        m.slow_speed = UNKNOWN
        m.band_accel = m.band_slow_accel = now.acceleration
        m.band_rate = m.band_slow_rate = m.band_s = rate = 0.0
    _compare_inertia(m, now)
    m.band_speed = now.speed
    quick = 1.0 - exp(-now.dt_s / BAND_QUICK_S)
    slow = 1.0 - exp(-now.dt_s / BAND_SLOW_S)
    m.band_rate += quick * (rate - m.band_rate)
    m.band_accel += quick * (now.acceleration - m.band_accel)
    m.band_slow_rate += slow * (m.band_rate - m.band_slow_rate)
    m.band_slow_accel += slow * (m.band_accel - m.band_slow_accel)
    m.band_s += now.dt_s
    accel = m.band_accel - m.band_slow_accel
    _compare_shares(m, now, m.band_rate - m.band_slow_rate, accel)
    _compare_frozen(m, now, accel)


def _compare_inertia(m: CheckMemory, now: Readings) -> None:
    if m.slow_speed < 0.0:
        m.slow_speed = now.speed
        m.slow_acceleration = now.acceleration
    share = 1.0 - exp(-now.dt_s / INERTIA_FILTER_S)
    m.slow_speed += share * (now.speed - m.slow_speed)
    m.slow_acceleration += share * (now.acceleration - m.slow_acceleration)
    gained = (now.speed - m.slow_speed) / INERTIA_FILTER_S
    failed = abs(m.slow_acceleration - gained) > INERTIA_MS2
    m.inertia_fault_s = INERTIA.advance(
        m.inertia_fault_s, now.dt_s, failed=failed
    )
    _compare_direction(m, now.dt_s, gained)


def _compare_direction(m: CheckMemory, dt_s: float, gained: float) -> None:
    faded = dt_s / REVERSED_MEMORY_S
    m.agreement -= faded * m.agreement
    m.motion -= faded * m.motion
    if abs(gained) > REVERSED_MS2:
        m.agreement += m.slow_acceleration * gained * dt_s
        m.motion += gained * gained * dt_s
    failed = None
    if m.motion > REVERSED_MOTION:
        if m.agreement < -REVERSED_SHARE * m.motion:
            failed = True
        elif m.agreement > REVERSED_SHARE * m.motion:
            failed = False
    m.reversed_fault_s = REVERSED.advance(
        m.reversed_fault_s, dt_s, failed=failed
    )


def _compare_shares(
    m: CheckMemory, now: Readings, rate: float, accel: float
) -> None:
    if (
        m.band_s < BAND_RESTART_S
        or now.speed < BAND_SPEED_MS
        or now.intervenes
        or (abs(rate) < BAND_LEAST_MS2 and abs(accel) < BAND_LEAST_MS2)
    ):
        return
    m.rate_square += rate * rate * now.dt_s
    m.accel_square += accel * accel * now.dt_s
    m.accel_rate += accel * rate * now.dt_s
    square = m.rate_square * m.accel_square
    if square > SHARE_MOST * SHARE_MOST:
        faded = SHARE_MOST * SHARE_MOST / square
        m.rate_square *= faded
        m.accel_square *= faded
        m.accel_rate *= faded


def _compare_frozen(m: CheckMemory, now: Readings, accel: float) -> None:
    known = (v for v, speed in enumerate(now.speeds) if not isnan(speed))
    held_s = min((m.speed_held_s[v] for v in known), default=UNKNOWN)
    if held_s < FROZEN_SPEED_S:
        m.unmoved_square = m.tilted_s = 0.0
        m.standing_accel = m.band_slow_accel
    else:
        faded = now.dt_s / UNMOVED_S
        m.unmoved_square -= faded * m.unmoved_square
        m.unmoved_square += accel * accel * now.dt_s
        if m.tilted_s < 0.0:
            m.standing_accel, m.tilted_s = m.band_slow_accel, 0.0
        tilt = abs(m.band_slow_accel - m.standing_accel)
        if now.speed < STANDING_MS and tilt > TILT_MS2:
            m.tilted_s += now.dt_s
    failed = None
    if m.unmoved_square > UNMOVED_SQUARE or m.tilted_s > TILT_S:
        failed = True
    elif held_s < MOVES_S:
        failed = False
    m.unmoved_fault_s = STUCK.advance(
        m.unmoved_fault_s, now.dt_s, failed=failed
    )


def compare_turns(m: CheckMemory, now: Readings) -> None:
    """Compare what speed and yaw rate make of a bend with what is felt."""
    turn = now.speed * now.yaw_rate
    if (
        not abs(turn) > TURN_LEAST_MS2
        or isnan(now.lateral)
        or now.speed < TURN_SPEED_MS
        or now.intervenes
    ):
        return
    m.turn_square += turn * turn * now.dt_s
    m.lateral_square += now.lateral * now.lateral * now.dt_s
    m.turn_lateral += now.lateral * turn * now.dt_s
    if m.turn_square > TURN_MOST:
        faded = TURN_MOST / m.turn_square
        m.turn_square *= faded
        m.lateral_square *= faded
        m.turn_lateral *= faded


def too_slow_in_bends(m: CheckMemory) -> bool:
    """Whether bends are felt more than the speed explains."""
    product = abs(m.turn_lateral)
    return (
        m.turn_square > TURN_LEAST
        and product > TURN_LIMIT * m.turn_square
        and product * product
        > TURN_CORRELATION * m.turn_square * m.lateral_square
    )


def stand_shown(m: CheckMemory) -> bool:
    """Whether a live accelerometer shows none of the changes of speed."""
    return (
        m.accel_held_s < FROZEN_SPEED_S
        and m.slow_speed >= 0.0
        and m.motion > STAND_MOTION
        and abs(m.agreement) < STAND_SHARE * m.motion
    )


def contradicted(m: CheckMemory) -> bool:
    """Whether the accelerometer contradicts the speed."""
    return (
        m.inertia_fault_s >= INERTIA.comes_s
        or m.reversed_fault_s >= REVERSED.comes_s
    )


def wrong_scale(m: CheckMemory) -> bool:
    """Whether speed and accelerometer differ by a factor."""
    square = m.rate_square * m.accel_square
    beyond = m.accel_rate - SHARE_LIMIT * min(m.rate_square, m.accel_square)
    enough = square > SHARE_LEAST * SHARE_LEAST
    return (
        beyond > (0.0 if enough else SHARE_BEYOND)
        and m.accel_rate * m.accel_rate > SHARE_CORRELATION * square
    )


def leaps(m: CheckMemory, median: float) -> bool:
    """Whether the *median* of all speeds is far from that a step before."""
    return m.median_speed >= 0.0 and abs(median - m.median_speed) > LEAP_MS


def watch_leap(
    m: CheckMemory, now: Readings, median: float, count: int
) -> None:
    """Forget what proved the speeds where all of them leap."""
    change = abs(median - m.median_speed)
    if (
        count > 0
        and leaps(m, median)
        and abs(now.acceleration) * LEAP_S < change
        and not wrong_scale(m)
    ):
        m.rate_square = m.accel_square = m.accel_rate = 0.0
    m.median_speed = median if count > 0 else UNKNOWN


def unproven(m: CheckMemory, braked_j: float) -> bool:
    """Whether brakes took *braked_j* and no change of speed was compared."""
    square = m.rate_square * m.accel_square
    return braked_j > PROOF_J and square < PROOF_MS2 * PROOF_MS2


def all_frozen(m: CheckMemory) -> bool:
    """Whether no speed changes although the car moves."""
    return m.unmoved_fault_s >= STUCK.comes_s
