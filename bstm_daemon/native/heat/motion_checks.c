#include "motion_checks.h"

#include "check_rules.h"

static void compare_direction(CheckMemoryFloats *m, double dt_s, double gained)
{
    const double faded = dt_s / REVERSED_MEMORY_S;
    m->agreement -= faded * m->agreement;
    m->motion -= faded * m->motion;
    if (fabs(gained) > REVERSED_MS2) {
        m->agreement += m->slow_acceleration * gained * dt_s;
        m->motion += gained * gained * dt_s;
    }
    int outcome = OPEN;
    if (m->motion > REVERSED_MOTION) {
        if (m->agreement < -REVERSED_SHARE * m->motion) outcome = FAILED;
        else if (m->agreement > REVERSED_SHARE * m->motion) outcome = PASSED;
    }
    m->reversed_fault_s =
        check_rules_advance(REVERSED, m->reversed_fault_s, outcome, dt_s);
}

static void compare_inertia(CheckMemoryFloats *m, const Readings *now)
{
    if (m->slow_speed < 0.0) {
        m->slow_speed = now->speed;
        m->slow_acceleration = now->acceleration;
    }
    const double share = 1.0 - exp(-now->dt_s / INERTIA_FILTER_S);
    m->slow_speed += share * (now->speed - m->slow_speed);
    m->slow_acceleration +=
        share * (now->acceleration - m->slow_acceleration);
    const double gained = (now->speed - m->slow_speed) / INERTIA_FILTER_S;
    const int failed = fabs(m->slow_acceleration - gained) > INERTIA_MS2;
    m->inertia_fault_s = check_rules_advance(INERTIA, m->inertia_fault_s,
                                        failed ? FAILED : PASSED, now->dt_s);
    compare_direction(m, now->dt_s, gained);
}

static void compare_shares(CheckMemoryFloats *m, const Readings *now,
                           double rate, double accel)
{
    if (m->band_s < BAND_RESTART_S || now->speed < BAND_SPEED_MS
        || now->intervenes
        || (fabs(rate) < BAND_LEAST_MS2 && fabs(accel) < BAND_LEAST_MS2))
        return;
    m->rate_square += rate * rate * now->dt_s;
    m->accel_square += accel * accel * now->dt_s;
    m->accel_rate += accel * rate * now->dt_s;
    const double square = m->rate_square * m->accel_square;
    if (square > SHARE_MOST * SHARE_MOST) {
        const double faded = SHARE_MOST * SHARE_MOST / square;
        m->rate_square *= faded;
        m->accel_square *= faded;
        m->accel_rate *= faded;
    }
}

static void compare_frozen(CheckMemoryFloats *m, const Readings *now,
                           int speeds, double accel)
{
    double held_s = UNKNOWN;
    for (int v = 0; v < speeds; v++)
        if (!isnan(now->speeds[v])
            && (held_s == UNKNOWN || m->speed_held_s[v] < held_s))
            held_s = m->speed_held_s[v];
    if (held_s < FROZEN_SPEED_S) {
        m->unmoved_square = m->tilted_s = 0.0;
        m->standing_accel = m->band_slow_accel;
    } else {
        const double faded = now->dt_s / UNMOVED_S;
        m->unmoved_square -= faded * m->unmoved_square;
        m->unmoved_square += accel * accel * now->dt_s;
        if (m->tilted_s < 0.0) {
            m->standing_accel = m->band_slow_accel;
            m->tilted_s = 0.0;
        }
        const double tilt = fabs(m->band_slow_accel - m->standing_accel);
        if (now->speed < STANDING_MS && tilt > TILT_MS2)
            m->tilted_s += now->dt_s;
    }
    int outcome = OPEN;
    if (m->unmoved_square > UNMOVED_SQUARE || m->tilted_s > TILT_S)
        outcome = FAILED;
    else if (held_s < MOVES_S) outcome = PASSED;
    m->unmoved_fault_s =
        check_rules_advance(STUCK, m->unmoved_fault_s, outcome, now->dt_s);
}

