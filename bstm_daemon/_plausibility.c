/* The compiled checks of the inputs: the operations of heat/checks.py in the
 * same order. Nothing here knows Python.
 */
#include "_plausibility.h"

#define HOLD_US INT64_C(2000000)
#define SILENT_US INT64_C(1000000)
#define APART_MS 2.0
#define APART_SHARE 0.2
#define APART_BRAKING 0.35
#define MOVING_MS 3.0
#define FROZEN_SPEED_S 5.0
#define FROZEN_SPEED_MS 3.0
#define FROZEN_PRESSURE_S 30.0
#define FROZEN_PRESSURE_MS 5.0
#define FROZEN_PRESSURE_PA 3e5
#define MOVES_S 1.0
#define SWITCH_PRESSURE_PA 5e5
#define SWITCH_MS 1.0
#define INERTIA_FILTER_S 2.0
#define INERTIA_MS2 4.0
#define REVERSED_MEMORY_S 120.0
#define REVERSED_MS2 2.0
#define REVERSED_MOTION 40.0
#define REVERSED_SHARE 0.2
#define OUTAGE_S 10.0
#define OUTAGE_MEMORY 30.0

#define BIT(n) (INT64_C(1) << (n))
#define SPEED_SUSPECT BIT(11)
#define PRESSURE_SUSPECT BIT(12)
#define ACCELERATION_SUSPECT BIT(13)
#define TORQUE_SUSPECT BIT(14)
#define TEMPERATURE_SUSPECT BIT(15)
#define SAMPLES_REFUSED BIT(16)
#define STUCK_BIT BIT(17)
#define SWITCH_CONTRADICTS BIT(18)
#define WHEELS_CONTRADICT BIT(19)
#define ACCELERATION_CONTRADICTS BIT(20)
#define HEAT_UNKNOWN BIT(22)
#define SILENT BIT(23)
#define WHEEL_SUSPECT(corner) BIT(24 + (corner))
#define CORNER_PRESSURE_SUSPECT(corner) BIT(28 + (corner))
#define HEAT_LOST(corner) BIT(32 + (corner))
#define HEAT_DOUBT(corner) BIT(36 + (corner))

enum {
    N_SLOW_SPEED, N_SLOW_ACCELERATION, N_INERTIA, N_SWITCH, N_PAIR,
    N_LAST_SPEED, N_AGREEMENT, N_MOTION, N_REVERSED, CHECK_NUMBERS
};
enum { CORNER_CHECKS = 2, VOICE_CHECKS = 6, PRESSURE_CHECKS = 4 };

enum { PASSED, FAILED, OPEN };

typedef struct {
    double comes_s, goes_s;
} Hysteresis;

static const Hysteresis CONTRADICTION = {2.0, 10.0};
static const Hysteresis STUCK = {1.0, 10.0};
static const Hysteresis SWITCH = {1.0, 10.0};
static const Hysteresis INERTIA = {5.0, 20.0};
static const Hysteresis REVERSED = {1.0, 20.0};

static double after(Hysteresis h, double doubt_s, int outcome, double dt_s)
{
    if (outcome == OPEN) return doubt_s;
    const int latched = doubt_s >= h.comes_s;
    if (outcome == FAILED) {
        doubt_s = doubt_s + dt_s;
        if (latched || doubt_s >= h.comes_s) return h.comes_s + h.goes_s;
        return doubt_s;
    }
    doubt_s = doubt_s - dt_s;
    return doubt_s <= (latched ? h.comes_s : 0.0) ? 0.0 : doubt_s;
}

ptrdiff_t bstm_checks_times(int roles) { return CHECK_TIMES + 2 * roles; }

ptrdiff_t bstm_checks_numbers(int corners, int roles)
{
    return CHECK_NUMBERS + roles + CORNER_CHECKS * corners
        + VOICE_CHECKS * (corners + 1) + PRESSURE_CHECKS * (corners + 2);
}

void bstm_checks_bind(Checks *c, int64_t *times, double *numbers, double dt_s)
{
    const int k = c->corners;
    c->share = 1.0 - exp(-dt_s / INERTIA_FILTER_S);
    c->t = times;
    c->candidate_stamp = times + CHECK_TIMES;
    c->until = c->candidate_stamp + c->roles;
    c->n = numbers;
    c->candidate = numbers + CHECK_NUMBERS;
    double *at = c->candidate + c->roles;
    double **corner[CORNER_CHECKS] = {&c->outage, &c->doubt};
    double **voice[VOICE_CHECKS] = {&c->apart, &c->held, &c->held_s, &c->mark,
                                    &c->stuck, &c->left_out};
    double **pressure[PRESSURE_CHECKS] = {&c->p_held, &c->p_held_s,
                                          &c->p_mark, &c->p_stuck};
    for (int i = 0; i < CORNER_CHECKS; i++, at += k) *corner[i] = at;
    for (int i = 0; i < VOICE_CHECKS; i++, at += k + 1) *voice[i] = at;
    for (int i = 0; i < PRESSURE_CHECKS; i++, at += k + 2) *pressure[i] = at;
    c->any_left_out = 0;
    for (int v = 0; v <= k; v++)
        if (c->left_out[v] != 0.0) c->any_left_out = 1;
}

