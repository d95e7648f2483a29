#include "checks.h"

#include "check_rules.h"
#include "motion_checks.h"
#include "pressure_checks.h"

#define NO_MOTION (FLAG_SPEED_SUSPECT | FLAG_ACCELERATION_SUSPECT)

static void hold(Checks *c, int64_t at, int role)
{
    c->t->until[role] = at + HOLD_US;
    if (c->t->until[role] > c->t->suspect_until)
        c->t->suspect_until = c->t->until[role];
}

int checks_admit_unusual(Checks *c, int64_t at, int role, double value)
{
    if (value < LIMITS[role].low || value > LIMITS[role].high) {
        c->t->out_of_range++;
        hold(c, at, role);
        return 0;
    }
    const int64_t first = c->t->jump_stamp[role];
    if (first == NEVER || at <= first
        || checks_jumped(role, value - c->m->jump_value[role], at - first)) {
        c->t->jump_stamp[role] = at;
        c->m->jump_value[role] = value;
        c->t->jumps_refused++;
        hold(c, at, role);
        return 0;
    }
    c->t->jump_stamp[role] = NEVER;
    return 1;
}

void checks_shift(Checks *c, int64_t ahead)
{
    for (int r = 0; r < ROLES; r++) {
        if (c->t->jump_stamp[r] != NEVER) c->t->jump_stamp[r] += ahead;
        if (c->t->until[r] != NEVER) c->t->until[r] += ahead;
    }
    if (c->t->last_sample != NEVER) c->t->last_sample += ahead;
    if (c->t->last_of_car != NEVER) c->t->last_of_car += ahead;
    if (c->t->suspect_until != NEVER) c->t->suspect_until += ahead;
}

void checks_settle(Checks *c)
{
    for (int i = 0; i < c->corners; i++)
        c->m->outage_s[i] = c->m->aftermath_s[i] = 0.0;
    c->m->air_k = c->m->air_fault_s = 0.0;
}

static double median(const double *value, int n, int *count)
{
    double sorted[MAX_SPEEDS];
    int k = 0;
    for (int i = 0; i < n; i++) {
        if (isnan(value[i])) continue;
        int at = k++;
        for (; at > 0 && sorted[at - 1] > value[i]; at--)
            sorted[at] = sorted[at - 1];
        sorted[at] = value[i];
    }
    *count = k;
    if (k == 0) return 0.0;
    if (k % 2) return sorted[k / 2];
    return 0.5 * (sorted[k / 2 - 1] + sorted[k / 2]);
}

static void compare_pair(Checks *c, const Readings *now, double middle,
                         double share)
{
    /* the median of two is their mean */
    double high = middle, low = middle;
    for (int v = 0; v <= c->corners; v++) {
        if (now->speeds[v] > high) high = now->speeds[v];
        if (now->speeds[v] < low) low = now->speeds[v];
    }
    int outcome = OPEN;
    if (high - low > DEVIATION_MS + share * high) outcome = FAILED;
    else if (middle > MOVING_MS) outcome = PASSED;
    c->m->pair_fault_s = check_rules_advance(DEVIATION, c->m->pair_fault_s, outcome, now->dt_s);
}

static void compare_scales(Checks *c, const Readings *now, double middle,
                           int count)
{
    double highest = 0.0, lowest = middle;
    for (int v = 0; v <= c->corners; v++) {
        if (now->speeds[v] > highest) highest = now->speeds[v];
        if (now->speeds[v] < lowest) lowest = now->speeds[v];
    }
    /* one that stands is dead, which is another check's; an intervention
       slows single wheels for many seconds */
    if (count < 3 || lowest <= STANDING_MS || highest < SCALE_MS
        || now->intervenes)
        return;
    const double share = 1.0 - exp(-now->dt_s / SCALE_S);
    for (int v = 0; v <= c->corners; v++) {
        if (isnan(now->speeds[v])) continue;
        const double error = now->speeds[v] / middle - 1.0;
        c->m->scale_error[v] += share * (error - c->m->scale_error[v]);
    }
}

/* Whether all wheels are stuck while the vehicle's speed changes. */
static int wheels_dead(const Checks *c, const Readings *now)
{
    int wheels = 0;
    if (isnan(now->speeds[c->corners])
        || c->m->speed_stuck_s[c->corners] >= STUCK.comes_s)
        return 0;
    for (int v = 0; v < c->corners; v++) {
        if (isnan(now->speeds[v])) continue;
        if (c->m->speed_stuck_s[v] < STUCK.comes_s) return 0;
        wheels++;
    }
    return wheels > 1;
}

