/* Input checks, described in model/heat/checks.py; both forms do the same
 * operations in the same order. Nothing here knows Python.
 */
#ifndef BSTM_CHECKS_H
#define BSTM_CHECKS_H

#include "generated.h"

enum { MAX_TEMPERATURES = 1 + MEASURED_COUNT * MAX_CORNERS };

typedef struct {
    const PlanNumbersFloats *plan;
    const PlanNumbersInts *options;
    CheckMemoryInts *t;
    CheckMemoryFloats *m;
    int corners, temperatures;
    int speed_role[MAX_SPEEDS], pressure_role[MAX_PRESSURES];
    int acceleration_role, torque_role, temperature_role[MAX_TEMPERATURES];
} Checks;

static inline int checks_jumped(int role, double change, int64_t time_us)
{
    const Limits *l = LIMITS + role;
    return fabs(change) > l->step + l->rate_per_s * ((double)time_us * 1e-6);
}

/* Whether a value that is out of range or has jumped is accepted after all. */
int checks_admit_unusual(Checks *c, int64_t at, int role, double value);

/* Whether value is accepted as a sample of role; `since` is the stamp of last,
 * or NEVER. In the header, because nearly every sample ends here. */
static inline int checks_admit(Checks *c, int64_t at, int role, double value,
                               double last, int64_t since)
{
    c->t->last_sample = at;
    if (role < ROLE_TEMP_FL_DISC) c->t->last_of_car = at;
    if (value < LIMITS[role].low || value > LIMITS[role].high
        || (since != NEVER && checks_jumped(role, value - last, at - since)))
        return checks_admit_unusual(c, at, role, value);
    c->t->jump_stamp[role] = NEVER;
    return 1;
}

void checks_shift(Checks *c, int64_t ahead);
void checks_settle(Checks *c);

/* Check a finished step; returns bits of the flags. */
int64_t checks_close(Checks *c, const Readings *now);

#endif
