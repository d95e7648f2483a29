/* Checks of the inputs, as the pass over samples (_samples.c) uses them:
 * heat/checks.py says what they do, heat/check_layout.py how their memory is
 * laid out, heat/plausibility.py has the thresholds and the reasons.
 */
#ifndef BSTM_PLAUSIBILITY_H
#define BSTM_PLAUSIBILITY_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>

#define NEVER INT64_MIN
#define UNKNOWN (-1.0)
#define STANDING_MS 0.5
#define PARKING_MS 5.0

enum {
    MAX_CORNERS = 4, /* each has bits of its own in flags */
    MAX_VOICES = MAX_CORNERS + 1,
    MAX_PRESSURES = MAX_CORNERS + 2,
    MAX_TEMPERATURES = 1 + 6 * MAX_CORNERS
};

/* Memory in the arrays of the state, limits in those of the plan. */
typedef struct {
    const double *low, *high, *step, *rate;
    double settling_s, share;
    int roles, corners, temperatures;
    int voice_role[MAX_VOICES], pressure_role[MAX_PRESSURES];
    int temperature_role[MAX_TEMPERATURES], acceleration_role, torque_role;
    int64_t *t, *candidate_stamp, *until;
    double *n, *candidate, *outage, *doubt;
    int any_left_out;
    double *apart, *held, *held_s, *mark, *stuck, *left_out;
    double *p_held, *p_held_s, *p_mark, *p_stuck;
} Checks;

/* What the pass knows at the end of a step; nan for what is missing. */
typedef struct {
    int64_t now;
    double dt_s, speed, brake_switch, esc_active, acceleration;
    int speed_known, braking;
    double voice[MAX_VOICES], pressure[MAX_PRESSURES];
    int source[MAX_CORNERS], heat_known[MAX_CORNERS], at_risk[MAX_CORNERS];
} Readings;

/* How many times and numbers the checks of a car remember. */
ptrdiff_t bstm_checks_times(int roles);
ptrdiff_t bstm_checks_numbers(int corners, int roles);

/* Point into the memory; roles, corners, settling_s and limits are set. */
void bstm_checks_bind(Checks *c, int64_t *times, double *numbers, double dt_s);

enum { T_HEARD, T_SUSPECT_UNTIL, T_OUT_OF_RANGE, T_REFUSED, CHECK_TIMES };

static inline int bstm_apart(const Checks *c, int role, double change,
                             int64_t time_us)
{
    return fabs(change)
        > c->step[role] + c->rate[role] * ((double)time_us * 1e-6);
}

/* Whether a value that is out of range or jumped is a sample all the same. */
int bstm_checks_doubt(Checks *c, int64_t at, int role, double value);

/* Whether value is a sample of role; last counts since `since` or NEVER. In
 * the header, because nearly every sample ends here. */
static inline int bstm_checks_admit(Checks *c, int64_t at, int role,
                                    double value, double last, int64_t since)
{
    c->t[T_HEARD] = at;
    if (value < c->low[role] || value > c->high[role]
        || (since != NEVER && bstm_apart(c, role, value - last, at - since)))
        return bstm_checks_doubt(c, at, role, value);
    c->candidate_stamp[role] = NEVER;
    return 1;
}

/* The clock was set: move the axis. All is at ambient: forget outages. */
void bstm_checks_shift(Checks *c, int64_t ahead);
void bstm_checks_settle(Checks *c);

/* Judge a step that ends; returns bits of the flags. */
int64_t bstm_checks_close(Checks *c, const Readings *now);

double bstm_last_speed(const Checks *c);

#endif