static void compare_speeds(Checks *c, const Readings *now, double middle,
                           int count)
{
    const double share = now->braking ? DEVIATION_BRAKING : DEVIATION_SHARE;
    const double allowed = DEVIATION_MS + share * middle;
    int agreeing = 0;
    for (int v = 0; v <= c->corners; v++)
        agreeing += fabs(now->speeds[v] - middle) <= allowed;
    for (int v = 0; v <= c->corners; v++) {
        int outcome = OPEN;
        if (v == c->corners && wheels_dead(c, now)) outcome = PASSED;
        else if (count >= 3 && !isnan(now->speeds[v])) {
            if (fabs(c->m->scale_error[v]) > SCALE_LIMIT) outcome = FAILED;
            else if (fabs(now->speeds[v] - middle) > allowed)
                outcome = agreeing >= 2 ? FAILED : OPEN;
            else if (middle > MOVING_MS) outcome = PASSED;
        }
        c->m->deviation_fault_s[v] = check_rules_advance(DEVIATION, c->m->deviation_fault_s[v], outcome, now->dt_s);
    }
    if (count == 2 || (count > 2 && agreeing < 2))
        compare_pair(c, now, middle, share);
    else if (count > 2)
        c->m->pair_fault_s = check_rules_advance(DEVIATION, c->m->pair_fault_s,
            middle > MOVING_MS ? PASSED : OPEN, now->dt_s);
}

static void hold_speeds(Checks *c, const Readings *now, double middle,
                        int count)
{
    /* where some leap, the median changes for those that drive on */
    const int unsure = count > 2 && motion_checks_leaps(c->m, middle);
    /* all wheels may freeze together: they are in one message */
    const double vehicle = now->speeds[c->corners];
    int held = !isnan(vehicle);
    for (int v = 0; v < c->corners; v++)
        if (!isnan(now->speeds[v])
            && (now->speeds[v] != c->m->speed_held[v]
                || !(c->m->speed_held_s[v] > MOVES_S)))
            held = 0;
    if (!held) c->m->vehicle_mark = vehicle;
    const int frozen =
        count > 2 && fabs(vehicle - c->m->vehicle_mark) > FROZEN_SPEED_MS;
    for (int v = 0; v <= c->corners; v++) {
        const double speed = now->speeds[v];
        const double other = count == 2 ? 2.0 * middle - speed : middle;
        if (isnan(speed) || speed != c->m->speed_held[v]) {
            c->m->speed_held[v] = isnan(speed) ? 0.0 : speed;
            c->m->speed_held_s[v] = 0.0;
            c->m->speed_mark[v] = isnan(other) ? 0.0 : other;
        } else c->m->speed_held_s[v] += now->dt_s;
        if (unsure) c->m->speed_mark[v] = isnan(other) ? 0.0 : other;
        int outcome = OPEN;
        if (count >= 2 && !isnan(speed)) {
            if (c->m->speed_held_s[v] < MOVES_S) outcome = PASSED;
            else if (c->m->speed_held_s[v] >= FROZEN_SPEED_S
                     && (frozen || fabs(other - c->m->speed_mark[v])
                                       > FROZEN_SPEED_MS))
                outcome = FAILED;
        }
        c->m->speed_stuck_s[v] = check_rules_advance(STUCK, c->m->speed_stuck_s[v], outcome, now->dt_s);
        c->m->left_out[v] = c->m->deviation_fault_s[v] >= DEVIATION.comes_s
            || c->m->speed_stuck_s[v] >= STUCK.comes_s ? 1.0 : 0.0;
    }
}

static void compare_air(Checks *c, const Readings *now)
{
    CheckMemoryFloats *m = c->m;
    int outcome = OPEN;
    if (!isnan(now->ambient_k)) {
        const double above_k = now->ambient_k - LOWEST_CODE_K;
        outcome = fabs(above_k) < LOWEST_CODE_WITHIN_K ? FAILED : PASSED;
    }
    m->lowest_code_s =
        check_rules_advance(LOWEST_CODE, m->lowest_code_s, outcome, now->dt_s);
    outcome = OPEN;
    if (isnan(now->ambient_k)) m->air_k -= AIR_NIGHT_K_S * now->dt_s;
    else {
        if (m->air_fault_s < AIR_FELL.comes_s)
            m->air_k -= AIR_FALL_K_S * now->dt_s;
        if (m->air_k < now->ambient_k) m->air_k = now->ambient_k;
        outcome = now->ambient_k < m->air_k - AIR_FELL_K ? FAILED : PASSED;
    }
    m->air_fault_s =
        check_rules_advance(AIR_FELL, m->air_fault_s, outcome, now->dt_s);
}