double bstm_last_speed(const Checks *c) { return c->n[N_LAST_SPEED]; }

static void hold(Checks *c, int64_t at, int role)
{
    c->until[role] = at + HOLD_US;
    if (c->until[role] > c->t[T_SUSPECT_UNTIL])
        c->t[T_SUSPECT_UNTIL] = c->until[role];
}

int bstm_checks_doubt(Checks *c, int64_t at, int role, double value)
{
    if (value < c->low[role] || value > c->high[role]) {
        c->t[T_OUT_OF_RANGE]++;
        hold(c, at, role);
        return 0;
    }
    const int64_t first = c->candidate_stamp[role];
    if (first == NEVER || at <= first
        || bstm_apart(c, role, value - c->candidate[role], at - first)) {
        c->candidate_stamp[role] = at;
        c->candidate[role] = value;
        c->t[T_REFUSED]++;
        hold(c, at, role);
        return 0;
    }
    c->candidate_stamp[role] = NEVER;
    return 1;
}

void bstm_checks_shift(Checks *c, int64_t ahead)
{
    for (int r = 0; r < c->roles; r++) {
        if (c->candidate_stamp[r] != NEVER) c->candidate_stamp[r] += ahead;
        if (c->until[r] != NEVER) c->until[r] += ahead;
    }
    if (c->t[T_HEARD] != NEVER) c->t[T_HEARD] += ahead;
    if (c->t[T_SUSPECT_UNTIL] != NEVER) c->t[T_SUSPECT_UNTIL] += ahead;
}

void bstm_checks_settle(Checks *c)
{
    for (int i = 0; i < c->corners; i++) c->outage[i] = c->doubt[i] = 0.0;
}

static double median(const double *value, int n, int *count)
{
    double sorted[MAX_VOICES];
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
        if (now->voice[v] > high) high = now->voice[v];
        if (now->voice[v] < low) low = now->voice[v];
    }
    int outcome = OPEN;
    if (high - low > APART_MS + share * high) outcome = FAILED;
    else if (middle > MOVING_MS) outcome = PASSED;
    c->n[N_PAIR] = after(CONTRADICTION, c->n[N_PAIR], outcome, now->dt_s);
}

static void compare_speeds(Checks *c, const Readings *now, double middle,
                           int count)
{
    const double share = now->braking ? APART_BRAKING : APART_SHARE;
    const double allowed = APART_MS + share * middle;
    int agreeing = 0;
    for (int v = 0; v <= c->corners; v++)
        agreeing += fabs(now->voice[v] - middle) <= allowed;
    for (int v = 0; v <= c->corners; v++) {
        int outcome = OPEN;
        if (count >= 3 && !isnan(now->voice[v])) {
            if (fabs(now->voice[v] - middle) > allowed)
                outcome = agreeing >= 2 ? FAILED : OPEN;
            else if (middle > MOVING_MS) outcome = PASSED;
        }
        c->apart[v] = after(CONTRADICTION, c->apart[v], outcome, now->dt_s);
    }
    if (count == 2) compare_pair(c, now, middle, share);
}

static void hold_speeds(Checks *c, const Readings *now, double middle,
                        int count)
{
    c->any_left_out = 0;
    for (int v = 0; v <= c->corners; v++) {
        const double voice = now->voice[v];
        const double other = count == 2 ? 2.0 * middle - voice : middle;
        if (isnan(voice) || voice != c->held[v]) {
            c->held[v] = isnan(voice) ? 0.0 : voice;
            c->held_s[v] = 0.0;
            c->mark[v] = isnan(other) ? 0.0 : other;
        } else c->held_s[v] += now->dt_s;
        int outcome = OPEN;
        if (count >= 2 && !isnan(voice)) {
            if (c->held_s[v] < MOVES_S) outcome = PASSED;
            else if (c->held_s[v] >= FROZEN_SPEED_S
                     && fabs(other - c->mark[v]) > FROZEN_SPEED_MS)
                outcome = FAILED;
        }
        c->stuck[v] = after(STUCK, c->stuck[v], outcome, now->dt_s);
        c->left_out[v] = c->apart[v] >= CONTRADICTION.comes_s
            || c->stuck[v] >= STUCK.comes_s ? 1.0 : 0.0;
        if (c->left_out[v] != 0.0) c->any_left_out = 1;
    }
}