void motion_checks_compare_motion(CheckMemoryFloats *m, const Readings *now,
                                  int speeds, int noise)
{
    if (now->acceleration != m->accel_held) {
        m->accel_held = now->acceleration;
        m->accel_held_s = 0.0;
    }
    m->accel_held_s += now->dt_s;
    if (isnan(now->acceleration) || !now->speed_known || noise) {
        m->slow_speed = m->band_speed = UNKNOWN;
        m->unmoved_square = 0.0;
        m->tilted_s = UNKNOWN;
        return;
    }
    double rate = (now->speed - m->band_speed) / now->dt_s;
    if (m->band_speed < 0.0 || fabs(rate) > BAND_RATE_MS2) {
        m->slow_speed = UNKNOWN;
        m->band_accel = m->band_slow_accel = now->acceleration;
        m->band_rate = m->band_slow_rate = m->band_s = rate = 0.0;
    }
    compare_inertia(m, now);
    m->band_speed = now->speed;
    const double quick = 1.0 - exp(-now->dt_s / BAND_QUICK_S);
    const double slow = 1.0 - exp(-now->dt_s / BAND_SLOW_S);
    m->band_rate += quick * (rate - m->band_rate);
    m->band_accel += quick * (now->acceleration - m->band_accel);
    m->band_slow_rate += slow * (m->band_rate - m->band_slow_rate);
    m->band_slow_accel += slow * (m->band_accel - m->band_slow_accel);
    m->band_s += now->dt_s;
    const double accel = m->band_accel - m->band_slow_accel;
    compare_shares(m, now, m->band_rate - m->band_slow_rate, accel);
    compare_frozen(m, now, speeds, accel);
}

void motion_checks_compare_turns(CheckMemoryFloats *m, const Readings *now)
{
    const double turn = now->speed * now->yaw_rate;
    if (!(fabs(turn) > TURN_LEAST_MS2) || isnan(now->lateral)
        || now->speed < TURN_SPEED_MS || now->intervenes)
        return;
    m->turn_square += turn * turn * now->dt_s;
    m->lateral_square += now->lateral * now->lateral * now->dt_s;
    m->turn_lateral += now->lateral * turn * now->dt_s;
    if (m->turn_square > TURN_MOST) {
        const double faded = TURN_MOST / m->turn_square;
        m->turn_square *= faded;
        m->lateral_square *= faded;
        m->turn_lateral *= faded;
    }
}

int motion_checks_too_slow_in_bends(const CheckMemoryFloats *m)
{
    const double product = fabs(m->turn_lateral);
    return m->turn_square > TURN_LEAST
        && product > TURN_LIMIT * m->turn_square
        && product * product
            > TURN_CORRELATION * m->turn_square * m->lateral_square;
}

int motion_checks_stand_shown(const CheckMemoryFloats *m)
{
    return m->accel_held_s < FROZEN_SPEED_S && m->slow_speed >= 0.0
        && m->motion > STAND_MOTION
        && fabs(m->agreement) < STAND_SHARE * m->motion;
}

int motion_checks_contradicted(const CheckMemoryFloats *m)
{
    return m->inertia_fault_s >= INERTIA.comes_s
        || m->reversed_fault_s >= REVERSED.comes_s;
}

int motion_checks_wrong_scale(const CheckMemoryFloats *m)
{
    const double square = m->rate_square * m->accel_square;
    const double least = m->accel_square < m->rate_square ? m->accel_square
                                                          : m->rate_square;
    const double beyond = m->accel_rate - SHARE_LIMIT * least;
    return beyond > (square > SHARE_LEAST * SHARE_LEAST ? 0.0 : SHARE_BEYOND)
        && m->accel_rate * m->accel_rate > SHARE_CORRELATION * square;
}

int motion_checks_leaps(const CheckMemoryFloats *m, double median)
{
    return m->median_speed >= 0.0 && fabs(median - m->median_speed) > LEAP_MS;
}

void motion_checks_watch_leap(CheckMemoryFloats *m, const Readings *now,
                              double median, int count)
{
    const double change = fabs(median - m->median_speed);
    if (count > 0 && motion_checks_leaps(m, median)
        && fabs(now->acceleration) * LEAP_S < change
        && !motion_checks_wrong_scale(m))
        m->rate_square = m->accel_square = m->accel_rate = 0.0;
    m->median_speed = count > 0 ? median : UNKNOWN;
}

int motion_checks_unproven(const CheckMemoryFloats *m, double braked_j)
{
    const double square = m->rate_square * m->accel_square;
    return braked_j > PROOF_J && square < PROOF_MS2 * PROOF_MS2;
}

int motion_checks_all_frozen(const CheckMemoryFloats *m)
{
    return m->unmoved_fault_s >= STUCK.comes_s;
}