static int64_t pressure_flags(const Checks *c, const Readings *now, int which)
{
    int64_t flags = FLAG_PRESSURE_SUSPECT;
    for (int i = 0; i < c->corners; i++)
        if (now->pressure_of[i] == which) flags |= CORNER_PRESSURE_SUSPECT << i;
    return flags;
}

static int64_t motion_flags(const Checks *c, const Readings *now)
{
    int64_t flags = 0;
    if (now->speed_known && motion_checks_all_frozen(c->m))
        flags |= FLAG_SPEED_SUSPECT | FLAG_STUCK;
    if (now->speed_known && motion_checks_too_slow_in_bends(c->m))
        flags |= FLAG_SPEED_SUSPECT | FLAG_ACCELERATION_CONTRADICTS;
    if (isnan(now->acceleration)) return flags;
    if (motion_checks_contradicted(c->m))
        flags |= FLAG_ACCELERATION_SUSPECT | FLAG_ACCELERATION_CONTRADICTS;
    /* nobody knows which of the two it is */
    if (now->speed_known && motion_checks_wrong_scale(c->m))
        flags |= NO_MOTION | FLAG_ACCELERATION_CONTRADICTS;
    return flags;
}

/* Bits of the checks of whole steps; absent inputs have none. */
static int64_t contradictions(const Checks *c, const Readings *now, int count)
{
    int64_t flags = 0;
    const int apart = c->m->pair_fault_s >= DEVIATION.comes_s;
    const int pair = count == 2 && apart;
    int left_out = 0;
    for (int v = 0; v <= c->corners; v++) {
        if (c->m->left_out[v] != 0.0) left_out = 1;
        if (isnan(now->speeds[v])) continue;
        if ((pair || c->m->left_out[v] != 0.0) && v < c->corners)
            flags |= WHEEL_SUSPECT << v;
        if (pair || c->m->deviation_fault_s[v] >= DEVIATION.comes_s)
            flags |= FLAG_WHEELS_CONTRADICT;
        if (c->m->speed_stuck_s[v] >= STUCK.comes_s) flags |= FLAG_STUCK;
    }
    /* two against two, and none of them is stuck */
    if (count > 2 && apart && !left_out)
        flags |= FLAG_WHEELS_CONTRADICT | FLAG_SPEED_SUSPECT;
    /* of the wheels and the vehicle's speed nobody knows which is right */
    const int vehicle = !isnan(now->speeds[c->corners])
        && fabs(c->m->scale_error[c->corners]) > SCALE_LIMIT;
    if (pair || vehicle || wheels_dead(c, now)) flags |= FLAG_SPEED_SUSPECT;
    const int without_switch =
        c->m->switch_fault_s >= SWITCH.comes_s && !isnan(now->brake_switch);
    for (int i = 0; i < c->corners + 2; i++) {
        if (isnan(now->pressures[i])) continue;
        const int stuck = c->m->pressure_stuck_s[i] >= STUCK.comes_s;
        const int alone = without_switch && i == 0;
        const int off = c->m->zero_fault_s[i] >= ZERO.comes_s;
        if (off) flags |= FLAG_PRESSURE_CONTRADICTS;
        if (stuck) flags |= FLAG_STUCK;
        if (alone) flags |= FLAG_SWITCH_CONTRADICTS;
        if (stuck || alone || off) flags |= pressure_flags(c, now, i);
    }
    for (int i = 0; i < c->corners; i++)
        if (c->m->twin_fault_s[c->options->place[i] / 2] >= TWIN.comes_s
            || c->m->twin_fault_s[2] >= TWIN.comes_s)
            flags |= FLAG_PRESSURE_SUSPECT | FLAG_PRESSURE_CONTRADICTS
                | CORNER_PRESSURE_SUSPECT << i;
    if (c->m->lowest_code_s >= LOWEST_CODE.comes_s
        || c->m->air_fault_s >= AIR_FELL.comes_s)
        flags |= FLAG_AMBIENT_SUSPECT;
    return flags | motion_flags(c, now);
}

static int suspect(const Checks *c, int64_t now, int role)
{
    return c->plan->timeout[role] >= 0.0 && now <= c->t->until[role];
}

/* Bits of the roles with recently rejected samples. */
static int64_t held_flags(const Checks *c, const Readings *now)
{
    int64_t flags = FLAG_SAMPLES_REFUSED;
    for (int i = 0; i < c->corners; i++)
        if (suspect(c, now->now, c->speed_role[i]))
            flags |= WHEEL_SUSPECT << i;
    if (suspect(c, now->now, c->speed_role[c->corners]))
        flags |= FLAG_SPEED_SUSPECT;
    for (int i = 0; i < c->corners + 2; i++)
        if (suspect(c, now->now, c->pressure_role[i]))
            flags |= pressure_flags(c, now, i);
    if (suspect(c, now->now, c->acceleration_role))
        flags |= FLAG_ACCELERATION_SUSPECT;
    if (suspect(c, now->now, c->torque_role)) flags |= FLAG_TORQUE_SUSPECT;
    for (int i = 0; i < c->temperatures; i++)
        if (suspect(c, now->now, c->temperature_role[i]))
            flags |= FLAG_TEMPERATURE_SUSPECT;
    return flags;
}