static void hold_pressures(Checks *c, const Readings *now, int64_t refused)
{
    /* what noise made of the speed is no driving */
    const int unsure = (refused & SPEED_SUSPECT) != 0;
    for (int i = 0; i < c->corners + 2; i++) {
        const double pressure = now->pressure[i];
        if (isnan(pressure) || pressure != c->p_held[i]) {
            c->p_held[i] = isnan(pressure) ? 0.0 : pressure;
            c->p_held_s[i] = 0.0;
            c->p_mark[i] = now->speed;
        } else c->p_held_s[i] += now->dt_s;
        if (unsure) c->p_mark[i] = now->speed;
        int outcome = OPEN;
        if (!isnan(pressure) && now->speed_known) {
            if (pressure <= FROZEN_PRESSURE_PA || c->p_held_s[i] < MOVES_S)
                outcome = PASSED;
            else if (c->p_held_s[i] >= FROZEN_PRESSURE_S
                     && fabs(now->speed - c->p_mark[i]) > FROZEN_PRESSURE_MS)
                outcome = FAILED;
        }
        c->p_stuck[i] = after(STUCK, c->p_stuck[i], outcome, now->dt_s);
    }
}

static void compare_switch(Checks *c, const Readings *now)
{
    /* only the pedal's own pressure: assistance fills the other circuits */
    int outcome = OPEN;
    const double primary = now->pressure[0];
    if (!isnan(primary) && now->speed > SWITCH_MS
        && !isnan(now->brake_switch) && now->esc_active == 0.0)
        outcome = primary > SWITCH_PRESSURE_PA && now->brake_switch == 0.0
            ? FAILED : PASSED;
    c->n[N_SWITCH] = after(SWITCH, c->n[N_SWITCH], outcome, now->dt_s);
}

static void compare_direction(Checks *c, double dt_s, double gained)
{
    double *n = c->n;
    const double faded = dt_s / REVERSED_MEMORY_S;
    n[N_AGREEMENT] -= faded * n[N_AGREEMENT];
    n[N_MOTION] -= faded * n[N_MOTION];
    if (fabs(gained) > REVERSED_MS2) {
        n[N_AGREEMENT] += n[N_SLOW_ACCELERATION] * gained * dt_s;
        n[N_MOTION] += gained * gained * dt_s;
    }
    int outcome = OPEN;
    if (n[N_MOTION] > REVERSED_MOTION) {
        if (n[N_AGREEMENT] < -REVERSED_SHARE * n[N_MOTION]) outcome = FAILED;
        else if (n[N_AGREEMENT] > REVERSED_SHARE * n[N_MOTION])
            outcome = PASSED;
    }
    n[N_REVERSED] = after(REVERSED, n[N_REVERSED], outcome, dt_s);
}

static void compare_inertia(Checks *c, const Readings *now, int64_t refused)
{
    double *n = c->n;
    const int64_t noise = refused & (SPEED_SUSPECT | ACCELERATION_SUSPECT);
    if (isnan(now->acceleration) || !now->speed_known || noise) {
        n[N_SLOW_SPEED] = UNKNOWN;
        return;
    }
    if (n[N_SLOW_SPEED] < 0.0) {
        n[N_SLOW_SPEED] = now->speed;
        n[N_SLOW_ACCELERATION] = now->acceleration;
    }
    n[N_SLOW_SPEED] += c->share * (now->speed - n[N_SLOW_SPEED]);
    n[N_SLOW_ACCELERATION] +=
        c->share * (now->acceleration - n[N_SLOW_ACCELERATION]);
    const double gained = (now->speed - n[N_SLOW_SPEED]) / INERTIA_FILTER_S;
    const int failed = fabs(n[N_SLOW_ACCELERATION] - gained) > INERTIA_MS2;
    n[N_INERTIA] = after(INERTIA, n[N_INERTIA], failed ? FAILED : PASSED,
                         now->dt_s);
    compare_direction(c, now->dt_s, gained);
}

static int64_t pressure_flags(const Checks *c, const Readings *now, int which)
{
    int64_t flags = PRESSURE_SUSPECT;
    for (int i = 0; i < c->corners; i++)
        if (now->source[i] == which) flags |= CORNER_PRESSURE_SUSPECT(i);
    return flags;
}