/* The bit of a suspect speed: no sound one is left. */
static int64_t speed_flags(const Checks *c, const Readings *now, int64_t flags)
{
    const int last = c->corners;
    int present = !isnan(now->speeds[last]);
    if (present && c->m->left_out[last] == 0.0) return 0;
    for (int i = 0; i < last; i++) {
        if (isnan(now->speeds[i])) continue;
        present = 1;
        if (!(flags & (WHEEL_SUSPECT << i))) return 0;
    }
    return present ? FLAG_SPEED_SUSPECT : 0;
}

/* Time the outages of each corner's heat; returns their bits. */
static int64_t outages(Checks *c, const Readings *now)
{
    int64_t flags = 0;
    const int64_t last = c->t->last_sample;
    const int silent = last == NEVER || now->now - last > SILENT_US;
    if (silent) flags |= FLAG_SILENT;
    if (now->speed_known) c->m->last_speed = now->speed;
    for (int i = 0; i < c->corners; i++) {
        if (!silent && now->at_risk[i] && !now->heat_known[i]) {
            c->m->outage_s[i] += now->dt_s;
            flags |= FLAG_HEAT_UNKNOWN;
            if (c->m->outage_s[i] > OUTAGE_S) {
                const double counts_s = OUTAGE_MEMORY * c->m->outage_s[i];
                c->m->aftermath_s[i] =
                    counts_s < c->plan->settling_s ? counts_s : c->plan->settling_s;
                flags |= HEAT_LOST << i;
            }
            continue;
        }
        const double outage = c->m->outage_s[i] - now->dt_s / OUTAGE_MEMORY;
        c->m->outage_s[i] = outage > 0.0 ? outage : 0.0;
        if (c->m->aftermath_s[i] > 0.0) {
            const double aftermath = c->m->aftermath_s[i] - now->dt_s;
            c->m->aftermath_s[i] = aftermath > 0.0 ? aftermath : 0.0;
            flags |= HEAT_UNCERTAIN << i;
        }
    }
    return flags;
}

/* The bit of a bus that sleeps because the car is parked. */
static int64_t sleeps(Checks *c, const Readings *now)
{
    CheckMemoryFloats *m = c->m;
    const int64_t last = c->t->last_of_car;
    const int silent = last == NEVER || now->now - last > SILENT_US;
    if (now->speed_known && (now->speed > STANDING_MS || now->braking)) {
        m->parked_s = 0.0;
    } else if (now->speed_known && !isnan(now->secured)) {
        m->parked_s = now->secured > 0.0 ? m->parked_s + now->dt_s : 0.0;
        m->unproven_s = 0.0;
    } else if (!silent) {
        m->unproven_s += now->dt_s;
        if (m->unproven_s > UNPROVEN_S) m->parked_s = 0.0;
    }
    return silent && m->parked_s >= PARKED_S ? FLAG_ASLEEP : 0;
}

int64_t checks_close(Checks *c, const Readings *now)
{
    int count;
    const double middle = median(now->speeds, c->corners + 1, &count);
    compare_scales(c, now, middle, count);
    compare_speeds(c, now, middle, count);
    hold_speeds(c, now, middle, count);
    int64_t refused = 0;
    if (now->now <= c->t->suspect_until) {
        refused = held_flags(c, now);
        refused |= speed_flags(c, now, refused);
    }
    /* a change of a suspect speed does not count as driving */
    pressure_checks_hold_pressures(c->m, now, c->corners + 2,
                                   (refused & FLAG_SPEED_SUSPECT) != 0);
    pressure_checks_compare_switch(c->m, now);
    pressure_checks_compare_zero(c->m, now, c->corners + 2);
    pressure_checks_compare_twins(c->m, now);
    motion_checks_watch_leap(c->m, now, middle, count);
    motion_checks_compare_motion(c->m, now, c->corners + 1,
                                 (refused & NO_MOTION) != 0);
    motion_checks_compare_turns(c->m, now);
    compare_air(c, now);
    int64_t flags = contradictions(c, now, count) | refused;
    flags |= speed_flags(c, now, flags);
    return flags | outages(c, now) | sleeps(c, now);
}