/* Bits of the checks of whole steps; absent inputs have none. */
static int64_t contradictions(const Checks *c, const Readings *now, int count)
{
    int64_t flags = 0;
    const int pair = count == 2 && c->n[N_PAIR] >= CONTRADICTION.comes_s;
    for (int v = 0; v <= c->corners; v++) {
        if (isnan(now->voice[v])) continue;
        if ((pair || c->left_out[v] != 0.0) && v < c->corners)
            flags |= WHEEL_SUSPECT(v);
        if (pair || c->apart[v] >= CONTRADICTION.comes_s)
            flags |= WHEELS_CONTRADICT;
        if (c->stuck[v] >= STUCK.comes_s) flags |= STUCK_BIT;
    }
    if (pair) flags |= SPEED_SUSPECT;
    const int without_switch =
        c->n[N_SWITCH] >= SWITCH.comes_s && !isnan(now->brake_switch);
    for (int i = 0; i < c->corners + 2; i++) {
        if (isnan(now->pressure[i])) continue;
        const int stuck = c->p_stuck[i] >= STUCK.comes_s;
        const int alone = without_switch && i == 0;
        if (stuck) flags |= STUCK_BIT;
        if (alone) flags |= SWITCH_CONTRADICTS;
        if (stuck || alone) flags |= pressure_flags(c, now, i);
    }
    const int contradicted = c->n[N_INERTIA] >= INERTIA.comes_s
        || c->n[N_REVERSED] >= REVERSED.comes_s;
    if (contradicted && !isnan(now->acceleration))
        flags |= ACCELERATION_SUSPECT | ACCELERATION_CONTRADICTS;
    return flags;
}

static int suspect(const Checks *c, int64_t now, int role)
{
    return role >= 0 && now <= c->until[role];
}

/* Bits of the roles that have refused samples of late. */
static int64_t held_flags(const Checks *c, const Readings *now)
{
    int64_t flags = SAMPLES_REFUSED;
    for (int i = 0; i < c->corners; i++)
        if (suspect(c, now->now, c->voice_role[i])) flags |= WHEEL_SUSPECT(i);
    if (suspect(c, now->now, c->voice_role[c->corners]))
        flags |= SPEED_SUSPECT;
    for (int i = 0; i < c->corners + 2; i++)
        if (suspect(c, now->now, c->pressure_role[i]))
            flags |= pressure_flags(c, now, i);
    if (suspect(c, now->now, c->acceleration_role))
        flags |= ACCELERATION_SUSPECT;
    if (suspect(c, now->now, c->torque_role)) flags |= TORQUE_SUSPECT;
    for (int i = 0; i < c->temperatures; i++)
        if (suspect(c, now->now, c->temperature_role[i]))
            flags |= TEMPERATURE_SUSPECT;
    return flags;
}

/* The speed is suspect where no sound voice is left. */
static int64_t speed_flags(const Checks *c, const Readings *now, int64_t flags)
{
    const int last = c->corners;
    int present = !isnan(now->voice[last]);
    if (present && c->left_out[last] == 0.0) return 0;
    for (int i = 0; i < last; i++) {
        if (isnan(now->voice[i])) continue;
        present = 1;
        if (!(flags & WHEEL_SUSPECT(i))) return 0;
    }
    return present ? SPEED_SUSPECT : 0;
}

/* Bits of what is done where the heat of a corner is not known. */
static int64_t answers(Checks *c, const Readings *now)
{
    int64_t flags = 0;
    const int64_t heard = c->t[T_HEARD];
    const int silent = heard == NEVER || now->now - heard > SILENT_US;
    if (silent) flags |= SILENT;
    if (now->speed_known) c->n[N_LAST_SPEED] = now->speed;
    for (int i = 0; i < c->corners; i++) {
        if (!silent && now->at_risk[i] && !now->heat_known[i]) {
            c->outage[i] += now->dt_s;
            flags |= HEAT_UNKNOWN;
            if (c->outage[i] > OUTAGE_S) {
                const double felt_s = OUTAGE_MEMORY * c->outage[i];
                c->doubt[i] =
                    felt_s < c->settling_s ? felt_s : c->settling_s;
                flags |= HEAT_LOST(i);
            }
            continue;
        }
        const double outage = c->outage[i] - now->dt_s / OUTAGE_MEMORY;
        c->outage[i] = outage > 0.0 ? outage : 0.0;
        if (c->doubt[i] > 0.0) {
            const double doubt = c->doubt[i] - now->dt_s;
            c->doubt[i] = doubt > 0.0 ? doubt : 0.0;
            flags |= HEAT_DOUBT(i);
        }
    }
    return flags;
}

int64_t bstm_checks_close(Checks *c, const Readings *now)
{
    int count;
    const double middle = median(now->voice, c->corners + 1, &count);
    compare_speeds(c, now, middle, count);
    hold_speeds(c, now, middle, count);
    int64_t refused = 0;
    if (now->now <= c->t[T_SUSPECT_UNTIL]) {
        refused = held_flags(c, now);
        refused |= speed_flags(c, now, refused);
    }
    hold_pressures(c, now, refused);
    compare_switch(c, now);
    compare_inertia(c, now, refused);
    int64_t flags = contradictions(c, now, count) | refused;
    flags |= speed_flags(c, now, flags);
    return flags | answers(c, now);
}
